"""Rows of the scratch for the candidates of a plan: their moves, predictions and costs.

The numbers are offsets: ``scratch[MIN_AIR + g]`` is the least air of the move ``g``.
"""

from pcs_racing.planners.planner import offsets

ACROSS = 8
DISTANCES = 2
GOALS = ACROSS * DISTANCES
SEGMENTS = 8  # segments of each move, which is measured at their ends
SPEEDS = 4
CANDIDATES = GOALS * SPEEDS
HORIZON_STEPS = 10
PROFILES, OPPONENT = SPEEDS + 1, SPEEDS  # number of profiles; index of the opponent's profile
METRES = 64  # max length of the profiles, m; they begin a metre behind the car

(
    # A number for each move.
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
    # A number for each candidate.
    ASIDE,  # lateral acceleration, m/s^2
    BEHIND,  # distance behind the opponent at the end, m
    MIN_COST,  # cost without the opponent
    COSTS,  # cost
    # A number for each speed.
    DRIVEN,  # distance within the prediction, m
    FAST,  # top speed, m/s
    BRAKED,  # change of the speed, m/s
    # A number for each end of a segment of each move.
    POINT_X,  # m
    POINT_Y,  # m
    AIR,  # distance to the next wall, m
    # Profiles: a row for each metre ahead.
    SQUARE,  # squared target speeds, at each speed and for the opponent
    RIGHT,  # the track's edges, m
    LEFT,
    SCALE,  # speed scale of each profile
    # Predictions: present state at each speed, then a row for each step.
    NOW_S,  # arc length, m
    NOW_V,  # speed, m/s
    OWN_S,  # own arc lengths at each speed, m
    OWN_V,  # own speeds, m/s
    OWN_LOW,  # room across the track to the right and left, m
    OWN_HIGH,
    OPP_S,  # the opponent's arc length, m
    OPP_D,  # its distance from the race line, m
    OPP_V,  # its speed, m/s
    SCRATCH,  # size of the scratch
) = offsets(
    *20 * [GOALS],
    *4 * [CANDIDATES],
    *3 * [SPEEDS],
    *3 * [SEGMENTS * GOALS],
    PROFILES * METRES,
    METRES,
    METRES,
    PROFILES,
    SPEEDS,
    SPEEDS,
    *4 * [SPEEDS * HORIZON_STEPS],
    *3 * [HORIZON_STEPS],
)
