"""The pieces of the compiled loop that have a meaning of their own."""

import numpy as np

from pcs_racing.planner import VIEW, VIEW_SIZE
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race import RaceSetup, advance, draw_starts, run_races, start_races
from pcs_racing.race_config import CONTEST, PAPER
from pcs_racing.race_kernel import fill_view, steering_noise
from pcs_racing.race_state import SUMS
from pcs_racing.seeds import race_seeds
from pcs_racing.track import load_track

NAMES = list(VIEW)


def noise(count: int, seed: int, car: int = 0) -> np.ndarray:
    return np.array([steering_noise(np.uint64(seed), car, tick) for tick in range(0, 2 * count, 2)])


def test_noise_is_standard_and_different_for_each_race_and_car() -> None:
    draws = noise(20_000, seed=1)
    assert abs(draws.mean()) < 0.03
    assert abs(draws.std() - 1.0) < 0.02
    assert np.abs(draws).max() <= 3.5
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 0.03
    for other in (noise(20_000, seed=2), noise(20_000, seed=1, car=1)):
        assert abs(np.corrcoef(draws, other)[0, 1]) < 0.03
    np.testing.assert_array_equal(draws, noise(20_000, seed=1))


def test_the_view_of_one_car_mirrors_that_of_the_other() -> None:
    track = load_track("Tarnfjord")
    setup = RaceSetup(track, PAPER, (LATTICE, LATTICE))
    state = start_races(setup, draw_starts(track, PAPER, 2, seed=5), race_seeds(5, 2))
    theta = np.tile(LATTICE.default, (2, 2, 1))
    advance(setup, state, theta, 200)
    params = np.stack([vehicle.as_row() for vehicle in setup.vehicles])
    views = np.zeros((2, VIEW_SIZE))
    for car in range(2):
        fill_view(track.arrays, state, 0, car, params, setup.settings, views[car])
    mine, theirs = (dict(zip(NAMES, view, strict=True)) for view in views)
    for own, opponent in (("X", "OPP_X"), ("V", "OPP_V"), ("S", "OPP_S"), ("D", "OPP_D"), ("WIDTH", "OPP_WIDTH")):
        assert mine[own] == theirs[opponent]
        assert theirs[own] == mine[opponent]
    assert mine["GAP"] == -theirs["GAP"] == -state.lead[0]
    assert mine["TIME"] == 2.0
    assert (mine["SPEED_LOW"], mine["SPEED_HIGH"]) == setup.speed_range


def test_time_and_samples_add_up() -> None:
    track = load_track("Tarnfjord")
    result = run_races(track, LATTICE.policy({"pace": 0.2}), LATTICE.policy({"pace": 0.4}), seed=3)
    sums = dict(zip(SUMS, result.state.sums[0, 0], strict=True))
    assert not result.crashed[0]
    np.testing.assert_allclose(sums["TIME"], PAPER.duration)
    assert sums["ITTC_SAMPLES"] == PAPER.duration * 20
    assert 0.0 < sums["ITTC"] / sums["ITTC_SAMPLES"] < PAPER.ittc_horizon


def test_noise_disturbs_the_contest_and_only_there() -> None:
    track = load_track("Tarnfjord")
    policy = LATTICE.policy({"pace": 0.1})
    for config, spread in ((PAPER, False), (CONTEST, True)):
        setup = RaceSetup(track, config, (LATTICE, LATTICE))
        starts = draw_starts(track, config, 1, seed=0).take([0, 0])
        state = start_races(setup, starts, np.array([1, 2], np.uint64))
        theta = np.tile(policy.parameters, (2, 2, 1))
        advance(setup, state, theta, 300)
        assert (state.cars[0] != state.cars[1]).any() == spread
