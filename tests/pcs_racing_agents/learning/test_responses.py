import numpy as np
import pytest
from long_jobs import files
from random_layers import random_layers
from refusal import refused

from pcs_racing import make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.players import always, never_switch, random_moves
from pcs_racing.race.config import load_rules
from pcs_racing_agents import make
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.learning import responses
from pcs_racing_agents.learning.branches import branch_games, branched_rows, game_blocks, outcome
from pcs_racing_agents.learning.responses import (
    ResponseSettings,
    learn_psro,
    learn_response,
    load_psro_settings,
    load_response_settings,
    mean_network,
)
from pcs_racing_agents.learning.self_play import load_self_play_settings
from pcs_racing_agents.networks import RegretNetwork
from pcs_racing_agents.tournament.games import game_between


@pytest.fixture(scope="module")
def spec():
    return make_game(None, "default", load_rules("paper", steps=(2.0,) * 3))


@pytest.fixture(scope="module")
def game(spec):
    return make_game("Tarnfjord", spec.archive, spec.rules, stay=True)


def test_a_branch_is_what_comes_of_playing_its_moves(game, spec):
    keys = race_seeds(3, 4)
    stay = never_switch(spec)
    result = branch_games(game, random_moves(spec, seed=1), keys, 1, [stay], stay, payoff="utility")
    # The same by hand: stay, then the move, against the same opponent.
    rival = random_moves(spec, seed=1)
    for move in range(game.offered):
        state = game.reset(keys)
        for own_move in (game.offered - 1, move):
            reply = rival.act(game.observation(state)[:, 1])
            state = game.step(state, np.stack([np.full(4, own_move), reply], axis=1))
        np.testing.assert_array_equal(result.outcomes[:, move], game.reward(state)[result.game, 0])


def test_moves_that_lead_to_the_same_policy_are_driven_once(game, spec):
    asked = []

    class Stays:
        name = "stays"

        def act(self, observations, turn):
            asked.append(len(observations))
            return np.full(len(observations), turn.stay)

    keys, stay = race_seeds(3, 60), never_switch(spec)
    result = branch_games(game, stay, keys, 0, [stay], Stays(), payoff="utility")
    after = game.table[game.reset(keys).policy[:, :1], np.arange(game.offered)][result.game]
    assert asked[0] <= sum(len(np.unique(policies)) for policies in after) < after.size
    for policies, outcomes in zip(after, result.outcomes, strict=True):
        for policy in np.unique(policies):
            assert len(np.unique(outcomes[policies == policy])) == 1


def test_branches_do_not_depend_on_the_batch_and_a_fixed_policy_may_be_the_opponent(game, spec):
    keys = race_seeds(5, 6)
    rest = ([random_moves(spec), never_switch(spec)], always(spec, "restraint +"))
    rival = random_moves(spec, seed=2)
    whole = branch_games(game, rival, keys, 1, *rest)
    parts = [branch_games(game, rival, keys[k : k + 2], 1, *rest) for k in (0, 2, 4)]
    np.testing.assert_array_equal(
        whole.outcomes, np.concatenate([piece.outcomes for piece in parts])
    )
    np.testing.assert_array_equal(
        whole.observations, np.concatenate([piece.observations for piece in parts])
    )
    rival = make("lane-switcher")
    game = game_between(game, never_switch(spec), rival)
    result = branch_games(
        game, rival, race_seeds(0, 3), 0, [never_switch(spec)], never_switch(spec)
    )
    assert np.isin(result.outcomes, (0.0, 0.5, 1.0)).all()
    # By hand: each key chooses the opponent's policy.
    chosen = [rival.policies[int(key) % len(rival.policies)] for key in race_seeds(0, 3)]
    for move in range(game.offered):
        state = game.reset(race_seeds(0, 3), opponents=chosen)
        for own_move in (move, game.offered - 1):
            state = game.step(state, np.stack([np.full(3, own_move), np.zeros(3, int)], axis=1))
        np.testing.assert_array_equal(result.outcomes[:, move], outcome(game, state)[result.game])


def test_rows_of_blocks_depend_on_their_place_and_number_alone(tmp_path):
    blocks = game_blocks(3, (1, 2, 5, 7), 600)
    assert [(one.place, one.first, len(one.keys)) for one in blocks] == [
        ((1, 2, 5, 7), k, min(256, 600 - k)) for k in (0, 256, 512)
    ]
    keys = np.concatenate([block.keys for block in blocks])
    assert len(np.unique(keys)) == 600
    np.testing.assert_array_equal(keys[:9], game_blocks(3, (1, 2, 5, 7), 9)[0].keys)
    others = (game_blocks(4, (1, 2), 1), game_blocks(3, (2, 1), 1), game_blocks(3, (1,), 1), blocks)
    assert len({one[0].keys[0] for one in others}) == 4

    def branch(block):
        running = np.array([4, 7]) if block.first else np.zeros(0, int)
        return {
            "observations": np.ones((len(running), 3)),
            "advantages": np.tile([0.5, 0.0], (len(running), 1)),
            "game": running,
        }

    with open_job(tmp_path / "job", "response", {}) as job:
        first, second = branched_rows(job, "some", branch, blocks, 0.25)
        (alone,) = branched_rows(job, "other", branch, game_blocks(3, (4, 5, 7), 300))
    assert (first.pair - ((7 * 100 + 5) * 1000 + 52) * 10**6).tolist() == [260, 263]
    assert (first.step.tolist(), first.weights.tolist()) == ([5] * 2, [0.25] * 2)
    assert (first.targets.dtype, first.targets.tolist()) == (np.float32, [[0.5, 0.0]] * 2)
    assert second.pair[0] - first.pair[0] == 256
    assert alone.weights.tolist() == [1.0, 1.0]
    assert alone.pair[0] // 10**6 == (7 * 100 + 5) * 1000 + 4


def test_a_response_is_learned_backwards_with_the_network_of_the_steps_behind(
    lesson, tmp_path, monkeypatch
):
    """Two rounds of two steps: who moves before and after each branch, what is learned, and by how
    many networks.
    """
    branched, fitted = [], []

    def branch(game, opponent, keys, step, behaviours, continuation, payoff, count):
        branched.append(
            (
                opponent.name,
                len(keys),
                step,
                [one.name for one in behaviours],
                continuation.name,
                payoff,
                count,
            )
        )
        return branch_games(game, opponent, keys, step, behaviours, continuation, payoff, count)

    def train(job, part, rows, identity, members, name, executor):
        fitted.append((part, [one.seed for one in members], rows))
        layers = random_layers(len(identity.elements), 4, len(identity.moves), seed=len(fitted))
        size = len(identity.elements)
        facts = {"rows": 3, "loss": 0.5}
        one = RegretNetwork(
            name, identity, "advantage", False, layers, np.zeros(size), np.ones(size), facts
        )
        return mean_network([one] * len(members))

    monkeypatch.setattr(responses, "branch_games", branch)
    monkeypatch.setattr(responses, "train_mean", train)
    games, pool, spec = lesson
    settings = ResponseSettings(starts=10, rounds=2, members=3, seed=5, worth="utility", epochs=7)
    with open_job(tmp_path / "job", "response", {}) as job:
        network = learn_response(
            games, pool, spec, settings, job, shares=[2, 1], name="mine", part="a-"
        )
    names, both = [opponent.name for opponent in pool], (["random-moves"], ["random-moves", "mine"])
    expected = []
    for k, (round_, step) in enumerate([(0, 1), (0, 0), (1, 1), (1, 0)]):
        after = "mine" if k else "random-moves"
        for name, count in zip(names, (7, 3), strict=True):
            expected.append((name, count, step, both[round_], after, "utility", 5))
        part, seeds, rows = fitted[k]
        assert (part, seeds) == (
            f"a-round-{round_}-step-{step}",
            [5 * 64 + i for i in range(3 if k == 3 else 2)],
        )
        assert (rows.weights == 1.0).all()
        assert len(set(rows.pair.tolist())) == len(rows) > len(fitted[k - 1][2]) * (k > 0)
        np.testing.assert_allclose(rows.targets.mean(axis=1), 0.0, atol=1e-5)
    assert branched == expected
    assert network.training == {
        "rows": len(fitted[3][2]),
        "worth": "utility",
        "loss": 0.5,
        "members": 3,
    }
    last = fitted[3][2]
    games_of = [last.pair // 1_000_000 == place for place in (100_000, 100_001)]
    assert [int(one.sum()) for one in games_of] == [7, 3]
    assert set(last.step[games_of[0]].tolist()) == {0}
    fit = settings.fit_settings(9)
    assert (fit.seed, fit.epochs, fit.patience, fit.batch_size) == (9, 7, 12, 512)
    assert (fit.learning_rate, fit.weight_decay, fit.rows_per_epoch) == (0.003, 0.001, 50_000)


def test_a_win_is_1_a_tie_a_half_and_a_crash_that_pays_neither_car_0(game):
    state = game.reset(games=4)
    state.race.progress[:, 0] = state.race.progress[:, 1] + [5.0, -5.0, 0.0, 5.0]
    state.race.crash[3, 1] = 1
    state.step[:] = game.rules.moves
    np.testing.assert_array_equal(outcome(game, state), [1.0, 0.0, 0.5, 0.0])
    np.testing.assert_array_equal(outcome(game, state, "utility"), game.reward(state)[:, 0])


def test_games_without_opponents_and_different_games_are_refused(game, spec, tmp_path):
    other = make_game("Tarnfjord", spec.archive, load_rules(spec.rules, steps=(2.0,) * 4))
    with open_job(tmp_path / "c", "response", {}) as job:
        refused("no opponent", learn_response, [game], [], spec, ResponseSettings(), job)
        refused("no game", learn_response, [], [never_switch(spec)], spec, ResponseSettings(), job)
        both = [game, other], [never_switch(spec)]
        refused("differs from the first", learn_response, *both, spec, ResponseSettings(), job)


def network(seed: int, hidden: tuple[int, ...] = (5, 4)) -> RegretNetwork:
    rng = np.random.default_rng(seed)
    game = GameIdentity(("a", "b", "c"), ("left", "right"), (0.35,), "toy", "0" * 64, "paper")
    layers = random_layers(3, *hidden, 2, seed=seed)
    mean, scale = rng.normal(size=3).astype(np.float32), rng.uniform(0.5, 2.0, 3).astype(np.float32)
    return RegretNetwork(f"net-{seed}", game, "advantage", False, layers, mean, scale)


@pytest.mark.parametrize("hidden", [(), (6,), (5, 4), (4, 3, 5)])
@pytest.mark.parametrize("count", [1, 3])
def test_the_mean_network_puts_out_the_mean_of_its_members(hidden, count):
    members = [network(seed, hidden) for seed in range(count)]
    x = np.random.default_rng(9).normal(size=(20, 3))
    merged = mean_network(members)
    np.testing.assert_allclose(merged(x), np.mean([m(x) for m in members], axis=0), atol=2e-5)
    assert (merged.name, merged.training) == ("net-0", {"members": count})


def test_networks_of_several_shapes_have_a_mean_too():
    members = [network(0, (5, 4)), network(1, (2, 7))]
    x = np.random.default_rng(9).normal(size=(20, 3))
    mean = np.mean([member(x) for member in members], axis=0)
    np.testing.assert_allclose(mean_network(members)(x), mean, atol=2e-5)


pytest.importorskip("torch", reason="torch is not installed")


def test_psro_plays_an_equilibrium_of_its_responses(lesson, learner, tmp_path):
    settings = load_psro_settings(rounds=3, races=20, learner=learner)
    with open_job(tmp_path / "one", "psro", {}) as job:
        networks = learn_psro(*lesson, settings, job)
    assert 1 <= len(networks.networks) <= 3
    assert networks.weights.sum() == pytest.approx(1.0)
    assert len({network.name for network in networks.networks}) == len(networks.networks)


def test_shares_divide_the_games(lesson, learner, tmp_path):
    settings = load_response_settings(learner)
    with open_job(tmp_path / "shares", "response", {}) as job:
        network = learn_response(*lesson, settings, job, shares=[3, 1])
        # At each of two steps; races that were over before give no row.
        assert settings.starts < network.training["rows"] <= 2 * settings.starts
        for shares in ([1.0], [0, 0], [1, -1], [1, np.nan]):
            refused("shares", learn_response, *lesson, settings, job, shares=shares)


GAME = ["--track", "Tarnfjord", "--duration", "2.5"]


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("response", "starts: 24\nrounds: 1\nmembers: 1\nhidden: [8]\nepochs: 4\n"),
        ("psro", "rounds: 2\nraces: 4\nlearner: {learner}\n"),
        ("self-play", "iterations: 2\nstarts: 8\nhidden: [8]\nepochs: 2\n"),
    ],
)
def test_the_command_learns_an_agent_that_races_and_again_after_a_stop(
    method, settings, learner, tmp_path, printed
):
    config = tmp_path / "settings.yaml"
    config.write_text(settings.format(learner=learner), encoding="utf-8")
    out = tmp_path / method
    command = ["train", method, *GAME, "--config", config, "--out", out]
    (last,) = [line for line in printed(*command).splitlines() if line.startswith("written: ")]
    agent = last.rpartition("race it as ")[2]
    printed("tournament", *GAME, "--agents", agent, "never-switch", "--races", 2)
    learned = files(out)
    for file in sorted((out / "chunks").glob("*.npz"))[::2]:
        file.unlink()
    printed(*command)
    assert files(out) == learned


def test_impossible_settings_are_refused():
    for load, change, message in [
        (load_response_settings, {"worth": "fame"}, "worth is 'fame'"),
        (load_response_settings, {"members": 0}, "members is 0"),
        (load_psro_settings, {"learner": "nobody"}, "'nobody' are unknown"),
        (load_psro_settings, {"rounds": 1}, "rounds is 1"),
        (load_self_play_settings, {"iterations": 0}, "iterations is 0"),
        (load_self_play_settings, {"weights": "square"}, "weights is 'square'"),
    ]:
        refused(message, load, **change)
