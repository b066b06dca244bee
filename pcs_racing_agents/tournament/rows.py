"""One line for every race: what was raced, and what came of it."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race import Starts
from pcs_racing_agents.tournament.matches import Matches

__all__ = ["RaceRow", "race_rows"]

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


def race_rows(
    names: tuple[str, str],
    track: str,
    seed: int,
    starts: Starts,
    variants: NDArray[np.int64],
    matches: Matches,
    moves: Sequence[str],
) -> Iterator[RaceRow]:
    """Lines of a pair's races, in their order.

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
    columns = [
        starts.s.tolist(),
        starts.side.tolist(),
        matches.lead.tolist(),
        matches.winner.tolist(),
        matches.crash.max(axis=1).tolist(),
        matches.fault.tolist(),
        matches.overtakes.tolist(),
        matches.duration.tolist(),
        variants.tolist(),
        matches.policy.tolist(),
        matches.moves.tolist(),
    ]
    rows = zip(*columns, strict=True)
    for race, (s, side, lead, winner, crash, fault, overtakes, duration, variant, policy, made) in enumerate(rows):
        paths = [tuple(index for index in path if index >= 0) for path in policy]
        words = [tuple(moves[index] for index in path if index >= 0) for path in made]
        yield RaceRow(
            ego=names[0],
            opponent=names[1],
            track=track,
            race=race,
            start_s=s,
            side=side,
            seed=seed,
            lead=lead,
            winner=CARS[winner] if winner >= 0 else "",
            crash=CRASHES[crash],
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
