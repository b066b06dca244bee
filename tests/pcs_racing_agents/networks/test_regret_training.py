import numpy as np
import pytest
from refusal import refused
from toy_networks import MOVES, identity

from pcs_racing_agents.networks import Rows, goals
from pcs_racing_agents.networks.metrics import score_rows
from pcs_racing_agents.networks.training import (
    TrainSettings,
    load_train_settings,
    train_layers,
    train_network,
)

torch = pytest.importorskip("torch")

QUICK = TrainSettings(
    hidden=(32, 32),
    epochs=40,
    patience=20,
    batch_size=128,
    learning_rate=5e-3,
)


def situations(count=2000, pairs=20, seed=0):
    """Observations of seven numbers, and four values that depend on them in no linear way."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (count, 7))
    x[:, 3], x[:, 5] = 20.0 * x[:, 3] + 5.0, 3.0
    better = np.stack(
        [x[:, 0], -x[:, 0], np.abs(x[:, 1]) - 0.5, 0.05 * (x[:, 3] - 5.0) * x[:, 2]], axis=1
    )
    return x, 30.0 * better, np.arange(count) % pairs, np.arange(count) % 4


def rows_of(x, values, pair, step, **changes) -> Rows:
    columns = {
        "observations": x,
        "targets": values,
        "weights": np.ones(len(x)),
        "pair": pair,
        "step": step,
    }
    return Rows(**columns | changes)


def learned(rows: Rows, settings=QUICK, **options):
    """Return the network of some rows."""
    return train_network(rows, identity(), settings, name="net", **options)[0]


def agreement(network, rows: Rows) -> float:
    return score_rows(network, rows).agreement


def test_a_network_learns_what_can_be_learned_and_knows_how_it_was_made():
    network, result = train_network(rows_of(*situations()), identity(), QUICK, name="net")
    fresh = rows_of(*situations(seed=1))
    everything = score_rows(network, fresh)
    assert everything.agreement > 0.9
    assert everything.constant < 0.5
    assert everything.shortfall < 1.0  # of targets that differ by 30
    assert everything.rows == len(fresh)
    first, best = result.epochs[0], result.epochs[result.best]
    assert best.validation_loss < 0.05 < 0.5 < first.validation_loss
    assert best.validation_loss == min(epoch.validation_loss for epoch in result.epochs)
    # The saved epoch is the network: its own score is its score on the held-out pairs.
    held_out = np.isin(rows_of(*situations()).pair, result.validation_pairs)
    again = agreement(network, rows_of(*situations()).take(held_out))
    assert again == pytest.approx(best.validation_agreement, abs=1e-3)
    known = (network.name, network.target, network.moves, network.clipped, network.hidden)
    assert known == ("net", "regret", MOVES, False, (32, 32))
    facts = {
        "rows": 2000,
        "starting_pairs": 20,
        "validation_pairs": 3,
        "epochs": result.epochs[-1].epoch,
        "best_epoch": best.epoch,
        "setting_hidden": "32, 32",
        "setting_seed": 0,
    }
    assert {key: network.training[key] for key in facts} == facts


def weights(result) -> bytes:
    return b"".join(array.tobytes() for array in (result.layers.flat(), result.mean, result.scale))


def test_training_repeats_and_leaves_torch_and_numpy_as_they_were():
    torch.set_num_threads(2)
    np.random.seed(5)
    before = torch.get_rng_state(), np.random.get_state()[1].copy()
    quick = load_train_settings(QUICK, epochs=3)
    one = train_layers(rows_of(*situations(300)), quick)
    assert torch.equal(torch.get_rng_state(), before[0])
    np.testing.assert_array_equal(np.random.get_state()[1], before[1])
    assert torch.get_num_threads() == 2
    torch.manual_seed(99)
    torch.set_num_threads(1)
    assert weights(train_layers(rows_of(*situations(300)), quick)) == weights(one)
    other = train_layers(rows_of(*situations(300)), load_train_settings(quick, seed=1))
    assert weights(other) != weights(one)


def test_training_ends_when_validation_stops_improving():
    x, values, pair, step = situations(300)
    # nothing to learn: the first epochs are the best
    noise = np.random.default_rng(0).normal(size=values.shape)
    settings = load_train_settings(QUICK, epochs=500, patience=8, batch_size=32)
    told = []
    rows = rows_of(x, noise, pair, step)
    result = train_layers(rows, settings, progress=lambda *news: told.append(news))
    assert result.epochs[-1].epoch == result.best + 8 < 500
    assert result.epochs[-1].learning_rate < settings.learning_rate
    last = result.epochs[-1].epoch
    expected = [(epoch, 500) for epoch in range(1, last)] + [(last, last)]
    assert [news[:2] for news in told] == expected


@pytest.mark.parametrize("heavy", [0, 1])
def test_a_row_counts_by_its_weight(heavy):
    """Two contradicting halves: the network follows the one of weight, up or down."""
    x, values, pair, step = situations(600)
    signs = np.repeat([1.0, -1.0], len(x))
    opposed = rows_of(
        np.tile(x, (2, 1)),
        np.tile(values, (2, 1)) * signs[:, None],
        np.tile(pair, 2),
        np.tile(step, 2),
        weights=np.repeat([1.0 - 0.99 * heavy, 0.01 + 0.99 * heavy], len(x)),
    )
    judge = rows_of(x, values * (1 - 2 * heavy), pair, step)
    assert agreement(learned(opposed), judge) > 0.7


def test_clipped_targets_are_learned_clipped():
    """Values below 0 do not matter, except in rows without a value above 0."""

    def with_hopeless_rows(count, seed):
        x, values, pair, step = situations(count, seed=seed)
        hopeless = x[:, 4] > 0.3
        values[hopeless] -= 100.0
        return rows_of(x, values, pair, step), hopeless

    network = learned(with_hopeless_rows(2000, 0)[0], clipped=True)
    rows, hopeless = with_hopeless_rows(2000, 1)
    assert network.clipped
    good, bad = rows.take(~hopeless), rows.take(hopeless)
    assert agreement(network, good) > 0.85
    error = np.mean((network(good.observations) - np.maximum(good.targets, 0.0)) ** 2)
    assert error < 0.1 * np.mean(np.maximum(good.targets, 0.0) ** 2)
    assert network(bad.observations).mean() < 0.5
    assert agreement(network, bad) > 0.7  # as good as in the rest, though all clipped values are 0


def test_relative_targets_are_learned_apart_from_the_level(monkeypatch):
    """The situations differ many times as much as the moves."""
    monkeypatch.setattr(goals, "FLOOR", np.inf)
    x, values, pair, step = situations(4000)
    fresh = situations(seed=1)

    def level(x):
        return 3000.0 * (x[:, 0] * x[:, 1] + np.abs(x[:, 2]))

    rows, judge = rows_of(x, values + level(x)[:, None], pair, step), rows_of(*fresh)
    networks = [learned(rows, relative=relative) for relative in (True, False)]
    relative, plain = (agreement(network, judge) for network in networks)
    assert relative > 0.8 > 0.6 > plain
    for network in networks:
        means = network(fresh[0]).mean(axis=1)
        assert np.corrcoef(means, level(fresh[0]) + fresh[1].mean(axis=1))[0, 1] > 0.9


def test_relative_targets_far_below_the_best_are_raised(monkeypatch):
    """Random moves lose about 20; with a floor of 0.5 no move is learned as more than 10 below."""
    monkeypatch.setattr(goals, "FLOOR", 0.5)
    x, values, pair, step = situations()
    below = values.max(axis=1, keepdims=True) - values
    network = learned(rows_of(x, values, pair, step), relative=True)
    answers = network(x)
    learned_below = answers.max(axis=1, keepdims=True) - answers
    lost = np.mean(below)
    assert 0.45 * lost < np.quantile(learned_below, 0.99) < 0.7 * lost
    assert np.quantile(below, 0.99) > 2.0 * lost
    assert agreement(network, rows_of(*situations(seed=1))) > 0.9


def test_constant_inputs_and_targets_are_no_trouble():
    x, _, pair, step = situations(100)
    rows = rows_of(np.ones_like(x), np.full((100, 4), 3.0), pair, step)
    result = train_layers(rows, load_train_settings(QUICK, epochs=1, learning_rate=1e-8))
    np.testing.assert_array_equal(result.scale, np.ones(7))
    start, end = result.epochs
    # one row, many times
    assert end.training_loss == pytest.approx(start.validation_loss, abs=1e-6)
    zero = rows_of(np.ones_like(x), np.zeros((100, 4)), pair, step)
    for options in ({"clipped": True}, {"relative": True}):
        assert np.isfinite(learned(zero, **options)(np.ones(7))).all()


def test_bad_input_is_one_clear_error():
    rows, named = rows_of(*situations(100)), {"settings": QUICK, "name": "net"}
    refused("observations have 7 numbers", train_network, rows, identity(8), **named)
    refused("targets have 4 numbers", train_network, rows, identity(7, MOVES[:3]), **named)
    alone = rows.take(rows.pair == 3)
    refused("one starting pair", train_network, alone, identity(), **named)
    wild = load_train_settings(QUICK, learning_rate=10.0, weight_decay=10.0)
    refused(r"loss is (nan|inf) .*\d+", train_layers, rows, wild)
