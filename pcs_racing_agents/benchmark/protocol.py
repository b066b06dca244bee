"""The protocol of the benchmark: who is raced, where, how often, and from which starts.

A protocol is a YAML file with a version in its name. It also lists the hashes of everything that its results depend on
(archive, circuits, opponents, rules): an installation in which one of them differs can't write cards of that version.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Any, NamedTuple

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import Settings, names, setting, text, whole
from pcs_racing.game.config import GameConfig
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import load_race_config
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Competitor, as_competitor, competitor_hash
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.tournament.play import game_rules

KINDS = {
    "keeps": "keep one policy of the archive",
    "switches": "change their policy at random",
    "planners": "drivers of other families",
    "agents": "agents that look at the race",
}
"""Kinds of opponents and what they do."""


@dataclass(frozen=True)
class ProtocolConfig(Settings):
    """A protocol: opponents by kind, circuits, number of races."""

    name: str = setting("bench-v2", text(), "Name, with the version.")
    archive: str = setting("contest", text(), "Archive of the agents.")
    race: str = setting("contest", text(), "Rules of the race.")
    seen: tuple[str, ...] = setting(("Pipkin", "Quillburg"), names(), "Circuits that may be trained on.")
    unseen: tuple[str, ...] = setting(("Larkmoor", "Saltmere"), names(), "Circuits that may not be trained on.")
    keeps: tuple[str, ...] = setting(("never-switch",), names(), "Opponents that keep one policy.")
    switches: tuple[str, ...] = setting(("random-moves",), names(), "Opponents that change it at random.")
    planners: tuple[str, ...] = setting(
        ("lane-switcher", "pure-pursuit", "gap-follower"), names(), "Drivers of other families; not to be trained on."
    )
    agents: tuple[str, ...] = setting(("cfr-argmax", "response"), names(), "Agents; not to be trained on.")
    blind: tuple[str, ...] = setting(
        ("best-fixed", "best-schedule"), names(), "Baselines (open-loop, lead-conditioned) of the gain."
    )
    egos: int = setting(10, whole(2, 1000), "Start policies of the agent in each cell.")
    variants: int = setting(10, whole(2, 1000), "Variants of the opponent in each cell.")
    seed: int = setting(71, whole(0, 2**62), "Seed of the starts, policies and noise.")
    hashes: tuple[str, ...] = setting((), names(0), "Hashes of what the results depend on; () checks none.")


class Cell(NamedTuple):
    """The races against one opponent on one circuit."""

    circuit: str
    seen: bool  #: Whether the circuit may be trained on.
    kind: str  #: Of the opponent, one of :data:`KINDS`.
    opponent: str


@dataclass(frozen=True, eq=False)
class Protocol:
    """A protocol with its circuits, opponents and rules loaded."""

    config: ProtocolConfig
    setting: Setting  #: Archive and rules of the game.
    tracks: dict[str, Track]
    opponents: dict[str, Competitor]  #: And the baselines.

    @property
    def cells(self) -> Iterator[Cell]:
        """Every opponent on every circuit."""
        for circuits, seen in ((self.config.seen, True), (self.config.unseen, False)):
            for circuit in circuits:
                for kind in KINDS:
                    for opponent in getattr(self.config, kind):
                        yield Cell(circuit, seen, kind, opponent)

    def game(self, circuit: str) -> RaceGame:
        """Return the game on a circuit."""
        return RaceGame(self.tracks[circuit], self.setting.archive, self.setting.config)

    @cached_property
    def hashes(self) -> tuple[str, ...]:
        """Hashes of what the results depend on, as ``"kind name sha256"``."""
        lines = [
            f"archive {self.setting.archive.name} {self.setting.archive.content_hash}",
            f"rules {self.config.race} {fingerprint(self.setting.config)}",
            *(f"circuit {name} {track.content_hash}" for name, track in self.tracks.items()),
            *(f"opponent {name} {competitor_hash(car)}" for name, car in self.opponents.items()),
        ]
        # Sixteen digits are enough to tell two versions apart, and fit on a line of the protocol's file.
        return tuple(" ".join([*line.split()[:-1], line.split()[-1][:16]]) for line in lines)

    @property
    def content_hash(self) -> str:
        """Hash of the protocol and of everything that its results depend on."""
        return fingerprint([self.config.name, *self.hashes, self.config.egos, self.config.variants, self.config.seed])

    def check_hashes(self) -> None:
        """Check that this installation is the one that the protocol describes."""
        if not self.config.hashes:
            return
        for wanted, here in zip_longest(self.config.hashes, self.hashes, fillvalue="nothing"):
            if wanted != here:
                raise InputError(
                    f"protocol {self.config.name!r} was written for {wanted!r}, but this installation has {here!r}; "
                    "install the version of pcs-racing that the protocol belongs to"
                )


def load_protocol(source: str | ProtocolConfig = "bench_v2", **changes: Any) -> Protocol:
    """Return a protocol from a shipped one's name, a YAML file or a configuration, with some fields changed."""
    config = load_config("protocol", ProtocolConfig(), source, **changes)
    rules: GameConfig = game_rules(load_race_config(config.race))
    setting = make_setting(config.archive, rules)
    circuits = dict.fromkeys([*config.seen, *config.unseen])
    rivals = dict.fromkeys([name for kind in (*KINDS, "blind") for name in getattr(config, kind)])
    protocol = Protocol(
        config,
        setting,
        {name: load_track(name) for name in circuits},
        {name: as_competitor(parse_agent(name, setting), name) for name in rivals},
    )
    # With other fields it is a protocol of one's own, which no hashes were written down for.
    if not changes:
        protocol.check_hashes()
    return protocol
