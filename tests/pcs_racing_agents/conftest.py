from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np
import pytest
from zoo_games import CONFIG, toy_archive, untrained

from pcs_racing import load_rules, load_track, make_game
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import save_archive
from pcs_racing.game.players import always, never_switch
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents import Agent
from pcs_racing_agents.base.executors import make_executor
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.networks import RegretNetwork
from pcs_racing_agents.tournament import (
    plan_tournament,
    play_plan,
    tournament_settings,
    write_results,
)


@pytest.fixture(scope="session")
def processes() -> Iterator[Executor]:
    """Two processes for all tests: new ones would import and load everything again."""
    with make_executor(2) as executor:
        yield executor


@pytest.fixture
def threads() -> Iterator[Executor]:
    """Two threads, which share imports and loaded files."""
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.fixture(scope="session")
def archive() -> PolicyArchive:
    """Twelve policies of the lattice planner, from slow to fast."""
    return toy_archive()


@pytest.fixture(scope="session")
def spec(archive) -> RaceGame:
    """Games of 4 s by the paper's rules."""
    return make_game(None, archive, CONFIG)


@pytest.fixture(scope="session")
def game(oval, spec) -> RaceGame:
    return make_game(oval, spec.archive, spec.rules, stay=True)


@pytest.fixture(scope="session")
def learner(tmp_path_factory) -> str:
    """Settings of a learner that learns next to nothing, as a file."""
    file = tmp_path_factory.mktemp("learner") / "tiny.yaml"
    file.write_text("starts: 24\nrounds: 1\nmembers: 1\nhidden: [8]\nepochs: 4\n", encoding="utf-8")
    return str(file)


@pytest.fixture(scope="session")
def lesson(oval, archive) -> tuple[list[RaceGame], list[Agent], RaceGame]:
    """Inputs of learning: games of two moves by the rules of the contest, two opponents, and the
    game spec.
    """
    game = make_game(oval, archive, "contest", steps=(1.2,) * 3, threads=1)
    spec = make_game(None, archive, game.rules)
    return [game], [never_switch(spec), always(spec, "aggressiveness -")], spec


@pytest.fixture(scope="session")
def network(spec) -> RegretNetwork:
    return untrained(spec)


@pytest.fixture(scope="session")
def seen(game) -> list[np.ndarray]:
    """Observations of both players before each move of some games and at their end, shape (B, D)
    for each step.
    """
    rng = np.random.default_rng(0)
    state = game.reset(games=20, seed=1)
    steps = []
    for _ in range(game.rules.moves):
        steps.append(game.observation(state).reshape(40, -1))
        state = game.step(state, rng.integers(0, game.offered, (20, 2)))
    return [*steps, game.observation(state).reshape(40, -1)]


@pytest.fixture
def run(capsys):
    """Run a command; returns exit code, stdout and stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return run


@pytest.fixture
def printed(run):
    """Run a command that must succeed; returns stdout."""

    def printed(*arguments: object) -> str:
        code, out, err = run(*arguments)
        assert code == 0, err
        return out

    return printed


@pytest.fixture
def told(run):
    """Run a command that must be refused before any work; returns its error, a single line."""

    def told(*arguments: object) -> str:
        code, out, err = run(*arguments)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert err.startswith("pcs-racing: error: ")
        return err

    return told


@pytest.fixture(scope="session")
def saved_archive(archive, tmp_path_factory):
    """The toy archive in a folder, as a command reads it."""
    return save_archive(archive, tmp_path_factory.mktemp("archives") / "toy")


@pytest.fixture(scope="session")
def tournament_folder(saved_archive, tmp_path_factory):
    """A tournament of 18 races in a folder, as the command leaves it; and the tournament."""
    folder = tmp_path_factory.mktemp("tournaments") / "three agents"
    rules = load_rules("contest", duration=5.0, steps=(1.0,) * 5)
    agents = ["random-moves", "lane-switcher:any", "never-switch"]
    plan = plan_tournament(
        load_track("Pipkin"), agents, rules, archive=saved_archive, races_per_pair=6, seed=2
    )
    with open_job(folder, "tournament", tournament_settings(plan)) as job:
        tournament = play_plan(plan, job=job)
        write_results(tournament.races, folder / "results.csv")
    return folder, tournament
