"""A study: its configuration and folder, as the context of its stages."""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.make import make_game
from pcs_racing.game.players import Competitor, competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.progress import Progress, show_progress
from pcs_racing_agents.study.config import BASELINES, StudyConfig

NETWORKS = {
    "cfr-argmax": "regret",
    "cfr-regret-matching": "regret",
    "nash": "nash",
}
"""Kinds of networks of the zoo's agents."""


@dataclass(frozen=True)
class Study:
    """A study with its configuration and folder."""

    config: StudyConfig
    folder: Path
    executor: Executor | None = None  #: Executor of the jobs.
    quiet: bool = False  #: No progress output.

    @cached_property
    def archive(self) -> PolicyArchive:
        """Policy archive."""
        return load_archive(self.config.archive)

    @cached_property
    def spec(self) -> GameSpec:
        """Archive and rules, in the form for agents."""
        return make_game_spec(self.archive, self.config.game)

    def game(self, track: Track | str) -> RaceGame:
        """Return the game on a track."""
        return make_game(track, self.archive, self.config.game)

    def games(self) -> list[RaceGame]:
        """Return the games on the training tracks."""
        return [self.game(track) for track in self.config.learning.tracks]

    def network(self, kind: str) -> Path:
        """Return the folder of a network (or set of networks) trained by this study."""
        return self.folder / "networks" / kind

    def fit(self, baseline: str) -> Path:
        """Return the file of a baseline fitted by this study."""
        return self.folder / "open-loop" / f"{baseline}.yaml"

    def table_seeds(self, table: int) -> range:
        """Return the seeds of the races of a table, one for each opponent."""
        first = self.config.seed + 100 * table
        return range(first, first + 100)

    def agent(self, name: str) -> Competitor:
        """Return an agent or planner by name, with this study's networks and fits.

        The names are the zoo's names and the names in the configuration's ``responses``.
        """
        seed, learning = self.config.seed, self.config.learning
        if name in learning.responses:
            agent = build("cfr-argmax", self.spec, seed=seed, network=self.network(name))
            assert isinstance(agent, Agent)
            return replace(agent, name=name)
        if name in BASELINES:
            return build(name, self.spec, seed=seed, fit=self.fit(name))
        # Networks of this study replace shipped networks.
        if NETWORKS.get(name) in learning.networks:
            return build(name, self.spec, seed=seed, network=self.network(NETWORKS[name]))
        return competitor(name, self.spec, seed=seed)

    def progress(self, unit: str) -> Progress | None:
        """Return a progress function that updates a line on stderr; None if ``quiet``."""
        return None if self.quiet else show_progress(unit)
