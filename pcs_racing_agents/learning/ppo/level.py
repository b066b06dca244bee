"""What there is to learn: the two levels behind one protocol."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from pcs_racing.base.errors import InputError
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing_agents.learning.ppo.scores import Cell, Score
from pcs_racing_agents.learning.ppo.settings import DuelSettings, Settings
from pcs_racing_agents.networks.layers import Layers

__all__ = ["Level", "make_level"]


class Level(Protocol):
    """What there is to learn: :class:`pcs_racing_agents.learning.ppo.duels.DuelLevel` or its sibling for driving."""

    activation: str
    limit: float
    unit: str

    @property
    def default_name(self) -> str:
        """Name under which the result is looked for."""

    @property
    def identity(self) -> dict[str, Any]:
        """What the results depend on beside the settings."""

    def parts(self) -> Sequence[BatchVectorEnv]:
        """Make the environments to learn from."""

    def judge(self, layers: Layers) -> dict[Cell, Score]:
        """Race without exploring, and count what comes of it."""

    def save(self, layers: Layers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy."""


def make_level(settings: Settings, *, archive: PolicyArchive | None = None, rules: GameConfig | None = None) -> Level:
    """Load circuits, archive and opponents, and check that they fit together.

    Parameters
    ----------
    settings : Settings
    archive, rules : optional
        Those of the game, in place of what the settings of a duel name.

    Raises
    ------
    InputError
        If one of them is unknown, or they do not fit, or a drive is given an archive or the rules of a game.
    """
    if isinstance(settings, DuelSettings):
        from pcs_racing_agents.learning.ppo.duels import duel_level

        return duel_level(settings, archive, rules)
    if archive is not None or rules is not None:
        raise InputError("settings of level drive know no archive and no game; give settings of level duel")
    from pcs_racing_agents.learning.ppo.drives import drive_level

    return drive_level(settings)  # type: ignore[arg-type]
