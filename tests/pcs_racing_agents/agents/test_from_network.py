from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from refusal import refused
from zoo_games import untrained

from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.agents import make_game_spec
from pcs_racing_agents.agents.from_network import DECISIONS, get_decision
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.fingerprint import fingerprint


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
        "untrained-regret: regret, preset paper",
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
    longer = make_game_spec(archive, replace(spec.config, moves=5))
    sees = "agent 'cfr-argmax': network 'untrained-regret' sees 31 .* the game has 37"
    refused(sees, build, "cfr-argmax", longer, network=network)
    wider = make_game_spec(archive, replace(spec.config, epsilon=0.7))
    refused(r"epsilon 0\.5", build, "nash", wider, network=network)
    fewer = replace(archive, parameters=archive.parameters[1:], coordinates=archive.coordinates[1:])
    refused("archive 'toy'", build, "nash", make_game_spec(fewer, spec.config), network=network)
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
