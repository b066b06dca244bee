"""Rows of the scratch in which the candidates of a plan are laid, predicted and weighed.

The numbers are offsets: ``scratch[MIN_AIR + g]`` is the least air of the move ``g``.
"""

ACROSS = 8
DISTANCES = 2
GOALS = ACROSS * DISTANCES
SEGMENTS = 8  # segments of each move, which is measured at their ends
SPEEDS = 4
CANDIDATES = GOALS * SPEEDS
HORIZON_STEPS = 10
PROFILES, OPPONENT = SPEEDS + 1, SPEEDS  # number of profiles; index of the opponent's profile
METRES = 64  # max length of the profiles, m; they begin a metre behind the car

# A number for each move.
(
    GOAL_D,  # end of the move, m from the race line
    LENGTH,  # m
    A,  # coefficients of its cubic, `pcs_racing.planners.candidates.lateral`
    B,
    KAPPA,  # curvature at the last measured point, 1/m
    MAX_KAPPA,  # max curvature, 1/m
    MEAN_KAPPA,  # mean curvature, 1/m
    KAPPA_RATE,  # max change of curvature, 1/m^2
    SIDEWAYS,  # max lateral acceleration, m/s^2
    STRETCH,  # length relative to the race line
    SLOWED,  # share of the speed that its bends leave
    LINE_AIR,  # min air along the race line, m
    MOVE_AIR,  # min air along the move, m
    WALL_COST,  # nearness to walls
    MIN_AIR,  # min air to a wall, m
    AWAY,  # distance from the race line, twice the mean, m
    CHANGE,  # squared distance to the last plan, m^2
    ABREAST,  # distance of its end from the opponent's line, m
    CLOSE,  # missing air along the move, m
    BASE,  # cost independent of the speed
) = range(0, 20 * GOALS, GOALS)
# A number for each candidate.
(
    ASIDE,  # lateral acceleration, m/s^2
    BEHIND,  # distance behind the opponent at the end, m
    MIN_COST,  # cost without the opponent
    COSTS,  # cost
) = range(20 * GOALS, 20 * GOALS + 4 * CANDIDATES, CANDIDATES)
# A number for each speed.
DRIVEN = COSTS + CANDIDATES  # distance within the prediction, m
FAST = DRIVEN + SPEEDS  # top speed, m/s
BRAKED = FAST + SPEEDS  # change of the speed, m/s
# A number for each end of a segment of each move.
POINT_X = BRAKED + SPEEDS  # m
POINT_Y = POINT_X + SEGMENTS * GOALS  # m
AIR = POINT_Y + SEGMENTS * GOALS  # distance to the next wall, m
# Profiles: a row for each metre ahead.
SQUARE = AIR + SEGMENTS * GOALS  # squared target speeds, at each speed and for the opponent
RIGHT = SQUARE + PROFILES * METRES  # the track's edges, m
LEFT = RIGHT + METRES
SCALE = LEFT + METRES  # speed scale of each profile
# Predictions: present state at each speed, then a row for each step.
NOW_S = SCALE + PROFILES  # arc length, m
NOW_V = NOW_S + SPEEDS  # speed, m/s
OWN_S = NOW_V + SPEEDS  # own arc lengths at each speed, m
OWN_V = OWN_S + SPEEDS * HORIZON_STEPS  # own speeds, m/s
OWN_LOW = OWN_V + SPEEDS * HORIZON_STEPS  # room across the track to the right and left, m
OWN_HIGH = OWN_LOW + SPEEDS * HORIZON_STEPS
OPP_S = OWN_HIGH + SPEEDS * HORIZON_STEPS  # the opponent's arc length, m
OPP_D = OPP_S + HORIZON_STEPS  # its distance from the race line, m
OPP_V = OPP_D + HORIZON_STEPS  # its speed, m/s
SCRATCH = OPP_V + HORIZON_STEPS
"""Size of the scratch."""
