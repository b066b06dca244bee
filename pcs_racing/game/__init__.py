"""The game on top of the race: characteristics, archives of policies, moves in Policy
Characteristic Space.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
