from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from refusal import refused

from pcs_racing import make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.statistics import match_units
from pcs_racing_agents.tournament import (
    cross_pairing,
    pairings as module,
    play_pairing,
    play_pairings,
    repeat_race,
)

SIZE = {"egos": 4, "opponents": 3, "lines": 2, "seed": 5}


def units(pairing):
    """Fields of a race that are the same for two egos."""
    columns = (*pairing.variants.T, pairing.starts.s, pairing.starts.side)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def test_a_crossed_pairing_crosses_everything_and_short_circuits_share_places(
    contest, zoo, archive
):
    pairing = cross_pairing(contest, zoo["random-moves"], zoo["lane-switcher:any"], **SIZE)
    assert len(pairing) == 4 * 3 * 2 * 2 == len(set(units(pairing)))
    egos, opponents, starts, sides = (np.unique(column) for column in np.array(units(pairing)).T)
    assert (len(egos), len(opponents), len(starts), sides.tolist()) == (4, 3, 16, [0, 1])
    assert egos.max() < 12
    assert opponents.max() < 20
    # Every pair has two lines of its own out of sixteen, each of them from both sides.
    for pair in np.unique(pairing.variants, axis=0):
        of_pair = pairing.starts.s[(pairing.variants == pair).all(axis=1)]
        assert sorted(np.unique(of_pair, return_counts=True)[1].tolist()) == [2, 2]
    legs = pairing.noise.reshape(24, 2)
    assert len(np.unique(legs)) == (legs[:, 0] == legs[:, 1]).sum() == 24
    paper = cross_pairing(contest, zoo["random-moves"], zoo["lane-switcher:any"])
    # this archive has 12 policies to start with; with 20 it were 4,000
    assert len(paper) == 12 * 20 * 5 * 2
    np.testing.assert_array_equal(paper.noise[::2], race_seeds(0, len(paper) // 2))
    # Tarnfjord has 27 places to start side by side, and a pairing draws from 40 lines; a place is
    # one cluster.
    game = make_game("Tarnfjord", archive, "paper")
    policies = build("never-switch", make_game(None, archive, game.rules))
    pairing = cross_pairing(game, policies, policies, egos=4, opponents=4, lines=5)
    assert len(np.unique(pairing.starts.s)) < 40


def test_arms_pair_up_race_by_race(contest, zoo):
    """Two egos against one opponent: the same races in the same order, and the opponent starts the
    same.
    """
    for opponent in ("never-switch", "random-policy", "random-moves"):
        pairings = [
            cross_pairing(contest, zoo[ego], zoo[opponent], **SIZE)
            for ego in ("never-switch", "random-moves")
        ]
        one, other = map(units, pairings)
        np.testing.assert_array_equal(match_units(one, other), np.arange(48))
        np.testing.assert_array_equal(pairings[0].noise, pairings[1].noise)
        arms = play_pairings(pairings)
        np.testing.assert_array_equal(arms[0].path[:, :, 0], arms[1].path[:, :, 0])
    same = play_pairing(cross_pairing(contest, zoo["never-switch"], zoo["never-switch"], **SIZE))
    reseeded = replace(zoo["never-switch"], seed=9)
    again = play_pairing(cross_pairing(contest, reseeded, zoo["never-switch"], **SIZE))
    np.testing.assert_array_equal(same.score, again.score)


def test_races_of_a_pairing_in_words_and_of_chosen_variants(contest, zoo):
    pairing = cross_pairing(contest, zoo["random-moves"], zoo["random-policy"], **SIZE)
    rows = list(play_pairing(pairing))
    assert [(row.ego_variant, row.opponent_variant) for row in rows] == [
        tuple(pair) for pair in pairing.variants
    ]
    assert {(row.ego, row.opponent, row.track, row.seed) for row in rows} == {
        ("random-moves", "random-policy", "oval", 5)
    }
    expected = zip(range(48), pairing.starts.s.tolist(), pairing.starts.side.tolist(), strict=True)
    assert [(row.race, row.start_s, row.side) for row in rows] == list(expected)
    pairing = cross_pairing(
        contest, zoo["never-switch"], zoo["never-switch"], egos=[7, 2], opponents=[1], lines=1
    )
    assert pairing.variants.tolist() == [[7, 1], [7, 1], [2, 1], [2, 1]]
    refused("no race 4", repeat_race, pairing, 4)


def test_the_races_are_the_same_in_blocks_in_a_job_and_together_with_others(
    contest, zoo, tmp_path, monkeypatch
):
    """Two pairings against one opponent are driven together, a fixed policy's alone; each gets its
    own races back.
    """
    pairings = [
        cross_pairing(contest, zoo[ego], zoo["lane-switcher:any"], **SIZE)
        for ego in ("random-moves", "never-switch", "random-policy")
    ]
    expected = [list(play_pairing(pairing)) for pairing in pairings]
    monkeypatch.setattr("pcs_racing_agents.tournament.pairings.BLOCK", 20)
    assert [list(races) for races in play_pairings(pairings)] == expected
    counts: list[tuple[int, int]] = []
    for _ in range(2):
        with (
            open_job(tmp_path / "job", "races", {}) as job,
            ThreadPoolExecutor(2) as executor,
        ):
            told = {"progress": lambda done, total, _: counts.append((done, total))}
            races = play_pairings(pairings, job=job, executor=executor, **told)
        assert list(map(list, races)) == expected
    # Blocks of 10 races of two agents, and of 20 of the policy: eight tasks, none of them driven
    # twice.
    assert counts == [(144 * task // 8, 144) for task in (*range(9), 8)]


def test_a_task_is_known_by_all_that_its_races_depend_on(contest, zoo, oval, monkeypatch):
    """Blocks of one race at least, however many agents share them; names of any kind become those
    of files.
    """
    pairing = cross_pairing(contest, zoo["random-moves"], zoo["lane-switcher:any"], **SIZE).take(
        [0, 1, 2]
    )
    monkeypatch.setattr(module, "BLOCK", 4)
    for egos, ends in ((1, [(0, 3)]), (2, [(0, 2), (2, 3)]), (5, [(0, 1), (1, 2), (2, 3)])):
        blocks = list(module._blocks(7, [pairing] * egos, False, hashed=False))
        assert [(block.group, block.first, block.last) for block in blocks] == [
            (7, *pair) for pair in ends
        ]
    faster = replace(oval.calibration["contest"], speed_range=(1.0, 1.5))
    other = replace(contest, rules=replace(contest.rules, discount=0.5))
    changed = [
        pairing,
        replace(pairing, opponent=zoo["pure-pursuit"]),
        replace(pairing, ego=zoo["never-switch"]),
        replace(pairing, noise=pairing.noise + np.uint64(1)),
        replace(pairing, variants=pairing.variants + 1),
        replace(pairing, starts=replace(pairing.starts, s=pairing.starts.s + 0.5)),
        replace(pairing, starts=replace(pairing.starts, side=1 - pairing.starts.side)),
        replace(pairing, game=other),
        replace(
            pairing,
            game=replace(
                contest, track=replace(oval, calibration={**oval.calibration, "mine": faster})
            ),
        ),
    ]
    groups = [(group, seen) for group in ([one] for one in changed) for seen in (False, True)] + [
        ([pairing] * 2, False)
    ]
    tasks = [
        block[0] for group, seen in groups for block in module._blocks(0, group, seen, hashed=True)
    ]
    assert len(set(tasks)) == len(tasks) == 2 * len(changed) + 2
    assert next(module._blocks(3, [replace(pairing, seed=1)], False, hashed=True))[0] == tasks[0]


def test_observations_are_kept_where_they_are_asked_for(contest, zoo, tmp_path):
    pairing = cross_pairing(contest, zoo["random-moves"], zoo["lane-switcher:any"], **SIZE)
    with open_job(tmp_path / "job", "races", {}) as job:
        bare = play_pairing(pairing, job=job)
        (whole,) = play_pairings([pairing], observations=True, job=job)
    assert bare.observations is None
    np.testing.assert_array_equal(
        whole.observations, pairing.race([pairing.ego])[0]["observations"]
    )


def test_impossible_pairings_are_refused(contest, zoo):
    for change, message in [
        ({"egos": 0}, "egos is 0"),
        ({"egos": [1, 1]}, r"egos is \[1, 1\]"),
        ({"egos": [12]}, "from 0 to 11"),
        ({"opponents": [20]}, "from 0 to 19"),
        ({"opponents": 2.5}, r"opponents is 2\.5"),
        ({"lines": 0}, "lines is 0"),
        ({"lines": 1001}, "lines is 1001"),
        ({"seed": -1}, "seed is -1"),
    ]:
        refused(
            message,
            cross_pairing,
            contest,
            zoo["random-moves"],
            zoo["lane-switcher:any"],
            **SIZE | change,
        )
