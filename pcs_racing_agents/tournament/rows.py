"""One line for every race: what was raced, and what came of it."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.tournament.matches import Matches

__all__ = ["PairRaces", "RaceRow", "RaceRows", "pair_races", "start_label"]

CARS = ("ego", "opponent")
CRASHES = ("", "wall", "car")
FAULTS = ("", "ego", "opponent", "both")


class RaceRow(NamedTuple):
    """One race.

    Attributes
    ----------
    ego, opponent : str
        Names of the competitors in car 0 and car 1.
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
    ego_variant, opponent_variant : int
        The policy that it started with, or which of a driver's policies it was.
    ego_path, opponent_path : tuple of int
        Policies of the archive that it drove, step by step, until the end or a crash; empty for a driver.
    ego_moves, opponent_moves : tuple of str
        Moves that it made; empty for a driver.
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
    ego_variant: int = 0
    opponent_variant: int = 0
    ego_path: tuple[int, ...] = ()
    opponent_path: tuple[int, ...] = ()
    ego_moves: tuple[str, ...] = ()
    opponent_moves: tuple[str, ...] = ()


def start_label(track: str, start_s: float) -> str:
    """Return the label of a place to start from: what is drawn together where intervals are made.

    Short circuits have few places, so that races of different numbers, and start lines of different numbers, may share
    one.
    """
    return f"{track} {start_s:.4f}"


@dataclass(frozen=True, eq=False)
class PairRaces:
    """B races of a pair on a track, of which lines are made when they are asked for; made by :func:`pair_races`.

    Attributes
    ----------
    names : tuple of two str
        Of ego and opponent.
    track : str
    seed : int
    moves : tuple of str
        Names of the moves.
    columns : tuple of ndarray
        What tells a race from the next, each of B rows, in the narrowest types.
    """

    names: tuple[str, str]
    track: str
    seed: int
    moves: tuple[str, ...]
    columns: tuple[NDArray[Any], ...]

    def __len__(self) -> int:
        return len(self.columns[0])

    def rows(self, first: int = 0, last: int | None = None) -> Iterator[RaceRow]:
        """Lines of the races from number ``first`` to before ``last``, in their order."""
        lists = zip(*(column[first:last].tolist() for column in self.columns), strict=True)
        moves = self.moves
        for race, row in enumerate(lists, start=first):
            s, side, lead, winner, crash, fault, overtakes, duration, variant, policy, made = row
            paths = [tuple(index for index in path if index >= 0) for path in policy]
            words = [tuple(moves[index] for index in path if index >= 0) for path in made]
            yield RaceRow(
                ego=self.names[0],
                opponent=self.names[1],
                track=self.track,
                race=race,
                start_s=s,
                side=side,
                seed=self.seed,
                lead=lead,
                winner=CARS[winner] if winner >= 0 else "",
                crash=CRASHES[max(crash)],
                fault=FAULTS[fault[0] + 2 * fault[1]],
                ego_overtakes=overtakes[0],
                opponent_overtakes=overtakes[1],
                duration=duration,
                ego_variant=variant[0],
                opponent_variant=variant[1],
                ego_path=paths[0],
                opponent_path=paths[1],
                ego_moves=words[0],
                opponent_moves=words[1],
            )


class RaceRows(Sequence[RaceRow]):
    """The lines of many races, one pair after the other: like a tuple of them, but each is made when it is asked for.

    A race of four moves takes about 70 bytes; as a line it takes ten times as many.

    Parameters
    ----------
    pairs : iterable of PairRaces
    """

    def __init__(self, pairs: Sequence[PairRaces]) -> None:
        self.pairs = tuple(pairs)
        self._ends = list(accumulate(map(len, self.pairs)))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[RaceRow]:
        for pair in self.pairs:
            yield from pair.rows()

    @overload
    def __getitem__(self, which: int) -> RaceRow: ...
    @overload
    def __getitem__(self, which: slice) -> tuple[RaceRow, ...]: ...
    def __getitem__(self, which: int | slice) -> RaceRow | tuple[RaceRow, ...]:
        if isinstance(which, slice):
            return tuple(self[number] for number in range(len(self))[which])
        number = range(len(self))[which]
        place = bisect_right(self._ends, number)
        race = number - (self._ends[place] - len(self.pairs[place]))
        return next(self.pairs[place].rows(race, race + 1))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RaceRows | tuple):
            return NotImplemented
        return len(self) == len(other) and all(one == another for one, another in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<{len(self)} races>"


def pair_races(
    names: tuple[str, str],
    track: str,
    seed: int,
    starts: Starts,
    variants: NDArray[np.int64],
    matches: Matches,
    moves: Sequence[str],
) -> PairRaces:
    """Return a pair's races, in their order.

    Parameters
    ----------
    names : tuple of two str
        Of ego and opponent.
    track : str
    seed : int
    starts : Starts
        B of them.
    variants : ndarray, shape (B, 2)
    matches : Matches
    moves : sequence of str
        Names of the moves.
    """
    columns: tuple[NDArray[Any], ...] = (
        starts.s,
        starts.side,
        matches.lead,
        matches.winner,
        matches.crash,
        matches.fault,
        matches.overtakes,
        matches.duration,
        variants,
        matches.policy,
        matches.moves,
    )
    return PairRaces(names, track, seed, tuple(moves), tuple(map(_narrow, columns)))


def _narrow(values: NDArray[Any]) -> NDArray[Any]:
    """Whole numbers in the narrowest type that holds them; others as they are."""
    if values.dtype.kind != "i" or values.size == 0:
        return values
    return values.astype(np.promote_types(np.min_scalar_type(values.min()), np.min_scalar_type(-1 - values.max())))
