"""Protocol of a tournament: tracks, opponents, races and seed in a file, and a table of scores.

Every agent drives the same races against the opponents of the file. The file lists the hashes of
all inputs of the results; an installation with another hash refuses it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product, zip_longest
from typing import Annotated, Any, NamedTuple, Unpack

import numpy as np
from annotated_types import Interval

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import Names, OptionalNames, Settings, Text
from pcs_racing.game.make import make_game
from pcs_racing.game.players import Competitor, competitor
from pcs_racing.planners.racers import own_name
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.base.tables import Column, aligned, table_rows, with_interval
from pcs_racing_agents.tournament.pairings import play_pairings
from pcs_racing_agents.tournament.plan import (
    Entrant,
    TournamentPlan,
    plan_tournament,
    tournament_settings,
)
from pcs_racing_agents.tournament.races import RaceTable, concatenate_races, series_of
from pcs_racing_agents.tournament.scores import (
    SCORE_COLUMNS,
    Score,
    clustered_score,
    score_races,
)


@dataclass(frozen=True)
class ProtocolConfig(Settings):
    """A protocol."""

    name: Annotated[Text, "Name, with the version."] = "mine-v1"
    archive: Annotated[Text, "Archive of the agents."] = "contest"
    rules: Annotated[Text, "Rules of the race."] = "contest"
    train: Annotated[Names, "Training tracks."] = ("Brackwater", "Pipkin")
    test: Annotated[Names, "Test tracks, held out of training."] = ("Saltmere", "Larkmoor")
    opponents: Annotated[Names, "Opponents of every agent."] = ("never-switch", "random-moves")
    races: Annotated[
        int, Interval(ge=4, le=2000), "Races against each opponent on each track; even."
    ] = 24
    seed: Annotated[int, Interval(ge=0, le=2**62), "Seed of the starts, policies and noise."] = 0
    hashes: Annotated[OptionalNames, "Hashes of the inputs of the results; () checks none."] = ()


@dataclass(frozen=True, eq=False)
class Protocol:
    """A protocol with competitors and drawn races."""

    config: ProtocolConfig
    plan: TournamentPlan  #: Agents, then the opponents that are no agents.
    agents: tuple[Competitor, ...]
    opponents: tuple[Competitor, ...]

    @cached_property
    def hashes(self) -> tuple[str, ...]:
        """Hashes of all inputs of the results except the agents, as ``"kind name sha256"``."""
        spec = self.plan.spec
        lines = [
            ("archive", spec.archive.name, spec.archive.content_hash),
            ("rules", self.config.rules, fingerprint(spec.rules)),
            *(("track", track.name, track.content_hash) for track in self.plan.tracks),
            *(("opponent", own_name(car), competitor_hash(car)) for car in self.opponents),
        ]
        # Sixteen digits distinguish versions.
        return tuple(f"{kind} {name} {digest[:16]}" for kind, name, digest in lines)

    @property
    def content_hash(self) -> str:
        """Hash of the protocol and of all inputs of its results."""
        return fingerprint(self.config.name, self.hashes, self.config.races, self.config.seed)

    @property
    def settings(self) -> dict[str, Any]:
        """All inputs, for :func:`pcs_racing_agents.base.jobs.open_job`."""
        return {**tournament_settings(self.plan), "protocol": self.content_hash}


class ProtocolScore(NamedTuple):
    """The score of an agent over the races of a protocol."""

    agent: str
    score: Score
    train: float  #: ``train``, ``test``: Score on the training tracks, on the test tracks.
    test: float
    gain: str  #: Score minus the score of the first agent on the same races, with its interval.


def load_protocol(
    source: str | ProtocolConfig, agents: Sequence[Entrant], like: Any = None
) -> Protocol:
    """Return the protocol of a shipped name, a YAML file or a config, for agents.

    Names of agents may name user code, names of opponents may not.
    """
    config = load_config("protocol", ProtocolConfig(), source)
    spec = make_game(None, config.archive, config.rules)
    given = {agent if isinstance(agent, str) else own_name(agent) for agent in agents}
    rivals = [
        competitor(name, spec, seed=config.seed) for name in config.opponents if name not in given
    ]
    plan = plan_tournament(
        [load_track(name) for name in (*config.train, *config.test)],
        [*agents, *rivals],
        spec.rules,
        archive=config.archive,
        races_per_pair=config.races,
        seed=config.seed,
        code=True,
        like=like,
    )
    named = dict(zip(plan.names, plan.competitors, strict=True))
    protocol = Protocol(
        config,
        plan,
        plan.competitors[: len(agents)],
        tuple(named[name] for name in config.opponents),
    )
    for wanted, here in zip_longest(config.hashes, protocol.hashes, fillvalue="nothing"):
        if config.hashes and wanted != here:
            raise InputError(
                f"protocol {config.name!r} was written for {wanted!r}, but this installation has"
                f" {here!r}; install the version of pcs-racing that the protocol belongs to"
            )
    return protocol


def play_protocol(protocol: Protocol, **run: Unpack[Run]) -> RaceTable:
    """Simulate the races of all agents against all opponents.

    ``**run``: as for :func:`pcs_racing_agents.tournament.play_pairings`.
    """
    pairings = protocol.plan.paired(tuple(product(protocol.agents, protocol.opponents)))
    return concatenate_races(play_pairings(pairings, name="protocol", **run))


def protocol_scores(protocol: Protocol, races: RaceTable) -> list[ProtocolScore]:
    """Return the scores of all agents, highest first."""
    ego = np.array(races.agents.words)[races.agents.codes[:, 0]]
    names = [own_name(agent) for agent in protocol.agents]
    own = {name: races.take(ego == name) for name in names}
    scores = [_score(protocol, name, own[name], own[names[0]]) for name in names]
    return sorted(scores, key=lambda one: -one.score.mean)


def _score(protocol: Protocol, name: str, races: RaceTable, first: RaceTable) -> ProtocolScore:
    own, base = (series_of(each, protocol.plan.rules) for each in (races, first))
    training = np.isin(np.array(own.track.words)[own.track.codes], protocol.config.train)
    gain = clustered_score(own, own.score - base.score)
    return ProtocolScore(
        name,
        score_races(races, own),
        float(own.score[training].mean()),
        float(own.score[~training].mean()),
        "" if races is first else with_interval(*gain),
    )


def protocol_text(protocol: Protocol, races: RaceTable) -> str:
    """Return the table of the scores as text."""
    config, first = protocol.config, own_name(protocol.agents[0])
    columns = (
        Column("agent"),
        *SCORE_COLUMNS,
        Column("train", format=".3f"),
        Column("test", format=".3f"),
        Column("score.races", "races"),
        Column("gain", f"over {first}"),
    )
    head = (
        f"protocol {config.name} {protocol.content_hash[:16]}: train {', '.join(config.train)};"
        f" test {', '.join(config.test)}; seed {config.seed}\n"
    )
    return "\n".join([head, *aligned(table_rows(columns, protocol_scores(protocol, races)))])
