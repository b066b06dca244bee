from dataclasses import dataclass, replace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from refusal import refused
from zoo_games import untrained

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game import players
from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing_agents.agents import Agent
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.from_network import DECISIONS, from_network, get_decision
from pcs_racing_agents.agents.from_torch import TorchPolicy
from pcs_racing_agents.agents.mixture import make_mixture
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.networks import NetworkSet, save_network_set


def test_the_papers_agent_makes_the_move_of_highest_regret_and_matching_draws_in_proportion(
    spec, network, seen
):
    agent = build("cfr-argmax", spec, network=network)
    rows = np.concatenate(seen)
    np.testing.assert_array_equal(agent.act(rows), network.choose(rows))
    clipped = build("cfr-argmax", spec, network=replace(network, clipped=True))
    np.testing.assert_array_equal(clipped.act(rows), network.choose(rows))
    assert agent.facts["source"] == "the paper's GT agent, Equations 8 and 9"
    assert agent.facts["weights sha256"] == fingerprint(network.layers)
    facts = {
        "setting_a": 1,
        "test_b": 2,
        "validation_c": 3,
        "training_d": 4,
        "games": 5,
        "loss": 0.25,
    }
    agent = build("cfr-argmax", spec, network=replace(network, training=facts))
    about = {key: agent.facts[key] for key in ("network", "trained on", "decision")}
    assert list(about.values()) == [
        "untrained-regret: regret, rules paper",
        "games 5, loss 0.25",
        "argmax",
    ]
    agent = build("cfr-regret-matching", spec, network=network)
    values = np.maximum(network.unclipped(seen[1]), 0.0).astype(float)
    some = values.sum(axis=1) > 0.0
    expected = values[some] / values[some].sum(axis=1, keepdims=True)
    np.testing.assert_allclose(agent.probabilities(seen[1])[some], expected)


def test_a_network_may_not_know_stay_which_is_worth_nothing_to_it(spec, seen):
    short = untrained(spec, stay=False)
    agent = build("cfr-argmax", spec, network=short)
    assert (agent.probabilities(seen[0])[:, 4] == 0.0).all()
    np.testing.assert_array_equal(agent.act(seen[0]), short.choose(seen[0]))


def test_a_network_of_another_game_is_refused(spec, network, archive):
    longer = make_game(None, archive, replace(spec.rules, steps=(0.8,) * 6))
    sees = "agent 'cfr-argmax': network 'untrained-regret' sees 31 .* the game has 37"
    refused(sees, build, "cfr-argmax", longer, network=network)
    wider = make_game(None, archive, replace(spec.rules, epsilon=0.7))
    refused(r"epsilon 0\.5", build, "nash", wider, network=network)
    fewer = replace(archive, parameters=archive.parameters[1:], coordinates=archive.coordinates[1:])
    refused("archive 'toy'", build, "nash", make_game(None, fewer, spec.rules), network=network)
    refused("needs 'toy-paper-nash'", build, "nash", spec, error=UnknownNameError)


@given(arrays(np.float32, (5, 4), elements=st.floats(-100.0, 100.0, width=32)))
@pytest.mark.parametrize("name", DECISIONS)
def test_chances_are_chances(name, values):
    chances = get_decision(name)(values)
    assert (chances >= 0.0).all()
    np.testing.assert_allclose(chances.sum(axis=1), 1.0, atol=1e-12)
    best = np.argmax(values, axis=1)
    np.testing.assert_allclose(chances[np.arange(5), best], chances.max(axis=1), atol=1e-6)


def test_what_each_rule_does():
    # Of equal values argmax takes the first; where no regret is positive, regret matching takes the
    # highest.
    values = np.array([[1.0, 3.0, -2.0, 0.0], [-3.0, -1.0, -1.0, -9.0]])
    argmax, regret_matching, softmax = map(get_decision, ("argmax", "regret-matching", "softmax"))
    np.testing.assert_array_equal(argmax(values), [[0, 1, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_allclose(regret_matching(values), [[0.25, 0.75, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_allclose(softmax(np.log([[1.0, 2.0, 5.0, 2.0]])), [[0.1, 0.2, 0.5, 0.2]])
    refused("'best' is unknown", get_decision, "best", error=UnknownNameError)


torch = pytest.importorskip("torch")


def linear(seed):
    torch.manual_seed(seed)
    return torch.nn.Sequential(torch.nn.Linear(5, 3), torch.nn.Dropout(0.5))


def test_the_move_with_the_largest_output_is_made_and_what_is_no_network_refused():
    module = linear(0)
    weight, bias = module[0].weight.detach().numpy(), module[0].bias.detach().numpy()
    seen = np.random.default_rng(0).normal(size=(20, 5)).astype(np.float32)
    policy = TorchPolicy(module, "mine")
    # the dropout is off
    np.testing.assert_array_equal(policy.act(seen), (seen @ weight.T + bias).argmax(axis=1))
    broken = linear(0)
    with torch.no_grad():
        broken[0].bias[1] = float("nan")
    refused("module is a str", TorchPolicy, "text")
    refused("'0.bias' .* NaN", TorchPolicy, broken)
    seen = np.zeros((4, 5), np.float32)
    refused(r"\(1, 5\)", TorchPolicy(Summed()).act, seen)


def test_models_are_told_apart_by_their_weights_and_others_are_refused(models, game):
    assert competitor_hash(TorchPolicy(linear(0))) == competitor_hash(
        TorchPolicy(linear(0), "other name")
    )
    assert competitor_hash(TorchPolicy(linear(0))) != competitor_hash(TorchPolicy(linear(1)))
    digests = {
        competitor_hash(competitor(model, game, name=name))
        for model in models
        for name in ("a", "b")
    }
    assert len(digests) == 2


class Summed(torch.nn.Module):
    def forward(self, seen):
        return seen.sum(dim=0, keepdim=True)


@pytest.fixture(scope="module")
def models(oval, spec):
    """Untrained models with ReLUs and with SB3's default, tanh."""
    PPO = pytest.importorskip("stable_baselines3").PPO

    env = gym.make(
        "pcs_racing/Duel-v1", track=oval, archive=spec.archive, steps=(0.8,) * 5, stay=True
    )
    relu = {"activation_fn": torch.nn.ReLU, "net_arch": [24, 16]}
    return [
        PPO("MlpPolicy", env, seed=0, policy_kwargs=kwargs, device="cpu") for kwargs in (relu, None)
    ]


@dataclass(frozen=True)
class Chances:
    """A strategy with the probabilities of a constant player."""

    player: players.ConstantPlayer

    def __call__(self, observation):
        return self.player.probabilities(observation)


def constant(player, spec):
    return Agent(player.name, Chances(player), spec)


def never_switch(spec):
    return constant(players.never_switch(spec), spec)


def random_moves(spec):
    return constant(players.random_moves(spec), spec)


def on_the_way(
    chances: np.ndarray, table: np.ndarray, here: np.ndarray, there: np.ndarray
) -> np.ndarray:
    """How likely a strategy goes from one policy to another, whichever of the moves that do it
    makes.
    """
    return (chances * (table[here] == there[:, None])).sum(axis=1)


def test_drawing_on_the_way_is_drawing_before_the_game(game, spec, network):
    """Kuhn's theorem: every course of a game is as likely under the mixture as if a member had been
    drawn for it.
    """
    members = [
        random_moves(spec),
        from_network(
            spec, name="regrets", kind="regret", decision="regret-matching", network=network
        ),
        from_network(spec, name="logits", kind="regret", decision="softmax", network=network),
    ]
    weights = np.array([0.2, 0.5, 0.3])
    mixture = Agent("mixture", make_mixture(members, weights), spec)
    state = game.reset(games=30, seed=4)
    rng = np.random.default_rng(1)
    behaviour, drawn = np.ones(30), np.ones((3, 30))
    differed = False
    while not game.done(state).all():
        running = ~game.done(state)
        seen = game.observation(state)[:, 0]
        after = game.step(state, rng.integers(0, 4, (30, 2)))
        way = (spec.table, state.policy[:, 0], after.policy[:, 0])
        steps = [on_the_way(one.probabilities(seen), *way) for one in (mixture, *members)]
        differed |= bool((np.abs(steps[0] - weights @ np.array(steps[1:])) > 0.01).any())
        behaviour *= np.where(running, steps[0], 1.0)
        drawn *= np.where(running, steps[1:], 1.0)
        state = after
    np.testing.assert_allclose(behaviour, weights @ drawn, rtol=1e-9, atol=1e-15)
    assert differed, "the members must have become unequally likely, or this test says nothing"


def test_a_set_of_networks_is_played_as_the_mixture_of_its_members(spec, seen, tmp_path):
    networks = tuple(untrained(spec, "advantage", seed) for seed in (1, 2, 3))
    known = NetworkSet(
        "three", networks, np.array([1.0, 2.0, 1.0]), "regret-matching", {"rounds": 3}
    )
    folder = save_network_set(known, tmp_path / "three")
    agent = build("self-play", spec, networks=str(folder))
    rule = {"kind": "any", "decision": "regret-matching"}
    members = [
        from_network(spec, name=network.name, network=network, **rule) for network in networks
    ]
    by_hand = make_mixture(members, [0.25, 0.5, 0.25])
    for rows in seen[:-1]:
        np.testing.assert_array_equal(agent.probabilities(rows), by_hand(rows))
    facts = {key: agent.facts[key] for key in ("networks", "weights", "decision", "trained on")}
    assert list(facts.values()) == [
        "three: 3, rules paper",
        "0.25, 0.5, 0.25",
        "regret-matching",
        "rounds 3",
    ]
    assert (
        build("psro", make_game(None, "contest", "contest"))
        .facts["networks"]
        .startswith("contest-contest-psro: ")
    )
    assert agent.content_hash == build("self-play", spec, networks=known).content_hash
    other = NetworkSet("three", networks[::-1], np.array([3.0, 2.0, 1.0]), "regret-matching")
    assert agent.content_hash != build("self-play", spec, networks=other).content_hash


def test_bad_mixtures_are_refused_and_without_networks_the_error_says_how_to_make_them(
    spec, archive
):
    stay = never_switch(spec)
    for weights in ([], [1.0, 2.0], [-1.0], [0.0], [np.nan]):
        refused("weights", make_mixture, [stay], weights)
    refused(
        "'never-switch' can't be a member of a mixture",
        make_mixture,
        [stay, "never-switch"],
        [1, 1],
    )
    other = never_switch(make_game(None, archive, "contest"))
    refused("different archives or rules", make_mixture, [stay, other], [1, 1])
    for name in ["psro", "self-play"]:
        refused(
            f"'toy-paper-{name}'.*pcs-racing train {name}",
            build,
            name,
            spec,
            error=UnknownNameError,
        )
        refused("'nowhere'", build, name, spec, networks="nowhere", error=UnknownNameError)
