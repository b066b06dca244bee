"""All against all: every pair of policies drives the same races, each of them from both sides of the grid."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

from pcs_racing.errors import InputError
from pcs_racing.planner import Policy
from pcs_racing.race import RaceResult, draw_starts, run_races
from pcs_racing.race_config import PAPER, RaceConfig
from pcs_racing.track import Track
from pcs_racing_agents.jobs import Progress, show_progress

__all__ = ["Progress", "RaceRow", "Tournament", "play_tournament", "show_progress"]


class RaceRow(NamedTuple):
    """One race of a tournament.

    Attributes
    ----------
    ego, opponent : str
        Names of the policies that drove car 0 and car 1.
    track : str
    race : int
        Number of the race within its pair: the same number is the same start line, side and noise for every pair.
    start_s : float
        Arc length of the start line, m.
    side : int
        0 when the ego started on the left or in front.
    seed : int
        Seed of the tournament.
    lead : float
        Progress of the ego minus that of the opponent at the end, m.
    winner : str
        ``"ego"``, ``"opponent"``, or ``""`` for a tie and for a crash that pays nobody.
    crash : str
        ``""``, ``"wall"`` or ``"car"``.
    fault : str
        Who is to blame for the crash: ``""``, ``"ego"``, ``"opponent"`` or ``"both"``.
    ego_overtakes, opponent_overtakes : int
        How often each passed the other.
    duration : float
        Length of the race, s; shorter than the rules say after a crash.
    """

    ego: str
    opponent: str
    track: str
    race: int
    start_s: float
    side: int
    seed: int
    lead: float
    winner: str
    crash: str
    fault: str
    ego_overtakes: int
    opponent_overtakes: int
    duration: float


@dataclass(frozen=True, eq=False)
class Tournament:
    """What a tournament was, and every race of it.

    Attributes
    ----------
    policies : tuple of str
        Names, in the order of the table.
    tracks : tuple of str
    config : RaceConfig
        The rules; :func:`pcs_racing.record_race` drives race ``k`` of a pair again with them, the seed and ``index=k``.
    races_per_pair : int
        On each track.
    seed : int
    rows : tuple of RaceRow
    """

    policies: tuple[str, ...]
    tracks: tuple[str, ...]
    config: RaceConfig
    races_per_pair: int
    seed: int
    rows: tuple[RaceRow, ...]


def play_tournament(
    tracks: Track | Sequence[Track],
    policies: Sequence[Policy],
    config: RaceConfig = PAPER,
    *,
    races_per_pair: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
) -> Tournament:
    """Play every pair of policies against each other.

    All pairs drive the same races (common random numbers): the same start lines, spread over the circuit, each of them
    from both sides, and the same noise.

    Parameters
    ----------
    tracks : Track or sequence of Track
    policies : sequence of Policy
        At least two; their names tell them apart.
    config : RaceConfig
        The rules. ``start_lines`` is replaced by half of ``races_per_pair``, so that no race is driven twice.
    races_per_pair : int
        Races of each pair on each track; even, from 2 to 2000.
    seed : int
        Root of the start lines and of the noise.
    progress : callable, optional
        Called as ``progress(done, total, what)`` after the races of each pair; :func:`show_progress` prints a line.

    Returns
    -------
    Tournament

    Raises
    ------
    InputError
        If names appear twice, there are too few policies, a number is impossible, or a track has no place to start.
    """
    tracks = [tracks] if isinstance(tracks, Track) else list(tracks)
    names = [policy.name for policy in policies]
    _check_distinct("policies", names, 2)
    _check_distinct("tracks", [track.name for track in tracks], 1)
    whole = isinstance(races_per_pair, int) and not isinstance(races_per_pair, bool)
    if not whole or races_per_pair % 2 or not 2 <= races_per_pair <= 2000:
        raise InputError(
            f"races_per_pair is {races_per_pair!r}; it must be an even number from 2 to 2000, since every start "
            "line is driven from both sides"
        )
    rules = replace(config, start_lines=races_per_pair // 2)
    for track in tracks:
        draw_starts(track, rules, races_per_pair, seed)  # an impossible start is an error before any race is driven
    pairs = list(combinations(policies, 2))
    total = len(tracks) * len(pairs) * races_per_pair
    rows: list[RaceRow] = []
    for track in tracks:
        for ego, opponent in pairs:
            result = run_races(track, [ego] * races_per_pair, opponent, rules, seed=seed)
            rows += _rows(result, ego.name, opponent.name, track.name, seed)
            if progress is not None:
                progress(len(rows), total, f"{track.name}: {ego.name} against {opponent.name}")
    return Tournament(tuple(names), tuple(t.name for t in tracks), rules, races_per_pair, seed, tuple(rows))


def _check_distinct(what: str, names: list[str], least: int) -> None:
    if len(names) < least:
        raise InputError(f"there are {len(names)} {what}; a tournament needs at least {least}")
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InputError(f"{what} must have different names; there is more than one {', '.join(sorted(twice))}")


def _rows(result: RaceResult, ego: str, opponent: str, track: str, seed: int) -> Iterator[RaceRow]:
    state = result.state
    cars = ("ego", "opponent")
    faults = ("", "ego", "opponent", "both")
    for race in range(state.races):
        winner = int(result.winner[race])
        yield RaceRow(
            ego=ego,
            opponent=opponent,
            track=track,
            race=race,
            start_s=float(result.starts.s[race]),
            side=int(result.starts.side[race]),
            seed=seed,
            lead=float(result.lead[race]),
            winner=cars[winner] if winner >= 0 else "",
            crash=("", "wall", "car")[int(state.crash[race].max())],
            fault=faults[int(state.fault[race, 0]) + 2 * int(state.fault[race, 1])],
            ego_overtakes=int(state.overtakes[race, 0]),
            opponent_overtakes=int(state.overtakes[race, 1]),
            duration=float(result.time[race]),
        )
