"""``pcs-racing view``: pages, explanations and refusals."""

import re
import shutil

import pytest

from pcs_racing import load_track
from pcs_racing_agents.cli import view
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.study.study import open_results
from pcs_racing_agents.watch.race_choice import choose_races


@pytest.fixture
def folder(tournament_folder, tmp_path):
    """A copy of a tournament's folder, to be spoilt."""
    place = tmp_path / "mine"
    shutil.copytree(tournament_folder[0], place)
    return place


def test_the_page_lies_beside_the_results(folder, capsys, monkeypatch):
    opened = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(view.webbrowser, "open", opened.append)
    assert main(["view", str(folder), "--replays", "2"]) == 0
    page = folder / "view.html"
    assert capsys.readouterr().out.splitlines()[-1] == f"page: {page}"
    assert opened == [page.as_uri()]
    content = page.read_text()
    assert content.count('<script type="application/json" id="race-') == 2
    assert "http://" not in content.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in content
    assert main(["view", str(folder), "--index", "3", "17", "--no-open"]) == 0
    assert opened == [page.as_uri()]
    assert re.findall('id="race-([0-9]+)"', page.read_text()) == ["3", "17"]


def test_what_is_asked_for_stands_first_and_then_what_the_rule_selects(tournament_folder):
    races = open_results(tournament_folder[0]).races
    chosen = choose_races(races, 4)
    first, other = list(chosen)[2], next(k for k in range(18) if k not in chosen)
    picks = view._picks(races, [other, first], 4)
    assert list(picks) == [other, first, *(race for race in chosen if race != first)]
    assert picks == {**chosen, **dict.fromkeys([other, first], "a race that was asked for")}
    assert view._picks(races, [], 0) == {}


def test_a_browser_is_opened_where_there_is_a_screen(monkeypatch):
    asked = []
    monkeypatch.setattr(view.webbrowser, "open", asked.append)
    for platform, variable in [("linux", "HOME"), ("linux", "DISPLAY"), ("win32", "HOME")]:
        monkeypatch.setattr(view.sys, "platform", platform)
        monkeypatch.setattr(view.os, "environ", {variable: "x"})
        view.open_page(f"{platform} {variable}")
    assert asked == ["linux DISPLAY", "win32 HOME"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{folder}/nothing"], "there is no folder"),
        (["{folder}/chunks"], "holds no races"),
        (["{folder}/results.csv"], "there is no folder"),
        (["{folder}", "--out", "page.txt"], "its name must end in .html"),
        (["{folder}", "--out", "{folder}/none/page.html"], "there is no folder"),
        (["{folder}", "--replays", "-1"], "--replays is -1; it must be"),
        (["{folder}", "--replays", "2001"], "--replays is 2001; it must be"),
        (["{folder}", "--index", "18"], "--index names 18; there are races 0 to 17"),
        (["{folder}", "--index", "-1"], "--index names -1"),
        (
            ["{folder}", "--explain", "18"],
            "there is no race 18 in {folder}; it holds races 0 to 17",
        ),
        (["{folder}", "--explain", "0", "--index", "1"], "--explain goes without --index"),
        (
            ["{folder}", "--explain", "0", "--out", "a.html"],
            "--explain goes without",
        ),
        (["{folder}", "--car", "0"], "--car goes with --explain"),
        (
            ["{folder}", "--explain", "{fixed}", "--car", "0"],
            "'lane-switcher:any' in car 0 makes no",
        ),
        (["{folder}", "--agents", "nash"], "'nash' is not in the races of {folder}; there are"),
        (
            ["{folder}", "--track", "Tarnfjord"],
            "'Tarnfjord' is not in the races of {folder}; there",
        ),
        (["{folder}", "--track", "Tarnfjordd"], "unknown track 'Tarnfjordd'"),
    ],
)
def test_what_is_asked_for_wrongly_is_named(folder, tournament_folder, arguments, message, told):
    rows = tournament_folder[1].races
    fixed = next(i for i, row in enumerate(rows) if row.ego == "lane-switcher:any")
    named = {"folder": folder, "fixed": fixed}
    given = [text.format(**named) for text in arguments]
    assert message.format(**named) in told("view", *given, "--no-open")
    assert not (folder / "view.html").exists()


CHANGES = [
    ("  never-switch: ", "  never-switch: 0000", "agent 'never-switch' has changed"),
    ("  Pipkin: ", "  Pipkin: 0000", "track 'Pipkin' has changed"),
    ("archive_sha256: ", "archive_sha256: 0000", "has changed since the races were driven"),
    ("kind: tournament", "kind: fitting", "holds no races"),
    ("format:", "- format:", "is damaged"),
]


@pytest.mark.parametrize(("old", "new", "message"), CHANGES)
def test_what_has_changed_is_one_clear_error(folder, run, old, new, message):
    manifest = folder / "job.yaml"
    manifest.write_text(manifest.read_text().replace(old, new))
    code, _, error = run("view", folder, "--index", 17, "--no-open")
    assert code == 2
    assert message in error
    assert run("view", folder, "--explain", 17)[0] == 2
    if "has changed" in message:
        assert "--replays 0 lists the races" in error
        assert run("view", folder, "--replays", 0, "--no-open")[0] == 0


def test_a_race_with_another_end_is_refused(folder, run):
    rows = (folder / "results.csv").read_text().splitlines()
    lead = rows[1].split(",")[8]
    rows[1] = rows[1].replace(lead, "99.0000")
    (folder / "results.csv").write_text("\n".join(rows))
    for option in ("--index", "--explain"):
        code, _, error = run("view", folder, option, 0, "--no-open")
        assert code == 2
        assert "race 0 came out otherwise" in error
        assert "instead of 99.0000 m" in error


def test_a_race_is_explained(folder, printed):
    text = printed("view", folder, "--explain", 1)
    assert text.startswith(
        "random-moves (car 0) against lane-switcher:any on Pipkin, contest rules: "
    )
    assert not (folder / "view.html").exists()


def test_fixed_policies_are_left_to_the_other_car(tournament_folder, printed):
    place, tournament = tournament_folder
    number = next(i for i, row in enumerate(tournament.races) if row.ego == "lane-switcher:any")
    assert printed("view", place, "--explain", number).startswith(
        "never-switch (car 1) against lane-switcher"
    )


def test_races_of_a_study_are_found_again(study_folder, printed, tmp_path):
    """Another race than the one of the results is an error."""
    place, pairings = study_folder
    races = len(pairings[1])
    page = ("view", place, "--index", 0, 12, "--no-open", "--out", tmp_path / "view.html")
    assert "40 races, 2 of them to be watched" in printed(*page)
    text = printed("view", place, "--explain", races + 3)
    assert text.startswith("always-aggressiveness+ (car 0) against lane-switcher:any on Pipkin")
    printed("view", place, "--explain", 2 * races + 2)


def test_settings_of_another_version_are_named(study_folder, tmp_path, told):
    place, _ = study_folder
    (tmp_path / "results.csv").write_text((place / "results.csv").read_text())
    (tmp_path / "job.yaml").write_text(
        (place / "job.yaml").read_text().replace("  egos:", "  drivers:")
    )
    assert "unknown table setting 'drivers'" in told("view", tmp_path, "--explain", 0)


def test_races_on_an_own_map_are_found_by_its_path_and_after_it_moved(
    tmp_path, monkeypatch, printed, run
):
    circuit = tmp_path / "my maps" / "Home"
    shutil.copytree(load_track("Pipkin").folder, circuit)
    for file in circuit.iterdir():
        file.rename(circuit / file.name.replace("Pipkin", "Home"))
    picture = circuit / "Home_map.yaml"
    picture.write_text(picture.read_text().replace("Pipkin", "Home"))
    race = ["--agents", "never-switch", "random-moves", "--duration", 5, "--races", 2]
    results = tmp_path / "results"
    monkeypatch.chdir(tmp_path)
    printed("tournament", "--track", "my maps/Home", *race, "--out", results)
    monkeypatch.chdir(results)
    page = ("view", results, "--index", 0, "--no-open")
    assert "2 races, 1 of them" in printed(*page)
    circuit.rename(tmp_path / "moved")
    code, _, error = run(*page)
    assert code == 2
    assert "Home" in error
    assert "if the map was moved, --track names its folder" in error
    assert "2 races, 1 of them" in printed(*page, "--track", tmp_path / "moved")
    assert " on Home, " in printed("view", results, "--explain", 0, "--track", tmp_path / "moved")
