"""Races of policies by the scenarios of a configuration, and their summary."""

from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError, load_track, racer
from pcs_racing.game import characteristics
from pcs_racing.game.characteristics import Characteristic, Segment, get_characteristics, measure
from pcs_racing.game.reward import reward, sum_winners
from pcs_racing.planners.lattice import LATTICE, REFERENCE
from pcs_racing.planners.planner import Policy
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import SUMS
from pcs_racing_agents.policies.config import FrontConfig
from pcs_racing_agents.policies.evaluate import draw_scenarios, race_policies, summarise

CONFIG = FrontConfig(
    rules="contest",
    tracks=("Tarnfjord", "Pipkin"),
    characteristics=("pace", "restraint"),
    duration=4.0,
    final_duration=4.0,
    segment_seconds=2.0,
)
SHORT = CONFIG.race_rules


def policies(count, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([REFERENCE.sample(rng) for _ in range(count)])


def drawn(opponents=3, seed=4, rivals=(), **changes):
    config = replace(CONFIG, **changes)
    return draw_scenarios(
        config.planner,
        config.tracks,
        config.rules_of(4.0),
        opponents=policies(opponents, 1),
        rivals=rivals,
        characteristics=config.axes,
        segment_seconds=config.segment_seconds,
        starts=2,
        seed=seed,
    )


@pytest.fixture(scope="module")
def scenarios():
    return drawn()


@pytest.fixture(scope="module")
def raced(scenarios):
    return race_policies((scenarios, policies(5)))


def by_hand(scenarios, races, ego, opponent_theta, planner=LATTICE):
    """Return setup, state and parameters of some races of a policy."""
    track = load_track(scenarios.tracks[scenarios.track[races[0]]])
    setup = RaceSetup(track, SHORT, (LATTICE, planner))
    starts = Starts(scenarios.start_s[races], scenarios.side[races])
    state = start_races(setup, starts, scenarios.seed[races])
    own = pad_parameters([Policy(LATTICE, ego, "own")], setup.theta_size)[0]
    other = np.pad(opponent_theta, ((0, 0), (0, setup.theta_size - opponent_theta.shape[1])))
    return setup, state, np.stack([np.tile(own, (len(races), 1)), other], axis=1)


def test_every_start_is_paired_with_every_opponent_in_races_drawn_from_the_seed(scenarios):
    assert len(scenarios) == 2 * 2 * 3 * 2
    for track in range(2):
        here = scenarios.track == track
        lines = np.unique(scenarios.start_s[here])
        assert len(lines) == 2
        columns = (scenarios.start_s, scenarios.opponent, scenarios.side)
        met = set(zip(*(column[here].tolist() for column in columns), strict=True))
        assert met == {(line, k, side) for line in lines for k in range(3) for side in range(2)}
    legs = scenarios.seed.reshape(-1, 2)
    assert len(set(legs[:, 0].tolist())) == len(legs) == (legs[:, 0] == legs[:, 1]).sum()
    again, other = drawn(), drawn(seed=5)
    for key in ("track", "start_s", "side", "seed", "opponent"):
        np.testing.assert_array_equal(getattr(again, key), getattr(scenarios, key))
    assert not np.isin(other.seed, scenarios.seed).any()
    # another track does not disturb the first
    alone = drawn(tracks=("Tarnfjord",))
    np.testing.assert_array_equal(alone.seed, scenarios.seed[:12])


def test_coordinates_are_means_over_the_segments(scenarios, raced):
    """One policy's races on the first track, driven here by hand."""
    races = np.arange(12)
    opponents = scenarios.opponents[scenarios.opponent[races]]
    setup, state, theta = by_hand(scenarios, races, policies(5)[2], opponents)
    totals, segments = np.zeros((12, 2)), np.zeros(12)
    for _ in range(2):
        before = state.copy()
        advance(setup, state, theta, 200)
        segment = Segment.between(before, state, 2.0)
        values = measure(segment, get_characteristics(CONFIG.axes))[:, 0]
        totals[segment.time > 0.0] += values[segment.time > 0.0]
        segments += segment.time > 0.0
    np.testing.assert_array_equal(raced["totals"][2, :12], totals)
    np.testing.assert_array_equal(raced["segments"][2, :12], segments)
    np.testing.assert_array_equal(raced["own_crash"][2, :12], state.fault[:, 0] == 1)
    np.testing.assert_array_equal(raced["crashed"][2, :12], state.crashed)
    found = summarise(raced)
    np.testing.assert_allclose(
        found.coordinates, raced["totals"].sum(axis=1) / raced["segments"].sum(axis=1)[:, None]
    )
    np.testing.assert_array_equal(found.own_crash, raced["own_crash"].mean(axis=1))


def test_a_pooled_coordinate_is_the_value_of_all_races_together():
    """Speed behind less speed in front, in whole races; its standard error is the jackknife's."""
    scenarios = drawn(characteristics=("speed", "reaction"), tracks=("Tarnfjord",))
    found = summarise(race_policies((scenarios, policies(2))))
    names = ("PROFILE_BEHIND", "TIME_BEHIND", "PROFILE", "TIME")
    columns = [list(SUMS).index(name) for name in names]
    races = np.arange(len(scenarios))
    opponents = scenarios.opponents[scenarios.opponent]
    setup, state, theta = by_hand(scenarios, races, policies(2)[1], opponents)
    advance(setup, state, theta, 400)
    sums = state.sums[:, 0][:, columns]

    def reaction(rows):
        profile_behind, behind, profile, time = rows.sum(axis=0)
        return profile_behind / behind - (profile - profile_behind) / (time - behind)

    assert found.coordinates[1, 1] == pytest.approx(reaction(sums))
    without = np.array([reaction(np.delete(sums, race, axis=0)) for race in races])
    assert found.spread[1, 1] == pytest.approx(np.sqrt((len(races) - 1) * without.var()))


def test_rivals_of_other_planners_are_met_as_often_as_opponents_and_scored():
    rivals = ("pure-pursuit:pace=0", "lane-switcher", "pure-pursuit:pace=1")
    scenarios = drawn(1, tracks=("Tarnfjord",), rivals=rivals)
    assert np.bincount(scenarios.opponent).tolist() == [4, 4, 4, 4]
    raced = race_policies((scenarios, policies(3)))
    for number, rival in enumerate(rivals, start=1):
        races, policy = np.flatnonzero(scenarios.opponent == number), racer(rival)
        opponents = np.tile(policy.parameters, (len(races), 1))
        setup, state, theta = by_hand(scenarios, races, policies(3)[1], opponents, policy.planner)
        advance(setup, state, theta, SHORT.ticks)
        leads = reward(SHORT, state, np.zeros(len(races), np.int64))
        series = np.repeat(sum_winners(SHORT, leads[::2] + leads[1::2]), 2)
        np.testing.assert_array_equal(raced["winner"][1, races], series)
    lost = (raced["winner"] == 1) | ((raced["winner"] < 0) & raced["crashed"])
    points = np.where(lost, 0.0, np.where(raced["winner"] == 0, 1.0, 0.5))
    np.testing.assert_allclose(summarise(raced).score, points.mean(axis=1))


def test_policies_do_not_disturb_each_other(scenarios, raced, processes):
    task = (scenarios, policies(5)[3:])
    for key, values in processes.submit(race_policies, task).result().items():
        np.testing.assert_array_equal(values, raced[key][3:], err_msg=key)


def test_the_spread_is_the_standard_error_of_a_mean_over_races():
    """The textbook's with equally many segments in all races; as good where crashes cut races
    short.
    """

    def summary(totals, segments):
        none = np.zeros(totals.shape[:2], bool)
        rest = dict.fromkeys(("own_crash", "crashed"), none)
        winner = np.full(none.shape, -1)
        return summarise({"totals": totals, "segments": segments, "winner": winner, **rest})

    rng = np.random.default_rng(0)
    totals = rng.normal(3.0, 2.0, (4, 50, 1))
    whole = summary(totals, np.full((4, 50), 2))
    expected = (totals[..., 0] / 2.0).std(axis=1, ddof=1) / np.sqrt(50.0)
    np.testing.assert_allclose(whole.spread[:, 0], expected)
    segments = rng.integers(1, 3, (4000, 50))
    cut = summary(rng.normal(3.0, 2.0, (4000, 50, 1)) + 3.0 * (segments[..., None] - 1), segments)
    assert cut.spread.mean() == pytest.approx(cut.coordinates.std(), rel=0.06)


def test_tracks_without_room_and_characteristics_that_are_no_number_are_refused(
    monkeypatch, scenarios
):
    refused("start_lines is 0", draw_scenarios, "lattice", ["Pipkin"], SHORT, starts=0, seed=0)
    broken = Characteristic(
        "broken", "1", "for a test", lambda segment: segment.progress / 0.0 - np.inf
    )
    registered = {**characteristics._registered, "broken": broken}
    monkeypatch.setattr(characteristics, "_registered", registered)
    wrong = replace(scenarios, characteristics=("pace", "broken"))
    with (
        np.errstate(all="ignore"),
        pytest.raises(InputError, match="characteristic 'broken' is nan in race 0; it must be"),
    ):
        race_policies((wrong, policies(2)))
