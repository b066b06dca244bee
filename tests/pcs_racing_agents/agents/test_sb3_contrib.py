"""Models of sb3-contrib are agents: MaskablePPO as a zip, RecurrentPPO with its state per game."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing import make_game, racer
from pcs_racing.envs.duel import DuelEnv
from pcs_racing.game.players import ask_moves
from pcs_racing_agents.tournament import play_tournament

sb3_contrib = pytest.importorskip("sb3_contrib")

SMALL = {"n_steps": 8, "batch_size": 8, "device": "cpu", "seed": 0}


@pytest.fixture(scope="module")
def models():
    env = DuelEnv(track="Tarnfjord")
    return {
        "masked": sb3_contrib.MaskablePPO("MlpPolicy", env, **SMALL),
        "recurrent": sb3_contrib.RecurrentPPO("MlpLstmPolicy", env, **SMALL),
    }


def test_models_and_the_zip_of_a_model_without_a_state_race(models, tmp_path):
    game = make_game("Tarnfjord", steps=(1.0,) * 5)
    for name, model in models.items():
        model.save(tmp_path / name)
    masked, seen = racer(str(tmp_path / "masked.zip"), game), game.observation(game.reset(games=9))
    wanted, _ = models["masked"].predict(seen[:, 0], deterministic=True)
    np.testing.assert_array_equal(masked.model.predict(seen[:, 0])[0], wanted)
    refused("has an LSTM, which keeps a state", racer, str(tmp_path / "recurrent.zip"), game)
    rules = {"rules": "paper", "races_per_pair": 2}
    played = play_tournament("Tarnfjord", {**models, "calm": "never-switch"}, **rules)
    assert played.plan.names == ("masked", "recurrent", "calm")
    assert len(played.races) == 6


def moves_of(agent, game, keys):
    """Return an agent's moves, shape (4, games), and the states of its model after them."""
    state, memories, moves = game.reset(keys), [None] * len(keys), []
    for _ in range(4):
        moves.append(ask_moves(agent, game, state, 0, memories=memories))
        both = np.stack([moves[-1], np.zeros(len(keys), int)], axis=1)
        state = game.step(state, both, checked=True)
    return np.array(moves), memories


def test_a_recurrent_model_has_its_own_state_in_each_game(models):
    game = make_game("Tarnfjord", steps=(0.5,) * 5)
    agent = racer(models["recurrent"], game)
    together, states = moves_of(agent, game, [5, 6, 7])
    for i, key in enumerate([5, 6, 7]):
        alone, (state,) = moves_of(agent, game, [key])
        np.testing.assert_array_equal(alone[:, 0], together[:, i])
        np.testing.assert_allclose(state[0], states[i][0], atol=1e-6)
    assert not np.allclose(states[0][0], states[1][0])
