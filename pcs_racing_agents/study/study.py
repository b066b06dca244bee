"""A study: its configuration and folder, as the context of its stages."""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.agents.zoo import build, parse_agent
from pcs_racing_agents.base.progress import Progress, show_progress
from pcs_racing_agents.study.config import BEST_OPEN_LOOP, StudyConfig

NETWORK_AGENTS = {
    "cfr-argmax": "regret",
    "cfr-regret-matching": "regret",
    "nash": "nash",
    "ppo": "ppo",
}
"""Targets of the networks of the zoo's agents."""


@dataclass(frozen=True)
class Study:
    """A study with its configuration and folder."""

    config: StudyConfig
    folder: Path
    executor: Executor | None = None  #: Executor of the jobs.
    quiet: bool = False  #: No progress output.

    @cached_property
    def archive(self) -> PolicyArchive:
        """Archive of the study's synthesis, or the archive named by the configuration."""
        made = self.config.synthesis is not None
        return load_archive(self.folder / "archive" if made else self.config.archive)

    @cached_property
    def spec(self) -> GameSpec:
        """Archive and rules, in the form for agents."""
        return make_game_spec(self.archive, self.config.game)

    def game(self, track: str) -> RaceGame:
        """Return the game on a track."""
        return make_game(load_track(track), self.archive, self.config.game)

    def games(self) -> list[RaceGame]:
        """Return the games on the training tracks."""
        return [self.game(track) for track in self.config.learning.tracks]

    def network(self, kind: str) -> Path:
        """Return the folder of a network (or set of networks) trained by this study."""
        return self.folder / "networks" / kind

    def agent(self, name: str) -> Competitor:
        """Return an agent or planner by name, with this study's networks and fits where available.

        The names are the zoo's names and the names in the configuration's ``responses``.
        """
        seed, responses = self.config.seed, self.config.learning.responses
        if name in responses:
            agent = build("cfr-argmax", self.spec, seed=seed, network=self.network(name))
            assert isinstance(agent, Agent)
            return replace(agent, name=name)
        # Networks and fits of this study, once trained, replace shipped networks and fits.
        options: dict[str, Any] = {}
        kind = NETWORK_AGENTS.get(name)
        if kind is not None and self.network(kind).is_dir():
            options = {"network": self.network(kind)}
        elif name in BEST_OPEN_LOOP:
            options = {"fit": self.folder / "open-loop" / f"{name}.yaml"}
        make = build if options else parse_agent
        return make(name, self.spec, seed=seed, **options)

    def progress(self, unit: str) -> Progress | None:
        """Return a progress function that updates a line on stderr; None if ``quiet``."""
        return None if self.quiet else show_progress(unit)
