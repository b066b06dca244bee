"""Archives by random search: draw policies, race them all alike, keep those that none beats in everything.

    python -m pcs_racing_agents.synthesis.random_search archives/default     # makes the shipped archive again

It needs no tuning and finds a front of some sort in a minute; a directed search finds a better one.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.archive import PolicyArchive
from pcs_racing.characteristics import Segment, get_characteristics, measure
from pcs_racing.errors import InputError
from pcs_racing.planner import Planner
from pcs_racing.race import RaceSetup, advance, draw_starts, race_seeds, start_races
from pcs_racing.race_config import PAPER, RaceConfig, load_race_config
from pcs_racing.registry import get_planner
from pcs_racing.track import Track, load_track

__all__ = ["Evaluation", "evaluate", "front_layers", "random_archive"]

Floats = NDArray[np.float64]

DEFAULT_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")
BATCH = 4096  # races advanced together: bounded memory


class Evaluation(NamedTuple):
    """What came of racing K policies.

    Attributes
    ----------
    coordinates : ndarray, shape (K, G)
        Mean over all pieces of racing, in the characteristics' units.
    own_crash : ndarray, shape (K,)
        Share of the races that ended by a crash of the policy's own fault.
    """

    coordinates: Floats
    own_crash: Floats


def evaluate(
    tracks: Sequence[Track],
    planner: Planner,
    parameters: Floats,
    opponents: Floats,
    config: RaceConfig,
    characteristics: Sequence[str],
    *,
    segment_seconds: float = 8.0,
    races: int = 8,
    seed: int = 0,
) -> Evaluation:
    """Race every policy in the same races: race ``j`` on a track is the same opponent, start, side and noise for all.

    A race is cut into pieces of ``segment_seconds`` and a policy's coordinates are means over all pieces that were
    begun, since in the game they are compared with estimates from one such piece.

    Parameters
    ----------
    tracks : sequence of Track
    planner : Planner
        Of the policies and of their opponents.
    parameters : ndarray, shape (K, P)
    opponents : ndarray, shape (O, P)
        Taken in turn, two races each: one from either side.
    config : RaceConfig
    characteristics : sequence of str
    segment_seconds : float
        Length of a piece, s; the duration of the race must be a multiple.
    races : int
        Races of each policy on each track; even.
    seed : int
        Root of starts and noise.

    Raises
    ------
    InputError
        If ``races`` is odd, or the duration is no multiple of ``segment_seconds``.
    """
    if races < 2 or races % 2:
        raise InputError(f"races is {races!r}; it must be an even number, since every start is driven from both sides")
    pieces = round(config.duration / segment_seconds)
    if pieces < 1 or abs(pieces * segment_seconds - config.duration) > 1e-9:
        raise InputError(f"a race of {config.duration:g} s is no multiple of segment_seconds, {segment_seconds:g} s")
    axes = get_characteristics(characteristics)
    count = len(parameters)
    total, driven, crashes = np.zeros((count, len(axes))), np.zeros(count), np.zeros(count)
    pair = np.arange(races) // 2
    step = max(1, BATCH // races)
    for k, track in enumerate(tracks):
        setup = RaceSetup(track, config, (planner, planner))
        root = seed + 1_000_003 * k  # every track its own starts and noise
        starts, seeds = draw_starts(track, config, races, root), race_seeds(root, races)
        rivals = opponents[(pair + k * (races // 2)) % len(opponents)]
        for first in range(0, count, step):
            egos = parameters[first : first + step]
            which = np.tile(np.arange(races), len(egos))
            ego = np.repeat(np.arange(first, first + len(egos)), races)
            state = start_races(setup, starts.take(which), seeds[which])
            theta = np.ascontiguousarray(np.stack([parameters[ego], rivals[which]], axis=1))
            for _ in range(pieces):
                before = state.copy()
                advance(setup, state, theta, round(segment_seconds * 100.0))
                piece = Segment.between(before, state, segment_seconds)
                begun = np.flatnonzero(piece.time > 0.0)
                np.add.at(total, ego[begun], measure(piece, axes)[begun, 0])
                np.add.at(driven, ego[begun], 1.0)
            np.add.at(crashes, ego, state.fault[:, 0])
    return Evaluation(total / driven[:, None], crashes / (races * len(tracks)))


def front_layers(points: Floats) -> NDArray[np.int64]:
    """Layer of each point, shape (K,): 0 if no other point beats it, 1 if only points of layer 0 do, and so on.

    A point beats another if it is at least as large in all coordinates and larger in one.
    """
    points = np.asarray(points, np.float64)
    beats = np.all(points[:, None] >= points[None], axis=-1) & np.any(points[:, None] > points[None], axis=-1)
    layer = np.full(len(points), -1, np.int64)
    depth = 0
    while (layer < 0).any():
        left = np.flatnonzero(layer < 0)
        beaten = np.any(beats[np.ix_(left, left)], axis=0)
        layer[left[~beaten]] = depth
        depth += 1
    return layer


def random_archive(
    tracks: Sequence[Track],
    config: RaceConfig = PAPER,
    characteristics: Sequence[str] | None = None,
    *,
    name: str = "random",
    planner: str = "lattice",
    policies: int = 600,
    opponents: int = 12,
    races: int = 8,
    held_out_races: int = 24,
    segment_seconds: float = 8.0,
    crash_limit: float = 0.15,
    fewest: int = 12,
    seed: int = 0,
) -> PolicyArchive:
    """Make an archive from policies drawn at random.

    Of the policies that crash by their own fault in at most ``crash_limit`` of the races, those stay that no other
    beats on all axes; if they are fewer than ``fewest``, the next layer of the front joins them, and so on. The
    coordinates in the archive come from other starts, noise and opponents than the choice did.

    Parameters
    ----------
    tracks : sequence of Track
    config : RaceConfig
        Rules and duration of the races.
    characteristics : sequence of str, optional
        Axes; by default aggressiveness (or pace, as the rules say) and restraint.
    name : str
        Of the archive.
    planner : str
        Whose parameters are drawn, uniformly between their bounds.
    policies, opponents : int
        How many are drawn; the opponents are drawn like the policies, and others for the final races.
    races, held_out_races : int
        Races of each policy on each track for the choice and for the final coordinates; even.
    segment_seconds : float
        Length of the pieces that coordinates are means of, s.
    crash_limit : float
        Share of own crashes that is tolerated.
    fewest : int
        Policies that the archive should hold at least.
    seed : int

    Raises
    ------
    InputError
        If no policy stays below the crash limit, or a number is impossible.
    """
    if len(tracks) == 0 or policies < 2 or opponents < 1:
        raise InputError(f"{len(tracks)} tracks, {policies} policies, {opponents} opponents: take at least 1, 2 and 1")
    if characteristics is None:
        characteristics = ("pace" if config.aggressiveness == "pace" else "aggressiveness", "restraint")
    family = get_planner(planner)
    counts, roots = (policies, opponents, opponents), np.random.SeedSequence(seed).spawn(3)
    generators = [np.random.default_rng(root) for root in roots]
    drawn, rivals, fresh_rivals = (
        np.stack([family.sample(rng) for _ in range(count)]) for count, rng in zip(counts, generators, strict=True)
    )
    first = evaluate(
        tracks,
        family,
        drawn,
        rivals,
        config,
        characteristics,
        segment_seconds=segment_seconds,
        races=races,
        seed=2 * seed,
    )
    safe = np.flatnonzero(first.own_crash <= crash_limit)
    if len(safe) == 0:
        raise InputError(
            f"all {policies} policies crash in more than {crash_limit:.0%} of the races; draw more, or lower the "
            "speed range"
        )
    layer = front_layers(first.coordinates[safe])
    depth = next((d for d in range(int(layer.max()) + 1) if np.sum(layer <= d) >= fewest), int(layer.max()))
    kept = safe[layer <= depth]
    kept = kept[np.argsort(first.coordinates[kept, 0], kind="stable")]
    final = evaluate(
        tracks,
        family,
        drawn[kept],
        fresh_rivals,
        config,
        characteristics,
        segment_seconds=segment_seconds,
        races=held_out_races,
        seed=2 * seed + 1,
    )
    return PolicyArchive(
        name=name,
        planner=planner,
        parameter_names=family.parameter_names,
        parameters=drawn[kept],
        characteristics=tuple(characteristics),
        coordinates=final.coordinates,
        explored_parameters=drawn,
        explored_coordinates=first.coordinates,
        settings={
            "method": "random search, provisional: no directed search (MO-CMA-ES) stands behind it",
            "tracks": ", ".join(track.name for track in tracks),
            "duration": config.duration,
            "segment_seconds": segment_seconds,
            "policies_drawn": policies,
            "opponents": opponents,
            "races_per_track": races,
            "held_out_races_per_track": held_out_races,
            "crash_limit": crash_limit,
            "policies_below_crash_limit": len(safe),
            "front_layers_kept": depth + 1,
            "held_out_own_crash_mean": round(float(final.own_crash.mean()), 4),
            "held_out_own_crash_largest": round(float(final.own_crash.max()), 4),
            "seed": seed,
        },
        preset=config.name,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Make an archive and write it."""
    parser = argparse.ArgumentParser(description="Make an archive of policies by random search.", allow_abbrev=False)
    parser.add_argument("folder", type=Path, help="where to write it; the folder's name is the archive's")
    parser.add_argument(
        "--tracks", nargs="+", default=list(DEFAULT_TRACKS), help=f"default: {' '.join(DEFAULT_TRACKS)}"
    )
    parser.add_argument("--preset", default="paper", help="rules of the races (default: paper)")
    parser.add_argument("--duration", type=float, default=16.0, help="of a race, s (default: 16)")
    parser.add_argument("--characteristics", nargs="+", help="default: aggressiveness or pace, and restraint")
    parser.add_argument("--policies", type=int, default=600, help="policies to draw (default: 600)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    try:
        archive = random_archive(
            [load_track(name) for name in options.tracks],
            load_race_config(options.preset, duration=options.duration),
            options.characteristics,
            name=options.folder.name,
            policies=options.policies,
            seed=options.seed,
        )
        archive.save(options.folder)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(archive)
    for axis, low, high in zip(archive.characteristics, archive.nadir, archive.ideal, strict=True):
        print(f"{axis}: {low:.2f} to {high:.2f}")
    print(f"moves that lead nowhere: {archive.no_op_share():.0%}")
    print(f"moves that lead where an earlier one leads: {archive.duplicate_share():.0%}")
    for key, value in archive.settings.items():
        print(f"{key}: {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
