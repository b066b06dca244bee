"""A choice among the lattice's candidates."""

import numpy as np
import pytest

from pcs_racing import InputError, racer
from pcs_racing.envs import LineEnv, split_observation
from pcs_racing.envs.line_options import LINE_ELEMENTS
from pcs_racing.planners.line_ppo import LAYERS, LINE_FORMAT, SHARPNESS
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, start_races
from pcs_racing.race.start_grid import Starts


def test_a_rejected_choice_becomes_the_cheapest_and_the_info_says_so():
    one, other = LineEnv(), LineEnv()
    (seen, info), _ = one.reset(seed=1), other.reset(seed=1)
    cost = split_observation(seen)["candidates"][:, -1]
    np.testing.assert_array_equal(one.action_masks(), cost >= 0.0)
    cheapest = int(np.where(cost < 0.0, np.inf, cost).argmin())
    rejected = int(np.flatnonzero(info["action_mask"] == 0)[0])
    replaced, chosen = one.step(rejected), other.step(cheapest)
    np.testing.assert_array_equal(replaced[0], chosen[0])
    assert (replaced[4]["replaced"], chosen[4]["replaced"]) == (1, 0)


def best_by_network(seen, tensors):
    """Return the choice of ``line-ppo``'s network for an observation, computed by numpy."""
    parts = split_observation(seen.astype(np.float64))
    c = np.arange(64)
    each = np.concatenate(
        [parts["moves"][c % 16], parts["speeds"][c // 16], parts["candidates"]], axis=1
    )

    def layer(name, x):
        return x @ tensors[f"{name}.weight"].T + tensors[f"{name}.bias"]

    inner = np.tanh(layer("context", parts["context"]))
    hidden = np.maximum(layer("candidate", each) + layer("situation", inner), 0.0)
    score = layer("score", hidden)[:, 0] + each @ layer("weights", inner)
    return int(np.where(each[:, -1] < 0.0, -np.inf, score - SHARPNESS * each[:, -1]).argmax())


def test_line_ppos_own_choices_drive_the_race_of_line_ppo():
    from safetensors.numpy import load_file

    tensors = load_file(LINE_FORMAT.find("line-ppo") / "weights.safetensors")
    assert set(tensors) == {f"{layer}.{kind}" for layer in LAYERS for kind in ("weight", "bias")}
    env = LineEnv(duration=10.0)
    seen, _ = env.reset(seed=5)
    state, rules, over = env.batch.state, env.batch.setup.rules, False
    begun = state.copy()
    while not over:
        seen, _, over, _, _ = env.step(best_by_network(seen, tensors))
    drivers = racer("line-ppo"), racer("lattice")
    setup = RaceSetup(env.track, rules, tuple(one.planner for one in drivers))
    start = Starts(begun.frenet[0, :1, 0], np.zeros(1, np.int64))
    race = start_races(setup, start, begun.seed)
    for name in ("cars", "frenet", "progress", "command", "handicap", "leader", "ahead", "laps"):
        getattr(race, name)[:] = getattr(begun, name)
    theta = np.stack([pad_parameters([one], setup.theta_size) for one in drivers], 1)
    advance(setup, race, theta, int(state.tick[0]))
    np.testing.assert_allclose(race.cars, state.cars, atol=1e-9)


def test_bad_input_is_refused_by_one_line():
    env = LineEnv()
    env.reset(seed=0)
    for action, word in ((64, "64"), (-1, "-1"), (1.5, "whole"), ([1, 2], "whole")):
        with pytest.raises(InputError, match=word):
            env.step(action)
    for style, word in (
        ({"risk": 2.0}, "risk"),
        ({"rsk": 0.5}, "risk"),
        ({"pace": (1.0, 0.5)}, "pace"),
        (3, "style"),
    ):
        with pytest.raises(InputError, match=word):
            LineEnv(style=style)
    with pytest.raises(InputError, match=str(len(LINE_ELEMENTS))):
        split_observation(np.zeros(41))


def test_ppo_of_stable_baselines3_learns_in_it():
    stable = pytest.importorskip("stable_baselines3")
    from pcs_racing.envs import make_sb3_vec_env

    envs = make_sb3_vec_env("line-self-play", 4, threads=1)
    model = stable.PPO("MlpPolicy", envs, n_steps=8, batch_size=16, n_epochs=1, seed=0)
    model.learn(32)
    masks = np.array(envs.env_method("action_masks"))
    assert masks.shape == (4, 64)
    assert masks.any(axis=1).all()
