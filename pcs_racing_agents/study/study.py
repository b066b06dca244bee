"""A study and its folder: the context of its stages."""

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import build, parse_agent
from pcs_racing_agents.jobs.progress import Progress, show_progress
from pcs_racing_agents.study.config import BEST_OPEN_LOOP, StudyConfig

NETWORK_AGENTS = {"cfr-argmax": "regret", "cfr-regret-matching": "regret", "nash": "nash", "ppo": "ppo"}
"""Targets of the networks of the zoo's agents."""

SET_AGENTS = ("robust", "psro", "self-play")
"""Agents of the zoo with a set of networks."""


@dataclass(frozen=True)
class Study:
    """A study with its configuration and folder."""

    config: StudyConfig
    folder: Path
    executor: Executor | None = None  #: Runs the jobs.
    quiet: bool = False  #: Show no progress.

    @cached_property
    def archive(self) -> PolicyArchive:
        """The archive that was made, or the one that the configuration names."""
        return load_archive(self.config.archive if self.config.synthesis is None else self.folder / "archive")

    @cached_property
    def setting(self) -> Setting:
        """Archive and rules, as agents know them."""
        return make_setting(self.archive, self.config.game)

    def game(self, track: str) -> RaceGame:
        """Return the game on a circuit."""
        return make_game(self.track(track), self.archive, self.config.game)

    def games(self) -> list[RaceGame]:
        """Return the games on the circuits of training."""
        return [self.game(track) for track in self.config.circuits]

    def tree_game(self, track: str) -> RaceGame:
        """Return the game of the trees on a circuit: without "stay", which would make them six times as large."""
        return make_game(self.track(track), self.archive, self.config.game, stay=False)

    def track(self, name: str) -> Track:
        """Return a circuit."""
        return load_track(name)

    def network(self, kind: str) -> Path:
        """Return the folder of a network, or of a set of networks, that this study trains."""
        return self.folder / "networks" / kind

    def agent(self, name: str) -> Competitor:
        """Return an agent or driver by name, with the networks and fits of this study where it has them.

        In addition to the names of the zoo there are those of the configuration's ``responses``: learned responses
        without a margin.
        """
        seed = self.config.seed
        if name in self.config.responses:
            agent = build("cfr-argmax", self.setting, seed=seed, network=self.network(name))
            assert isinstance(agent, Agent)
            return Agent(name, agent.strategy, agent.setting, agent.seed, agent.facts)
        # What this study has trained goes before what is shipped; a stage that did not run leaves the shipped one.
        options: dict[str, Any] = {}
        kind = NETWORK_AGENTS.get(name)
        if name == "adaptive" and self.config.responses:
            options = {"network": self.network(self.config.responses[0]), "open_loop": self.agent("best-fixed")}
        elif kind is not None and self.network(kind).is_dir():
            options = {"network": self.network(kind)}
        elif name in SET_AGENTS and self.network(name).is_dir():
            options = {"networks": self.network(name)}
        elif name in BEST_OPEN_LOOP:
            options = {"fit": self.folder / "open-loop" / f"{name}.yaml"}
        make = build if options else parse_agent
        return make(name, self.setting, seed=seed, **options)

    def progress(self, unit: str) -> Progress | None:
        """Return a progress function that updates a line on stderr; None if the study is quiet."""
        return None if self.quiet else show_progress(unit)
