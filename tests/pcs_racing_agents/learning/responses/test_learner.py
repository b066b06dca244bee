import numpy as np
import pytest

from pcs_racing import make_game
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.game.config import load_game_config
from pcs_racing_agents.agents.blind import always, never_switch
from pcs_racing_agents.agents.setting import make_setting
from pcs_racing_agents.jobs.executors import make_executor
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.learning.responses import learn_response, load_response_settings

SMALL = load_response_settings(starts=24, rounds=2, members=2, hidden=(8,), epochs=3, patience=2)


@pytest.fixture(scope="module")
def setting():
    return make_setting("default", load_game_config("paper", moves=2, step_seconds=2.0))


@pytest.fixture(scope="module")
def game(setting):
    return make_game("Tarnfjord", setting.archive, setting.config, threads=1)


def learn(game, setting, folder, executor=None, settings=SMALL):
    pool = [never_switch(setting), always(setting, "aggressiveness +")]
    with open_job(folder, "response", {"seed": settings.seed}) as job:
        return learn_response([game], pool, setting, settings, job, executor=executor)


def test_the_same_network_from_threads_and_after_a_stop(game, setting, tmp_path):
    pytest.importorskip("torch")
    first = learn(game, setting, tmp_path / "a")
    assert first.identity.moves == setting.moves
    with make_executor("threads", 2) as executor:
        second = learn(game, setting, tmp_path / "b", executor)
    removed = sorted((tmp_path / "b" / "chunks").glob("*.npz"))[::2]
    for file in removed:
        file.unlink()
    third = learn(game, setting, tmp_path / "b")
    for other in (second, third):
        for own, others in zip(first.layers.weights, other.layers.weights, strict=True):
            np.testing.assert_array_equal(own, others)


def test_games_must_be_alike(game, setting, tmp_path):
    other = make_game("Tarnfjord", setting.archive, load_game_config(setting.config, moves=3))
    with open_job(tmp_path / "c", "response", {}) as job:
        with pytest.raises(InputError, match="one of each"):
            learn_response([game], [], setting, SMALL, job)
        with pytest.raises(InputError, match="games of 2 moves"):
            learn_response([game, other], [never_switch(setting)], setting, SMALL, job)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"worth": "fame"}, "worth is 'fame'"),
        ({"members": 0}, "members is 0"),
        ({"hidden": (0,)}, "hidden"),
        ({"pupils": 3}, "unknown response setting 'pupils'"),
    ],
)
def test_impossible_settings_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        load_response_settings(**changes)
