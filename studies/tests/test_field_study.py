"""The table of the field: equal tuning, equal races, and one best planner for the agents."""

import csv

from refusal import refused

from pcs_racing.planners.registry import planner_names
from studies.__main__ import main
from studies.field import entrants, races, tables
from studies.field.entrants import FULL, PAPER, SMALL, Entrant
from studies.ppo_against_cfr.tables import Share


def line(name, kind, circuits, score, opponent=tables.ALL):
    """Line of a planner or an agent with a score."""
    share = Share(score, score - 0.1, score + 0.1)
    return tables.Line("contest", circuits, name, kind, opponent, "lattice", 40, share, share)


def test_every_planner_races_and_has_the_same_budget_of_tuning():
    defaults = {one.name for one in entrants.planner_entrants({}, FULL)}
    assert defaults == {*planner_names(), PAPER}
    tuned = entrants.tunable(FULL)
    assert "lidar-ppo" not in tuned
    configs = [entrants.tuning_config(name, FULL) for name in tuned]
    assert len({(c.against, c.tracks, c.generations, c.population, c.seed) for c in configs}) == 1
    assert len(configs[0].tracks) * len(configs[0].against) * 2 == 40
    assert configs[tuned.index("lattice")].start == PAPER


def test_a_tuned_planner_races_unless_the_search_kept_its_defaults():
    tuned = {"lattice": "lattice:pace=0.9", "stanley": "stanley"}
    found = [one for one in entrants.planner_entrants(tuned, SMALL) if one.kind == "tuned"]
    assert found == [Entrant(PAPER, "tuned", "lattice:pace=0.9")]
    assert found[0].label == "lattice:early, tuned"


def test_the_table_of_tuned_planners_must_be_whole(tmp_path):
    refused("run --part tune first", entrants.read_tuned, tmp_path, SMALL)
    (tmp_path / "tuned.csv").write_text("planner,policy\nstanley,stanley\n")
    refused("it must have lattice, pure-pursuit, stanley", entrants.read_tuned, tmp_path, SMALL)


def test_circuits_of_the_tuning_are_training_and_all_others_held_out(tmp_path, monkeypatch):
    refused("lacks the circuits Austin", races.circuits, FULL, tmp_path)
    monkeypatch.delenv("PCS_RACING_MAPS", raising=False)
    names = {
        kind: [track.name for track in several]
        for kind, several in races.circuits(FULL, None).items()
    }
    assert names["held-out"] == ["Larkmoor", "Saltmere", "Vellindra"]
    assert names["training"] == list(entrants.TUNING_TRACKS)


def test_the_best_planner_is_chosen_on_training_circuits():
    """An agent and a score on held-out circuits choose nothing."""
    every = [
        Entrant("stanley", "default", "stanley"),
        Entrant("stanley", "tuned", "stanley:pace=1"),
        Entrant("ppo", "agent", "ppo"),
    ]
    scores = [0.4, 0.5, 0.9]
    lines = [
        line(one.name, one.kind, "training", score)
        for one, score in zip(every, scores, strict=True)
    ]
    lines.append(line("stanley", "default", "held-out", 1.0))
    assert tables.best_planner(lines, every) == every[1]


def test_a_row_of_the_table_has_the_defaults_and_the_tuned_planner():
    lines = [
        line("stanley", "default", "held-out", 0.4),
        line("stanley", "tuned", "held-out", 0.5),
        line("stanley", "tuned", "training", 0.9),
        line("ppo", "agent", "held-out", 0.6),
    ]
    _, rows = tables.score_table(lines)
    assert rows[1:] == [
        ("`ppo`", "0.600", "0.600", "", ""),
        ("`stanley`", "0.400", "0.400", "0.500", "0.500"),
    ]


def test_scores_are_read_as_they_were_written(tmp_path):
    lines = [line("stanley", "tuned", "training", 0.25), line("ppo", "agent", "held-out", 0.5)]
    with open(tmp_path / "scores.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(tables.csv_rows(lines))
    assert tables.read_lines(tmp_path / "scores.csv") == lines


def test_the_small_study_tunes_races_and_resumes(tmp_path, capsys):
    arguments = ["field", "--small", "--out", str(tmp_path), "--part", "tune", *races.RULES]
    assert main([*arguments, "tables"]) == 0
    printed = capsys.readouterr().out
    lines = tables.read_lines(tmp_path / "scores.csv")
    assert {one.kind for one in lines} >= {"default", "agent"}
    assert {one.circuits for one in lines} == set(races.CIRCUITS)
    assert not any(one.kind == "agent" for one in lines if one.rules == "roboracer")
    title = [one for one in lines if one.opponent == tables.TITLE]
    assert {one.kind for one in title} == {"agent"}
    assert "contest, held out, agents against" in printed
    assert (tmp_path / "scores.png").is_file()
    chunks = {file: file.stat().st_mtime_ns for file in tmp_path.glob("*/chunks/*")}
    assert main([*arguments, "tables"]) == 0
    assert capsys.readouterr().out == printed
    assert chunks == {file: file.stat().st_mtime_ns for file in tmp_path.glob("*/chunks/*")}


def test_races_need_the_tuned_planners(tmp_path, capsys):
    assert main(["field", "--small", "--out", str(tmp_path), "--part", "contest"]) == 2
    assert "run --part tune first" in capsys.readouterr().err


def test_tables_need_the_races(tmp_path, capsys):
    assert main(["field", "--small", "--out", str(tmp_path), "--part", "tables"]) == 2
    assert "contest.csv does not exist" in capsys.readouterr().err
