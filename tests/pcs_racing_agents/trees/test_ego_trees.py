from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError, UnknownNameError
from pcs_racing_agents.jobs.chunks import chunk_file, read_chunk, write_chunk
from pcs_racing_agents.jobs.executors import make_executor
from pcs_racing_agents.networks.from_ego import ego_rows, ego_values
from pcs_racing_agents.trees import build_ego_trees, load_ego_trees, play_ego
from pcs_racing_agents.trees import ego as _ego


@pytest.fixture(scope="module")
def trees(noisy):
    return play_ego(noisy, 6, seed=1)


def same(found, expected) -> None:
    assert found.arrays().keys() == expected.arrays().keys()
    for name, array in expected.arrays().items():
        np.testing.assert_array_equal(found.arrays()[name], array, err_msg=name, strict=True)


def uniform(observations: np.ndarray) -> np.ndarray:
    return np.full((len(observations), 5), 0.2)


@pytest.mark.parametrize("opponent", ["random", "static"])
def test_every_history_is_what_the_game_plays(noisy, opponent):
    """All 5 * 5 sequences of car 0 against the moves of car 1, played by the game itself; 4 keeps the policy."""
    trees = play_ego(noisy, 3, opponent=opponent, seed=2)
    assert (trees.replies == -1).all() == (opponent == "static")
    crashes = 0
    for r in range(3):
        every = np.array(list(product(range(5), repeat=2)))
        state = noisy.reset(np.full(25, trees.seeds[r]), policies=trees.policies[r])
        for k in range(2):
            mine = every[:, 0] if k == 1 else np.zeros(25, np.int64)
            np.testing.assert_array_equal(trees.observations(k)[r][mine], noisy.observation(state)[:, 0])
            np.testing.assert_array_equal(trees.over[k][r][mine], state.race.crashed)
            crashes += int(state.race.crashed.sum())
            reply = np.full(25, 4 if trees.replies[r, k] < 0 else trees.replies[r, k])
            state = noisy.step(state, np.stack([every[:, k], reply], axis=1))
        np.testing.assert_array_equal(trees.payoffs[r], noisy.reward(state)[:, 0].astype(np.float32))
        crashes += int(state.race.crashed.sum())
    assert crashes > 0, "choose other seeds: this test needs crashes"


def test_a_root_depends_on_its_number_alone_and_drives_every_policy_once(noisy, trees, monkeypatch):
    monkeypatch.setattr(_ego, "BLOCK", 4)
    same(play_ego(replace(noisy, threads=1), 6, seed=1), trees)
    later = play_ego(noisy, 2, seed=1, first=3)
    np.testing.assert_array_equal(later.payoffs, trees.payoffs[3:5])
    np.testing.assert_array_equal(later.observations(1), trees.observations(1)[3:5])
    assert not np.array_equal(play_ego(noisy, 2, seed=2).seeds, trees.seeds[:2])
    for r, driven in enumerate(trees.driven):
        live = [np.repeat(~over[r], trees.options) for over in trees.over]  # histories that go on
        assert driven == 1 + sum(len(np.unique(trees.paths[k][r][live[k - 1]])) for k in (1, 2))
    trees = play_ego(noisy, 2, policies=(2, 6), opponent=np.array([[0, -1], [3, 2]]))
    np.testing.assert_array_equal(trees.policies, [[2, 6], [2, 6]])
    np.testing.assert_array_equal(trees.replies, [[0, -1], [3, 2]])


def test_values_go_backwards_and_a_continuation_sees_the_observations(trees, noisy):
    payoffs = trees.payoffs.reshape(6, 5, 5).astype(np.float64)
    (first, root), (last, middle) = ego_values(trees)
    np.testing.assert_array_equal(last, payoffs)
    np.testing.assert_array_equal(middle, payoffs.max(axis=2))
    np.testing.assert_array_equal(first[:, 0], payoffs.max(axis=2))
    np.testing.assert_array_equal(root[:, 0], payoffs.max(axis=(1, 2)))
    (first, root), _ = ego_values(trees, uniform)
    np.testing.assert_allclose(first[:, 0], payoffs.mean(axis=2))
    np.testing.assert_allclose(root[:, 0], payoffs.mean(axis=(1, 2)))
    seen = []

    def last_move(observations):
        seen.append(observations)
        return np.eye(5)[np.full(len(observations), 4)]

    (first, _), _ = ego_values(trees, last_move)
    np.testing.assert_array_equal(first[:, 0], trees.payoffs.reshape(6, 5, 5)[:, :, 4])
    np.testing.assert_array_equal(seen[0].reshape(6, 5, -1), trees.observations(1))
    assert seen[1].shape == (6, len(noisy.observation_elements))


def test_rows_hold_each_situation_with_a_decision_once(noisy, trees):
    rows = ego_rows(trees)
    q = ego_values(trees)[1][0]
    for step in range(2):
        of_step = rows.step == step
        different = [
            len({tuple(noisy.table[p[0], list(m)]) for m in product(range(5), repeat=step)}) for p in trees.policies
        ]
        alive = [
            len(np.unique(trees.paths[step][r][~trees.over[step][r]])) if n else 0 for r, n in enumerate(different)
        ]
        assert of_step.sum() == sum(alive)
        shares = [(~over).mean() for over in trees.over[step]]
        assert rows.weights[of_step].sum() == pytest.approx(sum(shares))
    root, at = np.argwhere((trees.observations(1) == rows.observations[rows.step == 1][0]).all(axis=-1))[0]
    np.testing.assert_array_equal(rows.targets[rows.step == 1][0], q[root, at].astype(np.float32))
    dead = replace(trees, over=tuple(np.ones_like(level) for level in trees.over))
    refused("every race is over", ego_rows, dead)


def test_a_folder_of_ego_trees_resumes_whatever_the_executor(noisy, tmp_path):
    game = replace(noisy, config=replace(noisy.config, moves=1, step_seconds=1.0))
    whole = build_ego_trees(game, tmp_path / "a", roots=70)
    same(play_ego(game, 70), whole)
    with make_executor("threads", 2) as executor:
        same(build_ego_trees(game, tmp_path / "b", roots=70, executor=executor), whole)
    chunk = chunk_file(tmp_path / "b", "ego", 1)
    assert chunk.read_bytes() == chunk_file(tmp_path / "a", "ego", 1).read_bytes()
    chunk.unlink()
    refused(r"ego-00001.npz can't be read: .*; run the command that made", load_ego_trees, tmp_path / "b")
    same(build_ego_trees(game, tmp_path / "b", roots=70), whole)
    arrays = read_chunk(chunk)
    arrays["payoffs"][0, 0] = np.inf
    write_chunk(chunk, arrays, "0" * 64)
    refused(r"ego-00001\.npz: payoffs", load_ego_trees, tmp_path / "b")
    del arrays["own_0"]
    write_chunk(chunk, arrays, "0" * 64)
    refused(r"ego-00001\.npz .*'own_0'", load_ego_trees, tmp_path / "b")


def test_impossible_settings_and_continuations_are_refused(noisy, trees):
    for settings, kind, message in [
        ({"roots": 0}, InputError, "roots is 0"),
        ({"seed": -1}, InputError, "seed is -1"),
        ({"opponent": "lazy"}, UnknownNameError, "opponent 'lazy' is unknown"),
        ({"opponent": [[0, 9]] * 2}, InputError, "the opponent's moves holds 9"),
        ({"opponent": [0.5, 1.0]}, InputError, r"the opponent's moves has shape \(2,\) and type float64"),
        ({"policies": [[0, 9]] * 2}, InputError, "policies holds 9"),
        ({"policies": [0, 1, 2]}, InputError, r"policies has shape \(3,\)"),
    ]:
        refused(message, play_ego, noisy, error=kind, **{"roots": 2, **settings})
    for continuation, message in [
        ("worst", "continuation is 'worst'"),
        (lambda seen: np.ones((len(seen), 4)) / 4, r"shape \(30, 4\)"),
        (lambda seen: np.full((len(seen), 5), np.nan), "probabilities of 5 moves"),
        (lambda seen: np.ones((len(seen), 5)), "sum up to 1"),
    ]:
        refused(message, ego_values, trees, continuation)
    refused("move 2 ", trees.observations, 2)
