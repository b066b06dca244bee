"""Archive and rules of the game that an agent is made for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.identity import GameIdentity, check_same_game, game_identity
from pcs_racing.game.moves import move_names, move_table
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import RaceConfig


@dataclass(frozen=True, eq=False)
class GameSpec:
    """An archive and the rules of a game, without a track."""

    archive: PolicyArchive  #: Archive with the axes of the game.
    config: GameConfig  #: Rules with the move "stay", so every agent can keep its policy.
    offered: int  #: Number of first moves that the rules offer: all, or all but "stay".

    @cached_property
    def identity(self) -> GameIdentity:
        """Identity of the game, with "stay" among its moves."""
        return game_identity(self)

    @cached_property
    def moves(self) -> tuple[str, ...]:
        """Names of the M moves; the last one is "stay"."""
        return move_names(self.archive, self.config.epsilon)

    @cached_property
    def table(self) -> NDArray[np.int64]:
        """Policy that each move leads to from every policy, shape (K, M)."""
        return move_table(self.archive, self.config.epsilon)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the D elements of an observation."""
        return self.identity.elements

    @property
    def race(self) -> str:
        """Name of the race's rules."""
        return self.config.race.name

    def move(self, name: str) -> int:
        """Return the index of a move by its name, with or without spaces."""
        wanted = "".join(str(name).split())
        for i, move in enumerate(self.moves):
            if "".join(move.split()) == wanted:
                return i
        raise InputError(f"{name!r} is no move; the moves are {', '.join(self.moves)}")

    def check_fits(self, game: RaceGame, agent: str) -> None:
        """Check that a game has this archive, the same moves and the same observations."""
        check_same_game(
            self.identity, make_game_spec(game.archive, game.config).identity, f"agent {agent!r}"
        )


def training_text(facts: Mapping[str, Any]) -> str:
    """Return the facts about an agent's training as text for reports."""
    return ", ".join(f"{key} {value}" for key, value in facts.items()) or "not said"


def shipped_name(spec: GameSpec, kind: str, known: Sequence[str], agent: str, how: str) -> str:
    """Return ``ARCHIVE-RACE-KIND``, the name of a shipped training result for a game."""
    name = f"{spec.archive.name}-{spec.race}-{kind}"
    if name not in known:
        end = f"-{spec.race}-{kind}"
        other = next((one.removesuffix(end) for one in known if one.endswith(end)), "")
        hint = f"give archive={other!r}, or " if other else ""
        raise UnknownNameError(
            f"{agent} needs {name!r}, which is not shipped (there are:"
            f" {', '.join(known) or 'none'}); {hint}{how}"
        )
    return name


def make_game_spec(
    archive: PolicyArchive | str | Path = "default",
    rules: GameConfig | RaceConfig | str | Path = "paper",
) -> GameSpec:
    """Return the spec of a game from an archive and rules, or their names.

    Parameters
    ----------
    archive : PolicyArchive, str or path
        The archive, its name or its folder.
    rules : GameConfig, RaceConfig, str or path
        Rules, as in :func:`pcs_racing.make_game`.
    """
    config = load_game_config(rules)
    policies = load_archive(archive)
    if config.characteristics is not None and config.characteristics != policies.characteristics:
        policies = policies.project(config.characteristics)
    offered = len(move_names(policies, config.epsilon)) - (not config.stay)
    return GameSpec(policies, replace(config, stay=True), offered)
