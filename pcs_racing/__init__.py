"""Head-to-head autonomous racing in Policy Characteristic Space.

Examples
--------
>>> import pcs_racing
>>> track = pcs_racing.load_track("Tarnfjord")
>>> calm, bold = (pcs_racing.racer(f"lattice:pace={pace}") for pace in (0.3, 0.8))
>>> result = pcs_racing.run_races(track, [calm] * 10, bold, "paper", seed=1)
>>> result.winner.shape
(10,)
"""

import lazy_loader

from pcs_racing.envs.registration import register_environments

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

register_environments()
