import numpy as np
import pytest
from refusal import refused
from toy_networks import MOVES, identity

from pcs_racing import InputError
from pcs_racing_agents.networks import Rows
from pcs_racing_agents.networks.metrics import score_rows
from pcs_racing_agents.networks.settings import TrainSettings, load_train_settings
from pcs_racing_agents.networks.training import train_layers, train_network

torch = pytest.importorskip("torch")

QUICK = TrainSettings(
    hidden=(32, 32),
    epochs=40,
    patience=20,
    batch_size=128,
    learning_rate=5e-3,
    validation_share=0.3,
)


def situations(count=2000, pairs=20, seed=0, noise=0.0):
    """Observations of seven numbers, and four values that depend on them in no linear way."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (count, 7)) * [1.0, 1.0, 1.0, 20.0, 1.0, 0.0, 1.0] + [
        0.0,
        0.0,
        0.0,
        5.0,
        0.0,
        3.0,
        0.0,
    ]
    better = np.stack(
        [x[:, 0], -x[:, 0], np.abs(x[:, 1]) - 0.5, 0.05 * (x[:, 3] - 5.0) * x[:, 2]], axis=1
    )
    values = 30.0 * better + noise * rng.normal(size=better.shape)
    return x, values, np.arange(count) % pairs, np.arange(count) % 4


def rows_of(x, values, pair, step, **changes) -> Rows:
    columns = {
        "observations": x,
        "targets": values,
        "weights": np.ones(len(x)),
        "pair": pair,
        "step": step,
    }
    return Rows(**columns | changes)


def test_a_network_learns_what_can_be_learned_and_knows_how_it_was_made():
    network, result = train_network(
        rows_of(*situations()), identity(), QUICK, name="net", target="toy"
    )
    fresh = rows_of(*situations(seed=1))
    everything, *steps = score_rows(network, fresh)
    assert everything.agreement > 0.9
    assert everything.constant < 0.5
    assert everything.shortfall < 1.0  # of targets that differ by 30
    assert [score.step for score in steps] == [0, 1, 2, 3]
    assert sum(score.rows for score in steps) == everything.rows == len(fresh)
    first, best = result.epochs[0], result.epochs[result.best]
    assert best.validation_loss < 0.05 < 0.5 < first.validation_loss
    assert best.validation_loss == min(epoch.validation_loss for epoch in result.epochs)
    # The epoch that was kept is the network: its own score is what it does on the held-out pairs.
    held_out = np.isin(rows_of(*situations()).pair, result.validation_pairs)
    again = score_rows(network, rows_of(*situations()).take(held_out))[0]
    assert again.agreement == pytest.approx(best.validation_agreement, abs=1e-3)
    assert again.shortfall == pytest.approx(best.validation_shortfall, rel=1e-2, abs=1e-4)
    network, result = train_network(rows_of(*situations(200)), identity(), QUICK, name="net")
    assert (network.name, network.target, network.moves, network.clipped) == (
        "net",
        "regret",
        MOVES,
        False,
    )
    assert network.hidden == (32, 32)
    summary = dict(network.training)
    assert (summary["rows"], summary["starting_pairs"], summary["validation_pairs"]) == (200, 20, 6)
    assert summary["epochs"] == result.epochs[-1].epoch >= summary["best_epoch"]
    assert summary["best_epoch"] == result.epochs[result.best].epoch
    assert summary["setting_hidden"] == "32, 32"
    assert summary["setting_seed"] == 0


def weights(result) -> bytes:
    return b"".join(array.tobytes() for array in (result.layers.flat(), result.mean, result.scale))


def test_training_repeats_and_leaves_torch_and_numpy_as_they_were():
    torch.set_num_threads(2)
    np.random.seed(5)  # noqa: NPY002 - the state that must not be touched
    before = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    quick = load_train_settings(QUICK, epochs=3)
    one = train_layers(rows_of(*situations(300)), quick)
    assert torch.equal(torch.get_rng_state(), before[0])
    np.testing.assert_array_equal(np.random.get_state()[1], before[1])  # noqa: NPY002
    assert torch.get_num_threads() == 2
    torch.manual_seed(99)
    torch.set_num_threads(1)
    assert weights(train_layers(rows_of(*situations(300)), quick)) == weights(one)
    assert weights(
        train_layers(rows_of(*situations(300)), load_train_settings(quick, seed=1))
    ) != weights(one)


def test_training_ends_when_validation_stops_improving():
    x, values, pair, step = situations(300)
    # nothing to learn: the first epochs are the best
    noise = np.random.default_rng(0).normal(size=values.shape)
    settings = load_train_settings(QUICK, epochs=500, patience=8, batch_size=32)
    told = []
    result = train_layers(
        rows_of(x, noise, pair, step), settings, progress=lambda *news: told.append(news)
    )
    assert result.epochs[-1].epoch == result.best + 8 < 500
    assert result.epochs[-1].learning_rate < settings.learning_rate
    last = result.epochs[-1].epoch
    assert [news[:2] for news in told] == [(epoch, 500) for epoch in range(1, last)] + [
        (last, last)
    ]


def test_a_row_counts_as_its_weight_says():
    """Two contradicting halves: the network follows the one of weight, up or down."""
    x, values, pair, step = situations(600)
    for heavy in (0, 1):
        opposed = rows_of(
            np.concatenate([x, x]),
            np.concatenate([values, -values]),
            np.concatenate([pair, pair]),
            np.concatenate([step, step]),
            weights=np.repeat([1.0 - 0.99 * heavy, 0.01 + 0.99 * heavy], len(x)),
        )
        network, _ = train_network(opposed, identity(), QUICK, name="net")
        score = score_rows(network, rows_of(x, values if heavy == 0 else -values, pair, step))[0]
        assert score.agreement > 0.7


def test_only_known_targets_are_learned():
    """Each row knows one or two of four values, the others are filled with nonsense that must not
    matter.
    """
    x, values, pair, step = situations(4000)
    rng = np.random.default_rng(3)
    mask = rng.random(values.shape) < 0.3
    mask[np.arange(len(x)), rng.integers(0, 4, len(x))] = True
    partly = rows_of(
        x, np.where(mask, values, 1e6 * rng.normal(size=values.shape)), pair, step, mask=mask
    )
    network, _ = train_network(partly, identity(), QUICK, name="net")
    assert score_rows(network, rows_of(*situations(seed=1)))[0].agreement > 0.85
    # Rows without any target of a move teach nothing about it, and nothing breaks.
    mask[:, 3] = False
    mask[:, 0] = True
    network, _ = train_network(
        rows_of(x, values, pair, step, mask=mask), identity(), QUICK, name="net"
    )
    fresh = rows_of(*situations(seed=1), mask=np.tile([True, True, True, False], (2000, 1)))
    assert score_rows(network, fresh)[0].agreement > 0.85


def test_clipped_targets_are_learned_clipped():
    """Below 0 the values are anybody's guess, but for rows in which no move is above 0."""
    x, values, pair, step = situations(4000)
    hopeless = x[:, 4] > 0.3
    values[hopeless] -= 100.0
    network, _ = train_network(
        rows_of(x, values, pair, step), identity(), QUICK, name="net", clipped=True
    )
    x, values, pair, step = situations(seed=1)
    hopeless = x[:, 4] > 0.3
    values[hopeless] -= 100.0
    good, bad = (
        score_rows(network, rows_of(x, values, pair, step).take(rows))[0]
        for rows in (~hopeless, hopeless)
    )
    assert network.clipped
    assert good.agreement > 0.85
    assert good.error < 0.1 * np.mean(np.maximum(values[~hopeless], 0.0) ** 2)
    assert network(x[hopeless]).mean() < 0.5
    assert bad.agreement > 0.7  # as good as in the rest, though all clipped values are 0
    literal = load_train_settings(QUICK, below_zero=0.0)
    paper, _ = train_network(
        rows_of(*situations(4000)), identity(), literal, name="net", clipped=True
    )
    assert score_rows(paper, rows_of(*situations(seed=1)))[0].agreement > 0.85


def test_differences_are_learned_apart_from_the_level():
    """The situations differ many times as much as the moves, yet the network is to tell the moves
    apart.
    """
    x, values, pair, step = situations(4000)
    level = 3000.0 * (x[:, :1] * x[:, 1:2] + np.abs(x[:, 2:3]))
    rows = rows_of(x, values + level, pair, step)
    fresh = situations(seed=1)
    judge = rows_of(*fresh)
    found = []
    for differences in (True, False):
        settings = load_train_settings(QUICK, differences=differences)
        network, _ = train_network(rows, identity(), settings, name="net")
        found.append(score_rows(network, judge)[0].agreement)
        known = 3000.0 * (fresh[0][:, 0] * fresh[0][:, 1] + np.abs(fresh[0][:, 2])) + fresh[1].mean(
            axis=1
        )
        assert np.corrcoef(network(fresh[0]).mean(axis=1), known)[0, 1] > 0.9
    assert found[0] > 0.8 > 0.6 > found[1]


def test_a_floor_raises_what_is_far_below_the_best_and_constants_are_no_trouble():
    """Random moves lose about 20; with a floor of 0.5 nothing is learned to be more than 10 below
    the best.
    """
    x, values, pair, step = situations(4000)
    lost = np.mean(values.max(axis=1, keepdims=True) - values)
    settings = load_train_settings(QUICK, floor=0.5)
    network, _ = train_network(rows_of(x, values, pair, step), identity(), settings, name="n")
    answers = network(x)
    below = answers.max(axis=1, keepdims=True) - answers
    assert 0.45 * lost < np.quantile(below, 0.99) < 0.7 * lost
    assert np.quantile(values.max(axis=1, keepdims=True) - values, 0.99) > 2.0 * lost
    assert score_rows(network, rows_of(*situations(seed=1)))[0].agreement > 0.9
    x, _, pair, step = situations(100)
    rows = rows_of(np.ones_like(x), np.full((100, 4), 3.0), pair, step)
    result = train_layers(rows, load_train_settings(QUICK, epochs=2))
    np.testing.assert_array_equal(result.scale, np.ones(7))
    still = train_layers(rows, load_train_settings(QUICK, epochs=1, learning_rate=1e-8)).epochs
    # one row, many times
    assert still[1].training_loss == pytest.approx(still[0].validation_loss, abs=1e-6)
    rows = rows_of(np.ones_like(x), np.zeros((100, 4)), pair, step)
    network, _ = train_network(rows, identity(), QUICK, name="net", clipped=True)
    assert np.isfinite(network(np.ones(7))).all()


def test_bad_input_is_one_clear_error():
    rows = rows_of(*situations(100))
    refused("observations have 7 numbers", train_network, rows, identity(8), QUICK, name="net")
    refused(
        "targets have 4 numbers", train_network, rows, identity(7, MOVES[:3]), QUICK, name="net"
    )
    refused(
        "one starting pair", train_network, rows.take(rows.pair == 3), identity(), QUICK, name="net"
    )
    with pytest.raises(InputError, match=r"loss is (nan|inf) .*\d+"):
        train_layers(rows, load_train_settings(QUICK, learning_rate=10.0, weight_decay=10.0))
