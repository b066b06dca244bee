from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_rules, racer
from pcs_racing.game.make import make_game
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.base.style import picture_bytes
from pcs_racing_agents.tournament import RaceRow, Tournament
from pcs_racing_agents.tournament.plan import TournamentPlan
from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import concatenate_races
from pcs_racing_agents.tournament.scores import clustered_score, score_races

CONTEST = load_rules("contest", duration=6.0)


def race(ego: str, opponent: str, **result: object) -> RaceRow:
    return RaceRow(ego=ego, opponent=opponent, track="t", **result)


SINGLE = load_rules(CONTEST, heats=1)


def played(*rows: RaceRow, rules=SINGLE) -> Tournament:
    competitors = tuple(PolicySet(name, (racer("lattice"),)) for name in "ab")
    tracks = SimpleNamespace(name="oval"), SimpleNamespace(name="Pipkin")
    plan = TournamentPlan(competitors, tracks, make_game(None, "default", rules), (), 2, 0)
    return Tournament(plan, race_table(rows))


ROWS = [
    race("a", "b", winner="ego", lead=3.0, ego_overtakes=2),
    race("a", "b", winner="opponent", lead=-3.0),
    race("a", "b"),  # a tie
    race("a", "b", winner="opponent", crash="wall", fault="ego"),
    race("a", "b", winner="ego", crash="car", fault="opponent"),
    race("b", "a", crash="car", fault="both"),
    race("b", "a", winner="ego", lead=1.0, opponent_overtakes=1),
    race("b", "a", winner="ego", lead=1.0, ego_overtakes=1),
]

TEXT = """\
oval, Pipkin, rules contest, seed 0: 8 races of 6 s, 62% without a crash, 38% with an overtake
agent  races  score            95 %  own crashes  others'  rating  95 %  equilibrium
b          8  0.562  [0.148, 0.977]        25.0%    12.5%     +59     -         1.00
a          8  0.312  [0.000, 0.695]        25.0%    12.5%     -59     -         0.00

score against    (1)    (2)
(1) b              -  0.562
(2) a          0.312      -

score: races won, a tie counting half; a crash is won by the car not to blame
rating: Bradley-Terry, 400 are odds of 10
equilibrium: probability of each agent in the game of choosing an agent
Final gaps: of the 5 races without a crash 100% ended within 5 m and 100% within 20 m; \
the median gap was 1.0 m."""


def test_the_table_counts_every_ending_once():
    result = played(*ROWS)
    b, a = result.standings
    assert (a.name, b.name) == ("a", "b")
    assert a.score.races == b.score.races == 8
    assert (a.score.own_crash, a.score.other_crash) == (2 / 8, 1 / 8)
    assert (b.score.own_crash, b.score.other_crash) == (2 / 8, 1 / 8)
    # a win, a crash that the other pays for, half a tie
    assert a.score.mean == pytest.approx((2 + 0.5) / 8)
    assert b.score.mean == pytest.approx((4 + 0.5) / 8)
    assert str(result) == TEXT
    by_laps = str(played(*ROWS, rules=load_rules("contest", laps=2, heats=1)))
    assert "8 races of 2 laps (at most 80 s)," in by_laps
    np.testing.assert_allclose(result.scores, [[np.nan, 2.5 / 8], [4.5 / 8, np.nan]])


def test_races_are_seen_by_each_car_and_turned_back(tournament):
    for name in tournament.plan.names:
        own = tournament.races.seen_by(name)
        assert {own.agents.words[code] for code in own.agents.codes[:, 0].tolist()} == {name}
        both = {(row.track, row.race, *sorted((row.ego, row.opponent))) for row in own}
        raced = [row for row in tournament.races if name in (row.ego, row.opponent)]
        assert len(both) == len(own) == len(raced)
        for row in own:
            turned = row._replace(
                ego=row.opponent, opponent=row.ego, side=1 - row.side, lead=-row.lead,
                winner={"ego": "opponent", "opponent": "ego", "none": "none"}[row.winner],
                fault={"ego": "opponent", "opponent": "ego"}.get(row.fault, row.fault),
                **{
                    f"{one}_{what}": getattr(row, f"{other}_{what}")
                    for one, other in (("ego", "opponent"), ("opponent", "ego"))
                    for what in ("overtakes", "variant", "path", "moves", "best_lap")
                },
            )  # fmt: skip
            assert row in raced or turned in raced


def test_opponents_of_another_strength_do_not_widen_an_interval():
    rows = [
        race("a", opponent, winner=winner, start_s=float(line), ego_variant=line % 3)
        for opponent, winner in (("b", "ego"), ("c", "opponent"))
        for line in range(6)
    ]
    races = race_table(rows)
    assert clustered_score(races, races.score) == pytest.approx((0.5, 0.5, 0.5))


def test_intervals_are_robust_to_places_and_policies(mixed):
    races = mixed.races.seen_by("random-moves")
    score = score_races(races)
    mean, low, high = clustered_score(races, races.score)
    assert (score.mean, score.low, score.high) == (mean, max(low, 0.0), min(high, 1.0))
    # A second copy of the races has no new information.
    twice = clustered_score(concatenate_races([races, races]), np.tile(races.score, 2))
    assert (twice[0], twice[2]) == pytest.approx((mean, high))


@pytest.mark.parametrize("shared", ["ego_variant", "start_s"])
def test_more_races_of_the_same_start_policy_or_place_are_no_more_evidence(shared):
    other, width = {"ego_variant": "start_s", "start_s": "ego_variant"}[shared], []
    for copies in (4, 8):
        ends = [(k, j, "ego" if k % 3 else "opponent") for k in range(6) for j in range(copies)]
        rows = [race("a", "b", winner=end, **{shared: k, other: 9 * k + j}) for k, j, end in ends]
        _, low, high = clustered_score(races := race_table(rows), races.score)
        width.append(high - low)
    assert width[0] == pytest.approx(width[1], rel=0.02)


def test_a_no_contest_scores_nothing_and_an_undecided_tournament_has_no_rating(tournament):
    rows = [race("a", "b", crash="car", fault="both"), race("a", "b", crash="wall", fault="ego")]
    result = played(*rows, rules=load_rules("paper"))
    assert {(one.name, one.score.mean, one.score.own_crash) for one in result.standings} == {
        ("a", 0.0, 1.0),
        ("b", 0.0, 0.5),
    }
    assert [one.equilibrium for one in result.standings] == [0.5, 0.5]
    assert "rating" not in str(result)
    ties = str(played(race("a", "b"), race("b", "a")))
    assert "rating" not in ties
    assert ties.count("0.50\n") == 2
    strange = race_table([tournament.races[0]._replace(opponent="somebody")])
    stranger = replace(tournament, races=strange)
    refused("'somebody' raced, but is not one of lattice:", lambda: stranger.standings)


def test_best_of_three_counts_as_one_race():
    """Series of 2 to 1, 1 to 1 and a tie, and 0 to 2."""
    ends = ["ego", "opponent", "ego", "opponent", "ego", "none", "opponent", "opponent"]
    rows = [race("a", "b", race=i, winner=end) for i, end in enumerate(ends)]
    rules = load_rules("roboracer", duration=6.0)
    result = played(*rows, rules=rules)
    assert result.series.winner.tolist() == [0, -1, 1]
    assert {(one.name, one.score.mean, one.score.races) for one in result.standings} == {
        ("a", 0.5, 8),
        ("b", 0.5, 8),
    }
    assert "best of 3 won" in str(result)
    rows = [race("a", "b", race=i, winner="ego", crash="car", fault="opponent") for i in range(3)]
    a, b = (one.score for one in played(*rows, rules=rules).standings)
    assert (a.mean, b.mean, b.own_crash) == (1.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("legs", "winner"),
    [
        (((8.0, "none"), (-8.05, "none")), -1),  # below .1 m
        (((8.0, "none"), (-7.8, "none")), 0),
        (((3.0, "none"), (-2.0, "ego")), 1),  # -2 - 20 m
        (((-30.0, "opponent"), (9.0, "none")), 1),
        (((1.0, "both"), (1.0, "none")), 0),
    ],
)
def test_two_legs_are_won_by_the_sum_of_leads_less_faults(legs, winner):
    rows = [
        race("a", "b", race=k, lead=lead, fault=fault, crash="none" if fault == "none" else "car")
        for k, (lead, fault) in enumerate(legs)
    ]
    result = played(*rows, rules=load_rules("contest"))
    assert result.series.winner.tolist() == [winner]
    assert "2 races of 40 s in 1 series" in str(result)


def test_the_picture_holds_each_number_at_its_place(tournament):
    """The best competitor on top; scores in cells, in digits that can be read."""
    means, matrix = tournament.plot().axes
    order = [tournament.plan.names.index(one.name) for one in tournament.standings]
    names = [tournament.plan.names[i] for i in order]
    assert [label.get_text() for label in means.get_yticklabels()] == names
    for k, one in enumerate(tournament.standings):
        interval, mean = means.lines[1 + 2 * k : 3 + 2 * k]
        assert interval.get_xydata().tolist() == [[one.score.low, k], [one.score.high, k]]
        assert mean.get_xydata().tolist() == [[one.score.mean, k]]
    scores = tournament.scores[np.ix_(order, order)]
    (image,) = matrix.images
    np.testing.assert_array_equal(image.get_array().filled(np.nan), scores)
    cells = {text.get_position(): text.get_text() for text in matrix.texts}
    assert cells == {(j, i): f"{scores[i, j]:.2f}" for i in range(3) for j in range(3) if i != j}
    assert picture_bytes(tournament.plot()) == picture_bytes(tournament.plot())
