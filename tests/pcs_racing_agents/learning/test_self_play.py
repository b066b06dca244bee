"""Self-play against the known equilibrium of a matrix game, and on races by definition."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused
from zoo_games import untrained

from pcs_racing import load_rules, make_game
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.players import random_moves
from pcs_racing_agents.agents import Agent
from pcs_racing_agents.agents.from_network import regret_matching
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.learning import responses, self_play
from pcs_racing_agents.learning.branches import GameBlock, branch_games
from pcs_racing_agents.learning.self_play import (
    learn_self_play,
    load_self_play_settings,
    traverse,
)
from pcs_racing_agents.networks import NetworkSet
from pcs_racing_agents.tournament.games import game_between

pytest.importorskip("torch", reason="torch is not installed")

# A network without hidden layers on the number of the situation is a table.
TABLE = {"hidden": (), "exploration": 0.0}
FIT = replace(responses.FIT, weight_decay=0.0, learning_rate=0.05, batch_size=256)
SHORT = load_self_play_settings(iterations=2, starts=12, hidden=(8,), epochs=3)
PAYOFFS = np.array([[2.0, -1.0], [-1.0, 1.0]])  # of player 0
"""Matching pennies with a larger prize for one side: both show it in 2 of 5 games."""


class MatrixGame:
    """A matrix game, played in each of some steps; players see the step and their number."""

    def __init__(self, steps=1):
        self.rules = SimpleNamespace(moves=steps)

    @property
    def identity(self):
        steps = self.rules.moves
        seen = tuple(f"step and player {i}" for i in range(2 * steps))
        return GameIdentity(seen, ("heads", "tails"), (0.5,), "toy", "0" * 64, "toy", steps)

    def chances(self, network, exploration, step, player):
        if network is None:
            return np.full(2, 0.5)
        seen = np.eye(2 * self.rules.moves, dtype=np.float32)[[2 * step + player]]
        return (1.0 - exploration) * regret_matching(network.unclipped(seen))[0] + exploration / 2

    def exploited(self, networks):
        """Half of both players' gains by best responses to the average strategy, and its value."""
        x, y = (
            sum(
                weight * self.chances(network, 0.0, 0, player)
                for network, weight in zip(networks.networks, networks.weights, strict=True)
            )
            for player in (0, 1)
        )
        return 0.5 * (max(PAYOFFS @ y) - min(x @ PAYOFFS)), x @ PAYOFFS @ y


def traverse_matrix(games, spec, payoff, network, exploration, block):
    """Let each player try both moves in half of the games, against a move that is drawn."""
    track, step, _ = block.place
    game, rng, rows = games[track], np.random.default_rng(block.keys), []
    for player, payoffs in enumerate((PAYOFFS, -PAYOFFS.T)):
        own, other = (game.chances(network, exploration, step, p) for p in (player, 1 - player))
        numbers = np.arange(player, len(block.keys), 2)
        outcomes = payoffs[:, rng.choice(2, len(numbers), p=other)].T
        seen = np.tile(np.eye(2 * game.rules.moves)[2 * step + player], (len(numbers), 1))
        rows.append((seen, outcomes - (outcomes @ own)[:, None], numbers))
    parts = [np.concatenate(part) for part in zip(*rows, strict=True)]
    return dict(zip(("observations", "advantages", "game"), parts, strict=True))


@pytest.fixture
def matrix(monkeypatch):
    """Self-play learns matrix games."""
    monkeypatch.setattr(self_play, "traverse", traverse_matrix)
    monkeypatch.setattr(responses, "FIT", FIT)


def learned(games, settings, folder, spec=None) -> NetworkSet:
    with open_job(folder, "self-play", {"seed": settings.seed}) as job:
        return learn_self_play(games, spec, settings, job)


def test_the_average_strategy_becomes_unexploitable_and_the_last_iteration_alone_does_not(
    tmp_path, matrix
):
    """The iterations go round in circles; their average comes to the equilibrium of value 1/5."""
    game = MatrixGame()
    settings = load_self_play_settings(iterations=24, starts=64, epochs=10, **TABLE)
    networks = learned([game], settings, tmp_path / "pennies")
    alone = [NetworkSet("one", (network,), np.ones(1), "argmax") for network in networks.networks]
    assert np.mean([game.exploited(one)[0] for one in alone]) > 0.5
    exploited, value = game.exploited(networks)
    assert exploited < 0.4
    assert value == pytest.approx(0.2, abs=0.15)


@pytest.fixture(scope="module")
def race(oval, archive):
    # fast enough for moves to matter in 3.2 s
    rules = load_rules("contest", speed_range=(1.2, 1.7))
    return make_game(oval, archive, rules, stay=False, steps=(1.6,) * 3, threads=1)


def test_the_weights_are_those_of_linear_cfr_and_other_games_are_refused(
    race, oval, archive, tmp_path
):
    offered = make_game(oval, archive, race.rules, stay=True, threads=1)
    spec = make_game(None, archive, offered.rules)
    networks = learned([offered], SHORT, tmp_path / "one", spec)
    assert networks.identity.moves[-1] == "stay"
    assert (networks.decision, len(networks.networks)) == ("regret-matching", 2)
    longer = make_game(race.track, archive, race.rules, steps=(1.6,) * 4)
    refused("differs from the first", learned, [race, longer], SHORT, tmp_path / "x")
    refused("at least one", learned, [], SHORT, tmp_path / "y")


def test_exploration_leaves_moves_a_chance_and_random_play_has_no_advantages(
    race, archive, game, spec, network, seen
):
    def rows_of(game, spec, payoff, strategy, exploration, keys):
        block = GameBlock((0, 1, 1), 0, keys)
        return traverse([game], spec, payoff, strategy, exploration, block)

    own = make_game(None, archive, race.rules)
    keys = np.arange(1, 9, dtype=np.uint64)
    rows = rows_of(race, own, "win", None, 0.1, keys)
    np.testing.assert_allclose(rows["advantages"].sum(axis=1), 0.0, atol=1e-12)
    parts = [rows_of(race, own, "win", None, 0.1, keys[k : k + 4]) for k in (0, 4)]
    np.testing.assert_array_equal(
        rows["advantages"], np.concatenate([part["advantages"] for part in parts])
    )
    trained = untrained(spec, "advantage")
    rows = rows_of(game, spec, "utility", trained, 0.2, keys)
    chances = self_play.ExploringStrategy(trained, 0.2, 5)(rows["observations"])
    np.testing.assert_allclose((chances * rows["advantages"]).sum(axis=1), 0.0, atol=1e-12)
    assert np.abs(rows["advantages"]).max() > 0.0
    first, second = (
        Agent("x", self_play.ExploringStrategy(trained, 0.2, 5), spec, seed) for seed in (0, 1)
    )
    before = random_moves(game, seed=2)
    by_hand = branch_games(
        game_between(game, first, second), second, keys, 1, [before], first, "utility", 5
    )
    np.testing.assert_array_equal(rows["observations"], by_hand.observations)
    np.testing.assert_allclose(
        rows["advantages"], by_hand.outcomes - (chances * by_hand.outcomes).sum(axis=1)[:, None]
    )
    chances = self_play.ExploringStrategy(network, 0.1, len(spec.moves))(seen[0])
    assert chances.min() >= 0.1 / len(network.moves) - 1e-12
    np.testing.assert_allclose(chances.sum(axis=1), 1.0)
    expected = 0.9 * regret_matching(network.unclipped(seen[0])) + 0.1 / len(network.moves)
    np.testing.assert_allclose(chances, expected)


@pytest.mark.parametrize("weights", ["linear", "uniform"])
def test_each_iteration_adds_its_rows_and_plays_by_the_network_of_the_one_before(
    tmp_path, monkeypatch, matrix, weights
):
    asked, fitted = [], []

    def counting(games, spec, payoff, network, exploration, block):
        step, keys = block.place[1], tuple(block.keys.tolist())
        asked.append((network and network.name, exploration, step, keys))
        return traverse_matrix(games, spec, payoff, network, exploration, block)

    def train(job, part, rows, identity, members, name, executor):
        fitted.append((part, [one.seed for one in members], rows))
        return real(job, part, rows, identity, members, name, executor)

    real = self_play.train_mean
    monkeypatch.setattr(self_play, "train_mean", train)
    monkeypatch.setattr(self_play, "traverse", counting)
    settings = load_self_play_settings(
        iterations=3,
        starts=8,
        epochs=1,
        seed=5,
        weights=weights,
        **{**TABLE, "exploration": 0.3},
    )
    networks = learned([MatrixGame(3)] * 2, settings, tmp_path / "run")
    steps = 3
    assert [one[:3] for one in asked] == [
        (f"iteration-{k}" if k else None, 0.3, step)
        for k in range(3)
        for _ in range(2)
        for step in range(steps)
    ]
    assert len({keys for *_, keys in asked}) == len(asked)  # games of their own everywhere
    for k, (part, seeds, rows) in enumerate(fitted, start=1):
        assert (part, seeds) == (
            f"iteration-{k}",
            [(5 * 64 + k) * 32],
        )
        new = rows.weights[len(fitted[k - 2][2]) if k > 1 else 0 :]
        assert set(new.tolist()) == {float(k) if weights == "linear" else 1.0}
    place, game = np.divmod(fitted[2][2].pair, 1_000_000)
    assert set(place.tolist()) <= {
        (k * 100 + step) * 1000 + i for k in (1, 2, 3) for step in range(steps) for i in (0, 1)
    }
    assert game.max() < 8
    np.testing.assert_allclose(
        networks.weights, np.array([2.0, 3.0, 4.0]) / 9.0 if weights == "linear" else 1 / 3
    )
    assert networks.training == {
        "rows": len(fitted[2][2]),
        "iterations": 3,
        "starts": 8,
        "exploration": 0.3,
        "weights": weights,
        "worth": "win",
        "seed": 5,
    }
