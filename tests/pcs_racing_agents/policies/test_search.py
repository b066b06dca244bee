"""Algorithm 1: the loss of a generation, the points that join the archive, restarts, and the whole
search on functions with known fronts.
"""

import numpy as np
import pytest
from refusal import refused

from pcs_racing_agents.policies.pareto import (
    Scale,
    hypervolume,
    non_dominated,
    uncrowded_improvement,
)
from pcs_racing_agents.policies.search import CubeCMAES, Search, latin_hypercube

pytest.importorskip("cma")
pytest.importorskip("moocore")

UNIT = np.tile([0.0, 1.0], (6, 1))
CORNERS = np.array([[0.0, 1.0], [1.0, 0.0]])
"""Objectives of an initial sample, which make 0 to 1 the scale of the search."""


def spheres(points):
    """Minus the squared distances from two points: the Pareto set is the line between them."""
    return -np.column_stack([((points - centre) ** 2).sum(axis=1) for centre in (0.3, 0.7)])


def zdt1(points):
    """Pareto set at the border: all parameters but the first are 0 (E. Zitzler, K. Deb, L. Thiele,
    2000).
    """
    g = 1.0 + 9.0 * points[:, 1:].mean(axis=1)
    return -np.column_stack([points[:, 0], g * (1.0 - np.sqrt(points[:, 0] / g))])


def searched(evaluate, generations: int, bounds=UNIT, **options) -> tuple[Search, np.ndarray]:
    """Run a search; return it and all evaluated points."""
    search, points = Search(bounds, **options), []
    for _ in range(generations):
        points.append(search.ask())
        results = evaluate(points[-1])
        search.tell(*(results if isinstance(results, tuple) else (results,)))
    return search, np.concatenate(points)


def begun(objectives=CORNERS, **options) -> Search:
    """Return a search in four dimensions with an archive of some points."""
    search = Search(UNIT[:4], population=10, **options)
    places = np.array([0.1, 0.9, 0.5])[: len(objectives), None]
    search.add(np.tile(places, 4), objectives)
    return search


@pytest.mark.parametrize(("function", "share"), [(spheres, 0.97), (zdt1, 0.98)])
def test_it_comes_near_the_whole_front_and_random_points_do_not(function, share):
    line = np.tile(np.linspace(0.3, 0.7, 2001)[:, None], 6)
    border = np.pad(np.linspace(0.0, 1.0, 2001)[:, None], ((0, 0), (0, 5)))
    front = function(line if function is spheres else border)
    scale = Scale.of(front)
    search, points = searched(function, 60, population=25, seed=1)
    drawn = function(np.random.default_rng(0).random(points.shape))
    found = hypervolume(scale(search.objectives)) / hypervolume(scale(front))
    assert found > share
    assert found > hypervolume(scale(drawn)) / hypervolume(scale(front)) + 0.1
    assert len(search.parameters) > 30


def test_the_best_half_of_a_generation_joins_the_archive():
    """Feasible ones by their loss, then infeasible ones by their violation."""
    search = Search(UNIT[:4], population=10)
    known = np.array([[0.0, 0.9], [0.6, 0.5], [1.0, 0.0], [-0.1, 1.0]])
    search.add(np.full((4, 4), 0.5), known)
    scale = Scale.of(known)
    points, rng = search.ask(), np.random.default_rng(0)
    assert points.shape == (10, 4)
    objectives = rng.random((10, 2))
    violation = np.where(np.arange(10) % 2, rng.random(10), -1.0)
    loss = -uncrowded_improvement(scale(objectives), scale(known))
    order = sorted(range(10), key=lambda i: (max(violation[i], 0.0), loss[i]))
    joined = [i for i in sorted(order[:5]) if violation[i] <= 0.0]
    search.tell(objectives, violation)
    everything = np.vstack([known, objectives[joined]])
    np.testing.assert_array_equal(search.objectives, everything[non_dominated(everything)])


def test_infeasible_points_never_enter_the_archive_but_lead_the_way_back():
    # everything good is forbidden: the sum must be 5 or above, and objectives ask for less
    def evaluate(points):
        return -np.column_stack([points[:, 0], points[:, 1:].sum(axis=1)]), 5.0 - points.sum(axis=1)

    search, points = searched(evaluate, 30, population=25)
    assert (evaluate(points[:25])[1] > 0.0).all()
    assert len(search.parameters) > 5
    assert (search.parameters.sum(axis=1) >= 5.0).all()
    assert search.objectives.sum(axis=1).max() > -5.1  # close to the border
    search, _ = searched(lambda x: (spheres(x), np.ones(len(x))), 6, population=12)
    assert (search.parameters.shape, search.objectives.shape) == ((0, 6), (0, 2))
    assert (search.hypervolume, search.restarts) == (0.0, 0)


def test_a_search_repeats_itself_stays_within_bounds_and_leaves_numpy_alone():
    bounds = np.array([[-5.0, 3.0], [0.0, 1e-3], [10.0, 20.0], [-1.0, 1.0], [2.0, 4.0]])

    def evaluate(points):
        unit = (points - bounds[:, 0]) / np.ptp(bounds, axis=1)
        return spheres(unit), unit[:, 0] - 0.8

    options = {"bounds": bounds, "population": 12, "step_size": 0.5}
    np.random.seed(5)
    state = np.random.get_state()
    first, points = searched(evaluate, 6, seed=3, **options)
    after = np.random.get_state()
    np.testing.assert_array_equal(state[1], after[1])
    assert (points >= bounds[:, 0]).all()
    assert (points <= bounds[:, 1]).all()
    assert (points == bounds[:, 1]).any()  # moved to the border
    again, same = searched(evaluate, 6, seed=3, **options)
    np.testing.assert_array_equal(points, same)
    np.testing.assert_array_equal(first.parameters, again.parameters)
    assert not np.array_equal(points, searched(evaluate, 6, seed=4, **options)[1])


def test_the_first_generation_lies_around_the_middle_and_the_initial_sample_is_the_scale():
    search = Search(np.tile([-1.0, 3.0], (20, 1)), population=400, step_size=0.05)
    assert search._es.step_size == pytest.approx(
        0.05, rel=1e-3
    )  # pycma makes the axes a bit unequal
    points = search.ask()
    np.testing.assert_allclose(points.mean(axis=0), 1.0, atol=0.05)
    np.testing.assert_allclose(points.std(axis=0), 0.2, rtol=0.2)
    search = Search(np.tile([-2.0, 4.0], (6, 1)), population=4)
    search.add([[-2.0] * 6, [4.0] * 6], [[0.0, 4.0], [2.0, 0.0]], [0.0, 0.5])
    assert search.generation == 0
    assert search.parameters.tolist() == [[-2.0] * 6]
    assert search.hypervolume == pytest.approx(0.1 * 1.1)
    search.ask()
    search.tell([[0.0, 0.0]] * 4)
    search.add([[0.0] * 6], [[2.0, 4.0]])
    assert search.parameters.tolist() == [[0.0] * 6]
    assert search.hypervolume == pytest.approx(1.1 * 1.1)


def generations_until_restart(search, objectives, violation, most: int) -> int | None:
    for k in range(1, most + 1):
        search.ask()
        search.tell(objectives, violation)
        if search.restarts:
            return k
    return None


def test_it_restarts_at_a_point_of_the_front_the_likelier_the_more_it_adds():
    nothing, feasible = np.full((10, 2), -1.0), np.full(10, -1.0)
    starts = {}
    better = np.array([[0.0, 1.0], [1.0, 0.95], [0.0, 0.0]])
    for name, objectives in (("equal", CORNERS), ("one", better)):
        starts[name] = []
        for seed in range(12):
            search = begun(objectives=objectives, seed=seed, step_size=0.02)
            assert generations_until_restart(search, nothing, feasible, 12) == 10
            assert search._es.step_size == pytest.approx(0.01, rel=1e-3)
            starts[name].append(search.ask().mean())
    assert {round(start, 1) for start in starts["equal"]} == {0.1, 0.9}
    assert np.mean(np.array(starts["one"]) > 0.5) > 0.8


def test_a_search_that_gains_does_not_restart_and_one_that_has_collapsed_restarts_anywhere():
    search, nothing = begun(step_size=0.1), np.full((10, 2), -1.0)
    for k in range(19):
        assert search.restarts == 0
        search.ask()
        search.tell(np.where((np.arange(10) == 3)[:, None] & (k == 8), 0.99, nothing))
    assert search.restarts == 1
    starts = []
    for seed in range(6):
        search = Search(UNIT[:4], population=10, step_size=0.5e-4, seed=seed)
        search.ask()
        search.tell(np.vstack([CORNERS, np.zeros((8, 2))]), np.ones(10))
        assert (search.restarts, search._es.step_size) == (1, pytest.approx(0.5e-4, rel=0.3))
        starts.append(search.ask().mean(axis=0))
    assert np.std(starts) == pytest.approx(0.29, abs=0.1)


def test_every_axis_of_a_latin_hypercube_has_a_point_in_each_part():
    points = latin_hypercube(25, 6, np.random.default_rng(1))
    parts = np.tile(np.arange(25.0)[:, None], 6)
    np.testing.assert_array_equal(np.sort(np.floor(25 * points), axis=0), parts)
    assert np.abs(np.corrcoef(points.T) - np.eye(6)).max() < 0.7
    assert (points * 25 % 1.0).std() > 0.2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bounds": [0.0, 1.0]}, r"bounds has shape \(2,\)"),
        ({"bounds": [[0.0, 1.0]]}, "bounds have 1 parameters"),
        ({"bounds": [[0.0, 1.0], [1.0, 1.0]]}, "bounds of parameter 1 are 1 and 1"),
        ({"population": 3}, "population is 3"),
        ({"step_size": np.nan}, "step_size is nan"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_impossible_arguments_are_named(options, words):
    refused(words, Search, **{"bounds": UNIT, **options})


@pytest.mark.parametrize(
    ("results", "words"),
    [
        ((np.zeros((3, 2)),), r"objectives has shape \(3, 2\)"),
        ((np.zeros((12, 1)),), r"shape \(12, 1\)"),
        (([["a", "b"]] * 12,), "must hold numbers"),
        ((np.where(np.arange(24).reshape(12, 2) == 7, np.nan, 1.0),), "nan"),
        ((np.tile([0.0, 1.0], (12, 1)),), "objective 0 is 0 in the whole initial sample"),
        ((spheres(np.eye(12)), np.full(12, np.inf)), "violation holds inf"),
        ((spheres(np.eye(12)), np.zeros((12, 1))), r"violation has shape \(12, 1\)"),
    ],
)
def test_impossible_results_are_named(results, words):
    search = Search(UNIT, population=12)
    refused("ask first", search.tell, np.zeros((12, 2)))
    refused(r"parameters has shape \(1, 5\)", search.add, [[0.5] * 5], [[1.0, 1.0]])
    refused("outside the bounds", search.add, [[2.0] * 6], [[1.0, 1.0]])
    search.ask()
    refused(words, search.tell, *results)
    search.tell(spheres(np.random.default_rng(0).random((12, 6))))
    refused(r"shape \(12, 3\)", lambda: (search.ask(), search.tell(np.zeros((12, 3)))))


def test_a_bounded_distribution_stays_within_the_cube_and_finds_an_optimum_on_its_border():
    rng = np.random.default_rng(0)
    es = CubeCMAES(np.array([1.0, 0.5, 0.0]), 0.2, 0.4, 8, 4, rng, bounded=True)
    target = np.array([0.0, 0.3, 1.2])  # the last one lies outside
    for _ in range(60):
        points = es.ask()
        assert (points >= 0.0).all()
        assert (points <= 1.0).all()
        es.tell(np.argsort(np.argsort(np.square(points - target).sum(axis=1))).astype(float))
    np.testing.assert_allclose(es.mean, [0.0, 0.3, 1.0], atol=0.02)
