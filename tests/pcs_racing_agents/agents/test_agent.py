import pickle
from dataclasses import replace

import numpy as np
from refusal import refused
from same_move import Model

from pcs_racing.game.players import always, competitor, random_moves
from pcs_racing.planners.line_ppo import LAYERS, load_line_planner, save_line_planner
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.agents import Agent, make, observing
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.zoo import build


def test_agents_and_fixed_policies_travel_to_other_processes(spec, seen):
    agent = pickle.loads(pickle.dumps(random_moves(spec, seed=7)))
    np.testing.assert_array_equal(agent.act(seen[1]), random_moves(spec, seed=7).act(seen[1]))
    assert competitor_hash(agent) == competitor_hash(random_moves(spec, seed=7))
    fixed = pickle.loads(pickle.dumps(make("lane-switcher:any")))
    assert fixed.planner is get_planner("lane-switcher")
    assert [policy.name for policy in fixed.policies] == [f"lane-switcher:{i}" for i in range(20)]
    assert competitor_hash(fixed) == competitor_hash(make("lane-switcher:any"))


def test_digests_tell_players_apart_and_a_player_without_one_is_not_cached(spec, network):
    first = always(spec, "restraint +")
    assert competitor_hash(first) == competitor_hash(always(spec, "restraint+", name="other"))
    others = [always(spec, "restraint -"), random_moves(spec), random_moves(spec, seed=1)]
    others.append(build("cfr-argmax", spec, network=network))
    others.append(build("cfr-regret-matching", spec, network=network))
    layers = network.layers
    changed = replace(
        network, layers=replace(layers, biases=(layers.biases[0], layers.biases[1] + 1.0))
    )
    others.append(build("cfr-argmax", spec, network=changed))
    others += [competitor(f"lattice:pace=0.{i}", spec) for i in (3, 4)]
    assert len({competitor_hash(agent) for agent in (first, *others)}) == 9
    function = Agent("function", lambda seen: np.full((len(seen), 5), 0.2), spec)
    for unknown in (Model(), competitor(Model(), spec, name="named"), function):
        refused("it has no content hash", competitor_hash, competitor(unknown, spec))
    known = Model()
    known.content_hash = "abc"
    x, y = (competitor(known, spec, name=name) for name in "xy")
    assert competitor_hash(x) == competitor_hash(y)


def test_weights_inside_compiled_code_are_part_of_the_hash(tmp_path):
    hashes = set()
    for value in (0.0, 1.0):
        weights = {f"{name}.weight": np.full(shape, value) for name, shape in LAYERS.items()}
        weights |= {f"{name}.bias": np.zeros(shape[0]) for name, shape in LAYERS.items()}
        folder = save_line_planner(tmp_path / str(value), weights, training={})
        hashes.add(competitor_hash(competitor(load_line_planner(folder), None)))
    assert len(hashes) == 2


def test_bad_agents_and_observations_are_refused(spec, network):
    agent = build("cfr-argmax", spec, network=network)
    assert competitor(agent, spec) is competitor(agent, spec, name="cfr-argmax") is agent
    assert isinstance(competitor(agent, spec, name="other"), Agent)
    assert repr(agent) == "<Agent 'cfr-argmax': archive 'toy', paper rules>"
    refused("an agent's name is ''", Agent, "", agent.strategy, spec)
    refused("seed of agent 'x' is -1", Agent, "x", agent.strategy, spec, -1)
    refused("'jump' is no move", always, spec, "jump")
    for observation, message in [
        (np.zeros((1, 30)), r"got observations of shape \(1, 30\)"),
        (np.zeros((2, 3, 31)), r"shape \(2, 3, 31\)"),
        (np.full((1, 31), np.nan), "holds NaN or infinity"),
    ]:
        refused(message, agent.act, observation)


def test_observations_are_read_as_the_game_writes_them_and_tell_what_was_earlier(game, seen, spec):
    names = [element.name for element in game.observation_elements]
    for step, rows in enumerate(seen):
        running = rows[:, names.index(f"seen_{step}")] == 1.0  # games that crashed stay behind
        assert running.any()
        np.testing.assert_array_equal(observing.moves_made(rows, 2)[running], step)
        for coordinates, name in ((observing.own, "own"), (observing.opponent, "opponent")):
            at = [names.index(f"{name}_{axis}_{step}") for axis in ("aggressiveness", "restraint")]
            np.testing.assert_array_equal(coordinates(rows, 2)[running], rows[running][:, at])
            np.testing.assert_array_equal(coordinates(rows, 2, step)[running], rows[running][:, at])
    assert observing.step_count(seen[0], 2) == 5
    last = seen[-1]
    count = observing.moves_made(last, 2)
    for step, rows in enumerate(seen[:-1]):
        long_enough = count >= step
        np.testing.assert_array_equal(
            observing.earlier(last, 2, step)[long_enough], rows[long_enough]
        )
    state = game.reset(games=10, seed=3)
    rows = game.observation(state)[:, 1]
    np.testing.assert_array_equal(spec.archive.nearest(observing.own(rows, 2)), state.policy[:, 1])
