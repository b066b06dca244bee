"""Checks to run on your own planner, archive or characteristic before racing with it.

Each check raises an :class:`AssertionError` that names the problem, and returns None without one:

>>> from pcs_racing.testing import check_planner
>>> check_planner(get_planner("lattice"), load_track("Tarnfjord"))            # doctest: +SKIP
"""

import tempfile
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.car.vehicle import PSI, V, X, Y
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive, save_archive
from pcs_racing.game.characteristics import Characteristic, Segment
from pcs_racing.game.moves import no_op_share
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.calling import bounds_checked
from pcs_racing.planners.planner import Planner
from pcs_racing.race.config import PAPER, Rules, load_rules
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, draw_starts, start_races
from pcs_racing.race.state import SUMS, RaceState, take
from pcs_racing.track.track import Track

RACES = 6


def check_planner(planner: Planner, track: Track, *, seconds: float = 4.0, seed: int = 0) -> None:
    """Check that a planner drives, and depends on its arguments only.

    Policies between its bounds race each other. Compiled functions must stay within their arrays
    (functions called by them are not checked). All numbers must stay finite, and the parameters
    unchanged. A race must end the same if repeated, run alone, or cut in pieces. With the default
    policy the cars must move. Opponents beyond the planner's ``sight`` must make no difference,
    except by the order of the cars. ``seconds``, the length of the races, is a multiple of 0.4.
    """
    setup = RaceSetup(track, load_rules(PAPER, duration=seconds), (planner, planner))
    rng = np.random.default_rng(seed)
    theta = np.zeros((RACES, 2, setup.theta_size))
    for race in range(RACES):
        for car in range(2):
            theta[race, car, : len(planner.parameters)] = (
                planner.default if race == 0 else planner.sample(rng)
            )
    grid = start_races(setup, draw_starts(track, setup.rules, RACES, seed), race_seeds(seed, RACES))
    ticks, who = setup.rules.ticks, f"planner {planner.name!r}"

    def drive(state: RaceState, parameters: NDArray[np.float64], pieces: int = 1) -> RaceState:
        given = parameters.copy()
        after = state.copy()
        for _ in range(pieces):
            advance(setup, after, given, ticks // pieces)
        assert np.array_equal(given, parameters), (
            f"{who} writes to its parameters; it must leave theta as it is"
        )
        return after

    careful = replace(
        planner, plan=bounds_checked(planner.plan), control=bounds_checked(planner.control)
    )
    try:
        advance(RaceSetup(track, setup.rules, (careful, careful)), grid.copy(), theta.copy(), ticks)
    except InputError as error:
        beyond = f"{who} reads or writes beyond the end of an array: " * isinstance(
            error.__cause__, IndexError
        )
        raise AssertionError(f"{beyond}{error}") from error
    end = drive(grid, theta)
    for name in ("cars", "command", "path", "memory"):
        array = getattr(end, name)
        assert np.isfinite(array).all(), (
            f"{who} leaves NaN or infinity in {name} of race"
            f" {int(np.argwhere(~np.isfinite(array))[0][0])}"
        )
    assert end.cars[0, :, V].max() > 0.1, (
        f"{who}: with the default policy the cars stand still after {seconds:g} s"
    )
    same = "; it must depend on nothing but its arguments"
    _assert_equal(
        drive(grid, theta), end, f"{who}: the same races end differently the second time{same}"
    )
    alone = drive(take(grid, [RACES - 1]), theta[RACES - 1 :])
    _assert_equal(
        alone, take(end, [RACES - 1]), f"{who}: a race ends differently without the others{same}"
    )
    _assert_equal(
        drive(grid, theta, pieces=4), end, f"{who}: races end differently when cut in pieces{same}"
    )
    for side in (1.0, -1.0):
        _check_sight(setup, take(grid, [0] * RACES), theta, rng, side)


def _check_sight(
    setup: RaceSetup,
    state: RaceState,
    theta: NDArray[np.float64],
    rng: np.random.Generator,
    side: float,
) -> None:
    """Check that a planner ignores an opponent ahead (1) or behind (-1) beyond its sight.

    A planner may know which car leads at any distance: the cars are in sight during an overtake.
    """
    planner, track = setup.planners[0], setup.track
    near, far = planner.sight + 2.0, 0.5 * track.length - 2.0
    if near >= far:
        return
    gap = np.linspace(near, far, RACES) * side
    s = np.mod(state.frenet[:, 0, 0] + gap, track.length)
    pose = track.to_cartesian(np.stack([s, np.zeros(RACES)], axis=-1))
    state.progress[:, 1] = state.progress[:, 0] + gap
    state.frenet[:, 1, 0], state.frenet[:, 1, 1] = s, 0.0
    state.cars[:, 1, X], state.cars[:, 1, Y], state.cars[:, 1, PSI] = pose.T
    state.cars[:, 1, V] = rng.uniform(1.0, 6.0, RACES)
    same = np.stack([np.broadcast_to(theta[0, 0], theta[:, 0].shape), theta[:, 1]], axis=1)
    advance(setup, state, same, 20)
    for name in ("cars", "command", "path", "memory"):
        own = getattr(state, name)[~state.crashed, 0]
        assert (own == own[0]).all(), (
            f"planner {planner.name!r} has sight {planner.sight:g}, but drives differently when"
            f" only an opponent beyond that does ({name})"
        )


def check_archive(archive: PolicyArchive, track: Track | None = None) -> None:
    """Check that an archive's policies exist, that its moves make sense, and that it can be saved.

    Its planner must be known and have its parameters, with all policies inside the bounds. Each
    policy must be the nearest to its own coordinates, and some move must lead to another policy.
    The archive must read back unchanged from a file. On a ``track``, a short game is played between
    its first and its last policy.
    """
    who = f"archive {archive.name!r}"
    try:
        archive.family()
    except InputError as error:
        raise AssertionError(str(error)) from error
    back = archive.nearest(archive.normalised)
    lost = np.flatnonzero((archive.coordinates[back] != archive.coordinates).any(axis=1))
    assert len(lost) == 0, f"{who}: policy {lost[0]} is not the nearest to its own coordinates"
    assert no_op_share(archive) < 1.0, f"{who}: no move leads from any policy to another"
    with tempfile.TemporaryDirectory() as folder:
        read = load_archive(save_archive(archive, folder))
    for key in archive.__dataclass_fields__:
        mine, other = getattr(archive, key), getattr(read, key)
        same = np.array_equal(mine, other) if isinstance(mine, np.ndarray) else mine == other
        assert same, f"{who}: {key} reads back differently from a file"
    if track is None:
        return
    game = RaceGame(track, archive, Rules(steps=(2.0, 2.0)))
    end = game.step(game.reset(policies=[0, len(archive) - 1]), [[0, 1]])
    assert np.isfinite(game.observation(end)).all(), (
        f"{who}: a game on {track.name} leaves NaN or infinity in the observation"
    )


def check_characteristic(characteristic: Characteristic, *, seed: int = 0) -> None:
    """Check that a characteristic gives one finite number per race and car, and treats all alike.

    The check includes segments of zero length. The result must not depend on the other races of the
    batch, and must follow the cars when they change places. The segment must not be changed.
    """
    who = f"characteristic {characteristic.name!r}"
    rng = np.random.default_rng(seed)
    time = np.array([8.0, 8.0, 3.2, 0.02, 0.0])
    races = len(time)
    sums = rng.uniform(0.0, 2.0, (races, 2, len(SUMS))) * time[:, None, None]
    segment = Segment(rng.uniform(0.0, 6.0, (races, 2)) * time[:, None], sums, time, 8.0)
    kept = Segment(segment.progress.copy(), segment.sums.copy(), segment.time.copy(), 8.0)
    values = np.asarray(characteristic.evaluate(segment))
    untouched = all(
        np.array_equal(getattr(segment, key), getattr(kept, key))
        for key in ("progress", "sums", "time")
    )
    assert untouched, f"{who} writes to the segment; it must leave it as it is"
    assert values.shape == (
        races,
        2,
    ), f"{who} returns shape {values.shape} for {races} races; it must be ({races}, 2)"
    assert values.dtype.kind == "f", f"{who} returns type {values.dtype}; it must be floating point"
    for race in range(races):
        assert np.isfinite(values[race]).all(), (
            f"{who} is {values[race]} for a piece of {time[race]} s; it must be finite"
        )
        one = slice(race, race + 1)
        alone = characteristic.evaluate(
            Segment(kept.progress[one], kept.sums[one], kept.time[one], 8.0)
        )
        assert np.array_equal(alone, values[one]), (
            f"{who}: the value of a race depends on the other races of the batch"
        )
    swapped = characteristic.evaluate(
        Segment(kept.progress[:, ::-1], kept.sums[:, ::-1], kept.time, 8.0)
    )
    assert np.array_equal(swapped, values[:, ::-1]), (
        f"{who}: the values do not change places when the cars do"
    )


def _assert_equal(found: RaceState, expected: RaceState, message: str) -> None:
    for name, array in found._asdict().items():
        assert np.array_equal(array, getattr(expected, name), equal_nan=array.dtype.kind == "f"), (
            f"{message} ({name})"
        )
