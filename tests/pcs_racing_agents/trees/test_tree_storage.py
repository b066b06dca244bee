from dataclasses import replace

import numpy as np
import pytest
import yaml
from refusal import refused
from same_arrays import assert_same

from pcs_racing import InputError, make_game
from pcs_racing_agents.base.chunks import read_chunk, write_chunk
from pcs_racing_agents.trees import build_tree, build_trees, choose_pairs, load_trees
from pcs_racing_agents.trees.build import default_seeds, draw_root

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
    assert settings["preset"] == "paper"
    assert (
        settings["rules"]["epsilon"],
        settings["rules"]["moves"],
        settings["seeds_per_pair"],
    ) == (0.35, 2, 1)
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
    refused("archive sha256 is", stored.check, make_game(track, other, paper.config))
    refused("preset is 'paper', not 'contest'", stored.check, noisy)
    refused(
        "moves is 2, not 1", stored.check, replace(paper, config=replace(paper.config, moves=1))
    )
    with pytest.raises(InputError, match=r"rules\.moves is 2, not 1"):
        build_trees(
            replace(paper, config=replace(paper.config, moves=1)),
            stored.folder,
            pairs=PAIRS,
            seed=3,
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
            replace(noisy, config=replace(noisy.config, moves=1)),
            root.policies,
            root[1:3],
            root.seeds,
        )
        assert not tree.over[0].any()
        assert len(np.unique(root.seeds)) == 3
