from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from refusal import refused

from pcs_racing import load_race_config, parse_policy
from pcs_racing_agents.agents import Driver, make_setting
from pcs_racing_agents.results.race_files import race_table
from pcs_racing_agents.results.races import concatenate_races
from pcs_racing_agents.tournament import RaceRow, Tournament, game_rules
from pcs_racing_agents.tournament.play import TournamentPlan
from pcs_racing_agents.tournament.table import payoff_matrix, payoff_picture, standings, sum_up, tournament_text

CONTEST = load_race_config("contest", duration=6.0)


def race(ego: str, opponent: str, **result: object) -> RaceRow:
    return RaceRow(ego=ego, opponent=opponent, track="t", **result)


def played(*rows: RaceRow, config=CONTEST) -> Tournament:
    drivers = tuple(Driver(name, (parse_policy("lattice"),)) for name in "ab")
    plan = TournamentPlan(drivers, (), make_setting("default", game_rules(config)), (), 2, 0)
    return Tournament(plan, race_table(rows))


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
    assert a.score == pytest.approx((2 + 0.5) / 8)  # a win, a crash that the other pays for, half a tie
    assert b.score == pytest.approx((4 + 0.5) / 8)
    assert (a.overtakes, b.overtakes) == (3 / 8, 1 / 8)
    text = tournament_text(played(*rows))
    assert "62% finished, 38% with an overtake\nHow close the races were: of the 5 without a crash 100% ended" in text
    matrix = payoff_matrix(played(*rows))
    np.testing.assert_allclose(matrix, [[np.nan, 2.5 / 8], [4.5 / 8, np.nan]])


def test_a_crash_that_pays_nobody_scores_nothing_and_races_from_one_place_are_one_unit(tournament):
    rows = [race("a", "b", crash="car", fault="both"), race("a", "b", crash="wall", fault="ego")]
    table = standings(played(*rows, config=load_race_config("paper")))
    assert [standing.score for standing in table] == [0.0, 0.0]
    assert {(s.name, s.own_crash, s.other_crash) for s in table} == {("a", 1.0, 0.0), ("b", 0.5, 0.5)}
    stranger = replace(tournament, races=race_table([tournament.races[0]._replace(opponent="somebody")]))
    refused("'somebody' raced, but is not one of lattice:", standings, stranger)
    # Whatever their numbers: twice the races from the same places tell no more than once.
    doubled = replace(tournament.races, race=tournament.races.race + 6)
    both = concatenate_races([tournament.races, doubled])
    once, twice = (sum_up(replace(tournament, races=races)) for races in (tournament.races, both))
    assert once.noise > 0.0
    assert twice.noise == pytest.approx(once.noise)


def test_best_of_three_counts_as_one_race():
    """Series of 2 to 1, 1 to 1 and a tie, and 0 to 2."""
    ends = ["ego", "opponent", "ego", "opponent", "ego", "none", "opponent", "opponent"]
    rows = [race("a", "b", race=i, winner=end) for i, end in enumerate(ends)]
    tournament = played(*rows, config=load_race_config("roboracer", duration=6.0))
    assert tournament.series.winner.tolist() == [0, -1, 1]
    assert {(s.name, s.score, s.races) for s in standings(tournament)} == {("a", 0.5, 8), ("b", 0.5, 8)}
    assert "best of 3 won" in tournament_text(tournament)
    crashed = [race("a", "b", race=i, winner="ego", crash="car", fault="opponent") for i in range(3)]
    a, b = standings(played(*crashed, config=load_race_config("roboracer", duration=6.0)))
    assert (a.score, b.score, b.own_crash) == (1.0, 0.0, 1.0)


def test_the_text_and_the_picture_hold_the_table(tournament, mixed, tmp_path):
    text = tournament_text(tournament)
    assert text.startswith("36 races of 6 s, preset contest, on oval, Pipkin; seed 4\n")
    for name in tournament.plan.names:
        assert text.count(name) == 2  # once in the table, once in the matrix
    assert "a crash is won by the car not to blame" in text
    path = payoff_picture(mixed, tmp_path / "payoffs.png")
    with Image.open(path) as picture:
        assert min(picture.size) > 300
    assert payoff_picture(mixed, tmp_path / "payoffs.svg").read_text().startswith("<?xml")
