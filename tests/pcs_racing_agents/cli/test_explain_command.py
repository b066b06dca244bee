"""``pcs-racing explain``, on tournaments, on studies, and on two agents."""

import pytest

from pcs_racing.race.replay import read_replay
from pcs_racing_agents.study.results import open_results


def test_a_race_is_told_and_drawn(tournament_folder, tmp_path, printed):
    place, tournament = tournament_folder
    captured = printed("explain", place, "--index", 1, "--out", tmp_path / "out")
    assert captured.startswith(
        "random-moves (car 0) against lane-switcher on Pipkin, contest rules: "
    )
    assert (tmp_path / "out" / "race.txt").read_text() in captured
    assert (tmp_path / "out" / "race.png").read_bytes().startswith(b"\x89PNG")
    replay = read_replay(tmp_path / "out" / "race.html")
    assert replay.lead[-1] == pytest.approx(tournament.races[1].lead, abs=0.002)


def test_fixed_policies_are_left_to_the_other_car(tournament_folder, printed):
    place, tournament = tournament_folder
    number = next(i for i, row in enumerate(tournament.races) if row.ego == "lane-switcher")
    assert printed("explain", place, "--index", number).startswith(
        "never-switch (car 1) against lane-switcher"
    )


def test_two_agents_race_as_in_a_tournament(saved_archive, printed, told):
    arguments = [
        "explain",
        "--agents",
        "random-moves",
        "never-switch",
        "--track",
        "Pipkin",
        "--duration",
        "6",
    ]
    arguments += ["--archive", saved_archive, "--races", 4, "--seed", 2, "--rules", "contest"]
    text = printed(*arguments, "--index", 3)
    assert text.startswith("random-moves (car 0) against never-switch on Pipkin, contest rules: ")


def test_a_picture_that_is_left_out_is_told(saved_archive, run, tmp_path, monkeypatch):
    monkeypatch.setattr("pcs_racing_agents.cli.options.find_spec", lambda name: None)
    arguments = [
        "explain",
        "--agents",
        "random-moves",
        "never-switch",
        "--duration",
        "5",
        "--races",
        "2",
    ]
    code, out, err = run(*arguments, "--archive", saved_archive, "--out", tmp_path)
    assert code == 0
    assert " on Brackwater, paper rules: " in out  # the default circuit
    assert "picture: " not in out
    assert 'the picture of the race is not drawn: pip install "pcs-racing[plots]" draws it' in err
    assert {file.name for file in tmp_path.iterdir()} == {"race.txt", "race.html"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give a folder of results, or two agents"),
        (["{folder}", "--agents", "nash"], "'nash' did not race"),
        (["--agents", "random-moves"], "give a folder of results, or two agents"),
        (["--agents", "a", "b"], "agent 'a' is unknown"),
        (["{folder}", "--races", "4"], "--races goes with --agents"),
        (["{folder}", "--index", "18"], "there is no race 18"),
        (["{folder}/chunks"], "holds no races"),
        (["{folder}", "--index", "5", "--car", "0"], "'lane-switcher' in car 0 makes no moves"),
        (["--agents", "random-moves", "nobody", "--track", "Pipkin"], "agent 'nobody' is unknown"),
        (
            ["--agents", "random-moves", "never-switch", "--track", "Pipkin", "--index", "20"],
            "there are races 0 to 19",
        ),
    ],
)
def test_what_is_asked_for_wrongly_is_named(tournament_folder, arguments, message, told):
    place, tournament = tournament_folder
    number = str(next(i for i, row in enumerate(tournament.races) if row.ego == "lane-switcher"))
    given = [number if text == "5" else text.format(folder=place) for text in arguments]
    assert message in told("explain", *given)


def test_agents_and_races_that_have_changed_are_noticed(tournament_folder, tmp_path, run):
    place, _ = tournament_folder
    for name, old, new, message in (
        (
            "job.yaml",
            "  never-switch: ",
            "  never-switch: 0000",
            "agent 'never-switch' has changed",
        ),
        ("job.yaml", "  Pipkin: ", "  Pipkin: 0000", "track 'Pipkin' has changed"),
        (
            "job.yaml",
            "archive_sha256: ",
            "archive_sha256: 0000",
            "has changed since the races were driven",
        ),
        ("job.yaml", "kind: tournament", "kind: fitting", "holds no races"),
        ("job.yaml", "format:", "- format:", "is damaged"),
    ):
        copy = tmp_path / "copy"
        copy.mkdir(exist_ok=True)
        for file in ("job.yaml", "results.csv"):
            text = (place / file).read_text()
            (copy / file).write_text(text.replace(old, new) if file == name else text)
        code, _, error = run("explain", copy, "--index", len(open_results(place).races) - 1)
        assert code == 2
        assert message in error
    rows = (place / "results.csv").read_text().splitlines()
    lead = rows[1].split(",")[8]
    (copy / "job.yaml").write_text((place / "job.yaml").read_text())
    (copy / "results.csv").write_text(
        "\n".join([rows[0], rows[1].replace(lead, "99.0000"), *rows[2:]])
    )
    code, _, error = run("explain", copy, "--index", 0)
    assert code == 2
    assert "a lead of" in error
    assert "instead of 99.0000 m" in error


def test_races_of_a_study_are_found_again(study_folder, printed):
    """Another race than the one of the results is an error."""
    place, pairings = study_folder
    races = len(pairings[1])
    text = printed("explain", place, "--index", races + 3)
    assert text.startswith("always-aggressiveness+ (car 0) against lane-switcher on Pipkin")
    printed("explain", place, "--index", 2 * races + 2)


def test_settings_of_another_version_are_named(study_folder, tmp_path, told):
    place, _ = study_folder
    (tmp_path / "results.csv").write_text((place / "results.csv").read_text())
    (tmp_path / "job.yaml").write_text(
        (place / "job.yaml").read_text().replace("  egos:", "  drivers:")
    )
    assert "unknown table setting 'drivers'" in told("explain", tmp_path, "--index", 0)
