import pickle
from dataclasses import replace

import numpy as np
from refusal import refused
from same_move import Model

from pcs_racing.game.competitor import RandomMoves
from pcs_racing.planners.line_ppo import LAYERS, load_line_planner, save_line_planner
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.agents import Agent, Driver, as_agent, make, observing
from pcs_racing_agents.agents.agent import competitor_hash, draw, hash_rows
from pcs_racing_agents.agents.blind import always, random_moves
from pcs_racing_agents.agents.zoo import build


def test_an_agent_draws_by_the_observation_and_its_seed(spec, seen):
    agent = always(spec, "restraint +")
    assert agent.act(seen[0]).tolist() == [2] * 40
    assert agent.probabilities(seen[0][:0]).shape == (0, 5)
    agent = random_moves(spec, seed=4)
    everything = np.concatenate(seen)
    moves = agent.act(everything)
    assert len(set(moves.tolist())) == 4  # the paper's rules offer no "stay"
    np.testing.assert_array_equal(agent.act(everything[::-1])[::-1], moves)
    alone = [int(agent.act(row[None])[0]) for row in everything]
    np.testing.assert_array_equal(alone, moves)
    assert 0.1 < np.mean(replace(agent, seed=5).act(everything) == moves) < 0.4


def splitmix(number):
    """The output function of splitmix64 (Steele and others, 2014)."""
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        number %= 2**64
        number = (number ^ (number >> shift)) * factor
    number %= 2**64
    return number ^ (number >> 31)


def test_draws_follow_the_chances_and_rounding_never_draws_what_is_impossible():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(20_000, 31)).astype(np.float32)
    chances = np.tile([0.1, 0.0, 0.6, 0.3, 0.0], (20_000, 1))
    share = np.bincount(draw(chances, rows, 0), minlength=5) / 20_000
    np.testing.assert_allclose(share, chances[0], atol=0.02)
    assert share[1] == share[4] == 0.0
    # A change in the last bit of one number is another situation.
    changed = rows.copy()
    changed[:, 17] = np.nextafter(rows[:, 17], np.float32(np.inf))
    assert abs(np.mean(draw(chances, changed, 0) == draw(chances, rows, 0)) - 0.46) < 0.02
    assert len(np.unique(hash_rows(rows, 0))) == 20_000
    # By definition: the words of a row one after the other.
    golden, state = 0x9E3779B97F4A7C15, splitmix(8 * 0x9E3779B97F4A7C15)
    for word in rows[0].view(np.uint32).tolist():
        state = splitmix((state ^ word) + golden)
    assert int(hash_rows(rows[:1], 7)[0]) == state
    assert int(draw(np.full((1, 2**20), 2.0**-20), rows[:1], 7)[0]) == state >> 44
    zeros = np.zeros((1, 3), np.float32)
    np.testing.assert_array_equal(hash_rows(zeros, 1), hash_rows(-zeros, 1))
    # Chances that add up to a bit less or more than 1.
    rows = np.random.default_rng(1).normal(size=(5000, 2)).astype(np.float32)
    for chances in (
        [0.0, 1.0 - 1e-16, 0.0],
        [0.3, 0.3, 0.4 - 1e-12],
        [0.0, 1e-300, 0.0],
        [5e-324, 0.0],
        [0.1] * 10,
    ):
        assert (np.array(chances)[draw(np.tile(chances, (5000, 1)), rows, 3)] > 0.0).all()


def test_agents_and_fixed_policies_travel_to_other_processes(spec, seen):
    agent = pickle.loads(pickle.dumps(random_moves(spec, seed=7)))
    np.testing.assert_array_equal(agent.act(seen[1]), random_moves(spec, seed=7).act(seen[1]))
    assert agent.content_hash == random_moves(spec, seed=7).content_hash
    fixed = pickle.loads(pickle.dumps(make("lane-switcher")))
    assert fixed.planner is get_planner("lane-switcher")
    assert [policy.name for policy in fixed.policies] == [f"lane-switcher:{i}" for i in range(20)]
    assert fixed.content_hash == make("lane-switcher").content_hash


def test_digests_tell_what_somebody_does_and_nothing_is_kept_of_whom_they_can_not(spec, network):
    first = always(spec, "restraint +")
    assert first.content_hash == always(spec, "restraint+", name="other name").content_hash
    others = [always(spec, "restraint -"), random_moves(spec), random_moves(spec, seed=1)]
    others.append(build("cfr-argmax", spec, network=network))
    others.append(build("cfr-regret-matching", spec, network=network))
    layers = network.layers
    changed = replace(
        network, layers=replace(layers, biases=(layers.biases[0], layers.biases[1] + 1.0))
    )
    others.append(build("cfr-argmax", spec, network=changed))
    assert len({first.content_hash, *(agent.content_hash for agent in others)}) == 7
    assert [competitor_hash(agent) for agent in others] == [agent.content_hash for agent in others]
    assert competitor_hash(make("lattice:pace=0.3")) != competitor_hash(make("lattice:pace=0.4"))
    function = Agent("function", lambda seen: np.full((len(seen), 5), 0.2), spec)
    for unknown in (Model(), as_agent(Model(), "named"), function):
        refused("it has no content hash", competitor_hash, as_agent(unknown))
    known = Model()
    known.content_hash = "abc"
    assert competitor_hash(as_agent(known, "x")) == competitor_hash(as_agent(known, "y"))


def test_weights_inside_compiled_code_are_part_of_the_hash(tmp_path):
    hashes = set()
    for value in (0.0, 1.0):
        weights = {f"{name}.weight": np.full(shape, value) for name, shape in LAYERS.items()}
        weights |= {f"{name}.bias": np.zeros(shape[0]) for name, shape in LAYERS.items()}
        folder = save_line_planner(tmp_path / str(value), weights, training={})
        policy = load_line_planner(folder).policy()
        hashes |= {competitor_hash(policy), as_agent(policy).content_hash}
    assert len(hashes) == 4


def test_bad_agents_fixed_policies_and_observations_are_refused(spec):
    assert as_agent(Model()).name == "Model"
    assert as_agent(Model(), "mine").name == "mine"
    fixed = as_agent(get_planner("lattice").policy(), "L")
    assert isinstance(fixed, Driver)
    assert (fixed.name, len(fixed.policies)) == ("L", 1)
    agent = random_moves(spec)
    assert as_agent(agent) is as_agent(agent, "random-moves") is agent
    assert isinstance(as_agent(agent, "other"), Agent)
    renamed = as_agent(fixed, "M")
    assert (renamed.name, renamed.policies) == ("M", fixed.policies)
    assert repr(agent) == "<Agent 'random-moves': archive 'toy', paper rules>"
    assert repr(fixed) == "<Driver 'L': 1 policies of planner 'lattice'>"
    for wrong in ("never-switch", 3, Model):
        refused("is not a competitor", as_agent, wrong)
    for wrong in (len, RandomMoves()):
        refused("can't race here", as_agent, wrong)
    refused("an agent's name is ''", random_moves, spec, name="")
    refused("seed of agent 'random-moves' is -1", random_moves, spec, seed=-1)
    refused("'jump' is no move", always, spec, "jump")
    refused("'d' has no policy", Driver, "d", ())
    lattice, pursuit = get_planner("lattice").policy(), get_planner("pure-pursuit").policy()
    refused("one planner", Driver, "d", (lattice, pursuit))
    assert Driver("d", [lattice]).policies == (lattice,)  # no list that somebody may change
    for observation, message in [
        (np.zeros((1, 30)), r"got observations of shape \(1, 30\)"),
        (np.zeros((2, 3, 31)), r"shape \(2, 3, 31\)"),
        (np.full((1, 31), np.nan), "holds NaN or infinity"),
    ]:
        refused(message, random_moves(spec).act, observation)


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
