"""The protocol of the benchmark: opponents, tracks, numbers of races, and starts.

A protocol is a YAML file with a version in its name. It also lists the hashes of all inputs of its
results (archive, tracks, opponents, rules). An installation with another hash can't write cards of
that version.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Annotated, Any, NamedTuple

from annotated_types import Interval

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import Names, OptionalNames, Settings, Text
from pcs_racing.game.config import GameConfig
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import load_race_config
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Competitor, as_agent, competitor_hash
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.tournament.play import game_rules

KINDS = {
    "keeps": "keep one policy of the archive",
    "switches": "change their policy at random",
    "planners": "race with one policy, without moves",
    "agents": "agents that look at the race",
}
"""Kinds of opponents, with descriptions."""


@dataclass(frozen=True)
class ProtocolConfig(Settings):
    """A protocol: opponents by kind, tracks, number of races."""

    name: Annotated[Text, "Name, with the version."] = "bench-v3"
    archive: Annotated[Text, "Archive of the agents."] = "contest"
    race: Annotated[Text, "Rules of the race."] = "contest"
    train: Annotated[Names, "Training tracks."] = ("Brackwater", "Pipkin")
    test: Annotated[Names, "Test tracks, held out of training."] = ("Saltmere", "Larkmoor")
    keeps: Annotated[Names, "Opponents that keep one policy."] = ("never-switch",)
    switches: Annotated[Names, "Opponents that change it at random."] = ("random-moves",)
    planners: Annotated[
        Names,
        "Planners, held out of training.",
    ] = (
        "line-ppo",
        "pure-pursuit",
        "gap-follower",
    )
    agents: Annotated[Names, "Agents, held out of training."] = ("cfr-argmax", "response")
    blind: Annotated[
        Names,
        "Baselines (open-loop, lead-conditioned) of the gain.",
    ] = (
        "best-fixed",
        "best-schedule",
    )
    egos: Annotated[int, Interval(ge=2, le=1000), "Start policies of the agent in each cell."] = 8
    variants: Annotated[int, Interval(ge=2, le=1000), "Variants of the opponent in each cell."] = 5
    seed: Annotated[int, Interval(ge=0, le=2**62), "Seed of the starts, policies and noise."] = 71
    hashes: Annotated[OptionalNames, "Hashes of what the results depend on; () checks none."] = ()


class Cell(NamedTuple):
    """The races against one opponent on one track."""

    circuit: str
    train: bool  #: True for a training track.
    kind: str  #: Kind of the opponent, a key of :data:`KINDS`.
    opponent: str


@dataclass(frozen=True, eq=False)
class Protocol:
    """A protocol with loaded tracks, opponents and rules."""

    config: ProtocolConfig
    spec: GameSpec  #: Archive and rules of the game.
    tracks: dict[str, Track]
    opponents: dict[str, Competitor]  #: Opponents and baselines.

    @property
    def cells(self) -> Iterator[Cell]:
        """All cells: every opponent on every track."""
        for circuits, train in ((self.config.train, True), (self.config.test, False)):
            for circuit in circuits:
                for kind in KINDS:
                    for opponent in getattr(self.config, kind):
                        yield Cell(circuit, train, kind, opponent)

    def game(self, circuit: str) -> RaceGame:
        """Return the game on a track."""
        return RaceGame(self.tracks[circuit], self.spec.archive, self.spec.config)

    @cached_property
    def hashes(self) -> tuple[str, ...]:
        """Hashes of all inputs of the results, as ``"kind name sha256"``."""
        lines = [
            f"archive {self.spec.archive.name} {self.spec.archive.content_hash}",
            f"rules {self.config.race} {fingerprint(self.spec.config)}",
            *(f"circuit {name} {track.content_hash}" for name, track in self.tracks.items()),
            *(f"opponent {name} {competitor_hash(car)}" for name, car in self.opponents.items()),
        ]
        # Sixteen digits distinguish versions, and fit on a line of the protocol's file.
        return tuple(" ".join([*line.split()[:-1], line.split()[-1][:16]]) for line in lines)

    @property
    def content_hash(self) -> str:
        """Hash of the protocol and of all inputs of its results."""
        return fingerprint(
            [
                self.config.name,
                *self.hashes,
                self.config.egos,
                self.config.variants,
                self.config.seed,
            ]
        )

    def check_hashes(self) -> None:
        """Check that this installation has the hashes listed in the protocol."""
        if not self.config.hashes:
            return
        for wanted, here in zip_longest(self.config.hashes, self.hashes, fillvalue="nothing"):
            if wanted != here:
                raise InputError(
                    f"protocol {self.config.name!r} was written for {wanted!r}, but this"
                    f" installation has {here!r}; install the version of pcs-racing that the"
                    " protocol belongs to"
                )


def load_protocol(source: str | ProtocolConfig = "bench_v3", **changes: Any) -> Protocol:
    """Return a protocol from a shipped name, a YAML file or a config, with changed fields."""
    config = load_config("protocol", ProtocolConfig(), source, **changes)
    rules: GameConfig = game_rules(load_race_config(config.race))
    spec = make_game_spec(config.archive, rules)
    circuits = dict.fromkeys([*config.train, *config.test])
    rivals = dict.fromkeys([name for kind in (*KINDS, "blind") for name in getattr(config, kind)])
    protocol = Protocol(
        config,
        spec,
        {name: load_track(name) for name in circuits},
        {name: as_agent(parse_agent(name, spec), name) for name in rivals},
    )
    # A protocol with changed fields is a custom protocol without listed hashes.
    if not changes:
        protocol.check_hashes()
    return protocol
