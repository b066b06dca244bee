from collections.abc import Iterator
from concurrent.futures import Executor

import numpy as np
import pytest
from zoo_games import CONFIG, toy_archive, untrained

from pcs_racing import PolicyArchive, RaceGame, load_race_config, load_track, save_archive
from pcs_racing_agents.agents import Setting, make_setting
from pcs_racing_agents.jobs.executors import make_executor
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.networks import RegretNetwork
from pcs_racing_agents.tournament import plan_tournament, play_plan, tournament_settings, write_results


@pytest.fixture(scope="session")
def processes() -> Iterator[Executor]:
    """Two processes for all tests: those of each executor would import and load everything again."""
    with make_executor("processes", 2) as executor:
        yield executor


@pytest.fixture
def executor(kind, request) -> Iterator[Executor | None]:
    """An executor of the kind that a test is about, with two workers."""
    if kind == "processes":
        yield request.getfixturevalue("processes")
    else:
        with make_executor(kind, 2) as own:
            yield own


@pytest.fixture(scope="session")
def archive() -> PolicyArchive:
    """Twelve policies of the lattice planner, from slow to fast."""
    return toy_archive()


@pytest.fixture(scope="session")
def setting(archive) -> Setting:
    """Games of 4 s by the paper's rules."""
    return make_setting(archive, CONFIG)


@pytest.fixture(scope="session")
def game(oval, setting) -> RaceGame:
    return RaceGame(oval, setting.archive, setting.config)


@pytest.fixture(scope="session")
def network(setting) -> RegretNetwork:
    return untrained(setting)


@pytest.fixture(scope="session")
def seen(game) -> list[np.ndarray]:
    """What both players saw before each move of some games and at their end, shape (B, D) for each step."""
    rng = np.random.default_rng(0)
    state = game.reset(games=20, seed=1)
    steps = []
    for _ in range(game.config.moves):
        steps.append(game.observation(state).reshape(40, -1))
        state = game.step(state, rng.integers(0, len(game.move_names), (20, 2)))
    return [*steps, game.observation(state).reshape(40, -1)]


@pytest.fixture(scope="session")
def tournament_folder(archive, tmp_path_factory):
    """A tournament of 18 races in a folder, as the command leaves it; and the tournament."""
    saved = save_archive(archive, tmp_path_factory.mktemp("archives") / "toy")
    folder = tmp_path_factory.mktemp("tournaments") / "three agents"
    rules = load_race_config("contest", duration=5.0)
    agents = ["random-moves", "lane-switcher", "never-switch"]
    plan = plan_tournament(load_track("Pipkin"), agents, rules, archive=saved, races_per_pair=6, seed=2)
    settings = {**tournament_settings(plan), "archive": str(saved)}
    with open_job(folder, "tournament", settings) as job:
        tournament = play_plan(plan, job=job)
        write_results(tournament.races, folder / "results.csv")
    return folder, tournament
