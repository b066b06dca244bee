"""Rows of the scratch of ``line-ppo``, after the rows of the candidates.

The numbers are offsets: ``scratch[MOVE_AIR + g]`` is a feature of the move ``g``. All features are
of order one. *Near* is the nearness of the opponent: 1 beside the own car, 0 out of sight.
"""

from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SCRATCH, SPEEDS
from pcs_racing.planners.planner import offsets

OWN = 30  # features of the situation before the track ahead
BENDS = 8  # places ahead, with the curvature of the race line
WIDTHS = 4  # places ahead, with the width of the track
CONTEXT = OWN + BENDS + 2 * WIDTHS  # features of the situation
MOVE, SPEED, PAIR = 14, 8, 7  # features of a move, of a speed and of a candidate
FEATURES = MOVE + SPEED + PAIR
INNER, UNITS = 48, 32  # units of the context's layer, and of the candidates' layer

(
    _,
    NEARNESS,  # nearness of each candidate to the opponent
    MET,  # its cost of meeting the opponent
    SITUATION,  # features, in this order
    MOVES,
    SPEEDS_AT,
    PAIRS,
    INNER_AT,  # layers of the network
    HIDDEN,
    LINEAR,
    OF_MOVES,  # parts of the first layer of each move and speed
    OF_SPEEDS,
    SCORES,
    STYLED,  # parameters of the candidates for the style
) = offsets(
    SCRATCH,
    CANDIDATES,
    CANDIDATES,
    CONTEXT,
    MOVE * GOALS,
    SPEED * SPEEDS,
    PAIR * CANDIDATES,
    INNER,
    UNITS,
    FEATURES,
    (UNITS + 1) * GOALS,
    (UNITS + 1) * SPEEDS,
    UNITS,
)

(
    OWN_V,  # speed, in 8 m/s
    OWN_D,  # distance from the race line, m
    OWN_SLOPE,  # change of this distance along the line, in 1/3
    OWN_YAW_RATE,  # in 5 rad/s
    OWN_BETA,  # slip angle, in 1/5 rad
    OWN_DELTA,  # steering angle, as a share of its max
    START_D,  # distance of the last plan from the race line, m
    START_SLOPE,  # change of this distance along the line, in 1/3
    OWN_SCALE,  # speed scale above 1.2, in 1/3
    NEAR,
    NEAR_GAP,  # near times the gap, positive ahead, in 2 m
    NEAR_SIDE,  # near times the opponent's distance to the left, m
    NEAR_D,  # near times the opponent's distance from the race line, m
    NEAR_D_DOT,  # near times the change of this distance, m/s
    NEAR_V,  # near times the opponent's speed minus the own speed, in 3 m/s
    NEAR_PROFILE,  # near times the opponent's share of the profile above 1, in 1/2
    NEAR_BEND,  # near times the curvature at the opponent, in 1/2 1/m
    MEETS,  # 1 if the opponent is predicted
    RIGHT_OF_WAY,  # near, negative if the right of way is the own car's
    FOLLOWS,  # 1 if the own car keeps a distance behind the opponent
    BESIDE,  # 1 if the cars are side by side
    ATTACKS,  # 1 if the lattice would attack
    LEAD,  # progress of the opponent minus the own progress, in 10 m
    VERY_NEAR,  # near, within 3 m
    NEAR_ACCELERATION,  # near times the opponent's acceleration, in 5 m/s^2
    USUAL,  # usual share of the opponent of the profile above 1, in 1/4
    RISK,  # style, from -1 to 1
    ASSERTIVENESS,  # style, from -1 to 1
    PACE,  # style above 1, in 1/2
    PACE_BEHIND,  # style, in 1/4
) = range(SITUATION, SITUATION + OWN)
BEND = SITUATION + OWN  # curvatures ahead, in 1/2 1/m
WIDTH_LEFT = BEND + BENDS  # widths ahead, m
WIDTH_RIGHT = WIDTH_LEFT + WIDTHS

(
    MOVE_LENGTH,  # 2.5 m over its length
    MOVE_MAX_KAPPA,  # max curvature, 1/m
    MOVE_MEAN_KAPPA,  # mean curvature, in 1/2 1/m
    MOVE_CHANGE,  # squared distance to the last plan, m^2
    MOVE_AWAY,  # mean distance from the race line, m
    MOVE_WALLS,  # nearness to walls, in 1/3
    MOVE_ABREAST,  # distance from the line of an opponent that closes from behind, m
    MOVE_CLOSE,  # missing air to walls, in 1/3 m
    MOVE_GOAL,  # end, m from the race line
    MOVE_SIDEWAYS,  # end, m from the own car
    MOVE_SIDE,  # near times the distance of the end to the left of the opponent, m
    MOVE_DISTANCE,  # near times the distance of the end from the opponent, m
    MOVE_AIR,  # min air to a wall, in 1/2 m
    MOVE_GAIN,  # share of the way that it gains on the race line, in 1/5
) = range(MOVES, MOVES + MOVE * GOALS, GOALS)

(
    SPEED_GAIN,  # speed after 1.25 s minus the own speed, in 3 m/s
    SPEED_BRAKED,  # change of the speed within 0.75 s, in 3 m/s
    SPEED_BEHIND,  # share by which an attack drives farther
    SPEED_AHEAD,  # distance beyond the profile's, in 4 m
) = range(SPEEDS_AT, SPEEDS_AT + 4 * SPEEDS, SPEEDS)
SPEED_IS = SPEEDS_AT + 4 * SPEEDS  # 1 for the speed itself, in a row for each speed

(
    PAIR_KAPPA_RATE,  # max change of curvature in time, in 4 1/(m s)
    PAIR_ASIDE,  # lateral acceleration, in 10 m/s^2
    PAIR_STRAIN,  # lateral acceleration beyond the grip, m/s^2
    PAIR_BEHIND,  # distance behind the opponent at the end, in 5 m
    PAIR_NEARNESS,  # nearness to the opponent
    PAIR_MET,  # root of the cost of meeting the opponent
    PAIR_ABOVE,  # root of the cost above the min cost; -1 for a rejected candidate
) = range(PAIRS, PAIRS + PAIR * CANDIDATES, CANDIDATES)
