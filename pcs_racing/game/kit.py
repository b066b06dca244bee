"""Names for own characteristics: starts and noise of races, columns of a race's state."""

from pcs_racing.base.seeds import race_seeds as race_seeds
from pcs_racing.race.races import draw_starts as draw_starts
from pcs_racing.race.state import ITTC as ITTC
from pcs_racing.race.state import ITTC_SAMPLES as ITTC_SAMPLES
