import csv

import numpy as np
import pytest

from pcs_racing import InputError, load_race_config, load_track, parse_policy, record_race
from pcs_racing_agents.tournament import (
    RaceRow,
    Tournament,
    payoff_matrix,
    play_tournament,
    show_progress,
    standings,
    tournament_text,
    write_results,
)

CONTEST = load_race_config("contest", duration=6.0)
POLICIES = [parse_policy(f"lattice:pace={pace}") for pace in (0.0, 0.5, 1.0)]


@pytest.fixture(scope="module")
def tournament(oval) -> Tournament:
    return play_tournament([oval, load_track("Pipkin")], POLICIES, CONTEST, races_per_pair=6, seed=4)


def test_every_pair_meets_on_every_track(tournament):
    assert tournament.policies == ("lattice:pace=0.0", "lattice:pace=0.5", "lattice:pace=1.0")
    assert tournament.tracks == ("oval", "Pipkin")
    assert len(tournament.rows) == 2 * 3 * 6
    met = {(row.track, row.ego, row.opponent) for row in tournament.rows}
    assert len(met) == 2 * 3


def test_all_pairs_drive_the_same_races(tournament):
    """Common random numbers: race k has the same line, side and noise for each pair; both sides of each line."""
    for track in tournament.tracks:
        rows = [row for row in tournament.rows if row.track == track]
        starts = {row.race: (row.start_s, row.side) for row in rows}
        assert all(starts[row.race] == (row.start_s, row.side) for row in rows)
        assert [starts[k][1] for k in range(6)] == [0, 1] * 3
        assert [starts[k][0] for k in (0, 2, 4)] == [starts[k][0] for k in (1, 3, 5)]
        assert len({s for s, _ in starts.values()}) == 3  # no race is driven twice


def test_a_tournament_repeats(tournament, oval):
    again = play_tournament([oval, load_track("Pipkin")], POLICIES, CONTEST, races_per_pair=6, seed=4)
    assert again.rows == tournament.rows
    other = play_tournament(oval, POLICIES, CONTEST, races_per_pair=6, seed=5)
    assert other.rows != tournament.rows[:18]


def test_a_race_of_a_tournament_can_be_watched(tournament, oval):
    row = tournament.rows[3]
    ego, opponent = parse_policy(row.ego), parse_policy(row.opponent)
    replay = record_race(oval, ego, opponent, tournament.config, seed=row.seed, index=row.race)
    assert replay.lead[-1] == row.lead


def race(ego: str, opponent: str, **result: object) -> RaceRow:
    row = {"track": "t", "race": 0, "start_s": 0.0, "side": 0, "seed": 0, "lead": 0.0, "winner": "", "crash": ""}
    row |= {"fault": "", "ego_overtakes": 0, "opponent_overtakes": 0, "duration": 40.0}
    return RaceRow(ego=ego, opponent=opponent, **(row | result))


def played(*rows: RaceRow, config=CONTEST) -> Tournament:
    return Tournament(("a", "b"), ("t",), config, 2, 0, rows)


def test_the_table_counts_every_ending_once():
    rows = [
        race("a", "b", winner="ego", lead=3.0, ego_overtakes=2),
        race("a", "b", winner="opponent", lead=-3.0),
        race("a", "b"),  # a tie
        race("a", "b", winner="opponent", crash="wall", fault="ego"),
        race("a", "b", winner="ego", crash="car", fault="opponent"),
        race("b", "a", crash="car", fault="both"),
        race("b", "a", winner="ego", lead=1.0, opponent_overtakes=1),
        race("b", "a", winner="ego", lead=1.0),
    ]
    b, a = standings(played(*rows))
    assert (a.name, b.name) == ("a", "b")
    assert a.races == b.races == 8
    assert (a.win, a.tie, a.loss, a.own_crash, a.other_crash) == (1 / 8, 1 / 8, 3 / 8, 2 / 8, 1 / 8)
    assert (b.win, b.tie, b.loss, b.own_crash, b.other_crash) == (3 / 8, 1 / 8, 1 / 8, 2 / 8, 1 / 8)
    assert a.score == pytest.approx((2 + 0.5) / 8)  # a win, a crash that the other pays for, half a tie
    assert b.score == pytest.approx((4 + 0.5) / 8)
    assert (a.overtakes, b.overtakes) == (3 / 8, 0.0)
    matrix = payoff_matrix(played(*rows))
    np.testing.assert_allclose(matrix, [[np.nan, 2.5 / 8], [4.5 / 8, np.nan]])


def test_after_a_crash_that_pays_nobody_nobody_scores():
    rows = [race("a", "b", crash="car", fault="both"), race("a", "b", crash="wall", fault="ego")]
    table = standings(played(*rows, config=load_race_config("paper")))
    assert [standing.score for standing in table] == [0.0, 0.0]
    assert {(s.name, s.own_crash, s.other_crash) for s in table} == {("a", 1.0, 0.0), ("b", 0.5, 0.5)}


def test_shares_and_payoffs_add_up(tournament):
    for standing in standings(tournament):
        assert sum(standing[3:8]) == pytest.approx(1.0)
        assert standing.races == 2 * 2 * 6
    matrix = payoff_matrix(tournament)
    assert np.isnan(np.diag(matrix)).all()
    both_to_blame = any(row.fault == "both" for row in tournament.rows)
    rest = (matrix + matrix.T)[~np.eye(3, dtype=bool)]
    assert ((rest <= 1.0 + 1e-12) & ((rest > 1.0 - 1e-12) | both_to_blame)).all()


def test_the_text_holds_table_and_matrix(tournament):
    text = tournament_text(tournament)
    assert text.startswith("36 races of 6 s, preset contest, on oval, Pipkin; seed 4\n")
    for name in tournament.policies:
        assert text.count(name) == 2  # once in the table, once in the matrix
    assert "a crash is won by the car not to blame" in text


def test_results_are_one_line_for_each_race(tournament, tmp_path):
    file = write_results(tournament, tmp_path / "results.csv")
    with open(file, newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(tournament.rows)
    assert rows[0]["preset"] == "contest"
    for found, row in zip(rows, tournament.rows, strict=True):
        assert (found["ego"], found["winner"], found["fault"]) == (row.ego, row.winner, row.fault)
        assert float(found["lead"]) == pytest.approx(row.lead, abs=1e-4)
    assert [path.name for path in tmp_path.iterdir()] == ["results.csv"]
    with pytest.raises(InputError, match="there is no folder"):
        write_results(tournament, tmp_path / "missing" / "results.csv")


def test_progress_is_told_in_plain_lines_where_there_is_no_terminal(oval, capsys):
    play_tournament(oval, POLICIES[:2], CONTEST, races_per_pair=2, progress=show_progress())
    err = capsys.readouterr().err
    assert err.endswith("2/2 races, 0 s\n")
    assert "\x1b" not in err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"policies": POLICIES[:1]}, "there are 1 policies; a tournament needs at least 2"),
        ({"policies": [*POLICIES, POLICIES[1]]}, "there is more than one lattice:pace=0.5"),
        ({"tracks": []}, "there are 0 tracks"),
        ({"races_per_pair": 3}, "races_per_pair is 3; it must be an even number"),
        ({"races_per_pair": 0}, "races_per_pair is 0"),
        ({"races_per_pair": 4000}, "races_per_pair is 4000"),
        ({"config": load_race_config("paper", start_spacing=5.0)}, "no straight piece"),
    ],
)
def test_bad_input_is_refused_before_any_race(oval, change, message):
    arguments = {"tracks": oval, "policies": POLICIES, "config": CONTEST, "races_per_pair": 2} | change
    driven = []
    with pytest.raises(InputError, match=message):
        play_tournament(**arguments, progress=lambda *news: driven.append(news))
    assert not driven
