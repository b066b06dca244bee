"""Names for the compiled code of own planners: compilation, track columns, geometry."""

from pcs_racing.base.compilation import compiled as compiled
from pcs_racing.base.elementary import sine_cosine as sine_cosine
from pcs_racing.car.lidar import Lidar as Lidar
from pcs_racing.track.frenet import KAPPA as KAPPA
from pcs_racing.track.frenet import LEFT as LEFT
from pcs_racing.track.frenet import PSI as PSI
from pcs_racing.track.frenet import RIGHT as RIGHT
from pcs_racing.track.frenet import SPEED as SPEED
from pcs_racing.track.frenet import angle_between as angle_between
from pcs_racing.track.frenet import to_cartesian as to_cartesian
