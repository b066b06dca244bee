"""Tournaments: all pairs of competitors drive the same races, from both sides of each start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import list_archives
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.players import Competitor, competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.racers import own_name
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing.track.maps import find_shipped, list_tracks
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.base.statistics import clustered_mean, varied
from pcs_racing_agents.base.tables import Column, aligned, table_rows
from pcs_racing_agents.tournament.games import game_between
from pcs_racing_agents.tournament.pairings import (
    Pairing,
    RaceSchedule,
    draw_schedule,
    schedule_pairing,
)
from pcs_racing_agents.tournament.pictures import payoffs_picture
from pcs_racing_agents.tournament.races import RaceRow, RaceTable, concatenate_races, series_of
from pcs_racing_agents.tournament.ratings import RoundRobin, agents_of, round_robin
from pcs_racing_agents.tournament.runner import Recording, play_pairings, repeat_race

Entrant = Any
"""A text or an object for :func:`pcs_racing.racer`."""
Rules = GameConfig | RaceConfig | str | Path


@dataclass(frozen=True, eq=False)
class TournamentPlan:
    """Checked tournament with drawn races, not yet simulated."""

    competitors: tuple[Competitor, ...]
    tracks: tuple[Track, ...]
    spec: GameSpec  #: Archive and rules, with the move "stay".
    schedules: tuple[RaceSchedule, ...]  #: Races of each pair, by track.
    races_per_pair: int  #: Number of races of each pair on each track.
    seed: int
    archive: str = ""  #: Source of the archive: name of a shipped archive, or path of a folder.

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the competitors, in the order of the table."""
        return tuple(map(own_name, self.competitors))

    @cached_property
    def pairings(self) -> tuple[Pairing, ...]:
        """Races of all pairs on the first track, then of all pairs on the next track, etc."""
        pairings = []
        for track, schedule in zip(self.tracks, self.schedules, strict=True):
            game = RaceGame(track, self.spec.archive, self.spec.config)
            for ego, opponent in combinations(self.competitors, 2):
                pairings.append(schedule_pairing(game, ego, opponent, schedule, self.seed))
        return tuple(pairings)

    @property
    def config(self) -> RaceConfig:
        """Race rules with the duration of the game."""
        return self.spec.config.race_rules


class AgentScore(NamedTuple):
    """Score of an agent over all its races."""

    agent: str
    races: int
    score: float  #: Mean score: 1 for a win, 0.5 for a tie, else 0.
    low: float  #: ``low``, ``high``: 95 % interval, robust to clusters of start lines.
    high: float
    own_crash: float  #: Share of the races that ended in a crash by the agent's own fault.

    @property
    def interval(self) -> str:
        """Interval as text."""
        return f"[{self.low:.3f}, {self.high:.3f}]"


SCORE_COLUMNS = (
    Column("agent"),
    Column("races"),
    Column("score", format=".3f"),
    Column("interval", "95 %"),
    Column("own_crash", "own crashes", ".1%"),
)


@dataclass(frozen=True, eq=False)
class Tournament:
    """Played tournament with its races; ``print`` shows its table, ``plot`` draws its scores."""

    plan: TournamentPlan
    races: RaceTable

    @cached_property
    def series(self) -> RaceTable:
        """Scored units: the races, or series of races under "best of" rules."""
        return series_of(self.races, self.plan.config.heats)

    @cached_property
    def summary(self) -> RoundRobin:
        """Scores against each other, ratings and equilibrium, in the plan's order."""
        return round_robin(self.plan.names, self.series, seed=self.plan.seed)

    @cached_property
    def scores(self) -> list[AgentScore]:
        """Score of each agent, in the plan's order."""
        series, raced = self.series, agents_of(self.plan.names, self.races)
        seats = agents_of(self.plan.names, series)
        won = np.stack([series.score, 1.0 - series.score], axis=1)
        won[series.crashed & (series.winner < 0)] = 0.0  # a no-contest is no tie
        table = []
        for k, name in enumerate(self.plan.names):
            rows, cars = np.nonzero(seats == k)
            found = clustered_mean(won[rows, cars], *varied(series.places[rows]))
            blamed = float((self.races.fault[raced == k] > 0).mean())
            table.append(AgentScore(name, len(rows), found.mean, found.low, found.high, blamed))
        return table

    def __str__(self) -> str:
        """Show the score, its interval and the own crashes of each agent, and each pair's score."""
        names = self.plan.names
        rows = table_rows(SCORE_COLUMNS, self.scores)
        pairs = [("against", *names)]
        for name, row in zip(names, self.summary.scores, strict=True):
            pairs.append((name, *("-" if np.isnan(one) else f"{one:.3f}" for one in row)))
        where = ", ".join(track.name for track in self.plan.tracks)
        head = f"{where}, rules {self.plan.config.name}, seed {self.plan.seed}"
        return "\n".join([head, *aligned(rows, left=1), "", *aligned(pairs, left=1)])

    def plot(self) -> Any:
        """Return a figure of matplotlib with the score of each agent against each other agent."""
        return payoffs_picture(self.plan.names, self.summary.scores)


def game_rules(rules: Rules = "paper", **settings: Any) -> GameConfig:
    """Return the rules of a game with the duration of a race, by an equal stretch of all steps.

    Parameters
    ----------
    rules : GameConfig, RaceConfig, str or path
        Rules of a race, or of a game (not stretched).
    **settings
        Fields of :class:`pcs_racing.game.config.GameConfig` to change; with ``step_seconds`` or
        ``first_steps`` nothing is stretched.
    """
    if isinstance(rules, GameConfig):
        return load_game_config(rules, **settings)
    race = load_race_config(rules)
    config = load_game_config(race, **settings)
    if {"step_seconds", "first_steps"} & settings.keys():
        return config
    # Whole tenths of a second, the time between two plans: a step of 8.1666 s would end between two
    # plans.
    parts = np.diff(config.end_ticks, prepend=0)
    parts //= np.gcd.reduce(parts)
    unit, rest = divmod(race.ticks, 10 * int(parts.sum()))
    if unit == 0 or rest:
        raise InputError(
            f"duration is {race.seconds:g} s; a game of {config.moves} moves lasts a multiple of "
            f"{0.1 * int(parts.sum()):g} s"
        )
    lengths = [round(0.1 * int(part) * unit, 1) for part in parts]
    first = lengths[: len(config.first_steps)]
    return load_game_config(
        race, **{**settings, "moves": config.moves}, step_seconds=lengths[-1], first_steps=first
    )


def plan_tournament(
    tracks: Track | Sequence[Track],
    entrants: Sequence[Entrant] | Mapping[str, Entrant],
    rules: Rules = "paper",
    *,
    archive: PolicyArchive | str | Path = "default",
    races_per_pair: int = 20,
    seed: int = 0,
    code: bool = False,
    like: Any = None,
) -> TournamentPlan:
    """Check the arguments of a tournament, and draw its races; see :func:`play_tournament`.

    ``code``: True to allow names of user code, as in :func:`pcs_racing.racer`.
    """
    circuits = [tracks] if isinstance(tracks, Track) else list(tracks)
    _check_distinct("tracks", [track.name for track in circuits], 1)
    spec = make_game_spec(archive, game_rules(rules))
    named = entrants.items() if isinstance(entrants, Mapping) else [(None, e) for e in entrants]
    competitors = []
    for name, entrant in named:
        competitors.append(competitor(entrant, spec, code, name=name, like=like, seed=seed))
    _check_distinct("competitors", [own_name(entrant) for entrant in competitors], 2)
    race = spec.config.race_rules
    schedules = tuple(draw_schedule(track, race, races_per_pair, seed) for track in circuits)
    source = spec.identity.archive
    if not isinstance(archive, PolicyArchive) and archive not in list_archives():
        source = str(Path(archive).resolve())
    plan = TournamentPlan(
        tuple(competitors), tuple(circuits), spec, schedules, races_per_pair, seed, source
    )
    for track in circuits:
        game = RaceGame(track, spec.archive, spec.config)
        for entrant in competitors:
            # A game against itself refuses an unsuitable competitor before any simulation.
            game_between(game, entrant, entrant)
    return plan


def play_tournament(
    tracks: Track | Sequence[Track],
    entrants: Sequence[Entrant] | Mapping[str, Entrant],
    rules: Rules = "paper",
    *,
    archive: PolicyArchive | str | Path = "default",
    races_per_pair: int = 20,
    seed: int = 0,
    like: Any = None,
    **run: Unpack[Run],
) -> Tournament:
    """Play every pair of competitors against each other.

    All pairs drive the same races (common random numbers): the same start lines, spread over the
    track, each from both sides, with the same start policies and the same noise.

    Parameters
    ----------
    entrants : sequence, or mapping by name
        At least two texts or objects (:func:`pcs_racing.racer`), with different names.
    rules : GameConfig, RaceConfig, str or path
        Rules. Race rules give a game of the same duration (:func:`game_rules`); their
        ``start_lines`` is not used, since every two races draw their own line.
    races_per_pair : int
        Number of races of each pair on each track; even, from 2 to 2000.
    seed : int
        Seed of start lines, start policies and noise, and of the draws of agents given by name.
    like : str, mapping or environment, optional
        Training environment of models that do not hold its arguments (:func:`pcs_racing.racer`).
    **run
        ``job``, ``executor``, ``progress`` as for
        :func:`pcs_racing_agents.tournament.play_pairings`; open a job with
        :func:`tournament_settings`.
    """
    plan = plan_tournament(
        tracks,
        entrants,
        rules,
        archive=archive,
        races_per_pair=races_per_pair,
        seed=seed,
        like=like,
    )
    return play_plan(plan, **run)


def play_plan(plan: TournamentPlan, **run: Unpack[Run]) -> Tournament:
    """Play a planned tournament; see :func:`play_tournament`."""
    return Tournament(plan, concatenate_races(play_pairings(plan.pairings, **run)))


def tournament_settings(plan: TournamentPlan) -> dict[str, Any]:
    """Return all inputs of a tournament, for :func:`pcs_racing_agents.base.jobs.open_job`."""
    spec = plan.spec
    own_maps = {
        track.name: str(track.folder)
        for track in plan.tracks
        if track.folder is not None and not _is_shipped(track)
    }
    return {
        "seed": plan.seed,
        "races_per_pair": plan.races_per_pair,
        "game": spec.config,
        "archive": plan.archive,
        "archive_sha256": spec.identity.archive_sha256,
        "tracks": {track.name: track.content_hash for track in plan.tracks},
        **({"maps": own_maps} if own_maps else {}),
        "agents": {
            own_name(competitor): competitor_hash(competitor) for competitor in plan.competitors
        },
    }


def _is_shipped(track: Track) -> bool:
    return track.name in list_tracks() and find_shipped(track.name) == track.folder


def record_row(tournament: Tournament, row: RaceRow, *, candidates: bool = True) -> Recording:
    """Repeat a race of a tournament, and record it."""
    for pairing in tournament.plan.pairings:
        if (pairing.game.track.name, *pairing.names) == (row.track, row.ego, row.opponent):
            return repeat_race(pairing, row.race, candidates=candidates)
    raise InputError(
        f"race {row.race} of {row.ego!r} against {row.opponent!r} on {row.track!r} was not raced"
        " here"
    )


def _check_distinct(noun: str, names: list[str], minimum: int) -> None:
    if len(names) < minimum:
        raise InputError(f"{len(names)} {noun} given; a tournament needs at least {minimum}")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"{noun} must have different names; {', '.join(repeated)} is not unique")
