"""Matches: a series of races against the same opponent, for one agent and for two."""

import inspect
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pcs_racing import ConfigError, InputError
from pcs_racing.envs.infos import Result
from pcs_racing.envs.match import (
    HeadToHeadMatchEnv,
    MatchEnv,
    MatchVectorEnv,
    SelfPlayMatchVectorEnv,
    parallel_env,
)
from pcs_racing.game.match_observation import decode_match


class Counts:
    """A chooser that takes policy 0 before the first race, 1 before the second, and so on."""

    def choose(self, observation):
        driven = decode_match(observation, 3, 2).driven
        return (driven > 0.0).sum(axis=1)


def play(made, seed, actions):
    """Observations, rewards and infos of a match."""
    rows = [made.reset(seed=seed)]
    for action in actions:
        seen, reward, terminated, truncated, info = made.step(action)
        rows.append((seen, reward, terminated, info))
        assert not truncated
        if terminated:
            break
    return rows


def test_the_specification_counts_the_steps_of_a_match(short):
    assert gym.make_vec("pcs_racing/Match-v0", num_envs=3, **short).spec.max_episode_steps == 3
    assert gym.make("pcs_racing/Match-v0", races=2, race_moves=True, **short).spec.max_episode_steps == 4


# What a match is


def test_the_table_of_its_page_is_its_space():
    made = MatchEnv()
    rows = re.findall(
        r"^\| (7r|21|22)(?: \+ (\d))? \| (\w+) \| ([\w ]+) \| (\S+) \| (\S+) \|$", inspect.getdoc(MatchEnv), re.M
    )
    assert len(rows) == 9
    for start, offset, name, unit, low, high in rows:
        for r in range(3 if start == "7r" else 1):
            element = made.elements[7 * r + int(offset or 0) if start == "7r" else int(start)]
            wanted = name.replace("_r_", f"_{r}_", 1) if start == "7r" else name
            assert (element.name, element.unit) == (wanted, unit)
            assert (element.low, element.high) == (float(low), float(high))
    assert made.observation_space.shape == (23,)


@pytest.mark.parametrize("kind", [MatchEnv, HeadToHeadMatchEnv])
def test_the_class_names_its_arguments(kind):
    text = inspect.getdoc(kind)
    for name in inspect.signature(kind).parameters:
        assert name in text or name == "settings", name


def test_a_match_remembers_its_races(short):
    """Every race is the one that the choices and the rules of the races make."""
    made = MatchEnv(opponent="lattice:pace=0.6", **short)
    rows = play(made, 3, [4, 0, 5])
    played, game = made.batch.played, made.game
    assert [row[2] for row in rows[1:]] == [False, False, True]
    assert played.sides[0].tolist() in ([0, 1, 0], [1, 0, 1])
    assert len(set(played.starts[0].tolist())) > 1
    memory = decode_match(rows[-1][0][None], 3, 2)
    for r, (choice, row) in enumerate(zip([4, 0, 5], rows[1:], strict=True)):
        np.testing.assert_allclose(memory.own[0, r], game.points[choice], atol=1e-6)
        assert memory.lead[0, r] == pytest.approx(np.clip(row[3]["lead"] / 20.0, -5.0, 5.0), abs=1e-6)
        assert row[1] == memory.score[0, r] == {Result.WIN: 1.0, Result.TIE: 0.5}.get(row[3]["race_result"], 0.0)
        assert row[3]["policy"] == choice
        assert row[3]["race"] == r + 1
        assert memory.driven[0, r] == pytest.approx(row[3]["time"])  # of a race of one second
        assert row[0][21] == pytest.approx((2 - r) / 3)
        earlier = decode_match(row[0][None], 3, 2)
        assert (earlier.driven[0] > 0.0).tolist() == [True] * (r + 1) + [False] * (2 - r)
    assert memory.opponent[0].std(axis=0).max() > 0.0  # measured, not known
    assert rows[-1][3]["score"] == sum(row[1] for row in rows[1:])
    assert rows[-1][0][22] == 0.0
    assert rows[0][0][22] == (played.sides[0, 0] == 0)


def test_a_faster_policy_wins_and_the_result_is_that_of_the_match(short):
    made = MatchEnv(opponent="lattice:pace=0.1", **{**short, "step_seconds": 4.0})
    last = play(made, 1, [5, 5, 5])[-1]
    assert last[3]["score"] == 3.0
    assert made.outcome()["result"] == "win"
    slow = MatchEnv(opponent="lattice:pace=0.9", **{**short, "step_seconds": 4.0})
    play(slow, 1, [0, 0, 0])
    assert slow.outcome()["result"] == "loss"
    assert slow.outcome()["opponent_score"] >= 2.0  # it may leave the track once


def test_a_crash_ends_a_race_and_not_the_match(short):
    """A policy that is much too fast leaves the track; the next race is driven nevertheless."""
    made = MatchEnv(opponent="never-switch", **{**short, "step_seconds": 8.0, "moves": 4})
    for seed in range(20):
        rows = play(made, seed, [5, 5, 5])
        crashed = [row[3]["crash"] or row[3]["opponent_crash"] for row in rows[1:]]
        assert len(rows) == 4
        if any(crashed[:2]):
            break
    else:
        pytest.fail("no crash in 20 matches")
    memory = decode_match(rows[-1][0][None], 3, 2)
    assert ((memory.driven[0] < 1.0) == np.array(crashed, bool)).all()
    assert (memory.driven > 0.0).all()


def test_the_opponent_stays_the_same_for_a_match(short):
    drivers = MatchVectorEnv(20, opponent=["never-switch", "random-moves", "always-aggressiveness +"], **short)
    _, info = drivers.reset(seed=0)
    drawn, theta = info["opponent"], drivers.batch.played.theta[:, 1].copy()
    assert set(drawn.tolist()) == {0, 1, 2}
    start = drivers.batch.played.policy[:, 1].copy()
    for _ in range(3):
        info = drivers.step(np.zeros(20, int))[4]
        np.testing.assert_array_equal(info["opponent"], drawn)
        np.testing.assert_array_equal(drivers.batch.played.theta[:, 1], theta)
        np.testing.assert_array_equal(drivers.batch.played.policy[:, 1], start)
    assert (start[drawn == 0] == -1).all()
    assert (start[drawn == 2] >= 0).all()
    assert (info["opponent_move"][drawn == 2] == 0).all()


def test_an_opponent_may_choose(short):
    made = MatchEnv(opponent=Counts(), **short)
    made.reset(seed=0)
    for r in range(3):
        made.step(3)
        assert made.batch.state.policy[0].tolist() == [3, r]


@pytest.mark.parametrize(("answer", "message"), [([9], "policy 9"), ([0.5], "float64"), ([0, 1], r"shape \(2,\)")])
def test_what_a_chooser_answers_is_checked(short, answer, message):
    class Chooses:
        def choose(self, observation):
            return np.array(answer)

    made = MatchEnv(opponent=Chooses(), **short)
    made.reset(seed=0)
    with pytest.raises(InputError, match=message):
        made.step(0)


# The moves of the races


def test_moves_within_the_races(short):
    made = MatchEnv(race_moves=True, opponent="never-switch", **{**short, "moves": 2, "stay": True})
    assert made.action_space.n == 6 + 5
    _, info = made.reset(seed=2)
    assert info["action_mask"].tolist() == [1] * 6 + [0] * 5
    seen, reward, _, _, info = made.step(2)
    racing = [element.name for element in made.elements].index("racing")
    assert (seen[racing], reward, info["race"], info["policy"]) == (1.0, 0.0, 0, 2)
    np.testing.assert_array_equal(seen[racing + 1 :], made.game.observation(made.batch.state)[0, 0])
    assert info["action_mask"].tolist() == [0] * 6 + [1] * 5
    np.testing.assert_array_equal(made.action_masks(), info["action_mask"])
    info = made.step(6)[4]  # the first move
    assert info["policy"] == made.game.table[2, 0]
    assert made.outcome()["move"] == "aggressiveness +"
    seen, reward, _, _, info = made.step(1)  # a policy is no move: nothing changes
    assert info["policy"] == made.game.table[2, 0]
    assert (seen[racing], info["race"]) == (0.0, 1)
    assert not seen[racing + 1 :].any()
    info = made.step(6)[4]  # a move is no policy: it starts as it started before
    assert info["policy"] == 2


def test_without_moves_the_races_are_the_same(short):
    """Whoever stays in every race has the match of one who only chooses."""
    plain = MatchEnv(opponent="random-moves", **short)
    moving = MatchEnv(opponent="random-moves", race_moves=True, **{**short, "stay": True})
    plain.reset(seed=4)
    moving.reset(seed=4)
    for choice in (1, 5, 3):
        seen, reward, over, _, _ = plain.step(choice)
        moved, paid, ended, _, info = moving.step(choice)
        while info["action_mask"][-1]:
            moved, paid, ended, _, info = moving.step(10)
        np.testing.assert_array_equal(moved[: len(seen)], seen)
        assert (paid, ended) == (reward, over)


# Scalar and vector


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_all_autoreset_modes(short, mode):
    envs = MatchVectorEnv(3, autoreset_mode=mode, races=2, **short)
    first, _ = envs.reset(seed=0)
    envs.step(np.zeros(3, int))
    seen, rewards, terminated, _, info = envs.step(np.zeros(3, int))
    assert terminated.all()
    if mode is AutoresetMode.DISABLED:
        with pytest.raises(InputError, match="has ended"):
            envs.step(np.zeros(3, int))
        seen, info = envs.reset(options={"reset_mask": np.array([True, False, True])})
        assert info["race"].tolist() == [0, 2, 0]
    elif mode is AutoresetMode.NEXT_STEP:
        assert info["race"].tolist() == [2, 2, 2]
        seen, rewards, terminated, _, info = envs.step(np.zeros(3, int))
        assert not terminated.any()
        assert not rewards.any()
        assert info["race"].tolist() == [0, 0, 0]
    else:
        assert info["race"].tolist() == [0, 0, 0]
        assert info["final_info"]["race"].tolist() == [2, 2, 2]
    assert envs.observation_space.contains(seen)
    assert first.shape == seen.shape


# As a value


def test_a_reset_can_continue_from_a_state(short):
    made = MatchEnv(**short)
    made.reset(seed=1)
    seen = made.step(2)[0]
    state = made.get_state()
    expected = made.step(3)
    made.reset(seed=2)
    np.testing.assert_array_equal(made.reset(options={"state": state})[0], seen)
    np.testing.assert_array_equal(made.step(3)[0], expected[0])


def test_states_of_something_else_are_refused(short):
    made = MatchEnv(**short)
    made.reset(seed=0)
    kept = made.get_state()
    for other, message in ((MatchEnv(races=2, **short), "another number of races"), (MatchEnv(), "it must be")):
        other.reset(seed=0)
        with pytest.raises(InputError, match=message):
            made.set_state(other.get_state())
    with pytest.raises(InputError, match="of 1 matches"):
        made.set_state(kept._replace(batch=("yesterday", *kept.batch[1:])))
    np.testing.assert_array_equal(made.set_state(kept), made.reset(options={"state": kept})[0])


def test_reset_options(short):
    made = MatchEnv(opponent="random-moves", **short)
    made.reset(seed=0, options={"policies": (2, 5), "start": (20.0, 1)})
    played = made.batch.played
    assert played.policy.tolist() == [[2, 5]]
    assert played.starts.tolist() == [[20.0] * 3]
    assert played.sides.tolist() == [[1, 0, 1]]
    made.reset(seed=3, options={"track": "Tarnfjord", "opponent": "never-switch"})
    made.step(0)
    fresh = MatchEnv(**{**short, "track": "Tarnfjord"})
    fresh.reset(seed=3)
    fresh.step(0)
    np.testing.assert_array_equal(made.get_state().batch[0].leads, fresh.get_state().batch[0].leads)


# Two agents


def test_two_agents_see_the_same_match_from_both_sides(short):
    both = parallel_env(**short)
    observations, _ = both.reset(seed=5)
    assert observations["car_0"][22] + observations["car_1"][22] == 1.0
    total = {"car_0": 0.0, "car_1": 0.0}
    for choices in ((0, 5), (5, 0), (3, 3)):
        observations, rewards, terminated, _, infos = both.step(dict(zip(total, choices, strict=True)))
        for agent in total:
            total[agent] += rewards[agent]
            assert infos[agent]["score"] == total[agent]
        assert sum(rewards.values()) in (0.0, 1.0)
    assert terminated == {"car_0": True, "car_1": True}
    assert both.agents == []
    first, second = (decode_match(observations[agent][None], 3, 2) for agent in total)
    np.testing.assert_array_equal(first.lead, -second.lead)
    np.testing.assert_array_equal(first.driven, second.driven)
    np.testing.assert_allclose(second.own[0], both.game.points[[5, 0, 3]], atol=1e-6)
    assert total["car_0"] == infos["car_1"]["opponent_score"]


def test_the_twin_is_the_match_of_one_agent(short):
    one, two = MatchEnv(opponent="lattice:pace=0.5", **short), parallel_env(opponent="lattice:pace=0.5", **short)
    np.testing.assert_array_equal(one.reset(seed=6)[0], two.reset(seed=6)[0]["car_0"])
    for choice in (1, 2, 3):
        seen, reward, *_ = one.step(choice)
        observations, rewards, *_ = two.step({"car_0": choice})
        np.testing.assert_array_equal(seen, observations["car_0"])
        assert rewards["car_0"] == reward


def test_frames_show_the_whole_race(short):
    both = parallel_env(render_mode="rgb_array", render_size=(120, 80), **short)
    both.reset(seed=0)
    first = both.render()
    both.step({"car_0": 5, "car_1": 0})
    frames = list(both.frames())
    assert len(frames) == 26  # a race of a second, in two steps of half a second
    assert (frames[-1] != first).any()
    both.close()


# Bad input


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"races": 0}, ConfigError, "races is 0"),
        ({"race_moves": 2}, ConfigError, "race_moves is 2"),
        ({"utility": "win"}, InputError, r"^utility"),
        ({"discount": 0.9}, InputError, "discount does not count"),
        ({"opponent": 5}, InputError, "5 is not a competitor"),
        ({"rases": 3}, TypeError, "did you mean 'races'"),
    ],
)
def test_impossible_arguments_are_named(arguments, error, message):
    for kind in (MatchEnv, MatchVectorEnv, HeadToHeadMatchEnv):
        with pytest.raises(error, match=message):
            kind(**arguments)


def test_impossible_actions_are_refused(short):
    made = MatchEnv(**short)
    with pytest.raises(InputError, match="not begun"):
        made.step(0)
    made.reset(seed=0)
    for action in (6, -1, 0.5, np.nan, None, "left", [0, 1]):
        with pytest.raises(InputError, match="move"):
            made.step(action)
    with pytest.raises(InputError, match="reset option 'moves' is unknown"):
        made.reset(options={"moves": 3})
    envs = MatchVectorEnv(2, **short)
    envs.reset(seed=0)
    with pytest.raises(InputError, match="environment 1: move 7"):
        envs.step(np.array([0, 7]))


def test_in_self_play_the_rows_of_a_pair_are_the_two_players_of_a_match(short):
    envs = SelfPlayMatchVectorEnv(4, autoreset_mode="DISABLED", races=2, **short)
    both = [HeadToHeadMatchEnv(races=2, **short) for _ in range(2)]
    seen, _ = envs.reset(seed=5)
    pairs = [each.reset(seed=5 + i)[0] for i, each in enumerate(both)]
    actions = np.array([0, 5, 3, 1])
    for last in (False, True):
        np.testing.assert_array_equal(seen, [pair[agent] for pair in pairs for agent in ("car_0", "car_1")])
        seen, rewards, terminated, _, _ = envs.step(actions)
        steps = [each.step({"car_0": actions[2 * i], "car_1": actions[2 * i + 1]}) for i, each in enumerate(both)]
        pairs = [step[0] for step in steps]
        assert rewards.tolist() == [step[1][agent] for step in steps for agent in ("car_0", "car_1")]
        assert terminated.tolist() == [last] * 4
    assert envs.action_masks().shape == (4, 6)


def test_in_self_play_there_is_no_opponent(short):
    with pytest.raises(InputError, match="never-switch"):
        SelfPlayMatchVectorEnv(2, opponent="never-switch", **short)
    with pytest.raises(InputError, match="num_envs is 3"):
        SelfPlayMatchVectorEnv(3, **short)
