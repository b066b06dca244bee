"""Scans against exact cell traversal, opponents in every direction, noise, and bad input."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from placed_cars import placed, view_of
from refusal import refused

from pcs_racing.car.collision import Rectangle
from pcs_racing.car.lidar import Lidar
from pcs_racing.car.lidar_kernel import Pose, scan_into
from pcs_racing.car.vehicle import VehicleParams
from pcs_racing.planners.scanning import BEAMS, FIELD_OF_VIEW, MAX_RANGE, SCAN_SIZE, scan
from pcs_racing.track.grid import cast
from pcs_racing.track.loading import load_track

LENGTH, WIDTH = 0.58, 0.31


def rectangle_ranges(pose, angles, other):
    """Exact ranges to an opponent's rectangle; infinite where beams miss it."""
    c, s = np.cos(other[2]), np.sin(other[2])
    box = (
        np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        * [0.5 * LENGTH, 0.5 * WIDTH]
        @ np.array([[c, s], [-s, c]])
    )
    box += np.asarray(other[:2]) - pose[:2]
    cos, sin = np.cos(angles + pose[2]), np.sin(angles + pose[2])
    ranges = np.full(len(angles), np.inf)
    for (ax, ay), (bx, by) in zip(box, np.roll(box, -1, axis=0), strict=True):
        across = cos * (by - ay) - sin * (bx - ax)
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = (ax * by - ay * bx) / across
            along = (ax * sin - ay * cos) / across
        ranges = np.where((hit > 0) & (along >= 0) & (along <= 1), np.minimum(ranges, hit), ranges)
    return ranges


def poses_on(track, count, seed=0):
    rng = np.random.default_rng(seed)
    sd = np.column_stack([rng.uniform(0, track.length, count), rng.uniform(-0.8, 0.8, count)])
    return track.to_cartesian(sd) + np.column_stack(
        [np.zeros((count, 2)), rng.uniform(-np.pi, np.pi, count)]
    )


def assert_close_to_exact(found, exact):
    error = np.abs(found - exact)
    assert np.median(error) <= 0.01
    assert np.quantile(error, 0.99) <= 0.2
    assert (error > 1.0).mean() <= 1e-3


def test_scans_of_the_reference(real_maps, reference):
    data = np.load(reference / "scans_spielberg.npz")
    lidar = Lidar(load_track(real_maps / "Spielberg"))
    assert np.allclose(lidar.angles, data["beam_angles"], atol=1e-12)
    found = lidar.scan(data["poses"])
    exact = np.minimum(data["exact_scans"], 30.0)
    assert_close_to_exact(found, exact)
    # Nearer to the truth than the ray march of the established simulator.
    marched = np.abs(data["gym_scans"] - exact)
    assert np.median(np.abs(found - exact)) < 0.5 * np.median(marched)
    assert (np.abs(found - exact) > 1.0).sum() < 0.5 * (marched > 1.0).sum()


@pytest.mark.parametrize("fov", [2.0 * np.pi, 4.7, 1.0])
@pytest.mark.parametrize("beams", [1080, 37, 2, 1])
def test_an_opponent_is_seen_in_every_direction(oval, fov, beams):
    lidar = Lidar(oval, beams=beams, fov=fov)
    hidden = 0
    for psi in np.linspace(-np.pi, np.pi, 16):
        pose = np.array([1.0, -4.0, psi])
        alone = lidar.scan(pose)
        for bearing in np.linspace(-np.pi, np.pi, 33):
            other = [1.0 + 0.6 * np.cos(bearing), -4.0 + 0.6 * np.sin(bearing), 0.3]
            expected = np.minimum(alone, rectangle_ranges(pose, lidar.angles, other))
            error = np.abs(lidar.scan(pose, other) - expected)
            # a beam through a corner may be rounded to either side
            assert (error > 1e-5).sum() <= 1
            hidden += (expected < alone).any()
    assert hidden > (0 if beams <= 2 else 100)


def test_a_lidar_within_a_car_in_a_wall_and_of_a_single_beam(oval):
    lidar = Lidar(oval, beams=360, fov=2.0 * np.pi)
    pose = [1.0, -4.0, 0.4]
    other = [1.05, -4.02, 1.0]
    assert np.allclose(
        lidar.scan(pose, other), rectangle_ranges(np.array(pose), lidar.angles, other), atol=1e-6
    )
    lidar = Lidar(oval, beams=36)
    for x, y in [(0.0, 0.0), (1e9, 0.0), (-1e9, 1e300), (0.0, -5.3)]:
        assert (lidar.scan([x, y, 0.3]) == 0.0).all()
    lidar = Lidar(oval, beams=1)
    assert lidar.angles.tolist() == [0.0]
    assert lidar.scan([0.0, -4.0, -0.5 * np.pi])[0] == pytest.approx(1.1, abs=0.06)


def test_beams_beside_an_edge_end_where_the_grid_says(oval):
    """The drawn outlines differ from the cells by a fraction of one: enough to miss an edge."""
    lidar = Lidar(oval, fov=2.0 * np.pi)
    edges = wrong = 0
    for pose in poses_on(oval, 40):
        exact = ranges_on_the_grid(oval, pose, lidar.angles)
        jumps = np.abs(np.diff(exact)) > 1.0
        beside = np.append(jumps, False) | np.append(False, jumps)
        edges += beside.sum()
        wrong += (np.abs(lidar.scan(pose) - exact)[beside] > 0.2).sum()
    assert edges > 100
    assert wrong <= 0.03 * edges


def ranges_on_the_grid(track, pose, angles):
    """Ranges of beams that are followed from cell to cell."""
    arrays = track.arrays
    u, v = (pose[0] - arrays.origin_x) / arrays.cell, (pose[1] - arrays.origin_y) / arrays.cell
    ways = zip(np.cos(pose[2] + angles), np.sin(pose[2] + angles), strict=True)
    return arrays.cell * np.array(
        [cast(arrays.distance, u, v, c, s, 30.0 / arrays.cell)[0] for c, s in ways]
    )


def test_ranges_stay_within_the_longest_and_a_lidar_never_changes(oval):
    scans = Lidar(oval, max_range=3.0).scan(poses_on(oval, 20))
    assert scans.max() == pytest.approx(3.0)
    assert (scans > 0.0).all()
    full = Lidar(oval, max_range=50.0).scan(poses_on(oval, 20))
    assert full.max() < 25.0  # the oval is closed
    # Edges at the longest range are no edges any more, so they are not settled.
    assert (np.abs(scans - np.minimum(full, 3.0)) > 1e-6).mean() < 2e-3
    lidar = Lidar(oval)
    with pytest.raises(AttributeError):
        lidar.beams = 5
    for array in (lidar.angles, lidar.kernel.cos, lidar.kernel.sin):
        assert not array.flags.writeable


def test_many_poses_are_scanned_as_one_by_one_in_any_thread_and_in_little_memory(oval):
    lidar = Lidar(oval, beams=108)
    poses = poses_on(oval, 24).reshape(2, 3, 4, 3)
    others = poses_on(oval, 24, seed=1).reshape(2, 3, 4, 3)
    scans = lidar.scan(poses, others)
    assert scans.shape == (2, 3, 4, 108)
    assert np.array_equal(scans[1, 2, 3], lidar.scan(poses[1, 2, 3], others[1, 2, 3]))
    with ThreadPoolExecutor(2) as pool:
        for threaded in pool.map(lambda _: lidar.scan(poses, others), range(8)):
            assert np.array_equal(threaded, scans)
    assert lidar.scan(np.empty((0, 3))).shape == (0, 108)
    lidar = Lidar(oval)
    out = np.empty(1080, dtype=np.float32)
    for pose, other in zip(poses_on(oval, 10), poses_on(oval, 10, seed=1), strict=True):
        s = oval.to_frenet(pose[:2])[0]
        body = Rectangle(*other, 0.5 * LENGTH, 0.5 * WIDTH)
        scan_into(oval.arrays, lidar.kernel, Pose(*pose), s, True, body, np.empty((4, 16)), out)
        error = np.abs(out - lidar.scan(pose, other))
        assert np.median(error) < 1e-5
        assert (error > 1e-3).sum() <= 2


def test_noise_comes_from_the_given_generator_alone(oval):
    lidar = Lidar(oval, vehicle={"lidar_noise": 0.02})
    poses = poses_on(oval, 50)
    exact = Lidar(oval).scan(poses)
    noisy = lidar.scan(poses, rng=np.random.default_rng(3))
    assert np.array_equal(noisy, lidar.scan(poses, rng=np.random.default_rng(3)))
    assert not np.array_equal(noisy[0], lidar.scan(poses[0], rng=np.random.default_rng(4)))
    difference = (noisy - exact)[exact < 29.0]
    assert difference.std() == pytest.approx(0.02, rel=0.05)
    assert abs(difference.mean()) < 1e-3
    assert noisy.min() >= 0.0
    assert noisy.max() <= 30.0
    refused("rng", lidar.scan, poses)


WRONG = {
    "track": ("Spielberg",),
    "beams": (0, 100_001, 10.5, True),
    "fov": (0.0, 6.3, np.nan, "wide"),
    "max_range": (0.0, np.inf),
}


def test_impossible_lidars_and_poses_are_refused(oval):
    for name, value in [(name, value) for name, values in WRONG.items() for value in values]:
        refused(name, Lidar, **{"track": oval} | {name: value})
    refused("lidar_noise is -0.1", Lidar, oval, vehicle={"lidar_noise": -0.1})
    for poses, opponents, message in [
        ([1.0, 2.0], None, "poses must"),
        (1.0, None, "poses must"),
        ([[1.0, 2.0, np.nan]], None, r"poses .*\[1.0, 2.0, nan\]"),
        ([1.0, np.inf, 0.0], None, r"poses must be finite"),
        (["a", "b", "c"], None, r"poses must be numbers"),
        ([0.0, -4.0, 0.0], [1.0, 2.0], "opponents must"),
        ([0.0, -4.0, 0.0], [1.0, 2.0, np.nan], r"opponents must be finite"),
        ([0.0, -4.0, 0.0], np.zeros((2, 3)), r"can't be broadcast"),
    ]:
        refused(message, Lidar(oval).scan, poses, opponents)
    refused(
        "width", Lidar(oval).scan, [0.0, -4.0, 0.0], [1.0, -4.0, 0.0], opponent_size=(0.58, -1.0)
    )


PLACES = ((3.0, 0.3, 0.2), (5.0, -0.3))


def planner_scan(track, car, tick=0, seed=5):
    """Scan of a planner's lidar, in a race of two such cars."""
    setup, state, _ = placed(track, PLACES, vehicles=(car, car))
    state.tick[:], state.seed[:] = tick, seed
    scratch = np.zeros(SCAN_SIZE)
    scan(track.arrays, view_of(setup, state, 0, 0), scratch)
    return scratch[-BEAMS:].copy(), state.cars[0][:, [0, 1, 4]]


def lidar(track, **car):
    return Lidar(track, BEAMS, FIELD_OF_VIEW, MAX_RANGE, car)


@pytest.mark.parametrize(
    "errors",
    [
        {},
        {"lidar_x": 0.25},
        {"lidar_x": -0.1, "lidar_y": 0.05, "lidar_yaw": 0.3},
        {"lidar_fov": 2.0},
        {"lidar_bias": -0.07},
        {"lidar_step": 0.25, "lidar_bias": 0.03},
    ],
)
def test_planners_and_lidars_have_the_same_errors(coarse_oval, errors):
    found, (own, other) = planner_scan(coarse_oval, VehicleParams(**errors))
    np.testing.assert_allclose(found, lidar(coarse_oval, **errors).scan(own, other), atol=1e-9)


def test_a_mounted_lidar_scans_from_its_own_place(coarse_oval):
    exact, (own, other) = planner_scan(coarse_oval, VehicleParams())
    moved, _ = planner_scan(coarse_oval, VehicleParams(lidar_x=0.2, lidar_y=-0.1, lidar_yaw=0.4))
    sine, cosine = np.sin(own[2]), np.cos(own[2])
    place = own + np.array([0.2 * cosine + 0.1 * sine, 0.2 * sine - 0.1 * cosine, 0.4])
    np.testing.assert_allclose(moved, lidar(coarse_oval).scan(place, other), atol=1e-9)
    assert np.abs(moved - exact).max() > 0.1


def test_beams_outside_the_field_of_view_read_the_max_range(coarse_oval):
    exact, _ = planner_scan(coarse_oval, VehicleParams())
    narrow, _ = planner_scan(coarse_oval, VehicleParams(lidar_fov=2.0))
    angles = lidar(coarse_oval).angles
    np.testing.assert_array_equal(narrow, np.where(np.abs(angles) <= 1.0, exact, MAX_RANGE))
    assert (narrow == MAX_RANGE).sum() > 100 > (exact == MAX_RANGE).sum()


def test_bias_and_steps_change_ranges_below_the_max_range(coarse_oval):
    exact, _ = planner_scan(coarse_oval, VehicleParams())
    biased, _ = planner_scan(coarse_oval, VehicleParams(lidar_bias=0.05))
    np.testing.assert_allclose(biased, np.minimum(exact + 0.05, MAX_RANGE), atol=1e-12)
    coarse, _ = planner_scan(coarse_oval, VehicleParams(lidar_step=0.2))
    assert np.abs(coarse - exact).max() <= 0.1 + 1e-12
    np.testing.assert_allclose(coarse / 0.2, np.round(coarse / 0.2), atol=1e-9)
    low = Lidar(coarse_oval, 40, max_range=0.7, vehicle={"lidar_bias": -0.1, "lidar_step": 0.3})
    ranges = low.scan([*coarse_oval.to_cartesian([3.0, 0.0])])
    assert (ranges == 0.7).any()  # without a return: neither biased nor rounded


def test_noise_and_losses_are_new_for_each_beam_car_and_moment(coarse_oval):
    exact, (own, other) = planner_scan(coarse_oval, VehicleParams())
    errors = {"lidar_noise": 0.02, "lidar_lost": 0.1}
    scans = np.array(
        [planner_scan(coarse_oval, VehicleParams(**errors), tick)[0] for tick in range(0, 100, 2)]
    )
    near = exact < MAX_RANGE - 1.0
    lost = (scans == MAX_RANGE)[:, near]
    assert lost.mean() == pytest.approx(0.1, abs=0.01)
    noise = (scans - exact)[:, near]
    assert noise[~lost].std() == pytest.approx(0.02, rel=0.05)
    assert abs(noise[~lost].mean()) < 0.001
    both = ~lost[1:] & ~lost[:-1]
    assert abs(np.corrcoef(noise[1:][both], noise[:-1][both])[0, 1]) < 0.05
    pairs = ~lost[:, 1:] & ~lost[:, :-1]
    assert abs(np.corrcoef(noise[:, 1:][pairs], noise[:, :-1][pairs])[0, 1]) < 0.05
    again, _ = planner_scan(coarse_oval, VehicleParams(**errors), 98)
    np.testing.assert_array_equal(again, scans[-1])
    drawn = lidar(coarse_oval, **errors).scan(
        np.tile(own, (50, 1)), other, rng=np.random.default_rng(0)
    )
    assert (drawn == MAX_RANGE)[:, near].mean() == pytest.approx(0.1, abs=0.01)
    none = lidar(coarse_oval, lidar_lost=1.0).scan(own, rng=np.random.default_rng(0))
    assert (none == MAX_RANGE).all()
