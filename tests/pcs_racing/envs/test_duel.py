import importlib
import inspect
import itertools
import re
import sys
import types

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import vector as vector_wrappers

from pcs_racing import InputError, UnknownNameError, advance, get_planner
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, SelfPlayVectorEnv
from pcs_racing.envs.video import RecordRaces
from pcs_racing.game.make import make_game

SHORT = {"step_seconds": 1.0, "moves": 3}
MIXTURE = [(1, "random-moves"), (2, "never-switch"), (1.0, "always-restraint+")]


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


def test_it_is_the_view_of_car_0():
    """The same key and moves, played through the rules themselves."""
    env = DuelEnv(opponent="always-aggressiveness +", **SHORT)
    observation, _ = env.reset(seed=8)
    game = make_game("Tarnfjord", **SHORT)
    key = np.random.default_rng(8).integers(2**63)  # what the environment draws first
    state = game.reset(np.array([key], np.uint64))
    np.testing.assert_array_equal(observation, game.observation(state)[0, 0])
    for move in (3, 1, 0):
        observation, reward, terminated, _, info = env.step(move)
        state = game.step(state, np.array([[move, 0]]))
        np.testing.assert_array_equal(observation, game.observation(state)[0, 0])
        assert reward == game.reward(state)[0, 0]
        assert terminated == game.done(state)[0]
        assert info["policy"] == state.policy[0, 0]
        assert (info["move"], info["opponent_move"]) == (move, 0)
        if terminated:
            break


def test_the_table_of_its_page_is_its_space():
    env = DuelEnv()
    rows = re.findall(
        r"^\| (6k|30)(?: \+ (\d))? \| (\w+) \| ([\w ]+) \| (\S+) \| (\S+) \|$", inspect.getdoc(DuelEnv), re.M
    )
    assert len(rows) == 7
    for start, offset, name, unit, low, high in rows:
        for k in range(5 if start == "6k" else 1):
            element = env.elements[6 * k + int(offset or 0) if start == "6k" else 30]
            assert (element.name, element.unit) == (name.removesuffix("_k") + (f"_{k}" if start == "6k" else ""), unit)
            assert (element.low, element.high) == (float(low), float(high))
    seen = [row[0] for row in episode(env, 2)]
    assert all(env.observation_space.contains(one) for one in seen)


def test_opponents_do_what_they_are_called():
    for name, expected in (("always-restraint -", 3), ("never-switch", -1)):
        env = DuelEnv(opponent=name, **SHORT)
        infos = [row[2] for row in episode(env, 4)[1:]]
        assert {info["opponent_move"] for info in infos} == {expected}
        assert env.outcome()["opponent"] == name
    moves = {row[2]["opponent_move"] for seed in range(12) for row in episode(DuelEnv(**SHORT), seed)[1:]}
    assert len(moves) == 4
    careful = Careful()
    assert episode(DuelEnv(opponent=careful, **SHORT), 4)[1][2]["opponent_move"] == 2
    assert set(careful.asked) == {((1, 25), True)}


def test_a_mixture_is_drawn_by_weight():
    envs = DuelVectorEnv(60, opponent=[(1, "random-moves"), (3, "never-switch")], step_seconds=0.2, moves=1)
    drawn = envs.reset(seed=0)[1]["opponent"].tolist()
    assert 34 < drawn.count(1) < 56


def test_in_self_play_the_rows_of_a_pair_are_the_two_cars():
    envs = SelfPlayVectorEnv(6, autoreset_mode="SAME_STEP", **SHORT)
    seen, info = envs.reset(seed=2)
    assert seen.shape == (6, 25)
    np.testing.assert_allclose(info["lead"][::2], -info["lead"][1::2])
    for _ in range(3):
        seen, rewards, terminated, _, info = envs.step(np.array([0, 1, 2, 3, 0, 1]))
        np.testing.assert_array_equal(rewards[::2], -rewards[1::2])
        np.testing.assert_array_equal(terminated[::2], terminated[1::2])
    assert info["final_info"]["move"][1] == 1
    assert envs.action_masks().shape == (6, 4)


def test_masks_rule_out_moves_that_lead_to_the_same_place():
    env = DuelEnv(mask_duplicates=True, epsilon=2.0, **SHORT)
    _, info = env.reset(seed=0)
    assert env.action_masks().dtype == np.bool_
    np.testing.assert_array_equal(info["action_mask"], env.action_masks())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"opponent": None}, "opponent is None"),
        ({"opponent": 5}, "5 is not a competitor"),
        ({"opponent": []}, "empty"),
        ({"opponent": [(1, 2, "random-moves")]}, "opponent 0"),
        ({"opponent": [(-1.0, "random-moves")]}, "weight of opponent 0 is -1.0"),
        ({"opponent": [(1, "lane-switcher:3"), (1, "random-moves")]}, "drive with planners"),
        ({"epsilon": -1.0}, "epsilon is -1.0"),
        ({"render_mode": "ansi"}, "render_mode is 'ansi'"),
    ],
)
def test_impossible_arguments_are_named(arguments, message):
    for kind in (DuelEnv, DuelVectorEnv):
        with pytest.raises(InputError, match=message):
            kind(**arguments)


def test_unknown_names_are_named():
    for arguments in ({"opponent": "nobody"}, {"opponent": "always-left"}, {"track": "nowhere"}, {"archive": "none"}):
        with pytest.raises(UnknownNameError, match=r"nobody|always-left|nowhere|none"):
            DuelEnv(**arguments)
    with pytest.raises(InputError, match="num_envs is 3"):
        SelfPlayVectorEnv(3)
    assert SelfPlayVectorEnv(**SHORT).num_envs == 2


def test_impossible_actions_are_refused():
    env = DuelEnv(**SHORT)
    with pytest.raises(InputError, match="not begun"):
        env.step(0)
    env.reset(seed=0)
    for action in (4, -1, 0.5, np.nan, None, "left", [0, 1]):
        with pytest.raises(InputError, match="move"):
            env.step(action)
    envs = DuelVectorEnv(3, **SHORT)
    with pytest.raises(InputError, match="not begun"):
        envs.step(np.zeros(3, int))
    envs.reset(seed=0)
    with pytest.raises(InputError, match="environment 1: move 9"):
        envs.step(np.array([0, 9, 0]))
    wrong = DuelEnv(opponent=wrong_move, **SHORT)
    wrong.reset(seed=0)
    with pytest.raises(InputError, match="competitor 'wrong': game 0: move 7"):
        wrong.step(0)


def wrong_move(observation, generator):
    return 7


wrong_move.__name__ = "wrong"


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
    env = DuelEnv(opponent=Chooses((np.array([4]), None)), **rules, **SHORT)
    env.reset(seed=0)
    before = env.batch.state.policy[0, 1]
    env.step(0)
    assert env.outcome()["opponent_move"] == "stay"
    assert env.batch.state.policy[0, 1] == before
    assert env.action_space.n == (5 if rules else 4)
    if not rules:
        with pytest.raises(InputError, match=r"move 4 .*0 to 3"):
            env.step(4)


def test_a_model_of_a_game_with_more_moves_is_refused_when_the_environment_is_made():
    for kind in (DuelEnv, DuelVectorEnv):
        with pytest.raises(InputError, match="'Chooses' has 8 moves"):
            kind(opponent=Chooses((np.array([0]), None), moves=8), **SHORT)
    DuelEnv(opponent=Chooses((np.array([0]), None), moves=5), **SHORT)  # the fifth is to stay
    DuelEnv(opponent=Chooses((np.array([0]), None), moves=4), stay=True, **SHORT)  # it never stays


@pytest.mark.parametrize("answer", [(np.array([0, 1]), None), np.array([0]), None, ([[0], [1, 2]], None), 3])
def test_what_a_model_answers_is_checked(answer):
    env = DuelEnv(opponent=Chooses(answer), **SHORT)
    env.reset(seed=0)
    with pytest.raises(InputError, match="'Chooses': predict returned"):
        env.step(0)


def test_what_a_function_answers_is_checked():
    env = DuelEnv(opponent=lambda observation, generator: [[0], [1, 2]], **SHORT)
    env.reset(seed=0)
    with pytest.raises(InputError, match="moves are"):
        env.step(0)


def test_after_the_end_comes_a_reset():
    env = DuelEnv(**SHORT)
    episode(env, 1)
    with pytest.raises(InputError, match="has ended"):
        env.step(0)
    env.reset()
    env.step(0)


def test_a_frame_shows_the_game():
    env = DuelEnv(render_mode="rgb_array", **SHORT)
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (640, 960, 3)
    for colour in [(21, 89, 176), (148, 89, 0)]:  # of the names of both cars
        assert (np.abs(first.astype(int) - colour).sum(axis=-1) < 9).sum() > 20
    env.step(0)
    assert (env.render() != first).any()
    env.close()


def test_a_window_follows_the_game(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    shown = []
    monkeypatch.setattr("pcs_racing.race.rendering.Renderer._show", lambda self, frame: shown.append(frame))
    env = DuelEnv(render_mode="human", **SHORT)
    env.reset(seed=0)
    env.step(0)
    assert len(shown) == 1 + 7  # the start, then a frame for each 0.16 s of a step of 1 s
    assert (shown[0] != shown[1]).any()
    env.close()
    with pytest.raises(InputError, match="render_mode is None"):
        DuelEnv(**SHORT).render()


def test_a_policy_object_races_as_its_text_does():
    policy = get_planner("lattice").policy({"pace": 0.9})
    env = DuelEnv(opponent=policy, **SHORT)
    assert [opponent.name for opponent in env.opponents] == [policy.name]
    for mine, theirs in zip(episode(env, 4), episode(DuelEnv(opponent="lattice:pace=0.9", **SHORT), 4), strict=True):
        np.testing.assert_array_equal(mine[0], theirs[0])


def test_states_of_something_else_are_refused():
    envs = DuelVectorEnv(2, **SHORT)
    envs.reset(seed=0)
    seen = envs.set_state(envs.get_state())
    other = DuelVectorEnv(2, step_seconds=1.0, moves=2)
    other.reset(seed=0)
    more = DuelVectorEnv(3, **SHORT)
    more.reset(seed=0)
    for wrong, message in (
        ("yesterday", "state is a str; it must be what get_state returned"),
        (other.get_state(), "belongs to another archive, planner or number of moves"),
        (more.get_state(), "the state is not one of 2 games"),
    ):
        with pytest.raises(InputError, match=message):
            envs.set_state(wrong)
    np.testing.assert_array_equal(envs.set_state(envs.get_state()), seen)
    with pytest.raises(InputError, match="state is a str"):
        DuelEnv(**SHORT).set_state("yesterday")


def test_in_self_play_there_is_no_other_opponent():
    with pytest.raises(InputError, match="opponent is 'random-moves'"):
        SelfPlayVectorEnv(2, opponent="random-moves", **SHORT)


# Videos


@pytest.fixture
def videos(monkeypatch):
    """What would be written by moviepy: frames and their rate of each video."""
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
    env = gym.make("pcs_racing/Duel-v1", render_mode="rgb_array_list", render_size=(120, 80), **SHORT)
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
    assert len(frames) == pytest.approx(25 * info["time"], abs=2)  # with the first step, which was only watched
    assert all(frame.shape == (80, 120, 3) for frame in frames)
    changes = [(one != other).any() for one, other in itertools.pairwise(frames)]
    assert np.mean(changes) > 0.95


@pytest.mark.parametrize("seed", range(4))
def test_the_first_step_is_filmed_as_it_was_driven(seed):
    env = DuelEnv(render_mode="rgb_array_list", opponent="lane-switcher:3", randomize={"friction": [0.6, 1.0]}, **SHORT)
    for options in (None, {"start": (10.0, 1)}):
        env.reset(seed=seed, options=options)
        ((race, theta),) = env.batch.last_step(0).pieces
        assert race.tick == 0
        conditions = env.batch.variety.conditions(np.zeros(1, np.int64))
        advance(env.game.setup, race, theta, env.game.config.step_ticks, conditions=conditions)
        np.testing.assert_array_equal(race.cars, env.batch.state.race.cars)


def test_gymnasiums_function_films_a_whole_game(videos, monkeypatch, tmp_path):
    monkeypatch.delitem(sys.modules, "gymnasium.utils.save_video", raising=False)
    save_video = importlib.import_module("gymnasium.utils.save_video").save_video
    env = gym.make("pcs_racing/Duel-v1", render_mode="rgb_array_list", render_size=(120, 80), **SHORT)
    env.reset(seed=3)
    over = False
    while not over:
        *_, over, _, info = env.step(0)
    save_video(env.render(), str(tmp_path), fps=env.metadata["render_fps"])
    del sys.modules["gymnasium.utils.save_video"]  # it knows the clip above
    (frames, fps) = videos[0]
    assert fps == 25
    assert len(frames) == pytest.approx(25 * info["time"], abs=2)


def test_frames_are_those_since_the_last_ones():
    env = DuelEnv(render_mode="rgb_array_list", render_size=(120, 80), **SHORT)
    env.reset(seed=0)
    assert [frame.shape for frame in env.render()] == [(80, 120, 3)] * 25
    assert env.render() == []
    env.step(1)
    env.step(2)
    kept = env.get_state()
    frames = env.render()
    assert len(frames) == 50
    assert env.render() == []
    np.testing.assert_array_equal(
        env.get_state().batch[0].race.cars, kept.batch[0].race.cars
    )  # filming changes nothing
    env.step(1)
    env.reset(seed=1)
    assert len(env.render()) == 25  # a reset forgets what was not asked for
    env.set_state(kept)
    assert len(env.render()) == 1  # of a value nothing is known but the moment
    still = DuelEnv(render_mode="rgb_array", render_size=(120, 80), **SHORT)
    still.reset(seed=0)
    still.step(1)
    assert still.render().shape == (80, 120, 3)
    with pytest.raises(InputError, match="render_mode"):
        DuelEnv(render_mode="ansi", **SHORT)


def test_gymnasiums_own_video_of_many_games_has_all_of_them(videos, tmp_path):
    envs = gym.make_vec("pcs_racing/Duel-v1", num_envs=2, render_mode="rgb_array", render_size=(120, 80), **SHORT)
    envs = vector_wrappers.RecordVideo(envs, str(tmp_path / "videos"), video_aspect_ratio=(3, 1))
    envs.reset(seed=0)
    for _ in range(2):
        envs.step(envs.action_space.sample())
    envs.close()
    (frames, fps) = videos[0]
    assert fps == 1
    assert [frame.shape for frame in frames] == [(80, 240, 3)] * 3
