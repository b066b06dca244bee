"""Names for own games and characteristics: rules, starts, noise and states of races."""

from pcs_racing.base.seeds import race_seeds as race_seeds
from pcs_racing.race.config import CONTROL_EVERY as CONTROL_EVERY
from pcs_racing.race.config import DT as DT
from pcs_racing.race.config import Rules as Rules
from pcs_racing.race.driving import advance as advance
from pcs_racing.race.driving import pad_parameters as pad_parameters
from pcs_racing.race.races import RaceSetup as RaceSetup
from pcs_racing.race.races import draw_starts as draw_starts
from pcs_racing.race.races import start_races as start_races
from pcs_racing.race.state import ITTC as ITTC
from pcs_racing.race.state import ITTC_SAMPLES as ITTC_SAMPLES
from pcs_racing.race.state import RaceState as RaceState
