import pytest
from chromium_pipe import Browser, chromium

from pcs_racing import load_race_config, load_track, save_archive
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.tournament import plan_tournament, play_plan, tournament_settings, write_results


@pytest.fixture(scope="session")
def tournament_folder(archive, tmp_path_factory):
    """A tournament of 18 races in a folder, as the command leaves it; and the tournament."""
    saved = save_archive(archive, tmp_path_factory.mktemp("archives") / "toy")
    place = tmp_path_factory.mktemp("tournaments") / "three agents"
    rules = load_race_config("contest", duration=5.0)
    agents = ["random-moves", "lane-switcher", "never-switch"]
    plan = plan_tournament(load_track("Pipkin"), agents, rules, archive=saved, races_per_pair=6, seed=2)
    settings = {**tournament_settings(plan), "archive": str(saved)}
    with open_job(place, "tournament", settings) as job:
        tournament = play_plan(plan, job=job)
        write_results(tournament.races, place / "results.csv")
    return place, tournament


@pytest.fixture(scope="session")
def page(tournament_folder, tmp_path_factory):
    """Its page, with five races to watch."""
    path = tmp_path_factory.mktemp("pages") / "view.html"
    assert main(["view", str(tournament_folder[0]), "--replays", "5", "--out", str(path), "--no-open"]) == 0
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if chromium() is None:
        pytest.skip("no chromium on PATH to open the page with")
    found = Browser(tmp_path_factory.mktemp("profile"))
    yield found
    found.close()
