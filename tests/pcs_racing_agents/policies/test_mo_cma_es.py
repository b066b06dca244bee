"""Algorithm 1 line by line: what a generation is worth, which of it is kept, and where the search
goes on.
"""

import numpy as np
import pytest

from pcs_racing_agents.policies.indicators import hypervolume, non_dominated
from pcs_racing_agents.policies.mo_cma_es import (
    MOCMAES,
    CubeCMAES,
    hypervolume_loss,
    latin_hypercube,
)
from pcs_racing_agents.policies.pareto_archive import ParetoArchive, Scale
from pcs_racing_agents.policies.search import OptimiserOptions

pytest.importorskip("cma")
pytest.importorskip("moocore")

REFERENCE = -0.1


def search_spec(**changes):
    values = {
        "dimension": 4,
        "population": 10,
        "seed": np.random.SeedSequence(3),
        "elite_ratio": 0.3,
        "loss": "uhvi",
        "mean": "generation",
        "start": np.full(4, 0.5),
        "step_size": 0.1,
        "reference": REFERENCE,
        "ideal": np.ones(2),
        "nadir": np.zeros(2),
    }
    return OptimiserOptions(**(values | changes))


def archive_of(objectives):
    return ParetoArchive.empty(4).joined(
        np.zeros((len(objectives), 4)), objectives, np.full(len(objectives), -1.0)
    )


UNIT = Scale(np.ones(2), np.zeros(2))
FRONT = np.array([[0.2, 0.9], [0.6, 0.5], [0.9, 0.1]])


def test_the_loss_is_minus_the_hypervolume_that_a_point_adds_and_grows_with_the_way_to_the_front():
    points = np.array([[0.8, 0.8], [0.4, 0.7], [0.95, 0.95], [0.5, 0.4], [0.3, 0.2]])
    found = hypervolume_loss(
        "uhvi", archive_of(FRONT), points, np.array([0.0, -1.0, 0.0, 0.0, 0.0]), UNIT, REFERENCE
    )
    whole = hypervolume(FRONT, REFERENCE)
    for k in (0, 1, 2):
        assert found[k] == pytest.approx(
            whole - hypervolume(np.vstack([FRONT, points[k]]), REFERENCE)
        )
    # Beaten points: the shortest way to a place that the front does not beat, looked for on a fine
    # grid.
    x = np.linspace(REFERENCE, 1.0, 1101)
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    free = ~(grid[:, None] < FRONT - 1e-9).all(axis=2).any(axis=1)
    for k in (3, 4):
        way = np.hypot(*(grid[free] - points[k]).T).min()
        assert found[k] == pytest.approx(way, abs=2e-3)
    assert found[3] < found[4]


def test_the_literal_loss_infeasible_points_and_an_empty_archive():
    points = np.array([[0.8, 0.8], [0.5, 0.4]])
    found = hypervolume_loss(
        "total_hypervolume", archive_of(FRONT), points, np.zeros(2), UNIT, REFERENCE
    )
    expected = [-hypervolume(np.vstack([FRONT, point]), REFERENCE) for point in points]
    np.testing.assert_allclose(found, expected)
    assert found[1] == pytest.approx(-hypervolume(FRONT, REFERENCE))
    points = np.array([[0.5, 0.5], [0.9, 0.9], [0.2, 0.4]])
    found = hypervolume_loss(
        "uhvi", ParetoArchive.empty(4), points, np.array([0.0, 0.1, -3.0]), UNIT, REFERENCE
    )
    np.testing.assert_allclose(found, [-0.6 * 0.6, np.inf, -0.3 * 0.5])


@pytest.mark.parametrize(
    ("ratio", "population", "kept"), [(0.3, 10, 3), (0.05, 10, 1), (1.0, 8, 8), (0.35, 10, 4)]
)
def test_the_best_of_a_generation_join_the_archive(ratio, population, kept):
    """Feasible ones by their loss, then infeasible ones by how much they violate."""
    search = MOCMAES(search_spec(elite_ratio=ratio, population=population))
    rng = np.random.default_rng(0)
    points = search.ask()
    assert points.shape == (population, 4)
    objectives, violation = (
        rng.random((population, 2)),
        np.where(np.arange(population) % 2, rng.random(population), -1),
    )
    archive = archive_of(FRONT)
    loss = hypervolume_loss("uhvi", archive, objectives, violation, UNIT, REFERENCE)
    order = sorted(range(population), key=lambda i: (max(violation[i], 0.0), loss[i]))
    grown = search.tell(points, objectives, violation, archive)
    assert len(grown) == 3 + population
    assert grown.member[:3].all()
    assert sorted(np.flatnonzero(grown.member[3:])) == sorted(order[:kept])
    np.testing.assert_array_equal(grown.parameters[3:], points)


def test_the_first_generation_has_the_stated_mean_or_is_a_sample():
    search = MOCMAES(
        search_spec(dimension=20, population=400, start=np.full(20, 0.4), step_size=0.05)
    )
    assert search.step_size == pytest.approx(0.05, rel=1e-3)  # pycma makes the axes a bit unequal
    points = search.ask()
    np.testing.assert_allclose(points.mean(axis=0), 0.4, atol=0.012)
    np.testing.assert_allclose(points.std(axis=0), 0.05, rtol=0.2)
    search = MOCMAES(search_spec(start=None, population=50, step_size=0.04))
    assert np.isnan(search.step_size)
    points = search.ask()
    np.testing.assert_array_equal(
        np.sort((50 * points).astype(int), axis=0), np.tile(np.arange(50)[:, None], 4)
    )
    objectives = np.column_stack([points[:, 0], 1.0 - points[:, 0]]) - np.abs(points[:, 1:2] - 0.5)
    grown = search.tell(points, objectives, np.full(50, -1.0), ParetoArchive.empty(4))
    assert grown.member.all()
    assert search.step_size == pytest.approx(0.02, rel=1e-3)
    best = points[non_dominated(objectives)].mean(axis=0)
    np.testing.assert_allclose(search.ask().mean(axis=0), best, atol=0.02)


def test_of_two_equally_good_generations_the_mean_of_the_archive_may_be_asked_for():
    for mean in ("generation", "archive"):
        search = MOCMAES(search_spec(mean=mean, step_size=0.01))
        archive = ParetoArchive.empty(4).joined(
            np.full((1, 4), 0.9), np.array([[2.0, 2.0]]), np.array([-1.0])
        )
        points = search.ask()
        search.tell(points, np.zeros((10, 2)), np.full(10, -1.0), archive)
        expected = 0.9 if mean == "archive" else 0.5  # the archive's front is the one known point
        np.testing.assert_allclose(search.ask().mean(axis=0), expected, atol=0.02)


def stalled(search, archive, objectives, violation, generations):
    """Tell the same again and again; the generation, counted from 1, in which the search starts
    again.
    """
    for k in range(1, generations + 1):
        archive = search.tell(search.ask(), objectives, violation, archive)
        if search.restarts:
            return k, archive
    return None, archive


def test_it_starts_again_at_a_point_of_the_front_the_likelier_the_more_it_adds():
    parameters = np.array([[0.1] * 4, [0.9] * 4])
    archive = ParetoArchive.empty(4).joined(
        parameters, np.array([[0.0, 1.0], [1.0, 0.0]]), np.full(2, -1.0)
    )
    nothing = np.full((10, 2), -1.0)
    starts = []
    for seed in range(12):
        search = MOCMAES(search_spec(seed=np.random.SeedSequence(seed), step_size=0.02))
        k, _ = stalled(search, archive, nothing, np.full(10, -1.0), 12)
        assert k == 10
        assert search.step_size == pytest.approx(0.01, rel=1e-3)
        starts.append(search.ask().mean())
    assert {round(start, 1) for start in starts} == {0.1, 0.9}
    archive = ParetoArchive.empty(4).joined(
        parameters, np.array([[0.0, 1.0], [1.0, 0.95]]), np.full(2, -1.0)
    )
    starts = []
    for seed in range(12):
        search = MOCMAES(search_spec(seed=np.random.SeedSequence(seed), step_size=0.02))
        stalled(search, archive, nothing, np.full(10, -1.0), 12)
        starts.append(search.ask().mean() > 0.5)
    assert np.mean(starts) > 0.8


def test_a_search_that_gains_or_finds_nothing_feasible_does_not_start_again():
    search, archive = MOCMAES(search_spec()), archive_of(FRONT)
    nothing = np.full((10, 2), -1.0)
    for k in range(18):
        objectives = nothing.copy()
        if k == 8:
            objectives[3] = 0.99, 0.99
        archive = search.tell(search.ask(), objectives, np.full(10, -1.0), archive)
        assert search.restarts == 0
    search.tell(search.ask(), nothing, np.full(10, -1.0), archive)
    assert search.restarts == 1
    search = MOCMAES(search_spec())
    k, archive = stalled(search, ParetoArchive.empty(4), np.zeros((10, 2)), np.ones(10), 15)
    assert k is None
    assert len(archive.front) == 0


def test_a_search_that_has_collapsed_starts_again_anywhere_if_nothing_is_feasible():
    starts = []
    for seed in range(6):
        search = MOCMAES(search_spec(step_size=0.5e-4, seed=np.random.SeedSequence(seed)))
        search.tell(search.ask(), np.zeros((10, 2)), np.ones(10), ParetoArchive.empty(4))
        assert (search.restarts, search.step_size) == (1, pytest.approx(0.5e-4, rel=0.3))
        starts.append(search.ask().mean(axis=0))
    assert np.std(starts) == pytest.approx(0.29, abs=0.1)


def cube(mean=0.5, step_size=0.1, largest=0.2, population=10, elite=3, dimension=3):
    return CubeCMAES(
        np.full(dimension, mean), step_size, largest, population, elite, np.random.default_rng(0)
    )


def test_the_step_size_stays_below_the_largest_and_the_mean_near_the_cube():
    search = cube(step_size=0.1, largest=0.11)
    for _ in range(15):
        points = search.ask()
        # ever further along one axis
        search.tell(np.argsort(np.argsort(-points[:, 0])).astype(float))
        assert search.step_size <= 0.11 * 1.8  # times the largest axis of the covariance
        assert float(search._es.sigma) <= 0.11 + 1e-12
    search = cube(step_size=0.05)
    for wanted in (5.0, -5.0, 0.5):
        search.move(np.full(3, wanted))
        np.testing.assert_allclose(search._es.mean, np.clip(wanted, -0.15, 1.15), atol=1e-4)
    assert not cube(step_size=2e-4).degenerate
    assert cube(step_size=0.9e-4).degenerate


def test_every_axis_of_a_latin_hypercube_has_a_point_in_each_part():
    points = latin_hypercube(25, 6, np.random.default_rng(1))
    assert points.shape == (25, 6)
    np.testing.assert_array_equal(
        np.sort(np.floor(25 * points), axis=0), np.tile(np.arange(25.0)[:, None], 6)
    )
    assert np.abs(np.corrcoef(points.T) - np.eye(6)).max() < 0.7
    assert (points * 25 % 1.0).std() > 0.2
