"""Environments for reinforcement learning at the strategy level and the control level.

Importing :mod:`pcs_racing` registers them with Gymnasium and PettingZoo. The module of an
environment is imported when the environment is made.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
