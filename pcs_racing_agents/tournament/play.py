"""All against all: every pair of competitors drives the same races, each of them from both seats of the grid."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.competitor import competitor_name
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Competitor, as_competitor, competitor_hash
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.jobs.jobs import Job, Progress
from pcs_racing_agents.results.races import RaceRow, RaceTable, concatenate_races
from pcs_racing_agents.tournament.matches import game_between
from pcs_racing_agents.tournament.pairings import Pairing, schedule_pairing
from pcs_racing_agents.tournament.runner import play_pairings
from pcs_racing_agents.tournament.schedule import Schedule, draw_schedule
from pcs_racing_agents.tournament.watching import Recording, record_match

__all__ = [
    "Tournament",
    "TournamentPlan",
    "game_rules",
    "plan_tournament",
    "play_plan",
    "play_tournament",
    "record_row",
    "tournament_settings",
]

Entrant = str | Policy | Competitor
Rules = GameConfig | RaceConfig | str | Path


@dataclass(frozen=True, eq=False)
class TournamentPlan:
    """What a tournament is, before a race has been driven; everything in it has been checked.

    Attributes
    ----------
    competitors : tuple of Competitor
    tracks : tuple of Track
    setting : Setting
        The archive and the rules, the move "stay" included.
    schedules : tuple of Schedule
        The races of each pair, by track.
    races_per_pair : int
        On each track.
    seed : int
    """

    competitors: tuple[Competitor, ...]
    tracks: tuple[Track, ...]
    setting: Setting
    schedules: tuple[Schedule, ...]
    races_per_pair: int
    seed: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the competitors, in the order of the table."""
        return tuple(map(competitor_name, self.competitors))

    @cached_property
    def pairings(self) -> tuple[Pairing, ...]:
        """The races: every pair on the first track, then every pair on the next one."""
        found = []
        for track, schedule in zip(self.tracks, self.schedules, strict=True):
            game = RaceGame(track, self.setting.archive, self.setting.config)
            for ego, opponent in combinations(self.competitors, 2):
                found.append(schedule_pairing(game, ego, opponent, schedule, self.seed))
        return tuple(found)

    @property
    def config(self) -> RaceConfig:
        """The rules of the race, as long as the game."""
        return self.setting.config.race_rules


@dataclass(frozen=True, eq=False)
class Tournament:
    """A tournament that was played.

    Attributes
    ----------
    plan : TournamentPlan
    races : RaceTable
    """

    plan: TournamentPlan
    races: RaceTable


def game_rules(race: Rules = "paper", **settings: Any) -> GameConfig:
    """Return the rules of a game as long as a race: its duration is cut into a step for each move and one more.

    Parameters
    ----------
    race : GameConfig, RaceConfig, str or path
        Rules of a game are taken as they are.
    **settings
        Fields of :class:`pcs_racing.GameConfig` to change.

    Raises
    ------
    InputError
        If a value is impossible, or the duration can't be cut into such steps.
    """
    if isinstance(race, GameConfig):
        return load_game_config(race, **settings)
    rules = load_race_config(race)
    steps = load_game_config(rules, **settings).moves + 1
    if "step_seconds" not in settings:
        tenths = round(rules.duration * 10.0)
        if tenths % steps:
            raise InputError(
                f"duration is {rules.duration:g} s; a game of {steps - 1} moves lasts a multiple of {0.1 * steps:g} s"
            )
        settings["step_seconds"] = tenths / steps / 10.0
    return load_game_config(rules, **settings)


def plan_tournament(
    tracks: Track | Sequence[Track],
    entrants: Sequence[Entrant] | Mapping[str, Entrant],
    race: Rules = "paper",
    *,
    archive: PolicyArchive | str | Path = "default",
    races_per_pair: int = 20,
    seed: int = 0,
) -> TournamentPlan:
    """Check everything that a tournament needs, and draw its races; see :func:`play_tournament`."""
    circuits = [tracks] if isinstance(tracks, Track) else list(tracks)
    _check_distinct("tracks", [track.name for track in circuits], 1)
    setting = make_setting(archive, game_rules(race))
    if isinstance(entrants, Mapping):
        given = [as_competitor(_made(one, setting, seed), name) for name, one in entrants.items()]
    else:
        given = [as_competitor(_made(one, setting, seed)) for one in entrants]
    _check_distinct("competitors", [competitor_name(one) for one in given], 2)
    rules = setting.config.race_rules
    schedules = tuple(draw_schedule(track, rules, races_per_pair, seed) for track in circuits)
    plan = TournamentPlan(tuple(given), tuple(circuits), setting, schedules, races_per_pair, seed)
    for track in circuits:
        game = RaceGame(track, setting.archive, setting.config)
        for one in given:
            game_between(game, one, one)  # who does not fit is an error before any race is driven
    return plan


def play_tournament(
    tracks: Track | Sequence[Track],
    entrants: Sequence[Entrant] | Mapping[str, Entrant],
    race: Rules = "paper",
    *,
    archive: PolicyArchive | str | Path = "default",
    races_per_pair: int = 20,
    seed: int = 0,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Tournament:
    """Play every pair of competitors against each other.

    All pairs drive the same races (common random numbers): the same start lines, spread over the circuit, each of them
    from both sides, with the same start policies and the same noise.

    Parameters
    ----------
    tracks : Track or sequence of Track
    entrants : sequence, or mapping by name
        At least two agents, drivers, policies, names (:func:`pcs_racing_agents.agents.make`), or models with
        ``predict``. Their names tell them apart.
    race : GameConfig, RaceConfig, str or path
        The rules. Those of a race alone make a game of the same duration (:func:`game_rules`); its ``start_lines`` is
        not used, since every two races draw a line of their own.
    archive : PolicyArchive, str or path
        Where agents find their policies.
    races_per_pair : int
        Races of each pair on each track; even, from 2 to 2000.
    seed : int
        Root of start lines, start policies and noise, and of the draws of agents that are given by name.
    job : Job, optional
        Where results are kept, so that a tournament that was stopped goes on: opened with :func:`tournament_settings`.
    executor : Executor, optional
        Where the races are driven; by default here, on all cores. It does not change the result.
    progress : callable, optional
        Called as ``progress(done, total, label)``, counting races; :func:`pcs_racing_agents.jobs.jobs.show_progress`
        prints a line.

    Returns
    -------
    Tournament

    Raises
    ------
    InputError
        If names appear twice, there are too few competitors, one of them does not fit the archive or the rules, a
        number is impossible, or a track has no place to start.
    """
    plan = plan_tournament(tracks, entrants, race, archive=archive, races_per_pair=races_per_pair, seed=seed)
    return play_plan(plan, job=job, executor=executor, progress=progress)


def play_plan(
    plan: TournamentPlan,
    *,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Tournament:
    """Play a tournament that was planned; see :func:`play_tournament`."""
    played = play_pairings(plan.pairings, job=job, executor=executor, progress=progress)
    tables = (pairing.table(matches) for pairing, matches in zip(plan.pairings, played, strict=True))
    return Tournament(plan, concatenate_races(tables))


def tournament_settings(plan: TournamentPlan) -> dict[str, Any]:
    """Return all that the results of a tournament depend on, for :func:`pcs_racing_agents.jobs.jobs.open_job`."""
    setting = plan.setting
    return {
        "seed": plan.seed,
        "races_per_pair": plan.races_per_pair,
        "game": setting.config,
        "archive": setting.identity.archive,
        "archive_sha256": setting.identity.archive_sha256,
        "tracks": {track.name: track.content_hash for track in plan.tracks},
        "agents": {name: competitor_hash(one) for name, one in zip(plan.names, plan.competitors, strict=True)},
    }


def record_row(tournament: Tournament, row: RaceRow, *, candidates: bool = True) -> Recording:
    """Drive a race of a tournament again, and record it.

    Raises
    ------
    InputError
        If the race is none of this tournament.
    """
    for pairing in tournament.plan.pairings:
        if (pairing.game.track.name, *pairing.names) == (row.track, row.ego, row.opponent):
            return record_match(
                pairing.game, pairing.ego, pairing.opponent, **pairing.one(row.race), candidates=candidates
            )
    raise InputError(f"race {row.race} of {row.ego!r} against {row.opponent!r} on {row.track!r} was not raced here")


def _made(given: Entrant, setting: Setting, seed: int) -> Any:
    return parse_agent(given, setting, seed=seed) if isinstance(given, str) else given


def _check_distinct(what: str, names: list[str], least: int) -> None:
    if len(names) < least:
        there = f"there are {len(names)} {what}" if len(names) != 1 else f"there is 1 {what[:-1]}"
        raise InputError(f"{there}; a tournament needs at least {least}")
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InputError(f"{what} must have different names; there is more than one {', '.join(sorted(twice))}")
