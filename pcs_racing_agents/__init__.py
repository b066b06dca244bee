"""Policies and agents for :mod:`pcs_racing`: archives, strategies and tournaments.

The folders in the order of the method: ``policies`` (search of archives), ``trees``, ``solvers``,
``networks``, ``agents``, ``learning``, ``tournament``. The other folders serve it: ``study``,
``watch``, ``base`` and ``cli``.

Examples
--------
>>> import pcs_racing_agents
>>> agent = pcs_racing_agents.make("cfr-argmax")
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
