"""Ranges of a lidar with errors: each error alone, and the same in all scans of a car."""

import numpy as np
import pytest
from placed_cars import placed, view_of

from pcs_racing.car.lidar import Lidar
from pcs_racing.car.vehicle import VehicleParams
from pcs_racing.planners.scanning import BEAMS, FIELD_OF_VIEW, MAX_RANGE, SCAN_SIZE, scan

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
    again, _ = planner_scan(coarse_oval, VehicleParams(**errors), 98)
    np.testing.assert_array_equal(again, scans[-1])
    drawn = lidar(coarse_oval, **errors).scan(
        np.tile(own, (50, 1)), other, rng=np.random.default_rng(0)
    )
    assert (drawn == MAX_RANGE)[:, near].mean() == pytest.approx(0.1, abs=0.01)
    none = lidar(coarse_oval, lidar_lost=1.0).scan(own, rng=np.random.default_rng(0))
    assert (none == MAX_RANGE).all()
