"""Matches: a series of races against the same opponent, for one agent and for two."""

import numpy as np
import pytest
from faces import Counts, begun
from refusal import refused

from pcs_racing.envs.infos import Result
from pcs_racing.envs.match import MatchEnv, MatchVectorEnv, parallel_env
from pcs_racing.game.match import KEEP, MatchGame
from pcs_racing.game.observation import decode_match


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
        assert memory.lead[0, r] == pytest.approx(
            np.clip(row[3]["lead"] / 20.0, -5.0, 5.0), abs=1e-6
        )
        assert (
            row[1]
            == memory.score[0, r]
            == {Result.WIN: 1.0, Result.TIE: 0.5}.get(row[3]["race_result"], 0.0)
        )
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


@pytest.mark.parametrize(("race", "crashed"), [("paper", [0.0, 0.0]), ("contest", [0.0, 1.0])])
def test_what_is_kept_of_a_race_that_has_ended(short, race, crashed):
    """By hand, for a win, a loss, a tie, a crash in the second step, and a race that goes on."""
    game = MatchEnv(**{**short, "race": race}).game
    match, ends = MatchGame(game, 2), game.config.end_ticks
    state = match.begin(np.arange(5, dtype=np.uint64), sides=[0, 1, 0, 1, 0])
    assert ends.tolist() == [50, 100]
    assert state.sides.tolist() == [[0, 1], [1, 0]] * 2 + [[0, 1]]
    front = [[1.0, 0.0], [0.0, 1.0]] * 2 + [[1.0, 0.0]]
    assert match.memory(state)[:, :, -1].tolist() == front
    state.game.race.tick[:] = [100, 100, 100, 60, 60]
    state.game.step[:] = [1, 1, 1, 1, 0]
    state.game.race.progress[:] = [[9.0, 4.0], [4.0, 6.0], [5.0, 5.0], [8.0, 2.0], [8.0, 2.0]]
    state.game.race.crash[3], state.game.race.fault[3] = [1, 0], [1, 0]
    draw = np.random.default_rng(0)
    for array in (state.game.own, state.game.estimates):
        array[:] = draw.random(array.shape)
    state.racing[:] = True
    assert not match.memory(state)[:, :, -1].any()
    after = match.move(state, np.zeros((5, 2), np.int64), np.arange(4))
    assert after.race.tolist() == [1, 1, 1, 1, 0]
    assert after.racing.tolist() == [False, False, False, False, True]
    assert after.scores[:, :, 0].tolist() == [
        [1.0, 0.0],
        [0.0, 1.0],
        [0.5, 0.5],
        crashed,
        [0.0, 0.0],
    ]
    np.testing.assert_array_equal(match.reward(state, after), after.scores[:, :, 0])
    assert match.reward(after, after).tolist() == [[0.0, 0.0]] * 5
    np.testing.assert_allclose(after.leads[:, 0], [5.0, -2.0, 0.0, 6.0, 0.0])
    np.testing.assert_allclose(after.driven[:, 0], [1.0, 1.0, 1.0, 0.6, 0.0])
    shares = np.array([[0.5, 0.5]] * 3 + [[50.0 / 60.0, 10.0 / 60.0], [0.0, 0.0]])
    for kept, steps in ((after.own, state.game.own), (after.measured, state.game.estimates)):
        np.testing.assert_allclose(kept[:, :, 0], np.einsum("mcsg,ms->mcg", steps, shares))
        assert not kept[:, :, 1].any()
    # The places on the grid have swapped for the second race; who races has none, nor has a match
    # that is over.
    assert match.memory(after)[:4, :, -1].tolist() == [pair[::-1] for pair in front[:4]]
    assert not match.memory(after)[4, :, -1].any()
    after.race[:2] = 2
    assert match.done(after).tolist() == [True, True, False, False, False]
    assert not match.memory(after)[:2, :, -1].any()
    assert match.start(after, np.full((5, 2), KEEP), np.array([0, 4])).racing.tolist() == [
        False
    ] * 4 + [True]


def test_a_faster_policy_wins_and_the_result_is_that_of_the_match(short):
    made = MatchEnv(opponent="lattice:pace=0.1", **{**short, "step_seconds": 8.0})
    assert play(made, 10, [5, 5, 5])[-1][3]["score"] == 3.0
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
    drivers = MatchVectorEnv(
        20, opponent=["never-switch", "random-moves", "always-aggressiveness +"], **short
    )
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


@pytest.mark.parametrize(
    ("answer", "message"), [([9], "choice holds 9"), ([0.5], "float64"), ([0, 1], r"shape \(2,\)")]
)
def test_what_a_chooser_answers_is_checked(short, answer, message):
    class Chooses:
        def choose(self, observation):
            return np.array(answer)

    made = begun(MatchEnv(opponent=Chooses(), **short), seed=0)
    refused(message, made.step, 0)


def test_moves_within_the_races(short):
    made = MatchEnv(race_moves=True, opponent="never-switch", **{**short, "moves": 2, "stay": True})
    assert made.action_space.n == 6 + 5
    _, info = made.reset(seed=2)
    assert info["action_mask"].tolist() == [1] * 6 + [0] * 5
    seen, reward, _, _, info = made.step(2)
    racing = [element.name for element in made.elements].index("racing")
    assert (seen[racing], reward, info["race"], info["policy"]) == (1.0, 0.0, 0, 2)
    np.testing.assert_array_equal(seen[racing + 1 :], made.game.observation(made.batch.state)[0, 0])
    assert (
        info["action_mask"].tolist()
        == [0] * 6 + made.game.action_mask(made.batch.played.game)[0, 0].tolist()
    )
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
    plain = begun(MatchEnv(opponent="random-moves", **short), seed=4)
    moving = begun(
        MatchEnv(opponent="random-moves", race_moves=True, **{**short, "stay": True}), seed=4
    )
    for choice in (1, 5, 3):
        seen, reward, over, _, _ = plain.step(choice)
        moved, paid, ended, _, info = moving.step(choice)
        while info["action_mask"][-1]:
            moved, paid, ended, _, info = moving.step(10)
        np.testing.assert_array_equal(moved[: len(seen)], seen)
        assert (paid, ended) == (reward, over)


def test_reset_options(short):
    made = MatchEnv(opponent="random-moves", **short)
    made.reset(seed=0, options={"policies": (2, 5), "start": (20.0, 1)})
    played = made.batch.played
    assert played.policy.tolist() == [[2, 5]]
    assert played.starts.tolist() == [[20.0] * 3]
    assert played.sides.tolist() == [[1, 0, 1]]


def test_two_agents_see_the_same_match_from_both_sides(short):
    both = parallel_env(**short)
    observations, _ = both.reset(seed=5)
    assert observations["car_0"][22] + observations["car_1"][22] == 1.0
    total = {"car_0": 0.0, "car_1": 0.0}
    for choices in ((0, 5), (5, 0), (3, 3)):
        observations, rewards, terminated, _, infos = both.step(
            dict(zip(total, choices, strict=True))
        )
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
