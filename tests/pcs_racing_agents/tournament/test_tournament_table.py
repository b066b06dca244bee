from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_race_config, racer
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.agents import make_game_spec
from pcs_racing_agents.tournament import RaceRow, Tournament, game_rules
from pcs_racing_agents.tournament.pictures import payoffs_picture, ratings_picture
from pcs_racing_agents.tournament.play import TournamentPlan
from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import concatenate_races
from pcs_racing_agents.tournament.ratings import rate
from pcs_racing_agents.tournament.table import (
    standings,
    tournament_text,
)

CONTEST = load_race_config("contest", duration=6.0)


def race(ego: str, opponent: str, **result: object) -> RaceRow:
    return RaceRow(ego=ego, opponent=opponent, track="t", **result)


def played(*rows: RaceRow, config=CONTEST) -> Tournament:
    competitors = tuple(PolicySet(name, (racer("lattice"),)) for name in "ab")
    tracks = SimpleNamespace(name="oval"), SimpleNamespace(name="Pipkin")
    plan = TournamentPlan(
        competitors, tracks, make_game_spec("default", game_rules(config)), (), 2, 0
    )
    return Tournament(plan, race_table(rows))


TEXT = """\
8 races of 6 s, preset contest, on oval, Pipkin; seed 0
62% finished, 38% with an overtake
How close the races were: of the 5 without a crash 100% ended within 5 m and 100% within 20 m; \
the median gap was 1.0 m.

agent  races  score  rating  95 %    win    tie   loss  crash: own  other's  overtakes  equilibrium
b          8  0.562     +59     -  37.5%  12.5%  12.5%       25.0%    12.5%       0.12         1.00
a          8  0.312     -59     -  12.5%  12.5%  37.5%       25.0%    12.5%       0.38         0.00

score against    (1)    (2)
(1) b              -  0.562
(2) a          0.312      -

score: races won, a tie counting half; a crash is won by the car not to blame; rating: \
Bradley-Terry, 400 are odds of 10, start lines drawn again for the interval
equilibrium: probability of each agent in the game of choosing an agent"""


def test_the_table_counts_every_ending_once():
    rows = [
        race("a", "b", winner="ego", lead=3.0, ego_overtakes=2),
        race("a", "b", winner="opponent", lead=-3.0),
        race("a", "b"),  # a tie
        race("a", "b", winner="opponent", crash="wall", fault="ego"),
        race("a", "b", winner="ego", crash="car", fault="opponent"),
        race("b", "a", crash="car", fault="both"),
        race("b", "a", winner="ego", lead=1.0, opponent_overtakes=1),
        race("b", "a", winner="ego", lead=1.0, ego_overtakes=1),
    ]
    b, a = standings(played(*rows))
    assert (a.name, b.name) == ("a", "b")
    assert a.races == b.races == 8
    assert (a.win, a.tie, a.loss, a.own_crash, a.other_crash) == (1 / 8, 1 / 8, 3 / 8, 2 / 8, 1 / 8)
    assert (b.win, b.tie, b.loss, b.own_crash, b.other_crash) == (3 / 8, 1 / 8, 1 / 8, 2 / 8, 1 / 8)
    # a win, a crash that the other pays for, half a tie
    assert a.score == pytest.approx((2 + 0.5) / 8)
    assert b.score == pytest.approx((4 + 0.5) / 8)
    assert (a.overtakes, b.overtakes) == (3 / 8, 1 / 8)
    assert tournament_text(played(*rows)) == TEXT
    by_laps = tournament_text(played(*rows, config=load_race_config("contest", laps=2)))
    assert by_laps.startswith("8 races of 2 laps (at most 80 s), preset contest, on oval")
    matrix = played(*rows).summary.scores
    np.testing.assert_allclose(matrix, [[np.nan, 2.5 / 8], [4.5 / 8, np.nan]])


def test_a_no_contest_scores_nothing_and_races_from_one_place_are_one_unit(tournament):
    rows = [race("a", "b", crash="car", fault="both"), race("a", "b", crash="wall", fault="ego")]
    table = standings(played(*rows, config=load_race_config("paper")))
    assert [standing.score for standing in table] == [0.0, 0.0]
    assert {(s.name, s.own_crash, s.other_crash) for s in table} == {
        ("a", 1.0, 0.0),
        ("b", 0.5, 0.5),
    }
    stranger = replace(
        tournament, races=race_table([tournament.races[0]._replace(opponent="somebody")])
    )
    refused("'somebody' raced, but is not one of lattice:", standings, stranger)
    # Whatever their numbers: twice the races from the same places tell no more than once.
    doubled = replace(tournament.races, race=tournament.races.race + 6)
    both = concatenate_races([tournament.races, doubled])
    once, twice = (replace(tournament, races=races).summary for races in (tournament.races, both))
    name = tournament.plan.names[0]
    assert once.ratings.low[0] == pytest.approx(twice.ratings.low[0], abs=0.5), name


def test_best_of_three_counts_as_one_race():
    """Series of 2 to 1, 1 to 1 and a tie, and 0 to 2."""
    ends = ["ego", "opponent", "ego", "opponent", "ego", "none", "opponent", "opponent"]
    rows = [race("a", "b", race=i, winner=end) for i, end in enumerate(ends)]
    tournament = played(*rows, config=load_race_config("roboracer", duration=6.0))
    assert tournament.series.winner.tolist() == [0, -1, 1]
    assert {(s.name, s.score, s.races) for s in standings(tournament)} == {
        ("a", 0.5, 8),
        ("b", 0.5, 8),
    }
    assert "best of 3 won" in tournament_text(tournament)
    crashed = [
        race("a", "b", race=i, winner="ego", crash="car", fault="opponent") for i in range(3)
    ]
    a, b = standings(played(*crashed, config=load_race_config("roboracer", duration=6.0)))
    assert (a.score, b.score, b.own_crash) == (1.0, 0.0, 1.0)


def test_pictures_hold_each_number_at_its_place():
    """Scores in the cells of their agents, in digits that can be read; ratings below each other,
    the best on top.
    """
    scores = np.array([[np.nan, 1.0, 0.625], [0.0, np.nan, np.nan], [0.375, np.nan, np.nan]])
    (axes,) = payoffs_picture(["one", "two", "three"], scores).axes
    (image,) = axes.images
    assert image.get_clim() == (-0.15, 1.15)  # so that neither end of the scale is black
    np.testing.assert_array_equal(image.get_array().filled(np.nan), scores)
    cells = {
        text.get_position(): (text.get_text(), text.get_color() == "white") for text in axes.texts
    }
    assert cells == {
        (1, 0): ("1.00", True),
        (2, 0): ("0.62", False),
        (0, 1): ("0.00", True),
        (0, 2): ("0.38", False),
    }
    labels = [label.get_text() for label in axes.yaxis.get_ticklabels()]
    assert labels == ["one", "two", "three"]
    races = (["a", "b", "a"] * 10, ["b", "c", "c"] * 10, [-1, 1, 1] * 5 + [1, -1, -1] * 5)
    ratings = rate(*races, rng=np.random.default_rng(0), replicates=100)
    ratings = replace(ratings, strength=np.array([0.0, 1.0, -1.0]))
    (axes,) = ratings_picture(ratings).axes
    _, *lines = (line.get_xydata() for line in axes.lines)
    elo = 400.0 / np.log(10.0)
    best = [[elo * ratings.low[1], 0.0], [elo * ratings.high[1], 0.0]]
    assert lines[0] == pytest.approx(np.array(best))
    assert [line[0, 0] for line in lines[1::2]] == pytest.approx([elo, 0.0, -elo])
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == ["b", "a", "c"]


def test_a_tournament_prints_scores_with_intervals_and_own_crashes(tournament):
    standing = {one.name: one for one in standings(tournament)}
    for one in tournament.scores:
        assert one.score == pytest.approx(standing[one.agent].score)
        assert one.own_crash == standing[one.agent].own_crash
        assert one.low <= one.score <= one.high
    lines = str(tournament).splitlines()
    assert lines[1].split() == ["agent", "races", "score", "95", "%", "own", "crashes"]
    assert f"{tournament.scores[0].score:.3f}" in lines[2]
    assert len(tournament.plot().axes[0].get_yticklabels()) == len(tournament.plan.names)
