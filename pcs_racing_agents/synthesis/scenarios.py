"""The races in which policies are compared: the same circuits, starts, opponents and noise for every policy.

Every policy meets every pair of start line and opponent, from both sides of the grid, on every track. All is drawn once
per run, so that policies differ by what they do and not by the luck of the draw.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_array
from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import start_lines
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scenarios:
    """The races that every policy drives: R of them."""

    #: Circuits, or their names or folders, which workers on other machines load themselves.
    tracks: tuple[Track | str, ...]
    config: RaceConfig  #: Rules and duration.
    planner: str  #: Of the policies and of their opponents, except for rivals.
    characteristics: tuple[str, ...]
    segment_seconds: float  #: Length of the segments that coordinates are means of, s.
    opponents: Floats  #: shape (O, P): Parameters of the opponents.
    rivals: tuple[str, ...]  #: Drivers of other planners, numbered after the opponents, as :func:`parse_policy` reads.
    track: NDArray[np.int64]  #: shape (R,): Index of the circuit of each race, ascending.
    start_s: Floats  #: shape (R,): Start line, m.
    side: NDArray[np.int64]  #: shape (R,): 0 when the policy starts on the left or in front.
    seed: NDArray[np.uint64]  #: shape (R,): Noise key.
    opponent: NDArray[np.int64]  #: shape (R,): Index of the opponent; a rival's from O on.

    def __len__(self) -> int:
        return len(self.track)


def draw_scenarios(
    tracks: Sequence[Track | str],
    config: RaceConfig,
    opponents: Floats,
    characteristics: Sequence[str],
    *,
    planner: str = "lattice",
    rivals: Sequence[str] = (),
    starts: int = 2,
    segment_seconds: float = 8.0,
    seed: int = 0,
) -> Scenarios:
    """Draw the races of a run: on every track, all pairs of ``starts`` start lines and all opponents, from both sides.

    Parameters
    ----------
    opponents : ndarray, shape (O, P)
    rivals : sequence of str
        Drivers of other planners that are met as the opponents are.
    starts : int
        Start lines on each track, 1 to 1000.
    segment_seconds : float
        Length of a segment, s; the duration of the race must be a multiple.
    seed : int
        Root of start lines and noise.

    Returns
    -------
    Scenarios
        ``len(tracks) * starts * (len(opponents) + len(rivals)) * 2`` races.
    """
    segments = round(config.duration / segment_seconds) if segment_seconds > 0.0 else 0
    if segments < 1 or abs(segments * segment_seconds - config.duration) > 1e-9:
        raise InputError(f"a race of {config.duration:g} s is no multiple of segment_seconds, {segment_seconds:g} s")
    family = get_planner(planner)
    opponents = check_policies("opponents", opponents, family)
    for rival in rivals:
        parse_policy(rival)
    if len(tracks) == 0:
        raise InputError("there are no tracks; name at least one")
    get_characteristics(characteristics)
    rules = replace(config, start_lines=starts)
    line, opponent, side = (indices.ravel() for indices in np.mgrid[:starts, : len(opponents) + len(rivals), :2])
    start_s, seeds = [], []
    for index, track in enumerate(tracks):
        # A root of its own for each circuit: another circuit in the list does not change the races on this one.
        root = np.random.SeedSequence(seed, spawn_key=(index,))
        lines, noise = root.spawn(2)
        start_s.append(start_lines(as_track(track), rules, lines)[line])
        seeds.append(race_seeds(int(noise.generate_state(1, np.uint64)[0]), len(line)))
    return Scenarios(
        tracks=tuple(tracks),
        config=config,
        planner=planner,
        characteristics=tuple(characteristics),
        segment_seconds=float(segment_seconds),
        opponents=opponents,
        rivals=tuple(rivals),
        track=np.repeat(np.arange(len(tracks)), len(line)),
        start_s=np.concatenate(start_s),
        side=np.tile(side, len(tracks)),
        seed=np.concatenate(seeds),
        opponent=np.tile(opponent, len(tracks)),
    )


def check_policies(name: str, parameters: ArrayLike, planner: Planner) -> Floats:
    """Return parameters of at least one policy of a planner, shape (K, P)."""
    policies = check_array(name, parameters, (None, len(planner.parameters)))
    if len(policies) == 0:
        raise InputError(f"there are no {name}; give at least one policy of planner {planner.name!r}")
    return policies
