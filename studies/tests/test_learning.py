"""Learning on worlds whose coordinates are a known function of behaviour."""

import numpy as np
import pytest

from pcs_racing import ConfigError, InputError
from pcs_racing.game import characteristics
from studies.axes.coordinates import payoff_coordinates
from studies.axes.learn import LearnSettings, fit_characteristics
from studies.axes.pools import best_of_intervals
from studies.axes.ridge import fit_ridge, term_names, term_values
from studies.axes.validation import DRAWS, draw_rows, explained

POLICIES, TRACKS, PIECES = 24, 2, 64
SETTINGS = LearnSettings(name="world", inputs=("speed", "restraint"), degree=1, folds=6)


@pytest.fixture(autouse=True)
def own_registry(monkeypatch):
    monkeypatch.setattr(characteristics, "_registered", dict(characteristics._registered))


def payoffs_of(rating: np.ndarray, plane: np.ndarray, tracks: int = TRACKS, folds: int = 4) -> np.ndarray:
    """Payoffs without noise: differences of ratings, and a cyclic plane."""
    x, y = plane.T
    one = rating[:, None] - rating[None, :] + x[:, None] * y[None, :] - y[:, None] * x[None, :]
    return np.broadcast_to(one, (tracks, folds, *one.shape)).copy()


class World:
    """Policies with two traits; the plane's coordinates are the traits, and the rating is a sum of both."""

    def __init__(self, seed: int, noise: float = 0.5):
        rng = np.random.default_rng(seed)
        # Traits of variance 1 that are uncorrelated and sum to zero.
        traits = rng.normal(size=(POLICIES, 2))
        traits = np.linalg.qr(np.column_stack([np.ones(POLICIES), traits]))[0][:, 1:] * np.sqrt(POLICIES)
        self.traits = traits * np.sign(rng.normal())
        self.rating = 0.05 * (self.traits[:, 0] + self.traits[:, 1])
        self.payoffs = payoffs_of(self.rating, 0.2 * self.traits)
        # What is seen: traits in other units, with noise in every segment.
        self.behaviour = [5.0, 2.0] + [0.5, 0.1] * (
            self.traits[None, :, None] + noise * rng.normal(size=(TRACKS, POLICIES, PIECES, 2))
        )


def test_weights_of_a_linear_world_are_recovered():
    learning = fit_characteristics(World(0).payoffs, World(0).behaviour, SETTINGS)
    rating, first, second = learning.characteristics.axes
    # Inputs have variance 1 + .25 in units of the traits, of which a mean over 4 segments keeps 1 + .25 / 4.
    kept = np.sqrt(1.25) / (1.0 + 0.25 / 4.0)
    np.testing.assert_allclose(dict(first.weights)["speed"], kept, rtol=0.05)
    np.testing.assert_allclose(dict(first.weights)["restraint"], 0.0, atol=0.05)
    np.testing.assert_allclose(abs(dict(second.weights)["restraint"]), kept, rtol=0.05)
    np.testing.assert_allclose([weight for _, weight in rating.weights], kept / np.sqrt(2.0), rtol=0.1)
    assert (learning.scores[16].r2 > learning.scores[1].r2).all()
    assert (learning.scores[16].r2 > 0.9).all()
    assert [axis.name for axis in learning.characteristics.axes] == ["world_rating", "world_cycle_1", "world_cycle_2"]


def test_behaviour_that_says_nothing_explains_nothing():
    world = World(0)
    noise = np.random.default_rng(5).normal(size=world.behaviour.shape)
    assert (fit_characteristics(world.payoffs, noise, SETTINGS).scores[16].r2 < 0.05).all()


def test_a_product_is_found_where_the_world_has_one():
    world = World(0, noise=0.1)
    squared = world.traits[:, 0] ** 2
    payoffs = payoffs_of(0.05 * (squared - squared.mean()), 0.2 * world.traits)
    linear, products = (
        fit_characteristics(payoffs, world.behaviour, LearnSettings(inputs=SETTINGS.inputs, degree=degree))
        .scores[16]
        .r2[0]
        for degree in (1, 2)
    )
    assert products > 0.9
    assert linear < 0.5


def test_the_learned_set_is_the_same_whenever_it_is_learned():
    first, second = (fit_characteristics(World(0).payoffs, World(0).behaviour, SETTINGS) for _ in range(2))
    assert first.characteristics.content_hash == second.characteristics.content_hash


def test_the_first_coordinate_of_the_plane_grows_with_behaviour_and_the_second_does_not():
    world, rng = World(2), np.random.default_rng(0)
    trend = world.traits @ [0.6, 0.8] + 0.1 * rng.normal(size=POLICIES)
    plane = payoff_coordinates(world.payoffs[0], trend).plane
    assert np.corrcoef(trend, plane[:, 0])[0, 1] > 0.9
    assert abs((trend - trend.mean()) @ plane[:, 1]) < 1e-9


def test_ridge_without_a_penalty_is_least_squares():
    rng = np.random.default_rng(0)
    terms, noise = rng.normal(size=(50, 3)), rng.normal(size=(50, 2))
    targets = 1.0 + terms @ [[1.0, 0.0], [2.0, -1.0], [0.0, 3.0]] + 0.1 * noise
    design = np.column_stack([np.ones(50), terms])
    expected = np.linalg.lstsq(design, targets, rcond=None)[0]
    fitted = fit_ridge(terms, targets, [0.0, 0.0])
    np.testing.assert_allclose(np.vstack([fitted.intercept, fitted.weights]), expected, atol=1e-9)
    assert np.abs(fit_ridge(terms, targets, [10.0, 10.0]).weights).sum() < np.abs(fitted.weights).sum()


def test_terms_are_all_products_up_to_the_degree():
    assert term_names(["a", "b"], 2) == ["a", "b", "a * a", "a * b", "b * b"]
    np.testing.assert_array_equal(term_values(np.array([2.0, 3.0]), 2), [2.0, 3.0, 4.0, 6.0, 9.0])


def test_rows_are_means_of_pieces_that_were_driven():
    values = np.full((1, 1, 6, 1), np.nan)
    values[0, 0, :4, 0] = [1.0, 2.0, 3.0, 4.0]
    rows = draw_rows(values, 4, 0)
    assert rows.shape == (1, 1, DRAWS, 1)
    np.testing.assert_allclose(rows, 2.5)
    with pytest.raises(InputError, match="4 segments"):
        draw_rows(values, 5, 0)


def test_explained_is_1_for_the_truth_and_0_for_the_mean():
    targets = np.random.default_rng(0).normal(size=(10, 2))
    estimates = np.broadcast_to(targets[:, None], (1, 10, 3, 2)).copy()
    np.testing.assert_allclose(explained(estimates, targets).r2, 1.0)
    estimates[:] = targets.mean(axis=0)
    np.testing.assert_allclose(explained(estimates, targets).r2, 0.0, atol=1e-12)


def test_every_interval_gives_its_best_and_empty_ones_the_best_that_is_left():
    axis, score = np.array([0.0, 0.1, 0.2, 3.0]), np.array([1.0, 5.0, 4.0, 0.0])
    np.testing.assert_array_equal(best_of_intervals(axis, score, 3), [1, 2, 3])


@pytest.mark.parametrize(
    "wrong",
    [
        {"inputs": ("charm",)},
        {"opponents": 1, "starts": 1},
        {"degree": 4},
        {"inputs": ()},
        {"segments": 0},
        {"name": "../x"},
    ],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises((ConfigError, InputError)):
        LearnSettings(**wrong)


def test_behaviour_of_another_shape_is_refused():
    world = World(0)
    with pytest.raises(InputError, match="behaviour"):
        fit_characteristics(world.payoffs, world.behaviour[:, 1:], SETTINGS)
