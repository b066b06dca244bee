"""What a study depends on, as data."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import ConfigError
from pcs_racing.game.archive_files import list_archives
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.race.config import load_race_config
from pcs_racing_agents.jobs.configuration import check_wholes, load_settings
from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
from pcs_racing_agents.learning.responses.learner import load_response_settings
from pcs_racing_agents.networks.targets import get_target
from pcs_racing_agents.synthesis.config import load_archive_config

__all__ = ["BEST_BLIND", "StudyConfig", "load_study_config"]

BEST_BLIND = ("best-fixed", "best-schedule")
"""Agents that never look at the race, found on training races: the best policy to walk to, the best plan of moves."""


@dataclass(frozen=True)
class StudyConfig:
    """Everything that decides the results of a study.

    Attributes
    ----------
    race : str
        Rules: a preset's name or a YAML file.
    epsilon : float
        How far a move goes, in the archive's normalised units.
    moves : int
        Moves of each car in a game.
    step_seconds : float
        Time between two moves, s.
    synthesis : str or None
        Configuration of the archive's synthesis; None takes the archive that is named instead of making one.
    archive : str
        Shipped archive, or folder of one, where none is made.
    circuits : tuple of str
        Where trees are played and answers are learned.
    pairs : int
        Game trees on each circuit; 0 for none.
    seeds : int
        Seeds of the noise in each tree; 1 where the races have no noise.
    training : str
        Settings of the networks' training.
    targets : tuple of str
        What networks are trained to say, in this order.
    responses : tuple of str
        Settings of the answers to learn: names of :class:`pcs_racing_agents.learning.responses.ResponseSettings`.
    response_pool : tuple of str
        Opponents that answers are learned against.
    fitting_games : int
        Games against each opponent on each circuit, for the choice of the best blind strategies; even.
    fixed_targets : int
        Policies among which the best one to walk to is chosen, spread over the archive; 0 for all.
    fitting_opponents : tuple of str
        Opponents in those games.
    tracks : tuple of str
        Circuits of the table.
    opponents : tuple of str
        Opponents of the table.
    arms : tuple of str
        Agents of the table; the first is what the others are compared with. With both of :data:`BEST_BLIND` among them
        the table has the adaptivity gain; one without the other is refused.
    best : str
        Our best agent among them.
    egos, variants, lines : int
        Start policies of the ego, variants of the opponent, and start lines of each cell; from both sides.
    further_tracks, further_opponents, further_arms : tuple of str
        The second table has these beside those of the first.
    further_lines : int
        Start lines of its cells; 0 for no second table.
    ppo : str or None
        Settings, of level duel, of a PPO baseline that is trained along the way on the study's circuits, with its
        archive and by its rules; None for none. Without it the agent "ppo" is the shipped one.
    rivals : tuple of str
        Agents that play all against all for the ratings.
    rival_races : int
        Races of each pair of them on each circuit of the table; even.
    seed : int
        Root of everything that is drawn.

    Raises
    ------
    ConfigError
        If a value is impossible.
    """

    race: str = "paper"
    epsilon: float = 0.5
    moves: int = 4
    step_seconds: float = 8.0
    synthesis: str | None = None
    archive: str = "default"
    circuits: tuple[str, ...] = ("Tarnfjord",)
    pairs: int = 12
    seeds: int = 1
    training: str = "study"
    targets: tuple[str, ...] = ("regret", "normalised", "advantage", "static-q")
    responses: tuple[str, ...] = ()
    response_pool: tuple[str, ...] = ("never-switch", "random-moves")
    fitting_games: int = 100
    fixed_targets: int = 16
    fitting_opponents: tuple[str, ...] = ("never-switch",)
    tracks: tuple[str, ...] = ("Tarnfjord",)
    opponents: tuple[str, ...] = ("never-switch", "random-policy", "lane-switcher")
    arms: tuple[str, ...] = ("never-switch", "best-fixed", "best-schedule", "cfr-argmax")
    best: str = "cfr-argmax"
    egos: int = 20
    variants: int = 20
    lines: int = 5
    further_tracks: tuple[str, ...] = ()
    further_opponents: tuple[str, ...] = ()
    further_arms: tuple[str, ...] = ()
    further_lines: int = 0
    ppo: str | None = None
    rivals: tuple[str, ...] = ()
    rival_races: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        for key in ("race", "archive", "training", "best", *(("synthesis",) if self.synthesis is not None else ())):
            if not isinstance(getattr(self, key), str):
                raise ConfigError(f"{key} is {getattr(self, key)!r}; it must be a name or a path")
        self.game  # noqa: B018 - checks race and epsilon
        for key in ("circuits", "targets", "response_pool", "fitting_opponents", "tracks", "opponents", "arms"):
            self._check_names(key, 1)
        for key in ("responses", "rivals", "further_tracks", "further_opponents", "further_arms"):
            self._check_names(key, 0)
        for name in self.targets:
            get_target(name)
        for name in self.responses:
            load_response_settings(name)
        if self.synthesis is not None:
            load_archive_config(self.synthesis)
        elif self.archive not in list_archives() and not os.path.isdir(self.archive):
            raise ConfigError(
                f"archive is {self.archive!r}; it must be a folder or one of {', '.join(list_archives())}"
            )
        if self.ppo is not None and load_ppo_settings(self.ppo).level != "duel":  # type: ignore[attr-defined]
            raise ConfigError(f"ppo is {self.ppo!r}; these are no settings of level duel")
        missing = [name for name in BEST_BLIND if name not in self.arms]
        if len(missing) == 1:
            there = next(name for name in BEST_BLIND if name in self.arms)
            raise ConfigError(
                f"arms hold {there!r} but not {missing[0]!r}; name both or neither: the adaptivity gain is over the "
                "one that won more training races"
            )
        if self.best not in self.arms:
            raise ConfigError(f"best is {self.best!r}; it must be one of the arms, {', '.join(self.arms)}")
        check_wholes(
            self,
            pairs=(0, 100_000),
            seeds=(1, 1000),
            fitting_games=(2, 1_000_000),
            fixed_targets=(0, 1_000_000),
            egos=(2, 1000),
            variants=(2, 1000),
            lines=(1, 1000),
            further_lines=(0, 1000),
            rival_races=(2, 2000),
            seed=(0, 2**62),
        )
        if 0 < self.pairs * len(self.circuits) < 3:
            raise ConfigError(
                f"pairs is {self.pairs}; networks need at least 3 trees: to learn, to stop by, to judge by"
            )

    def _check_names(self, key: str, least: int) -> None:
        names = getattr(self, key)
        if not isinstance(names, tuple) or len(names) < least or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"{key} is {names!r}; it must be a list of names")
        if len(set(names)) < len(names):
            raise ConfigError(f"{key} are {', '.join(names)}; name each once")

    @property
    def tables(self) -> dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], int]]:
        """Circuits, opponents, arms and start lines of each table, by name."""
        tables = {"main": (self.tracks, self.opponents, self.arms, self.lines)}
        if self.further_lines:
            tables["further"] = (
                (*self.tracks, *(name for name in self.further_tracks if name not in self.tracks)),
                (*self.opponents, *(name for name in self.further_opponents if name not in self.opponents)),
                (*self.arms, *(name for name in self.further_arms if name not in self.arms)),
                self.further_lines,
            )
        return tables

    @property
    def every_track(self) -> tuple[str, ...]:
        """All circuits that are used."""
        return tuple(dict.fromkeys((*self.circuits, *self.tracks, *self.further_tracks)))

    @property
    def every_arm(self) -> tuple[str, ...]:
        """All agents of the tables."""
        return tuple(dict.fromkeys((*self.arms, *self.further_arms)))

    @property
    def game(self) -> GameConfig:
        """Rules of the game; with the move "stay" if the race's rules have it."""
        race = load_race_config(self.race)
        return load_game_config(race, epsilon=self.epsilon, moves=self.moves, step_seconds=self.step_seconds)


def load_study_config(source: str | Path | StudyConfig | None = None, **changes: Any) -> StudyConfig:
    """Return a configuration from a shipped one's name, a YAML file or a configuration, with some fields changed.

    Raises
    ------
    ConfigError
        If a key is unknown or a value impossible.
    UnknownNameError
        If a name stands for nothing.
    """
    return load_settings("study", StudyConfig(), source, **changes)
