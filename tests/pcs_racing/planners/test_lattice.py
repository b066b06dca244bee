from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pcs_racing import load_rules, load_track
from pcs_racing.car.vehicle import DELTA
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.lattice import REFERENCE
from pcs_racing.planners.line import GRIP
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.pursuit import COMMAND_SLOTS, hold_command
from pcs_racing.planners.view import (
    GAP,
    OPP_V,
    OWN_X,
    OWN_Y,
    PATH_POINTS,
    SPEED_HIGH,
    SPEED_LOW,
)
from pcs_racing.race.config import Rules
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, draw_starts, run_races, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.frenet import KAPPA, SPEED
from pcs_racing.track.maps import list_tracks

MEMORY = np.zeros(REFERENCE.memory_size)
RANGE = (0.8, 1.0)
PARKED = Planner("parked", (), control=hold_command, memory_size=COMMAND_SLOTS)


def candidates(track, view, parameters=None):
    """Points (64, 9, 2) and costs (64,)."""
    return REFERENCE.candidates(track.arrays, REFERENCE.policy(parameters).parameters, view, MEMORY)


def path(track, view, parameters=None):
    """The path that the planner writes, shape (12, 4)."""
    return plan(track, view, parameters=parameters)[0]


def plan(track, view, memory=MEMORY, parameters=None):
    """The path that the planner writes, and its memory after that."""
    written, memory = np.full((PATH_POINTS, 4), np.nan), memory.copy()
    scratch = np.full(REFERENCE.scratch_size, np.nan)  # values left there must not matter
    REFERENCE.plan(
        track.arrays, REFERENCE.policy(parameters).parameters, view, memory, scratch, written
    )
    return written, memory


def test_candidates_are_cubics_from_the_car_across_the_track(oval, view_at):
    view = view_at(oval, 3.0, 0.2)
    points, costs = candidates(oval, view)
    assert points.shape == (64, 9, 2)
    assert costs.shape == (64,)
    np.testing.assert_allclose(points[:, 0], np.tile(view[[OWN_X, OWN_Y]], (64, 1)), atol=1e-9)
    ends = oval.to_frenet(points[:, -1])
    assert len(np.unique(ends[:, 0].round(2))) == 2
    # Eight positions across the track, one of them on the line, at every distance; four speeds of
    # each move.
    np.testing.assert_array_equal(points.reshape(4, 16, 9, 2), np.tile(points[:16], (4, 1, 1, 1)))
    for across in ends[:16, 1].reshape(2, 8):
        assert (np.diff(across) > 0.05).all()
        assert np.abs(across).min() < 1e-6
        # 0.25 m from the side of the car
        np.testing.assert_allclose(across[[0, -1]], [-0.695, 0.695], atol=0.02)
    assert np.isfinite(costs).sum() > 32
    points, _ = candidates(oval, view_at(oval, 3.0, 0.2, turned=0.05, speed=4.0))
    for move in points[:16]:
        s, d = oval.to_frenet(move).T
        cubic = np.polynomial.Polynomial.fit(s, d, 3)
        np.testing.assert_allclose(cubic(s), d, atol=2e-3)
        assert cubic.deriv()(s[0]) == pytest.approx(np.tan(0.05), abs=0.01)
        assert cubic.deriv()(s[-1]) == pytest.approx(0.0, abs=0.01)


def test_pace_is_the_speed_of_the_path_which_begins_the_cheapest_candidate(oval, view_at):
    view = view_at(oval, 3.0, 0.2)
    points, costs = candidates(oval, view)
    s, d = oval.to_frenet(points[np.argmin(costs)]).T
    written = path(oval, view)
    assert np.isfinite(written).all()
    np.testing.assert_allclose(written[0, :2], view[[OWN_X, OWN_Y]], atol=1e-9)
    at, across = oval.to_frenet(written[:, :2]).T
    assert at[-1] - at[0] == pytest.approx(1.5 + 0.2 * 4.0, abs=0.01)
    np.testing.assert_allclose(across, np.polynomial.Polynomial.fit(s, d, 3)(at), atol=5e-3)
    view = view_at(oval, 3.0)
    slow, fast = (path(oval, view, {"pace": pace})[:, 2] for pace in (0.0, 1.0))
    low, high = RANGE
    np.testing.assert_allclose(slow / fast, low / high, atol=0.06)


def test_walls_and_swerves_that_would_spin_the_car_reject_candidates(oval, view_at):
    points, costs = candidates(oval, view_at(oval, 3.0))
    assert np.isfinite(costs[np.abs(oval.to_frenet(points[:, -1])[:, 1]) < 0.3]).all()
    # Next to the right wall and pointed at it, only bends to the left remain.
    points, costs = candidates(oval, view_at(oval, 3.0, -0.75, turned=-0.3, speed=1.0))
    rejected = ~np.isfinite(costs)
    assert 0 < rejected.sum() < 64
    nearest = oval.wall_distance(points).min(axis=1)
    assert nearest[~rejected].min() > 0.15
    assert rejected[nearest < 0.15].all()
    # At speed the near goals far to the side ask for more lateral acceleration than the tyres have.
    full_speed = np.arange(64) < 16
    points, costs = candidates(oval, view_at(oval, 3.0, speed=7.0))
    aside = np.abs(oval.to_frenet(points[:, -1])[:, 1])
    ahead = np.hypot(*(points[:, -1] - points[:, 0]).T)
    near = ahead < np.median(ahead)
    assert not np.isfinite(costs[full_speed & near & (aside > 0.7)]).any()
    assert np.isfinite(costs[aside < 0.1]).all()


def test_an_opponent_in_the_way_rejects_candidates_and_is_passed_on_the_free_side(oval, view_at):
    """Both cars' half widths and the margin are kept free next to a standing car."""
    points, costs = candidates(oval, view_at(oval, 3.0, speed=8.0, gap=8.0, opp_d=0.0))
    across = oval.to_frenet(points[:, -1])[:, 1]
    rejected = ~np.isfinite(costs)
    # Of the candidates that are open without a car.
    open_else = np.isfinite(candidates(oval, view_at(oval, 3.0, speed=8.0))[1]) & (
        np.arange(64) < 16
    )
    assert rejected[open_else & (np.abs(across) < 0.31 + 0.32)].all()
    assert not rejected[open_else & (np.abs(across) > 0.31 + 0.32)].any()
    assert (open_else & (np.abs(across) > 0.31 + 0.32)).any()
    full_speed = np.arange(64) < 16
    assert abs(across[full_speed][np.argmin(costs[full_speed])]) > 0.31 + 0.32
    for opp_d in [-0.5, 0.5]:
        end = oval.to_frenet(
            path(oval, view_at(oval, 3.0, gap=2.5, opp_d=opp_d, speed=3.0))[-1, :2]
        )
        assert np.sign(end[1]) != np.sign(opp_d) or abs(end[1]) < 0.05
        assert abs(end[1] - opp_d) > 0.31


def test_a_policy_has_a_second_pace_behind_within_the_range_of_speeds(oval, view_at):
    """A metre of lead leads from one pace to the other; a lap or more behind is behind, too."""
    for gap, expected in [
        (-8.0, 0.5),
        (-0.5, 0.5),
        (-0.25, 0.575),
        (0.0, 0.65),
        (0.5, 0.8),
        (8.0, 0.8),
        (100.0, 0.8),
    ]:
        view = view_at(oval, 3.0, opp_d=0.9)
        view[GAP] = gap
        two = path(oval, view, {"pace": 0.5, "pace_behind": 0.3})
        np.testing.assert_allclose(
            two, path(oval, view, {"pace": expected, "pace_behind": 0.0}), rtol=1e-12
        )
    for pace, behind, expected in [(0.8, 0.5, 1.0), (0.2, -0.5, 0.0), (0.2, -0.1, 0.1)]:
        view = view_at(oval, 3.0, gap=8.0)
        two = path(oval, view, {"pace": pace, "pace_behind": behind})
        np.testing.assert_allclose(
            two, path(oval, view, {"pace": expected, "pace_behind": 0.0}), rtol=1e-12
        )


@pytest.mark.parametrize("name", list_tracks())
def test_it_drives_shipped_circuits(name, drive_alone):
    check_solo(load_track(name), drive_alone)


@pytest.mark.parametrize("name", ["Catalunya", "Oschersleben", "Spielberg"])
def test_it_drives_real_circuits(name, real_maps, drive_alone):
    check_solo(load_track(real_maps / name), drive_alone)


def check_solo(track, drive_alone):
    result = drive_alone(track, [REFERENCE.policy({"pace": 0.5})], speed_range=RANGE)
    assert not result.crashed.any()
    # At least 85 % of the profile at this pace.
    laps = result.state.progress[0] + [0.0, min(0.5 * track.length, 50.0)]
    line = track.line
    speed = track.length / (track.arrays.ds / line[:, 6]).sum()
    assert (laps > 0.85 * 0.9 * speed * 40.0).all()


def test_a_faster_follower_gets_by_a_slower_car(shipped):
    """It starts 3 m behind a car that drives at 60 % of its speed scale, on five lines of every
    circuit.
    """
    config = Rules(
        duration=20.0, start="rolling", start_gap=3.0, start_spacing=0.0, speed_range=(0.5, 0.85)
    )
    slow, fast = PURE_PURSUIT.policy({"pace": 0.0}), [REFERENCE.policy({"pace": 1.0})] * 10
    # From the places of the paper's start, which every circuit has; other places would need
    # a calibration.
    starts = [draw_starts(track, load_rules("paper"), 10, seed=1) for track in shipped]
    results = [
        run_races(track, fast, slow, config, starts=at)
        for track, at in zip(shipped, starts, strict=True)
    ]
    behind = np.concatenate([result.starts.side == 1 for result in results])
    crashed = np.concatenate([result.crashed for result in results])[behind]
    passed = np.concatenate([result.lead > 0.0 for result in results])[behind]
    assert len(crashed) >= 40
    assert crashed.mean() <= 0.1
    assert passed[~crashed].mean() > 0.8


def test_a_plan_goes_on_where_the_last_one_was(oval, view_at):
    """A tenth of a second later a car that kept to its plan gets the same one; 70 % of a stray are
    led back.
    """
    first, memory = plan(oval, view_at(oval, 2.0, 0.3, turned=0.1, speed=5.0))
    s, d = oval.to_frenet(first[:, :2]).T
    move = CubicSpline(s, d)
    now = 2.0 + 0.1 * 5.0
    for stray in (0.0, 0.1, -0.2):
        view = view_at(
            oval, now, move(now) + stray, turned=float(np.arctan(move(now, 1))), speed=5.0
        )
        later = oval.to_frenet(plan(oval, view, memory)[0][:, :2])
        assert later[0, 1] - move(now) == pytest.approx(0.7 * stray, abs=2e-3)
        shared = later[:, 0] < s[-1]
        assert shared.sum() > 6
        left = later[shared, 1] - move(later[shared, 0])
        assert np.abs(left).max() <= 0.7 * abs(stray) + 0.02
        assert np.abs(left[-1]) < 0.04


@pytest.mark.parametrize(("stray", "beyond"), [(0.5, 0.0), (-0.5, 0.0), (0.0, 8.0)])
def test_a_car_that_lost_its_plan_begins_where_it_is(oval, view_at, stray, beyond):
    _, memory = plan(oval, view_at(oval, 1.0))
    view = view_at(oval, 1.3 + beyond, stray)
    again = plan(oval, view, memory)[0]
    np.testing.assert_allclose(again[0, :2], view[[OWN_X, OWN_Y]], atol=1e-9)
    np.testing.assert_array_equal(again, path(oval, view))


@pytest.mark.parametrize(("scale", "most"), [(0.7, 1.0), (1.0, 1.0), (1.3, 1.3**2)])
def test_the_paths_speed_respects_its_own_bends(scale, most, view_at):
    """Everywhere on a circuit, for cars that stand askew: GRIP, and from scale 1 on with its
    square, as on the line.
    """
    track = load_track("Pipkin")
    rng = np.random.default_rng(2)
    asked, profile = [], []
    for s in np.linspace(0.0, track.length, 150, endpoint=False):
        view = view_at(
            track,
            s,
            rng.uniform(-0.3, 0.3),
            turned=rng.uniform(-0.1, 0.1),
            speed=rng.uniform(3.0, 8.0),
        )
        view[[SPEED_LOW, SPEED_HIGH]] = scale, scale
        written = path(track, view)
        asked.append((written[:, 2] ** 2 * np.abs(written[:, 3])).max())
        profile.append(
            written[0, 2] / (scale * track.line[int(s / track.arrays.ds) % len(track.line), SPEED])
        )
    assert max(asked) <= GRIP * most * (1.0 + 1e-9)
    assert max(asked) > 0.95 * GRIP * most  # it is the limit
    assert np.mean(np.array(profile) > 0.99) > 0.3  # which costs nothing where the line is straight


def test_it_attacks_on_straights_from_wholly_behind_to_wholly_ahead(oval, view_at):
    hard, soft = {"attack": 0.2, "pace_behind": 0.0}, {"attack": 0.0, "pace_behind": 0.0}
    beside = view_at(oval, 2.0, 0.5, speed=7.0, gap=2.0, opp_d=-0.6, opp_speed=6.0)
    np.testing.assert_allclose(
        path(oval, beside, hard)[:6, 2], 1.2 * path(oval, beside, soft)[:6, 2], rtol=0.02
    )
    bend = view_at(oval, 15.0, 0.3, speed=4.5, gap=2.0, opp_d=-0.6, opp_speed=4.0)
    np.testing.assert_allclose(
        path(oval, bend, hard)[:, 2], path(oval, bend, soft)[:, 2], rtol=0.03
    )
    alone = view_at(oval, 2.0, 0.5, speed=7.0)
    np.testing.assert_array_equal(path(oval, alone, hard), path(oval, alone, soft))
    attack = {"attack": 0.3, "pace_behind": 0.0}
    behind, level, ahead = (
        view_at(oval, 1.0, 0.8, speed=7.5, gap=gap, opp_speed=7.0) for gap in (1.5, -0.3, -1.5)
    )
    _, attacking = plan(oval, behind, parameters=attack)
    with_it, still = plan(oval, level, attacking, attack)
    without, idle = plan(oval, level, parameters=attack)
    assert with_it[:, 2].max() > without[:, 2].max() + 0.5
    assert (still[-1], idle[-1], plan(oval, ahead, attacking, attack)[1][-1]) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("gap", [-0.65, -1.0, -2.0])
def test_a_followed_car_holds_its_place(oval, view_at, gap):
    """A faster car right behind neither drives it off its line nor makes it brake or flee."""
    parameters = {"pace_behind": 0.0}
    view = view_at(oval, 3.0, speed=5.0, gap=gap)
    alone = path(oval, view, parameters)
    view[OPP_V] = 6.0
    np.testing.assert_allclose(path(oval, view, parameters), alone, atol=1e-9)
    assert np.abs(oval.to_frenet(alone[:, :2])[:, 1]).max() < 0.02


def test_behind_a_car_it_keeps_a_distance_and_slows_before_that_car_brakes(oval, view_at):
    """With such a clearance there is no room to pass the other car: the nearer, the slower."""
    wide = {"side_margin": 0.45}
    seen = [view_at(oval, 3.0, speed=4.0, gap=gap, opp_speed=4.0) for gap in (0.8, 1.2, 1.9)]
    speeds = np.array([path(oval, view, wide)[:, 2].min() for view in seen])
    assert (np.diff(speeds) > 0.0).all()
    assert speeds[0] < 4.0 < speeds[2] < 5.5
    # At 1.4 m and equal speed: on a straight it keeps its speed, before a bend it falls back, long
    # before its own.
    calm = {"attack": 0.0, "side_margin": 0.45, "pace_behind": 0.0}
    straight, bend = (
        path(oval, view_at(oval, s, speed=5.5, gap=1.4, opp_speed=5.5), calm)[0, 2]
        for s in (3.0, 8.0)
    )
    alone = path(oval, view_at(oval, 8.0, speed=5.5), calm)[0, 2]
    assert bend < 5.0 < straight
    assert bend < alone - 1.0


def test_a_standing_car_is_seen_between_two_steps_of_the_prediction(oval, view_at):
    """At 9 m/s a step is 2.3 m, more than both cars are long; ahead is a straight."""
    for gap in [2.0, 3.5, 5.0, 6.5, 8.0]:
        points, costs = candidates(oval, view_at(oval, 0.5, speed=9.0, gap=gap, opp_d=0.0))
        across = oval.to_frenet(points[:, -1])[:, 1]
        assert not np.isfinite(costs[(np.abs(across) < 0.05) & (np.arange(64) < 32)]).any()


def test_alone_it_neither_crashes_nor_falls_behind_pure_pursuit(oval, drive_alone):
    """At the full speed profile, disturbed, 40 s: the house's measure of a driver that holds its
    line.
    """
    for track in (oval, load_track("Tarnfjord")):
        ours, theirs = (
            drive_alone(
                track,
                [planner.policy({"pace": 0.0})] * 20,
                speed_range=(1.0, 1.2),
                steering_noise=0.01,
            )
            for planner in (REFERENCE, PURE_PURSUIT)
        )
        assert not ours.crashed.any()
        assert ours.state.progress.sum() > 0.985 * theirs.state.progress.sum()


@pytest.mark.parametrize(("scale", "noise"), [(1.0, 0.0), (1.0, 0.01), (1.2, 0.02)])
def test_it_does_not_weave_on_straights(oval, scale, noise):
    """Its steering moves no faster than 1.3 times the steering of pure pursuit."""
    ours, theirs = (
        steering_rate(oval, planner, scale, noise) for planner in (REFERENCE, PURE_PURSUIT)
    )
    assert ours < 1.3 * theirs


def steering_rate(track, planner, scale, noise):
    """RMS on straights of cars alone, from the fourth second on, rad/s."""
    apart = {"start": "staggered", "start_gap": 0.5 * track.length, "start_spacing": 0.0}
    config = Rules(**apart, steering_noise=noise, speed_range=(scale, scale + 0.1))
    setup = RaceSetup(track, config, (planner, planner))
    state = start_races(
        setup, Starts(np.arange(8) * 5.0, np.zeros(8, np.int64)), np.arange(8, dtype=np.uint64)
    )
    theta = np.tile(planner.policy({"pace": 0.0}).parameters, (8, 2, 1))
    advance(setup, state, theta, 400)
    rates, before = [], state.cars[..., DELTA].copy()
    for _ in range(300):
        advance(setup, state, theta, 2)
        bend = track.line[
            (state.frenet[..., 0] / track.arrays.ds).astype(int) % len(track.line), KAPPA
        ]
        rates.append(((state.cars[..., DELTA] - before) / 0.02)[np.abs(bend) < 0.05])
        before = state.cars[..., DELTA].copy()
    return np.sqrt(np.mean(np.concatenate(rates) ** 2))


def test_a_car_that_stands_on_the_race_line_is_driven_around():
    """At forty places of a wide circuit, in bends too, from a standing start 12 m behind."""
    track = load_track("Tarnfjord")
    start = {"start": "staggered", "start_gap": 12.0, "start_speed": 0.0, "start_spacing": 0.0}
    config = Rules(duration=12.0, **start, speed_range=(1.03, 1.43))
    starts = Starts(np.arange(40) / 40.0 * track.length, np.ones(40, np.int64))
    for noise in (0.0, 0.02):
        rules = replace(config, steering_noise=noise)
        result = run_races(track, [REFERENCE.policy()] * 40, PARKED.policy(), rules, starts=starts)
        assert (np.abs(result.state.progress[:, 1]) < 0.1).all()  # at rest
        assert ((result.lead > 10.0) & ~result.crashed).mean() > 0.9
