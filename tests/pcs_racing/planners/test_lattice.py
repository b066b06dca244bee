import numpy as np
import pytest

from pcs_racing import (
    InputError,
    RaceConfig,
    Starts,
    UnknownNameError,
    draw_starts,
    list_tracks,
    load_race_config,
    load_track,
    run_races,
)
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.view import GAP, OWN_D, OWN_X, OWN_Y, PATH_POINTS

MEMORY = np.zeros(LATTICE.memory_size)
RANGE = (0.8, 1.0)


def candidates(track, view, parameters=None):
    """Points (64, 9, 2) and costs (64,)."""
    return LATTICE.candidates(track.arrays, LATTICE.policy(parameters).parameters, view, MEMORY)


def path(track, view, parameters=None):
    """The path that the planner writes, shape (12, 4)."""
    written = np.full((PATH_POINTS, 4), np.nan)
    scratch = np.full(LATTICE.scratch_size, np.nan)  # whatever was left there must not matter
    LATTICE.plan(track.arrays, LATTICE.policy(parameters).parameters, view, MEMORY.copy(), scratch, written)
    return written


def test_parameters():
    weights = (
        "length",
        "max_curvature",
        "mean_curvature",
        "curvature_rate",
        "lateral_acceleration",
        "braking",
        "similarity",
        "progress",
        "deviation",
        "walls",
        "proximity",
        "overtaking",
        "blocking",
    )
    assert LATTICE.parameter_names == (*weights, "pace", "late_braking", "side_margin", "pace_behind")
    np.testing.assert_array_equal(LATTICE.bounds[: len(weights)], np.tile([-2.0, 1.0], (len(weights), 1)))
    np.testing.assert_array_equal(LATTICE.bounds[len(weights) :], [[0.0, 1.0], [0.0, 0.15], [0.05, 0.35], [-0.5, 0.5]])
    assert (LATTICE.bounds[:, 0] < LATTICE.default).all()
    assert (LATTICE.default < LATTICE.bounds[:, 1]).all()
    assert all("log10 weight" in parameter.meaning for parameter in LATTICE.parameters[: len(weights)])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1.5])
def test_impossible_weights_are_refused(value):
    with pytest.raises(InputError, match="parameter 'progress' is"):
        LATTICE.policy({"progress": value})


def test_unknown_parameters_are_refused():
    with pytest.raises(UnknownNameError, match="no parameter 'speed'"):
        LATTICE.policy({"speed": 0.5})
    with pytest.raises(InputError, match=r"shape \(3,\)"):
        LATTICE.policy([0.0, 0.0, 0.0])


def test_candidates_start_at_the_car_and_end_across_the_track(oval, view_at):
    view = view_at(oval, 3.0, 0.2)
    points, costs = candidates(oval, view)
    assert points.shape == (64, 9, 2)
    assert costs.shape == (64,)
    np.testing.assert_allclose(points[:, 0], np.tile(view[[OWN_X, OWN_Y]], (64, 1)), atol=1e-9)
    ends = oval.to_frenet(points[:, -1])
    assert len(np.unique(ends[:, 0].round(2))) == 2
    assert ends[:, 1].min() < -0.7
    assert ends[:, 1].max() > 0.7
    assert np.isfinite(costs).sum() > 32


def test_the_path_is_the_cheapest_candidate(oval, view_at):
    view = view_at(oval, 3.0, 0.2)
    points, costs = candidates(oval, view)
    best = points[np.argmin(costs)]
    written = path(oval, view)
    assert np.isfinite(written).all()
    np.testing.assert_allclose(written[0, :2], best[0], atol=1e-9)
    np.testing.assert_allclose(written[-1, :2], best[-1], atol=1e-3)
    # Points of the path lie between the candidate's points, which are farther apart.
    step = np.hypot(*np.diff(best, axis=0).T).max()
    assert np.hypot(*(written[:, None, :2] - best[None]).T).min(axis=0).max() < 0.5 * step + 1e-3


def test_a_wall_in_the_way_rejects_candidates(oval, view_at):
    points, costs = candidates(oval, view_at(oval, 3.0))
    assert np.isfinite(costs[np.abs(oval.to_frenet(points[:, -1])[:, 1]) < 0.3]).all()
    # Next to the right wall and pointed at it, only bends to the left remain.
    points, costs = candidates(oval, view_at(oval, 3.0, -0.75, turned=-0.3, speed=1.0))
    rejected = ~np.isfinite(costs)
    assert 0 < rejected.sum() < 64
    nearest = oval.wall_distance(points).min(axis=1)
    assert nearest[~rejected].min() > 0.15
    assert rejected[nearest < 0.15].all()


def test_a_swerve_that_would_spin_the_car_is_rejected(oval, view_at):
    """At speed the near goals far to the side ask for more lateral acceleration than the tyres have."""
    full_speed = np.arange(64) < 16
    points, costs = candidates(oval, view_at(oval, 3.0, speed=7.0))
    aside = np.abs(oval.to_frenet(points[:, -1])[:, 1])
    ahead = np.hypot(*(points[:, -1] - points[:, 0]).T)
    near = ahead < np.median(ahead)
    assert not np.isfinite(costs[full_speed & near & (aside > 0.7)]).any()
    assert np.isfinite(costs[aside < 0.1]).all()


def test_an_opponent_in_the_way_rejects_candidates(oval, view_at):
    points, costs = candidates(oval, view_at(oval, 3.0, gap=3.0, opp_d=0.0))
    across = oval.to_frenet(points[:, -1])[:, 1]
    rejected = ~np.isfinite(costs)
    # Of those that are open when nobody is there.
    open_else = np.isfinite(candidates(oval, view_at(oval, 3.0))[1]) & (np.arange(64) < 16)
    assert rejected[open_else & (np.abs(across) < 0.4)].all()
    assert not rejected[open_else & (np.abs(across) > 0.5)].any()
    assert (open_else & (np.abs(across) > 0.5)).any()
    assert abs(across[np.argmin(costs)]) > 0.5


@pytest.mark.parametrize("opp_d", [-0.5, 0.5])
def test_it_passes_a_standing_car_on_the_free_side(oval, view_at, opp_d):
    end = oval.to_frenet(path(oval, view_at(oval, 3.0, gap=2.5, opp_d=opp_d, speed=3.0))[-1, :2])
    assert np.sign(end[1]) != np.sign(opp_d) or abs(end[1]) < 0.05
    assert abs(end[1] - opp_d) > 0.31


def test_pace_is_the_speed_of_the_path(oval, view_at):
    view = view_at(oval, 3.0)
    slow, fast = (path(oval, view, {"pace": pace})[:, 2] for pace in (0.0, 1.0))
    low, high = RANGE
    np.testing.assert_allclose(slow / fast, low / high, atol=0.06)


@pytest.mark.parametrize(
    ("gap", "expected"),
    [(-8.0, 0.5), (-0.5, 0.5), (-0.25, 0.575), (0.0, 0.65), (0.5, 0.8), (8.0, 0.8), (100.0, 0.8)],
)
def test_a_policy_has_a_second_pace_behind(oval, view_at, gap, expected):
    """A metre of lead leads from one pace to the other; a lap or more behind is behind, too."""
    view = view_at(oval, 3.0, opp_d=0.9)
    view[GAP] = gap
    two = path(oval, view, {"pace": 0.5, "pace_behind": 0.3})
    np.testing.assert_allclose(two, path(oval, view, {"pace": expected}), rtol=1e-12)
    one = path(oval, view, {"pace": 0.5, "pace_behind": 0.0})
    np.testing.assert_array_equal(one, path(oval, view, {"pace": 0.5}))


@pytest.mark.parametrize(("pace", "behind", "expected"), [(0.8, 0.5, 1.0), (0.2, -0.5, 0.0), (0.2, -0.1, 0.1)])
def test_the_second_pace_stays_in_the_range_of_speeds(oval, view_at, pace, behind, expected):
    view = view_at(oval, 3.0, gap=8.0)
    two = path(oval, view, {"pace": pace, "pace_behind": behind})
    np.testing.assert_allclose(two, path(oval, view, {"pace": expected}), rtol=1e-12)


def test_who_speeds_up_behind_only_ends_in_front_of_who_does_not():
    """The same pace in front; staggered by 3 m, the car behind catches up in every race and gains in the mean."""
    config = load_race_config("paper", duration=16.0, start="rolling", start_gap=3.0, start_spacing=0.45)
    starts = Starts(np.arange(6) * 8.0, np.ones(6, np.int64))  # car 0 behind
    bold, calm = LATTICE.policy({"pace": 0.3, "pace_behind": 0.5}), LATTICE.policy({"pace": 0.3})
    track = load_track("Tarnfjord")
    plain, reacts = (run_races(track, [ego] * 6, calm, config, starts=starts) for ego in (calm, bold))
    assert reacts.lead.mean() > plain.lead.mean() + 1.0


def test_races_are_deterministic():
    track = load_track(list_tracks()[0])
    config = RaceConfig(duration=8.0, steering_noise=0.03)
    first, again = (run_races(track, [LATTICE.policy()] * 4, PURE_PURSUIT.policy(), config, seed=3) for _ in range(2))
    for a, b in zip(first.state, again.state, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", list_tracks())
def test_it_drives_shipped_circuits(name, drive_alone):
    check_solo(load_track(name), drive_alone)


@pytest.mark.parametrize("name", ["Catalunya", "Oschersleben", "Spielberg"])
def test_it_drives_real_circuits(name, real_maps, drive_alone):
    check_solo(load_track(real_maps / name), drive_alone)


def check_solo(track, drive_alone):
    result = drive_alone(track, [LATTICE.policy({"pace": 0.5})], speed_range=RANGE)
    assert not result.crashed.any()
    # At least 85 % of what the profile allows at this pace.
    laps = result.state.progress[0] + [0.0, min(0.5 * track.length, 50.0)]
    line = track.line
    speed = track.length / (track.arrays.ds / line[:, 6]).sum()
    assert (laps > 0.85 * 0.9 * speed * 40.0).all()


def test_it_stays_near_the_race_line_when_alone(shipped, views):
    for track in shipped[:3]:
        config = RaceConfig(
            duration=15.0,
            start="staggered",
            start_gap=min(0.5 * track.length, 50.0),
            start_spacing=0.0,
            speed_range=RANGE,
        )
        seen = views(track, LATTICE.policy(), config, Starts(np.array([0.3 * track.length]), np.zeros(1, np.int64)))
        away = np.abs(seen[:, OWN_D])
        assert np.median(away) < 0.1
        assert away.max() < 0.6


def test_more_weight_on_the_deviation_keeps_nearer_to_the_line(views):
    track = load_track("Larkmoor")
    config = RaceConfig(duration=10.0, start="staggered", start_gap=40.0, start_spacing=0.0, speed_range=(0.6, 0.8))
    starts = Starts(np.array([0.2, 0.5, 0.8]) * track.length, np.zeros(3, np.int64))
    rng = np.random.default_rng(5)
    away = []
    for _ in range(4):
        theta = LATTICE.sample(rng)
        for weight in (-2.0, 1.0):
            theta[LATTICE.parameter_names.index("deviation")] = weight
            away.append(np.abs(views(track, LATTICE.policy(theta), config, starts)[:, OWN_D]).mean())
    loose, tight = np.array(away).reshape(-1, 2).T
    assert tight.mean() < 0.5 * loose.mean()
    assert (tight < loose).mean() > 0.7


def test_a_faster_follower_gets_by_a_slower_car(shipped):
    """It starts 3 m behind a car that drives at 60 % of its speed scale, on five lines of every circuit."""
    config = RaceConfig(duration=20.0, start="rolling", start_gap=3.0, start_spacing=0.0, speed_range=(0.5, 0.85))
    slow, fast = PURE_PURSUIT.policy({"pace": 0.0}), [LATTICE.policy({"pace": 1.0})] * 10
    # From the places of the paper's start, which every circuit brings: those of this one would be found by driving.
    starts = [draw_starts(track, load_race_config("paper"), 10, seed=1) for track in shipped]
    results = [run_races(track, fast, slow, config, starts=at) for track, at in zip(shipped, starts, strict=True)]
    behind = np.concatenate([result.starts.side == 1 for result in results])
    crashed = np.concatenate([result.crashed for result in results])[behind]
    passed = np.concatenate([result.lead > 0.0 for result in results])[behind]
    assert len(crashed) >= 40
    assert crashed.mean() <= 0.1
    assert passed[~crashed].mean() > 0.8
