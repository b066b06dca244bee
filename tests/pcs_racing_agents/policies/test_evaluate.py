from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError, Policy, Starts, load_race_config, parse_policy
from pcs_racing.game import characteristics
from pcs_racing.game.characteristics import Characteristic, Segment, get_characteristics, measure
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race.driving import pad_parameters
from pcs_racing.race.races import RaceSetup, advance, start_races, winners
from pcs_racing.race.state import SUMS
from pcs_racing_agents.policies import evaluate as evaluation
from pcs_racing_agents.policies.evaluate import (
    draw_scenarios,
    evaluate,
    race_policies,
    race_segments,
    summarise,
)

SHORT = load_race_config("contest", duration=4.0)
AXES = ("pace", "restraint")


def policies(count, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([LATTICE.sample(rng) for _ in range(count)])


@pytest.fixture(scope="module")
def scenarios(oval):
    return draw_scenarios(
        [oval, "Pipkin"], SHORT, policies(3, 1), AXES, starts=2, segment_seconds=2.0, seed=4
    )


@pytest.fixture(scope="module")
def raced(scenarios):
    return race_policies((scenarios, policies(5)))


def test_every_start_is_paired_with_every_opponent_in_races_drawn_from_the_seed(scenarios, oval):
    assert len(scenarios) == 2 * 2 * 3 * 2
    for track in range(2):
        here = scenarios.track == track
        lines = np.unique(scenarios.start_s[here])
        assert len(lines) == 2
        drawn = (scenarios.start_s, scenarios.opponent, scenarios.side)
        met = set(zip(*(part[here].tolist() for part in drawn), strict=True))
        assert met == {
            (line, opponent, side) for line in lines for opponent in range(3) for side in range(2)
        }
    assert len(set(scenarios.seed.tolist())) == len(scenarios)
    given = ([oval, "Pipkin"], SHORT, policies(3, 1), AXES)
    again, other = (draw_scenarios(*given, segment_seconds=2.0, seed=seed) for seed in (4, 5))
    for key in ("track", "start_s", "side", "seed", "opponent"):
        np.testing.assert_array_equal(getattr(again, key), getattr(scenarios, key))
    assert not np.isin(other.seed, scenarios.seed).any()
    alone = draw_scenarios([oval], SHORT, policies(3, 1), AXES, segment_seconds=2.0, seed=4)
    # another track does not disturb the first
    np.testing.assert_array_equal(alone.seed, scenarios.seed[:12])


def test_coordinates_are_means_over_the_pieces(scenarios, raced, oval):
    """One policy's races on the first track, driven here by hand."""
    setup = RaceSetup(oval, SHORT, (LATTICE, LATTICE))
    state = start_races(
        setup, Starts(scenarios.start_s[:12], scenarios.side[:12]), scenarios.seed[:12]
    )
    theta = np.stack(
        [np.tile(policies(5)[2], (12, 1)), scenarios.opponents[scenarios.opponent[:12]]], axis=1
    )
    totals, segments = np.zeros((12, 2)), np.zeros(12)
    for _ in range(2):
        before = state.copy()
        advance(setup, state, theta, 200)
        segment = Segment.between(before, state, 2.0)
        values = measure(segment, get_characteristics(AXES))[:, 0]
        for race in range(12):
            if segment.time[race] > 0.0:
                totals[race] += values[race]
                segments[race] += 1
    np.testing.assert_array_equal(raced["totals"][2, :12], totals)
    np.testing.assert_array_equal(raced["segments"][2, :12], segments)
    np.testing.assert_array_equal(raced["own_crash"][2, :12], state.fault[:, 0] == 1)
    found = summarise(raced)
    np.testing.assert_allclose(
        found.coordinates, raced["totals"].sum(axis=1) / raced["segments"].sum(axis=1)[:, None]
    )
    np.testing.assert_array_equal(found.own_crash, raced["own_crash"].mean(axis=1))


def test_a_pooled_coordinate_is_that_of_all_races_together(scenarios):
    """Speed behind less speed in front, in whole races; its standard error is the jackknife's."""
    scenarios = replace(scenarios, characteristics=("speed", "reaction"))
    task = (scenarios, policies(2))
    segments, found = race_segments(task), summarise(race_policies(task))
    assert segments["values"].shape == (2, len(scenarios), 2, 2)
    columns = [
        list(SUMS).index(name) for name in ("PROFILE_BEHIND", "TIME_BEHIND", "PROFILE", "TIME")
    ]
    for k in range(2):
        races = segments["sums"][k, :, 0][:, columns]

        def reaction(rows):
            profile_behind, behind, profile, time = rows.sum(axis=0)
            return profile_behind / behind - (profile - profile_behind) / (time - behind)

        assert found.coordinates[k, 1] == pytest.approx(reaction(races))
        without = np.array([reaction(np.delete(races, race, axis=0)) for race in range(len(races))])
        assert found.spread[k, 1] == pytest.approx(np.sqrt((len(races) - 1) * without.var()))


def test_rivals_of_other_planners_are_met_as_often_as_opponents_and_scored(oval):
    given = {"starts": 2, "segment_seconds": 2.0, "seed": 4}
    rivals = ("pure-pursuit:pace=0", "lane-switcher", "pure-pursuit:pace=1")
    scenarios = draw_scenarios([oval], SHORT, policies(1), AXES, rivals=rivals, **given)
    assert np.bincount(scenarios.opponent).tolist() == [4, 4, 4, 4]
    raced = race_policies((scenarios, policies(3)))
    assert raced["rival"].sum(axis=1).tolist() == [12, 12, 12]
    for number, rival in enumerate(rivals, start=1):
        of = np.flatnonzero(scenarios.opponent == number)
        driver = parse_policy(rival)
        setup = RaceSetup(oval, SHORT, (LATTICE, driver.planner))
        state = start_races(
            setup, Starts(scenarios.start_s[of], scenarios.side[of]), scenarios.seed[of]
        )
        pair = pad_parameters([Policy(LATTICE, policies(3)[1], "own"), driver], setup.theta_size)
        advance(setup, state, np.tile(pair, (len(of), 1, 1)), SHORT.ticks)
        np.testing.assert_array_equal(raced["winner"][1, of], winners(SHORT, state))
    points = np.where(
        raced["winner"] == 0, 1.0, np.where((raced["winner"] < 0) & ~raced["crashed"], 0.5, 0.0)
    )
    np.testing.assert_allclose(summarise(raced).score, points[:, 4:].mean(axis=1))
    refused(
        "planner 'nobody' is unknown",
        draw_scenarios,
        [oval],
        SHORT,
        policies(1),
        AXES,
        rivals=("nobody",),
        **given,
    )


@pytest.mark.parametrize("kind", ["serial", "threads", "processes"])
def test_blocks_and_executors_change_nothing(scenarios, raced, kind, executor):
    expected = summarise(raced)
    for size in (1, 2, 5) if kind != "processes" else (2,):
        found = evaluate(scenarios, policies(5), executor=executor, block=size)
        for mine, theirs in zip(found, expected, strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_policies_do_not_disturb_each_other_and_many_races_are_driven_one_by_one(
    scenarios, raced, monkeypatch
):
    refused(r"parameters .*\(2, 3\)", evaluate, scenarios, np.zeros((2, 3)))
    alone = race_policies((scenarios, policies(5)[3:4]))
    for key, values in alone.items():
        np.testing.assert_array_equal(values[0], raced[key][3])
    monkeypatch.setattr(evaluation, "RACES_AT_ONCE", 1)
    for key, values in race_policies((scenarios, policies(5))).items():
        np.testing.assert_array_equal(values, raced[key])


def test_the_spread_is_that_of_a_mean_over_races():
    """With equally many segments in all races, the textbook's standard error; as good where crashes
    cut races short.
    """

    def nobody(policies: int) -> dict[str, np.ndarray]:
        """Races without a winner."""
        none = np.zeros((policies, 50), bool)
        return {"winner": np.full((policies, 50), -1), "crashed": none, "rival": none}

    rng = np.random.default_rng(0)
    totals = rng.normal(3.0, 2.0, (4, 50, 1))
    own_crash = np.zeros((4, 50), bool)
    whole = summarise(
        {"totals": totals, "segments": np.full((4, 50), 2), "own_crash": own_crash, **nobody(4)}
    )
    np.testing.assert_allclose(
        whole.spread[:, 0], (totals[..., 0] / 2.0).std(axis=1, ddof=1) / np.sqrt(50.0)
    )
    segments = rng.integers(1, 3, (4000, 50))
    values = rng.normal(3.0, 2.0, (4000, 50, 1)) + 3.0 * (segments[..., None] - 1)
    # A win, a tie, a crash that pays nobody and a loss against rivals; the last race does not
    # count.
    raced = {
        "winner": np.array([[0, -1, -1, 1, 0]]),
        "crashed": np.array([[False, False, True, True, False]]),
    }
    raced |= {
        "rival": np.arange(5)[None] < 4,
        "own_crash": raced["crashed"],
        "segments": np.ones((1, 5)),
    }
    judged = summarise({**raced, "totals": np.arange(5.0)[None, :, None]})
    assert (judged.score[0], judged.won[0], judged.own_crash[0]) == (1.5 / 4, 0.4, 0.4)
    cut = summarise(
        {
            "totals": values,
            "segments": segments,
            "own_crash": np.zeros((4000, 50), bool),
            **nobody(4000),
        }
    )
    assert cut.spread.mean() == pytest.approx(cut.coordinates.std(), rel=0.06)


def test_impossible_races_and_characteristics_that_are_no_number(oval, monkeypatch):
    for change, message in [
        ({"tracks": []}, "there are no tracks"),
        ({"opponents": np.zeros((0, 17))}, r"there are no opponents"),
        ({"opponents": np.zeros((3, 2))}, r"opponents has shape \(3, 2\)"),
        ({"segment_seconds": 3.0}, r"4 s .*segment_seconds, 3 s"),
        ({"segment_seconds": 0.0}, "segment_seconds, 0 s"),
        ({"starts": 0}, "start_lines is 0"),
        ({"characteristics": ("pace", "charm")}, "characteristic 'charm' is unknown"),
        ({"config": load_race_config("paper", start_spacing=5.0, duration=4.0)}, "has no place"),
    ]:
        given = {
            "tracks": [oval],
            "config": SHORT,
            "opponents": policies(2),
            "characteristics": AXES,
        }
        given["segment_seconds"] = 2.0
        refused(message, draw_scenarios, **{**given, **change})
    broken = Characteristic(
        "broken", "1", "for a test", lambda segment: segment.progress / 0.0 - np.inf
    )
    monkeypatch.setattr(
        characteristics, "_registered", {**characteristics._registered, "broken": broken}
    )
    scenarios = draw_scenarios(
        [oval], SHORT, policies(1), ("pace", "broken"), starts=1, segment_seconds=2.0
    )
    with (
        np.errstate(all="ignore"),
        pytest.raises(InputError, match="characteristic 'broken' is nan in race 0 of policy 0"),
    ):
        evaluate(scenarios, policies(2))
