"""Names for own games and characteristics: rules, starts, noise and states of races."""

from pcs_racing.base.seeds import race_seeds as race_seeds
from pcs_racing.race.config import CONTROL_EVERY as CONTROL_EVERY, DT as DT, Rules as Rules
from pcs_racing.race.driving import advance as advance, pad_parameters as pad_parameters
from pcs_racing.race.races import (
    RaceSetup as RaceSetup,
    draw_starts as draw_starts,
    start_races as start_races,
)
from pcs_racing.race.state import ITTC as ITTC, ITTC_SAMPLES as ITTC_SAMPLES, RaceState as RaceState
