"""The paper's study in stages: archive, game trees, networks, agents, races and a report."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
