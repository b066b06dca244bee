"""Features of ``line-ppo``, and their rows in its scratch, after the rows of the candidates.

The numbers are offsets: ``scratch[MOVE_AIR + g]`` is a feature of the move ``g``. All features are
of order one. *Near* is the nearness of the opponent: 1 next to the own car, 0 out of sight.
"""

from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SCRATCH, SPEEDS
from pcs_racing.planners.planner import offsets

SITUATION_FEATURES = {
    "own speed": "in 8 m/s",
    "own offset": "distance from the race line, m",
    "own slope": "change of this distance along the line, in 1/3",
    "own yaw rate": "in 5 rad/s",
    "own slip": "slip angle, in 1/5 rad",
    "own steering": "steering angle, as a share of its max",
    "plan offset": "distance of the last plan from the race line, m",
    "plan slope": "change of this distance along the line, in 1/3",
    "own scale": "speed scale above 1.2, in 1/3",
    "near": "nearness of the opponent",
    "near gap": "near times the gap, positive ahead, in 2 m",
    "near side": "near times the opponent's distance to the left, m",
    "near offset": "near times the opponent's distance from the race line, m",
    "near drift": "near times the change of this distance, m/s",
    "near speed": "near times the opponent's speed minus the own speed, in 3 m/s",
    "near profile": "near times the opponent's share of the profile above 1, in 1/2",
    "near bend": "near times the curvature at the opponent, in 1/2 1/m",
    "meets": "1 if the opponent is predicted",
    "right of way": "near, negative if the right of way is the own car's",
    "follows": "1 if the own car keeps a distance behind the opponent",
    "beside": "1 if the cars are side by side",
    "attacks": "1 if the lattice would attack",
    "deficit": "progress of the opponent minus the own progress, in 10 m",
    "very near": "near, within 3 m",
    "near acceleration": "near times the opponent's acceleration, in 5 m/s^2",
    "usual profile": "usual share of the opponent of the profile above 1, in 1/4",
    "risk": "style, from -1 to 1",
    "assertiveness": "style, from -1 to 1",
    "pace": "style above 1, in 1/2",
    "pace behind": "style, in 1/4",
}
"""Features of the situation before the track ahead, with meaning and unit."""

MOVE_FEATURES = {
    "length": "2.5 m over its length",
    "max curvature": "1/m",
    "mean curvature": "in 1/2 1/m",
    "change": "squared distance to the last plan, m^2",
    "deviation": "mean distance from the race line, m",
    "walls": "nearness to walls, in 1/3",
    "abreast": "distance from the line of an opponent that closes from behind, m",
    "missing air": "missing air to walls, in 1/3 m",
    "end": "end, m from the race line",
    "sideways": "end, m from the own car",
    "side": "near times the distance of the end to the left of the opponent, m",
    "distance": "near times the distance of the end from the opponent, m",
    "air": "min air to a wall, in 1/2 m",
    "gain": "share of the way that it gains on the race line, in 1/5",
}
"""Features of a move."""

SPEED_FEATURES = {
    "gain": "speed after 1.25 s minus the own speed, in 3 m/s",
    "braked": "change of the speed within 0.75 s, in 3 m/s",
    "attack": "farther drive of an attack, as a share",
    "ahead": "distance beyond the profile's, in 4 m",
    **{f"is speed {k}": f"1 for the speed {k}" for k in range(SPEEDS)},
}
"""Features of a speed."""

PAIR_FEATURES = {
    "bending": "max change of curvature in time, in 4 1/(m s)",
    "aside": "lateral acceleration, in 10 m/s^2",
    "strain": "lateral acceleration beyond the grip, m/s^2",
    "behind": "distance behind the opponent at the end, in 5 m",
    "nearness": "nearness to the opponent",
    "met": "root of the cost of meeting the opponent",
    "cost": "root of the cost above the min cost; -1 for a rejected candidate",
}
"""Features of a candidate."""

BENDS = 8  # places ahead, with the curvature of the race line
WIDTHS = 4  # places ahead, with the width of the track
OWN = len(SITUATION_FEATURES)
CONTEXT = OWN + BENDS + 2 * WIDTHS  # features of the situation
MOVE, SPEED, PAIR = len(MOVE_FEATURES), len(SPEED_FEATURES), len(PAIR_FEATURES)
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
    OWN_V,
    OWN_D,
    OWN_SLOPE,
    OWN_YAW_RATE,
    OWN_BETA,
    OWN_DELTA,
    START_D,
    START_SLOPE,
    OWN_SCALE,
    NEAR,
    NEAR_GAP,
    NEAR_SIDE,
    NEAR_D,
    NEAR_D_DOT,
    NEAR_V,
    NEAR_PROFILE,
    NEAR_BEND,
    MEETS,
    RIGHT_OF_WAY,
    FOLLOWS,
    BESIDE,
    ATTACKS,
    LEAD,
    VERY_NEAR,
    NEAR_ACCELERATION,
    USUAL,
    RISK,
    ASSERTIVENESS,
    PACE,
    PACE_BEHIND,
) = range(SITUATION, SITUATION + OWN)
BEND = SITUATION + OWN  # curvatures ahead, in 1/2 1/m
WIDTH_LEFT = BEND + BENDS  # widths ahead, m
WIDTH_RIGHT = WIDTH_LEFT + WIDTHS

(
    MOVE_LENGTH,
    MOVE_MAX_KAPPA,
    MOVE_MEAN_KAPPA,
    MOVE_CHANGE,
    MOVE_AWAY,
    MOVE_WALLS,
    MOVE_ABREAST,
    MOVE_CLOSE,
    MOVE_GOAL,
    MOVE_SIDEWAYS,
    MOVE_SIDE,
    MOVE_DISTANCE,
    MOVE_AIR,
    MOVE_GAIN,
) = range(MOVES, MOVES + MOVE * GOALS, GOALS)

(
    SPEED_GAIN,
    SPEED_BRAKED,
    SPEED_BEHIND,
    SPEED_AHEAD,
) = range(SPEEDS_AT, SPEEDS_AT + 4 * SPEEDS, SPEEDS)
SPEED_IS = SPEEDS_AT + 4 * SPEEDS  # 1 for the speed itself, in a row for each speed

(
    PAIR_KAPPA_RATE,
    PAIR_ASIDE,
    PAIR_STRAIN,
    PAIR_BEHIND,
    PAIR_NEARNESS,
    PAIR_MET,
    PAIR_ABOVE,
) = range(PAIRS, PAIRS + PAIR * CANDIDATES, CANDIDATES)
