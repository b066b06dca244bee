from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError
from pcs_racing_agents.policies.indicators import hypervolume, non_dominated
from pcs_racing_agents.policies.mo_cma_es import middle_of_the_best
from pcs_racing_agents.policies.optimisers import METHODS
from pcs_racing_agents.policies.pareto_archive import ParetoArchive
from pcs_racing_agents.policies.search import Search
from pcs_racing_agents.policies.synthesize import Evaluated, synthesize

UNIT = np.tile([0.0, 1.0], (6, 1))
SMALL = {"population": 12, "generations": 6, "seed": 3}


def spheres(points, dimension: int = 6):
    """Minus the squared distances from two points: the Pareto set is the line between them."""
    one, other = np.full(dimension, 0.3), np.full(dimension, 0.7)
    return -np.column_stack(
        [((points - one) ** 2).sum(axis=1), ((points - other) ** 2).sum(axis=1)]
    )


def zdt1(points):
    """Pareto set at the border: all parameters but the first are 0 (E. Zitzler, K. Deb, L. Thiele,
    2000).
    """
    g = 1.0 + 9.0 * points[:, 1:].mean(axis=1)
    return -np.column_stack([points[:, 0], g * (1.0 - np.sqrt(points[:, 0] / g))])


def three(points):
    return -np.column_stack(
        [((points - centre) ** 2).sum(axis=1) for centre in (0.2, 0.5, np.linspace(0.2, 0.8, 6))]
    )


def same(one, other):
    for key in ("parameters", "objectives", "explored_parameters", "explored_objectives", "ideal"):
        np.testing.assert_array_equal(getattr(one, key), getattr(other, key), err_msg=key)
    for news, others in zip(one.generations, other.generations, strict=True):
        np.testing.assert_array_equal(news[:7], others[:7])


@pytest.fixture(
    params=[pytest.param(name, marks=[pytest.mark.compare] * (name == "nsga2")) for name in METHODS]
)
def method(request):
    if request.param == "nsga2":
        pytest.importorskip("pymoo")
    return request.param


@pytest.mark.parametrize(("function", "share"), [(spheres, 0.97), (zdt1, 0.98)])
def test_it_comes_near_the_whole_front_and_random_search_does_not(function, share):
    line = np.tile(np.linspace(0.3, 0.7, 2001)[:, None], 6)
    border = np.pad(np.linspace(0.0, 1.0, 2001)[:, None], ((0, 0), (0, 5)))
    front = function(line if function is spheres else border)
    low, extent = front.min(axis=0), np.ptp(front, axis=0)

    def of_possible(result):
        return hypervolume((result.objectives - low) / extent, -0.1) / hypervolume(
            (front - low) / extent, -0.1
        )

    found = synthesize(function, UNIT, population=25, generations=60, seed=1)
    drawn = synthesize(function, UNIT, population=25, generations=60, seed=1, method="random")
    assert of_possible(found) > share
    assert of_possible(found) > of_possible(drawn) + 0.1
    assert len(found.parameters) > 30


def test_the_front_is_what_nothing_explored_beats():
    seen = []
    result = synthesize(
        spheres, UNIT, population=12, generations=10, elite_ratio=1.0, callback=seen.append
    )
    front = non_dominated(result.explored_objectives, duplicates=False)
    np.testing.assert_array_equal(result.parameters, result.explored_parameters[front])
    np.testing.assert_array_equal(result.objectives, spheres(result.parameters))
    assert result.explored_parameters.shape == (120, 6)
    grown = result.hypervolumes()
    assert grown.shape == (10,)
    assert (np.diff(grown) >= -1e-12).all()
    last = result.generations[-1]
    assert (last.generation, last.evaluations, last.archive_size) == (
        10,
        120,
        len(result.parameters),
    )
    assert last.hypervolume == pytest.approx(grown[-1])
    assert (seen[0].infeasible, len(seen)) == (0, 10) == (0, len(result.generations))
    for one in result.generations:
        low, high = one.front.min(axis=0), one.front.max(axis=0)
        assert one.hypervolume == pytest.approx(hypervolume((one.front - low) / (high - low), -0.1))
        np.testing.assert_array_equal(one.front, spheres(one.front_parameters))
        assert one.archive_size == len(one.front)
    scaled = (result.objectives - result.nadir) / (result.ideal - result.nadir)
    assert grown[-1] == pytest.approx(hypervolume(scaled, result.reference))


def test_infeasible_points_never_enter_the_archive_but_lead_the_way_back():
    # everything good is forbidden: the sum must be 5 or above, and objectives ask for less
    def evaluate(points):
        return -np.column_stack([points[:, 0], points[:, 1:].sum(axis=1)]), 5.0 - points.sum(axis=1)

    seen = []
    result = synthesize(
        evaluate, UNIT, population=25, generations=30, callback=seen.append, start=np.full(6, 0.1)
    )
    assert seen[0].infeasible == 25
    assert seen[0].archive_size == 0
    assert seen[0].hypervolume == 0.0
    assert len(result.parameters) > 5
    assert (result.parameters.sum(axis=1) >= 5.0).all()
    assert result.objectives.sum(axis=1).max() > -5.1  # close to the border
    assert (result.explored_violation > 0.0).any()

    def evaluate(points):
        return spheres(points), np.ones(len(points))

    result = synthesize(evaluate, UNIT, **SMALL)
    assert result.parameters.shape == (0, 6)
    assert result.objectives.shape == (0, 2)
    np.testing.assert_array_equal(result.hypervolumes(), np.zeros(6))


def test_a_search_starts_again_within_the_bounds_in_the_middle_of_the_front():
    points = np.arange(18.0).reshape(3, 6)
    objectives = np.array([[2.0, 0.0], [0.0, 2.0], [-1.0, -1.0]])
    allowed = ParetoArchive.empty(6).joined(points, objectives, np.zeros(3))
    np.testing.assert_array_equal(middle_of_the_best(allowed), points[:2].mean(axis=0))
    forbidden = ParetoArchive.empty(6).joined(points, objectives, np.array([3.0, 1.0, 2.0]))
    np.testing.assert_array_equal(middle_of_the_best(forbidden), points[1])
    bounds = np.tile([-2.0, 4.0], (6, 1))
    points = Search(bounds, population=200, start=np.full(6, 3.9), step_size=0.2).ask()
    assert points.min() >= -2.0
    assert points.max() == 4.0
    assert 0.2 < (points == 4.0).mean() < 0.7
    search = Search(bounds, start=np.full(6, 4.0))
    assert search.ask().shape == (50, 6)
    assert Search(bounds).ask().mean() == pytest.approx(1.0, abs=0.3)
    search = Search(bounds, population=4)
    first = search.add([[-2.0] * 6, [4.0] * 6], [[0.0, 1.0], [1.0, 0.0]], [0.0, 0.5])
    assert (first.generation, first.evaluations, first.archive_size, first.infeasible) == (
        0,
        2,
        1,
        1,
    )
    assert search.archive.tolist() == [[-2.0] * 6]
    search.ask()
    search.tell([[0.0, 0.0]] * 4)
    later = search.add([[0.0] * 6], [[2.0, 2.0]])
    assert (later.generation, later.evaluations, search.archive.tolist()) == (1, 7, [[0.0] * 6])


def test_every_method_repeats_itself_stays_within_bounds_and_leaves_numpy_alone(method):
    bounds = np.array([[-5.0, 3.0], [0.0, 1e-3], [10.0, 20.0], [-1.0, 1.0], [2.0, 4.0]])
    seen = []

    def evaluate(points):
        seen.append(points)
        unit = (points - bounds[:, 0]) / np.ptp(bounds, axis=1)
        return spheres(unit, 5), unit[:, 0] - 0.8

    np.random.seed(5)  # noqa: NPY002
    state = np.random.get_state()  # noqa: NPY002
    first = synthesize(evaluate, bounds, method=method, start="sample", **SMALL)
    after = np.random.get_state()  # noqa: NPY002
    np.testing.assert_array_equal(state[1], after[1])
    assert state[2:] == after[2:]
    points = np.concatenate(seen)
    assert len(points) == 72
    assert (points >= bounds[:, 0]).all()
    assert (points <= bounds[:, 1]).all()
    same(first, synthesize(evaluate, bounds, method=method, start="sample", **SMALL))
    other = synthesize(evaluate, bounds, method=method, start="sample", **{**SMALL, "seed": 4})
    assert not np.array_equal(first.explored_parameters, other.explored_parameters)


@pytest.mark.parametrize("known", [1, 4, 6])
def test_a_search_told_again_what_it_was_told_goes_on_as_if_it_had_never_stopped(method, known):
    calls = []

    def evaluate(points):
        calls.append(len(points))
        return spheres(points), np.full(len(points), -1.0)

    options = {"method": method, **SMALL}
    whole = synthesize(evaluate, UNIT, **options)
    calls.clear()
    stored = [
        Evaluated(news.objectives, news.violation, news.parameters)
        for news in whole.generations[:known]
    ]
    again = synthesize(evaluate, UNIT, evaluated=stored, **options)
    assert len(calls) == 6 - known
    same(whole, again)


def test_an_executor_and_asking_and_telling_change_nothing():
    def evaluate(points):
        return spheres(points), points[:, 0] - 0.6

    with ThreadPoolExecutor(2) as executor:
        same(
            synthesize(evaluate, UNIT, executor=executor, **SMALL),
            synthesize(evaluate, UNIT, **SMALL),
        )
    parts = []
    with ThreadPoolExecutor(1) as executor:
        options = {**SMALL, "population": 40, "generations": 1}
        synthesize(
            lambda points: parts.append(len(points)) or spheres(points),
            UNIT,
            executor=executor,
            **options,
        )
    assert sorted(parts) == [2] * 8 + [3] * 8  # up to 16 blocks
    search = Search(UNIT, population=12, seed=3)
    for _ in range(6):
        search.tell(spheres(search.ask()))
    same(search.result(), synthesize(spheres, UNIT, **SMALL))


def test_three_objectives_and_fixed_scales(method):
    options = {
        "method": method,
        **SMALL,
        "ideal": [0.0, 0.0, 0.0],
        "nadir": [-3.0, -3.0, -3.0],
        "reference": [0.0] * 3,
    }
    result = synthesize(three, UNIT, **options)
    np.testing.assert_array_equal(result.nadir, [-3.0] * 3)
    assert result.hypervolumes()[-1] == pytest.approx(
        hypervolume(result.objectives / 3.0 + 1.0, 0.0)
    )


def test_an_initial_sample_is_the_first_archive_and_evaluations_end_the_search():
    sample, news = np.tile(np.linspace(0.2, 0.8, 7)[:, None], 6), []
    options = {**SMALL, "initial": sample}
    result = synthesize(spheres, UNIT, callback=news.append, **options)
    assert [one.generation for one in news] == list(range(7))
    assert news[0].evaluations == 7
    np.testing.assert_array_equal(news[0].front_parameters, sample[1:-1])
    np.testing.assert_array_equal(news[0].front, spheres(sample[1:-1]))
    np.testing.assert_array_equal(result.ideal, spheres(sample).max(axis=0))
    np.testing.assert_array_equal(result.nadir, spheres(sample).min(axis=0))
    np.testing.assert_array_equal(result.explored_parameters[:7], sample)
    stored = [Evaluated(one.objectives, None, one.parameters) for one in news[:4]]
    same(synthesize(spheres, UNIT, evaluated=stored, **options), result)
    alone = synthesize(spheres, UNIT, initial=sample, generations=0)
    np.testing.assert_array_equal(alone.parameters, sample[1:-1])
    for most, generations in ((11, 0), (12, 1), (35, 2), (10_000, 6)):
        assert len(synthesize(spheres, UNIT, evaluations=most, **SMALL).generations) == generations


def test_impossible_arguments_are_named():
    for options, words in [
        ({"bounds": [0.0, 1.0]}, r"bounds has shape \(2,\)"),
        ({"bounds": np.zeros((0, 2))}, r"bounds have shape \(0, 2\)"),
        ({"bounds": [[0.0, 1.0], [1.0, 1.0]]}, "bounds of parameter 1 are 1 and 1"),
        ({"bounds": [[0.0, 1.0]]}, "at least 2 parameters"),
        ({"population": 3}, "population is 3"),
        ({"generations": 0}, "generations is 0"),
        ({"elite_ratio": 0.0}, "elite_ratio is 0.0"),
        ({"step_size": np.nan}, "step_size is nan"),
        ({"seed": -1}, "seed is -1"),
        ({"loss": "hv"}, "loss is 'hv'"),
        ({"mean": "median"}, "mean is 'median'"),
        ({"ideal": [1.0, 1.0]}, "only one of ideal"),
        ({"ideal": [1.0, 1.0], "nadir": [0.0, 1.0]}, "must be larger on all axes"),
        ({"ideal": [1.0] * 3, "nadir": [0.0] * 3}, "ideal has 3 numbers"),
        ({"reference": [0.0] * 3}, "reference has 3 numbers"),
        ({"start": [2.0] * 6}, "must lie within the bounds"),
        ({"start": "centre"}, "start is 'centre'"),
        ({"evaluations": 0}, "evaluations is 0"),
        ({"initial": [[2.0] * 6, [0.5] * 6]}, "outside the bounds"),
        ({"initial": [[0.5] * 6]}, "ideal must be larger on all axes"),
        ({"method": "cmaes"}, "method is 'cmaes'"),
    ]:
        refused(words, synthesize, spheres, **{"bounds": UNIT, **SMALL, **options})


def test_impossible_results_are_named():
    for evaluate, words in [
        (lambda x: np.zeros(len(x)), r"shape \(12,\)"),
        (lambda x: np.zeros((3, 2)), r"shape \(3, 2\)"),
        (lambda x: np.zeros((len(x), 1)), r"shape \(12, 1\)"),
        (lambda x: [["a", "b"]] * len(x), "no number"),
        (lambda x: None, "shape"),
        (
            lambda x: np.where(np.arange(24).reshape(12, 2) == 7, np.nan, 1.0),
            "objective 1 of point 3 is nan",
        ),
        (lambda x: (spheres(x), np.full(12, np.inf)), "violation of point 0 is inf"),
        (lambda x: (spheres(x), np.zeros((12, 1))), r"violations have shape \(12, 1\)"),
    ]:
        refused(words, synthesize, evaluate, UNIT, **SMALL)


def test_results_that_do_not_fit_each_other_or_another_search_are_named():
    """Where an executor has each part of the points evaluated on its own."""
    with (
        ThreadPoolExecutor(2) as executor,
        pytest.raises(InputError, match="results of different shapes"),
    ):
        synthesize(
            lambda x: np.zeros((len(x), 2 + int(x[0, 0] > 0.5))), UNIT, **SMALL, executor=executor
        )
    with (
        ThreadPoolExecutor(2) as executor,
        pytest.raises(InputError, match="results of different shapes"),
    ):
        synthesize(violations_in_a_part, UNIT, **SMALL, executor=executor)
    generations = synthesize(spheres, UNIT, **SMALL).generations
    stored = [Evaluated(news.objectives, None, news.parameters) for news in generations]
    refused(
        r"other points .*0 evaluations",
        synthesize,
        spheres,
        UNIT,
        **{**SMALL, "seed": 4},
        evaluated=stored,
    )
    refused(
        "holds 6 results",
        synthesize,
        spheres,
        UNIT,
        **{**SMALL, "generations": 5},
        evaluated=stored,
    )


def violations_in_a_part(points):
    objectives = np.zeros((len(points), 2))
    return objectives if points[0, 0] > 0.5 else (objectives, np.zeros(len(points)))


def test_what_a_search_is_told_must_fit_what_it_asked_for():
    search = Search(UNIT, population=12)
    refused(r"parameters has shape \(1, 5\)", search.add, [[0.5] * 5], [[1.0, 1.0]])
    refused("ask first", search.tell, np.zeros((12, 2)))
    asked = search.ask()
    for call in (search.ask, lambda: search.add(UNIT[:, :1].T, [[0, 0]])):
        refused("were not told yet", call)
    search.tell(spheres(asked))
    refused(r"shape \(12, 3\)", search.tell, three(search.ask()))
