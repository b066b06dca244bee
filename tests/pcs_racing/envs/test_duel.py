"""The game of moves as an environment: games, calls of opponents, and films."""

import itertools
import sys
import types

import gymnasium as gym
import numpy as np
import pytest
from faces import AGENTS, begun
from refusal import refused

from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv
from pcs_racing.envs.infos import Result
from pcs_racing.envs.video import RecordRaces
from pcs_racing.race.driving import advance

SHORT = {"steps": (1.0,) * 4}


class Careful:
    """A strategy with SB3's interface that writes down how it was asked."""

    def __init__(self):
        self.asked = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.asked.append((observation.shape, deterministic))
        return np.full(len(observation), 2), None


def episode(env, seed, action=1):
    observation, info = env.reset(seed=seed)
    rows = [(observation, 0.0, info)]
    while True:
        observation, reward, terminated, truncated, info = env.step(action)
        rows.append((observation, reward, info))
        assert not truncated
        if terminated:
            return rows


def test_an_episode_is_the_game():
    """Agents get the values of RaceGame, step by step, until the game is over."""
    env = HeadToHeadEnv(steps=(1.0,) * 5)
    game = env.game
    for seed in range(5):
        _, infos = env.reset(seed=seed)
        state = game.reset(np.random.default_rng(seed).integers(2**63, size=1))
        assert infos["car_0"]["policy"] == state.policy[0, 0]
        for moves in [(0, 3), (2, 1), (1, 1), (0, 2)]:
            if not env.agents:
                break
            observations, rewards, terminated, truncated, infos = env.step(
                dict(zip(AGENTS, moves, strict=True))
            )
            state = game.step(state, [moves])
            for car, agent in enumerate(AGENTS):
                np.testing.assert_array_equal(observations[agent], game.observation(state)[0, car])
                assert rewards[agent] == game.reward(state)[0, car]
                assert (terminated[agent], truncated[agent]) == (game.done(state)[0], False)
                assert (infos[agent]["move"], infos[agent]["policy"]) == (
                    moves[car],
                    state.policy[0, car],
                )
                assert infos[agent]["lead"] == (
                    state.race.lead[0] if car == 0 else -state.race.lead[0]
                )
        assert env.agents == []
        results = {infos[agent]["result"] for agent in AGENTS}
        assert results in ({Result.WIN, Result.LOSS}, {Result.TIE}, {Result.CRASH})


def test_an_episode_may_begin_before_the_start():
    rules = {"steps": (0.0, 1.0, 2.0, 2.0), "opponent": "never-switch"}
    env = DuelEnv(**rules, render_mode="rgb_array_list", render_size=(120, 80))
    observation, _ = env.reset(seed=1)
    assert env.batch.state.race.tick[0] == 0
    assert len(env.render()) == 1  # nothing was driven
    times = []
    for _ in range(3):
        env.step(1)
        times.append(int(env.batch.state.race.tick[0]))
    assert times == [100, 300, 500]
    envs = DuelVectorEnv(2, **rules)
    np.testing.assert_array_equal(envs.reset(seed=[1, 2])[0][0], observation)


def test_policies_and_start_can_be_given():
    env = HeadToHeadEnv(**SHORT)
    _, infos = env.reset(seed=0, options={"policies": [2, 7], "start": (20.0, 1)})
    assert [infos[agent]["policy"] for agent in AGENTS] == [2, 7]
    state = env.batch.state
    begin = (state.race.frenet[0, 0, 0] - state.race.progress[0, 0]) % env.game.track.length
    assert begin == pytest.approx(20.0, abs=0.05)
    _, infos = env.reset(seed=0, options={"policies": (2, -1)})
    assert infos["car_0"]["policy"] == 2


def test_opponents_do_what_they_are_called():
    for name, expected in (("always-restraint-", 3), ("never-switch", 4)):
        env = DuelEnv(opponent=name, **SHORT)
        infos = [row[2] for row in episode(env, 4)[1:]]
        assert {info["opponent_move"] for info in infos} == {expected}
        assert env.outcome()["opponent"] == name
    moves = {
        row[2]["opponent_move"] for seed in range(12) for row in episode(DuelEnv(**SHORT), seed)[1:]
    }
    assert len(moves) == 4
    careful = Careful()
    assert episode(DuelEnv(opponent=careful, **SHORT), 4)[1][2]["opponent_move"] == 2
    assert set(careful.asked) == {((1, 25), True)}
    drawing = Careful()
    episode(DuelEnv(opponent=drawing, deterministic_opponent=False, **SHORT), 4)
    assert set(drawing.asked) == {((1, 25), False)}


class Chooses:
    """A model that always answers the same."""

    def __init__(self, answer, moves=None):
        self.answer = answer
        if moves is not None:
            self.action_space = gym.spaces.Discrete(moves)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.answer


@pytest.mark.parametrize("rules", [{}, {"stay": True}])
def test_an_opponent_may_stay_whatever_moves_the_rules_offer(rules):
    """4 is "stay", which the rules "paper" do not offer to the agent."""
    env = begun(DuelEnv(opponent=Chooses((np.array([4]), None)), **rules, **SHORT), seed=0)
    before = env.batch.state.policy[0, 1]
    env.step(0)
    assert env.outcome()["opponent_move"] == "stay"
    assert env.batch.state.policy[0, 1] == before
    assert env.action_space.n == (5 if rules else 4)
    if not rules:
        refused(r"move 4 .*0 to 3", env.step, 4)


def test_a_model_of_a_game_with_more_moves_is_refused_when_the_environment_is_made():
    for kind in (DuelEnv, DuelVectorEnv):
        refused(
            "'Chooses' has 8 moves", kind, opponent=Chooses((np.array([0]), None), moves=8), **SHORT
        )
    DuelEnv(opponent=Chooses((np.array([0]), None), moves=5), **SHORT)  # the fifth is to stay
    DuelEnv(opponent=Chooses((np.array([0]), None), moves=4), stay=True, **SHORT)  # it never stays


@pytest.mark.parametrize(
    "answer", [(np.array([0, 1]), None), np.array([0]), None, ([[0], [1, 2]], None), 3]
)
def test_what_a_model_answers_is_checked(answer):
    env = begun(DuelEnv(opponent=Chooses(answer), **SHORT), seed=0)
    refused("'Chooses': predict returned", env.step, 0)


@pytest.fixture
def videos(monkeypatch):
    """Input of moviepy: frames and their rate of each video."""
    written = []

    class Clip:
        def __init__(self, frames, fps):
            written.append((list(frames), fps))

        def write_videofile(self, path, logger=None):
            pass

    names = ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip")
    for name in names:
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setattr(sys.modules[names[-1]], "ImageSequenceClip", Clip, raising=False)
    return written


def test_a_video_shows_25_moments_of_each_second_that_was_raced(videos, tmp_path):
    env = gym.make(
        "pcs_racing/Duel-v1", render_mode="rgb_array_list", render_size=(120, 80), **SHORT
    )
    assert env.metadata["render_fps"] == 25
    env = RecordRaces(env, str(tmp_path / "videos"), episode_trigger=lambda episode: episode == 1)
    for _ in range(2):
        env.reset(seed=3)
        over = False
        while not over:
            *_, over, _, info = env.step(0)
    env.close()
    (frames, fps) = videos[0]
    assert len(videos) == 1
    assert fps == 25
    # with the first step, which was only watched
    assert len(frames) == pytest.approx(25 * info["time"], abs=2)
    assert all(frame.shape == (80, 120, 3) for frame in frames)
    assert np.mean([(one != other).any() for one, other in itertools.pairwise(frames)]) > 0.95


def test_a_video_of_single_frames_keeps_one_of_each_step(videos, tmp_path):
    env = gym.make("pcs_racing/Duel-v1", render_mode="rgb_array", render_size=(120, 80), **SHORT)
    env = RecordRaces(env, str(tmp_path / "videos"), episode_trigger=lambda episode: True)
    env.reset(seed=3)
    env.step(0)
    assert len(env.recorded_frames) == 2
    env.close()


@pytest.mark.parametrize("seed", range(4))
def test_the_first_step_is_filmed_as_it_was_driven(seed):
    env = DuelEnv(
        render_mode="rgb_array_list",
        opponent="lane-switcher:3",
        randomize={"mu": [0.6, 1.0]},
        **SHORT,
    )
    for options in (None, {"start": (10.0, 1)}):
        env.reset(seed=seed, options=options)
        race, theta, _ = env.batch.last_step()
        assert race.tick == 0
        conditions = env.batch.randomization.conditions(np.zeros(1, np.int64))
        advance(
            env.game.setup, race, theta, int(env.game.rules.end_ticks[0]), conditions=conditions
        )
        np.testing.assert_array_equal(race.cars, env.batch.state.race.cars)


def test_frames_are_those_since_the_last_ones():
    env = begun(DuelEnv(render_mode="rgb_array_list", render_size=(120, 80), **SHORT), seed=0)
    assert [frame.shape for frame in env.render()] == [(80, 120, 3)] * 25
    assert env.render() == []
    env.step(1)
    env.step(2)
    kept = env.get_state()
    assert len(env.render()) == 50
    assert env.render() == []
    filmed = env.get_state().batch[0].race.cars
    np.testing.assert_array_equal(filmed, kept.batch[0].race.cars)  # filming changes nothing
    env.step(1)
    env.reset(seed=1)
    assert len(env.render()) == 25  # a reset drops frames that were not rendered
    env.set_state(kept)
    assert len(env.render()) == 1  # of a value nothing is known but the moment
