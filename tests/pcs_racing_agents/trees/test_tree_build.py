from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import yaml
from refusal import refused
from same_arrays import assert_same

from pcs_racing import CONTEST, InputError, load_rules, make_game
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.base.jobs import read_chunk, write_chunk
from pcs_racing_agents.solvers import solve_exact
from pcs_racing_agents.trees import (
    build_tree,
    build_trees,
    choose_pairs,
    driving as _driving,
    load_trees,
)
from pcs_racing_agents.trees.build import default_seeds, draw_root
from pcs_racing_agents.trees.tree import check_size, own_histories


def test_a_tree_may_begin_before_the_start(paper, played):
    game = replace(paper, rules=replace(paper.rules, steps=(0.0, 1.0, 2.0)))
    tree = build_tree(game, (2, 7), (float(game.start_lines[1]), 1), [5])
    every = np.array(list(product(range(4), repeat=4))).reshape(-1, 2, 2)
    ends = played(game, tree, 0, every)
    np.testing.assert_array_equal(tree.payoffs[0], game.reward(ends)[:, 0].astype(np.float32))
    starts = Starts(np.array([tree.start_s]), np.array([1]))
    assert (tree.leads[0] == game.reset(games=1, policies=(2, 7), starts=starts).leads[0, 0]).all()


@pytest.mark.parametrize(
    ("name", "policies", "line", "side"), [("noisy", (7, 6), 1, 1), ("far", (7, 1), 0, 0)]
)
def test_what_is_seen_on_the_way_is_what_the_game_shows(
    name, policies, line, side, request, played, number
):
    game = request.getfixturevalue(name)
    tree = build_tree(game, policies, (float(game.start_lines[line]), side), [1, 2])
    options, moves = tree.options, tree.moves
    assert options == 5
    rng = np.random.default_rng(0)
    histories = rng.integers(options, size=(40, moves, 2))
    crashes = np.zeros(moves + 1, np.int64)
    for seed in range(2):
        for k in range(moves + 1):
            nodes = number(histories[:, :k], options)
            state = played(game, tree, seed, histories[:, :k])
            over = state.race.crashed
            crashes[k] += int(over.sum())
            if k == moves:
                np.testing.assert_array_equal(
                    tree.payoffs[seed][nodes], game.reward(state)[:, 0].astype(np.float32)
                )
                continue
            np.testing.assert_array_equal(tree.over[k][seed, nodes], over)
            np.testing.assert_array_equal(
                tree.observations(k)[seed, nodes], game.observation(state)
            )
            np.testing.assert_array_equal(tree.leads[k][seed, nodes], state.leads[:, k])
            np.testing.assert_array_equal(
                tree.estimates[k][seed, nodes], state.estimates[:, :, k].astype(np.float32)
            )
            np.testing.assert_array_equal(tree.policy[k][nodes][~over], state.policy[~over])
    assert crashes[moves] > crashes[1] >= (name == "noisy"), (
        "choose other noise: this test needs crashes"
    )
    assert not np.array_equal(tree.payoffs[0], tree.payoffs[1])


def test_putting_far_races_together_changes_no_bit_nor_do_threads(far, noisy, monkeypatch):
    place = (float(far.start_lines[0]), 0)
    tree = build_tree(far, (7, 1), place, [1])
    one_by_one = build_tree(far, (7, 1), place, [1], share=False)
    assert_same(tree.arrays(), one_by_one.arrays(), skip=("driven",))
    assert 4 * tree.statistics.driven < one_by_one.statistics.driven == tree.statistics.live
    assert 0.0 < tree.statistics.crashed < 1.0
    place = (float(noisy.start_lines[0]), 0)
    tree = build_tree(noisy, (2, 6), place, [7])
    monkeypatch.setattr(_driving, "CHUNK", 13)
    assert_same(build_tree(replace(noisy, threads=1), (2, 6), place, [7]).arrays(), tree.arrays())


def test_cars_within_sight_and_planners_that_promise_none_are_driven_together(track, archive):
    """The car behind is the faster one: what can be put together must end where it comes within
    sight.
    """
    rules = {"steps": (6.0,) * 3, "utility": "lead", "epsilon": 0.35}
    contest = replace(CONTEST, start_gap=30.0, steering_noise=0.0, front_pace=(1.0, 1.0))
    game = make_game(track, archive, contest, **rules)
    place = (float(game.start_lines[5]), 0)
    tree = build_tree(game, (4, 7), place)
    assert_same(
        tree.arrays(), build_tree(game, (4, 7), place, share=False).arrays(), skip=("driven",)
    )
    assert np.abs(tree.leads[1]).max() > 20.0
    assert np.abs(tree.payoffs).min() < 11.0
    assert 0.2 * tree.statistics.live < tree.statistics.driven < 0.8 * tree.statistics.live
    theta = np.stack([PURE_PURSUIT.sample(np.random.default_rng(i)) for i in range(3)])
    named = ("pursuers", "pure-pursuit", PURE_PURSUIT.parameter_names)
    archive = PolicyArchive(*named, theta, ("pace", "restraint"), [[0, 1], [1, 0], [2, 2]])
    rules = replace(CONTEST, start_gap=20.0, steering_noise=0.0)
    tree = build_tree(make_game(track, archive, rules, steps=(2.0,) * 3), (0, 1), (20.0, 0))
    assert tree.statistics.driven == tree.statistics.live


def test_a_tree_of_several_seeds_is_the_trees_of_each_and_its_game_their_mean(noisy):
    place = (float(noisy.start_lines[0]), 0)
    both = build_tree(noisy, (2, 6), place, [7, 8])
    for i, seed in enumerate((7, 8)):
        one = build_tree(noisy, (2, 6), place, [seed])
        np.testing.assert_array_equal(one.payoffs[0], both.payoffs[i])
        np.testing.assert_array_equal(one.observations(1)[0], both.observations(1)[i])
    game = both.game_tree()
    np.testing.assert_allclose(np.ravel(game.payoffs), both.payoffs.astype(np.float64).mean(axis=0))
    assert -1.0 <= solve_exact(game).value <= 1.0


def test_a_root_that_is_over_has_one_outcome(noisy, played):
    """Policies that crash while they watch: nothing is driven after that, and all leaves are worth
    the same.
    """
    place = Starts(np.full(60, noisy.start_lines[0]), np.zeros(60, np.int64))
    over = np.flatnonzero(noisy.reset(np.arange(60), policies=(8, 7), starts=place).race.crashed)
    tree = build_tree(noisy, (8, 7), (float(noisy.start_lines[0]), 0), [over[0]])
    assert tree.statistics.driven == 1
    assert tree.statistics.crashed == 1.0
    assert len(np.unique(tree.payoffs)) == 1
    assert all(level.all() for level in tree.over)
    state = played(noisy, tree, 0, np.array([[[1, 2]]]))
    np.testing.assert_array_equal(tree.observations(1)[0, 1 * 5 + 2], noisy.observation(state)[0])


def test_the_statistics_count_what_they_say_and_histories_stand_in_row_major_order(paper):
    tree = build_tree(paper, (2, 7), (float(paper.start_lines[1]), 1))
    s = tree.statistics
    assert (s.seeds, s.shared, s.replayed) == (1, 1 + 16 + 256, 3 * 256)
    counts = [
        [len({tuple(p) for p in sequences(paper, start, k)}) for k in range(3)] for start in (2, 7)
    ]
    if not tree.over[1].any():
        assert s.live == sum(a * b for a, b in zip(*counts, strict=True))
    assert s.duplicates == 1.0 - counts[0][2] * counts[1][2] / 256
    assert s.driven <= s.live
    first, second = own_histories(2, 3)
    for i, (a0, b0, a1, b1) in enumerate(product(range(3), repeat=4)):
        assert (first[i], second[i]) == (a0 * 3 + a1, b0 * 3 + b1)
    check_size(5, 4)
    refused(r"4 moves with 9 choices .*4\.3e\+07", check_size, 9, 4)


def sequences(game: RaceGame, start: int, k: int):
    """Policies that every sequence of ``k`` moves leads through."""
    for moves in product(range(game.offered), repeat=k):
        policies = [start]
        for move in moves:
            policies.append(int(game.table[policies[-1], move]))
        yield policies


def test_impossible_roots_and_games_without_a_tree_are_refused(paper, track):
    for change, message in [
        ({"policies": (3, 9)}, "game 0, car 1: policy 9"),
        ({"policies": (3, -1)}, r"policies are \(3, -1\)"),
        ({"policies": (3,)}, r"policies are \(3,\)"),
        ({"start": (-1.0, 0)}, r"start line -1.0 m"),
        ({"start": (20.0, 2)}, r"start sides .* 2"),
        ({"start": Starts(np.array([20.0, 21.0]), np.array([0, 0]))}, "there are 2 starts"),
        ({"seeds": [1, 2]}, "2 seeds, but no steering noise"),
        ({"seeds": [1, 1]}, r"seeds are \[1, 1\]"),
        ({"seeds": []}, r"seeds are \[\]"),
        ({"seeds": [-1]}, r"seeds are .*-1.*"),
    ]:
        refused(
            message,
            build_tree,
            paper,
            **{"policies": (2, 7), "start": (20.0, 0), "seeds": [1], **change},
        )
    refused(
        "4 moves with 9 choices",
        build_tree,
        make_game(track, paper.archive, epsilon=(0.2, 0.4), stay=True),
        (2, 7),
        (20.0, 0),
    )
    outside = replace(paper, opponent_planner="pure-pursuit")
    refused(r"car 1 .*'pure-pursuit'", build_tree, outside, (2, 7), (20.0, 0))
    by_laps = make_game(track, paper.archive, load_rules("paper", laps=3))
    refused("laps is 3; a game tree needs races by time", build_tree, by_laps, (2, 7), (20.0, 0))
    refused("move 2 ", build_tree(paper, (2, 7), (20.0, 0)).observations, 2)


PAIRS = [[2, 8], [5, 1], [4, 4]]  # 8: the last policy


@pytest.fixture
def stored(paper, tmp_path):
    return build_trees(paper, tmp_path / "trees", pairs=PAIRS, seed=3)


def contents(trees) -> list[bytes]:
    return [trees.file(i).read_bytes() for i in range(len(trees))]


def test_trees_come_back_as_they_were_played_and_the_manifest_names_what_decides_them(
    paper, stored
):
    assert len(stored) == len(list(stored)) == 3
    for i, tree in enumerate(stored):
        assert tree.policies.tolist() == PAIRS[i]
        again = build_tree(paper, tree.policies, (tree.start_s, tree.side), tree.seeds)
        assert_same(tree.arrays(), again.arrays())
        np.testing.assert_array_equal(tree.observations(1), again.observations(1))
    assert [tree.policies[0] for tree in stored[1:]] == [5, 4]
    assert stored[-1].policies.tolist() == PAIRS[-1]
    assert len({(tree.start_s, tree.side, int(tree.seeds[0])) for tree in stored}) == 3
    settings = yaml.safe_load((stored.folder / "job.yaml").read_text())["settings"]
    assert settings["archive"] == {"name": "tiny", "sha256": paper.archive.content_hash}
    assert settings["track"] == {"name": "Tarnfjord", "sha256": paper.track.content_hash}
    assert (
        settings["rules"]["name"],
        settings["rules"]["epsilon"],
        settings["rules"]["steps"],
        settings["seeds_per_pair"],
    ) == ("paper", 0.35, [2.0] * 3, 1)
    assert (
        tuple(settings["encoding"])
        == stored.elements
        == tuple(e.name for e in paper.observation_elements)
    )
    stored.check(paper)


def test_what_is_missing_or_damaged_is_made_again_to_the_byte(paper, stored, caplog):
    whole = contents(stored)
    stored.file(0).unlink()
    damaged = bytearray(whole[2])
    damaged[len(damaged) // 2] ^= 1
    stored.file(2).write_bytes(damaged)
    refused(r"tree-00000\.npz missing of 3 trees", load_trees, stored.folder)
    with pytest.raises(InputError, match=r"tree-00002\.npz is damaged"):
        stored[2]
    calls = []
    again = build_trees(
        paper, stored.folder, pairs=PAIRS, seed=3, progress=lambda *call: calls.append(call)
    )
    assert contents(again) == whole
    assert "tree-00002.npz" in caplog.text
    assert calls == [(1, 3, "tree"), (2, 3, "tree"), (3, 3, "tree")]


def test_trees_of_another_game_renamed_files_and_other_folders_are_noticed(
    paper, noisy, stored, track, tmp_path
):
    other = replace(
        paper.archive, coordinates=1.1 * paper.archive.coordinates, ideal=None, nadir=None
    )
    assert len(load_trees(stored.folder, paper.archive)) == 3
    refused(r"archive 'tiny' .*not with 'tiny'", load_trees, stored.folder, other)
    refused("archive sha256 is", stored.check, make_game(track, other, paper.rules))
    refused("rules name is 'paper', not 'contest'", stored.check, noisy)
    fewer = replace(paper, rules=replace(paper.rules, steps=(2.0, 2.0)))
    refused(r"rules steps is \[2.0, 2.0, 2.0\], not \[2.0, 2.0\]", stored.check, fewer)
    refused(
        r"rules\.steps is \[2.0, 2.0, 2.0\]", build_trees, fewer, stored.folder, pairs=PAIRS, seed=3
    )
    stored.file(2).rename(stored.file(1))
    with pytest.raises(InputError, match=r"policies \[4, 4\]"):
        stored[1]
    refused(r"game trees: job\.yaml", load_trees, tmp_path)
    (tmp_path / "job.yaml").write_text("format: pcs-racing job\nkind: other trees\nsettings: {}\n")
    refused("manifest of game trees", load_trees, tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("leads_1"), "leads_1"),
        (lambda a: a.update(payoffs=a["payoffs"][:, 1:]), r"payoffs has shape \(1,"),
        (lambda a: a.update(table=a["table"] + 1), "names a policy"),
        (lambda a: a.update(side=a["side"] + 0.5), "side is of type float64"),
        (lambda a: a.update(points=a["points"][1:]), "do not fit"),
        (lambda a: a["payoffs"].fill(np.nan), "payoffs holds NaN"),
    ],
)
def test_files_that_do_not_fit_are_refused(stored, change, message):
    arrays = read_chunk(stored.file(1))
    change(arrays)
    write_chunk(stored.file(1), arrays, "0" * 64)
    with pytest.raises(InputError, match=f"tree-00001.npz.*{message}"):
        stored[1]


def test_impossible_settings_are_refused_before_anything_is_written(paper, tmp_path):
    for settings, message in [
        ({"pairs": 0}, "pairs is 0"),
        ({"pairs": [[1, 2, 3]]}, r"pairs has shape \(1, 3\)"),
        ({"pairs": [[1.0, 2.0]]}, r"pairs has shape \(1, 2\) and type float64"),
        ({"pairs": [[1, 2], [3, 9]]}, r"pairs holds 9 at \(1, 1\)"),
        ({"pairs": 1, "seed": -1}, "seed is -1"),
        ({"pairs": 1, "seeds_per_pair": 0}, "seeds_per_pair is 0"),
        ({"pairs": 1, "seeds_per_pair": 2}, "seeds_per_pair is 2"),
    ]:
        refused(message, build_trees, paper, tmp_path / "trees", **settings)
        assert not (tmp_path / "trees").exists()


def test_pairs_are_different_and_nobody_crashes_before_the_first_move(paper, noisy):
    for count in (1, 7, 30, 36):
        pairs = choose_pairs(paper.archive, count, seed=2)
        assert pairs.shape == (count, 2)
        assert len({frozenset(pair) for pair in pairs.tolist() if len(set(pair)) == 2}) == count
        np.testing.assert_array_equal(choose_pairs(paper.archive, count, seed=2), pairs)
    assert not np.array_equal(choose_pairs(paper.archive, 36, seed=3), pairs)
    assert len(choose_pairs(paper.archive, 100)) == 100  # more than there are: some come twice
    assert default_seeds(noisy) == 4
    rng = np.random.default_rng(0)
    for _ in range(3):
        root = draw_root(noisy, np.array([8, 7]), 3, rng)
        tree = build_tree(
            replace(noisy, rules=replace(noisy.rules, steps=(6.0, 6.0))),
            root.policies,
            root[1:3],
            root.seeds,
        )
        assert not tree.over[0].any()
        assert len(np.unique(root.seeds)) == 3
