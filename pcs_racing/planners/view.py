"""Inputs and outputs of a planner: the numbers of its view, and the columns of its path."""

VIEW: dict[str, str] = {
    "TIME": "time since the start of the race, s",
    "X": "own position, m",
    "Y": "own position, m",
    "DELTA": "own steering angle, rad",
    "V": "own speed, m/s",
    "PSI": "own heading, rad",
    "PSI_DOT": "own yaw rate, rad/s",
    "BETA": "own slip angle, rad; the car moves along PSI + BETA",
    "S": "own arc length on the race line, m",
    "D": "own distance from the race line, m, positive to the left",
    "OPP_X": "opponent's position, m",
    "OPP_Y": "opponent's position, m",
    "OPP_V": "opponent's speed, m/s",
    "OPP_PSI": "opponent's heading, rad",
    "OPP_BETA": "opponent's slip angle, rad",
    "OPP_S": "opponent's arc length on the race line, m",
    "OPP_D": "opponent's distance from the race line, m",
    "OPP_D_DOT": "how fast that distance grows, m/s",
    "GAP": "opponent's progress minus own, m; positive when the opponent leads",
    "LENGTH": "own car's length, m",
    "WIDTH": "own car's width, m",
    "WHEELBASE": "own wheelbase, m",
    "STEER_MAX": "own largest steering angle, rad",
    "UNDERSTEER": "extra steering that the own car needs per lateral acceleration, rad s^2/m",
    "UNDERSTEER_GAIN": "how that grows with the longitudinal acceleration, rad s^4/m^2",
    "REAR_SLIP": "slip angle of the own rear tyres per lateral acceleration, rad s^2/m",
    "REAR_AXLE": "own distance from the centre of gravity to the rear axle, m",
    "GRIP_USE": "share of the own tyres' usable grip per lateral acceleration, s^2/m; 0 if linear",
    "OPP_LENGTH": "opponent's length, m",
    "OPP_WIDTH": "opponent's width, m",
    "SPEED_LOW": "own speed scale at pace 0 in this race",
    "SPEED_HIGH": "own speed scale at pace 1 in this race, within the grip of the own tyres",
}
"""Elements of a planner's view by name, with meaning and unit; the order is the index."""

VIEW_SIZE = len(VIEW)
(
    TIME,
    OWN_X,
    OWN_Y,
    OWN_DELTA,
    OWN_V,
    OWN_PSI,
    OWN_PSI_DOT,
    OWN_BETA,
    OWN_S,
    OWN_D,
    OPP_X,
    OPP_Y,
    OPP_V,
    OPP_PSI,
    OPP_BETA,
    OPP_S,
    OPP_D,
    OPP_D_DOT,
    GAP,
    OWN_LENGTH,
    OWN_WIDTH,
    WHEELBASE,
    STEER_MAX,
    UNDERSTEER,
    UNDERSTEER_GAIN,
    REAR_SLIP,
    REAR_AXLE,
    GRIP_USE,
    OPP_LENGTH,
    OPP_WIDTH,
    SPEED_LOW,
    SPEED_HIGH,
) = range(VIEW_SIZE)

PATH_POINTS = 12
"""Number of points of a planned path: rows of x, y (m), speed (m/s) and curvature (1/m)."""

PATH_X, PATH_Y, PATH_SPEED, PATH_KAPPA = range(4)
PATH_COLUMNS = 4
