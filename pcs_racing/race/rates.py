"""How long a step of the simulation is, and after how many steps the parts of a race take their turn."""

DT = 0.01  # s, one simulation step
PLAN_EVERY = 10  # steps: 10 Hz
CONTROL_EVERY = 2  # 50 Hz, as are progress and collisions
ITTC_EVERY = 5  # 20 Hz
