from itertools import combinations

import numpy as np
import pytest
from refusal import refused

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.lattice import LATTICE
from pcs_racing_agents.policies import diverse


def an_archive(coordinates):
    rng = np.random.default_rng(0)
    return PolicyArchive(
        name="points",
        planner="lattice",
        parameter_names=LATTICE.parameter_names,
        parameters=np.stack([LATTICE.sample(rng) for _ in coordinates]),
        characteristics=("aggressiveness", "restraint"),
        coordinates=coordinates,
    )


def probabilities(kernel, k):
    """Brute force: det(L_Y) of every set of k items, normalised."""
    sets = list(combinations(range(len(kernel)), k))
    weights = np.array([np.linalg.det(kernel[np.ix_(chosen, chosen)]) for chosen in sets])
    return dict(zip(sets, weights / weights.sum(), strict=True))


@pytest.mark.parametrize(("size", "k"), [(3, 1), (5, 3), (4, 4)])
def test_sets_have_the_probabilities_of_the_definition(size, k):
    kernel = diverse.similarity(np.random.default_rng(size * 10 + k).uniform(size=(size, 2)), 0.4)
    expected = probabilities(kernel, k)
    rng = np.random.default_rng(1)
    draws = 4000
    found = dict.fromkeys(expected, 0)
    for _ in range(draws):
        found[tuple(sorted(diverse.sample_kdpp(kernel, k, rng).tolist()))] += 1
    unsure = {chosen: p for chosen, p in expected.items() if p < 1.0}
    error = [
        (found[chosen] - draws * p) / np.sqrt(draws * p * (1 - p) + 1e-9)
        for chosen, p in unsure.items()
    ]
    assert np.max(np.abs([*error, 0.0])) < 4.0


def test_draws_are_repeated_and_impossible_choices_refused():
    archive = an_archive(np.random.default_rng(3).uniform(size=(30, 2)))
    first = diverse.select_diverse(archive, 6, rng=np.random.default_rng(5))
    np.testing.assert_array_equal(first, diverse.select_diverse(archive, 6, rng=5))
    others = {tuple(diverse.select_diverse(archive, 6, rng=seed)) for seed in range(5)}
    assert others != {tuple(first)}
    places = archive.normalised
    squares = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    kernel = np.exp(-0.5 * squares / 0.2**2) + 1e-6 * np.eye(30)
    np.testing.assert_allclose(diverse.similarity(places), kernel, rtol=1e-12)
    # The determinants of all sets are below the smallest number there is.
    kernel = diverse.similarity(np.random.default_rng(0).uniform(size=(90, 2)) * 1e-3, 0.5)
    chosen = diverse.sample_kdpp(kernel, 70, np.random.default_rng(1))
    assert len(set(chosen.tolist())) == 70
    for k in (0, 31):
        refused(f"k is {k}", diverse.select_diverse, archive, k)


def test_diverse_sets_lie_farther_apart_than_random_ones():
    rng = np.random.default_rng(2)
    agg = rng.uniform(size=60)
    archive = an_archive(np.column_stack([agg, 1.0 - agg]))

    def nearest_pair(indices):
        points = archive.normalised[indices]
        away = np.linalg.norm(points[:, None] - points[None], axis=-1)
        return away[np.triu_indices(8, 1)].min()

    drawn = [nearest_pair(diverse.select_diverse(archive, 8, rng=seed)) for seed in range(40)]
    anywhere = [nearest_pair(rng.choice(60, 8, replace=False)) for _ in range(40)]
    assert np.mean(drawn) > 1.5 * np.mean(anywhere)
