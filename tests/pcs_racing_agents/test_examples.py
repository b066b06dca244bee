import importlib
import re

import numpy as np
import pytest
from repository import REPOSITORY, run_python

from pcs_racing import load_rules, load_track, run_races
from pcs_racing.game.make import make_game
from pcs_racing.game.moves import duplicate_moves
from pcs_racing.game.players import competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.races import start_lines
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.observing import own

EXAMPLES = REPOSITORY / "examples"


@pytest.mark.parametrize(
    ("script", "arguments", "said", "made"),
    [
        (
            "policy_tournament",
            "--races 2 --duration 4 --out out",
            ["12 races of 4 s"],
            {"results.csv", "replay.html"},
        ),
        (
            "agent_tournament",
            "--races 4 --agents never-switch random-moves lane-switcher --out out",
            ["12 races of 40 s", "equilibrium"],
            {"results.csv"},
        ),
        (
            "custom_agent",
            "--races 2",
            ["20 races of 40 s", "catch-up", "catch-up-too", "stubborn"],
            set(),
        ),
        (
            "custom_planner",
            "--races 4",
            ["Pipkin, contest: 4 races", "seed 0: 60 races of 40 s", "caution 0.3 "],
            set(),
        ),
        ("watch_a_race", "--duration 1 --gif", ["race.html"], {"race.html", "race.gif"}),
    ],
)
def test_races(tmp_path, script, arguments, said, made):
    out = run_python(
        EXAMPLES / f"{script}.py", "--track", "Pipkin", *arguments.split(), folder=tmp_path
    )
    assert all(text in out for text in said)
    assert made <= {path.name for path in tmp_path.rglob("*")}


def test_the_table_of_the_paper(tmp_path):
    size = ("--egos", 2, "--variants", 2, "--lines", 1, "--agents", "never-switch", "cfr-argmax")
    script = EXAMPLES / "paper_table.py"
    out = run_python(script, "--tracks", "Tarnfjord", *size, "--out", "made", folder=tmp_path)
    assert re.search(r"^Tarnfjord \(train\) +never-switch +\d\.\d{3} ", out, re.MULTILINE)
    assert (tmp_path / "made" / "table.csv").read_text(encoding="utf-8").count("\n") == 1 + 2 * 3
    again = run_python(script, "--tracks", "Tarnfjord", *size, "--out", "made", folder=tmp_path)
    assert again == out  # from the way driven before


def test_a_race_is_explained_move_by_move(tmp_path):
    out = run_python(
        EXAMPLES / "explain_a_race.py",
        "--track",
        "Pipkin",
        "--opponent",
        "random-moves",
        folder=tmp_path,
    )
    assert out.startswith("cfr-argmax (policy ")
    assert out.count("  ego: ") == len(re.findall(r"^move \d: lead", out, re.MULTILINE)) >= 1
    assert (tmp_path / "out" / "explain_a_race" / "race.html").is_file()


def test_a_car_is_steered_with_keys(tmp_path, monkeypatch):
    pygame = pytest.importorskip("pygame", reason="pygame-ce is not installed")
    monkeypatch.syspath_prepend(EXAMPLES)
    next_action = importlib.import_module("play_a_race").next_action
    still = np.array([0.0, -1.0], np.float32)
    left = next_action(next_action(still, {pygame.K_LEFT}), {pygame.K_LEFT, pygame.K_UP})
    assert left == pytest.approx([0.3, -0.97])
    assert next_action(left, {pygame.K_RIGHT, pygame.K_DOWN}) == pytest.approx([0.15, -1.0])
    assert next_action(left, set()) == pytest.approx([0.15, -0.97])  # back towards the middle
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    (tmp_path / "short.yaml").write_text("duration: 0.4\n")
    script = EXAMPLES / "play_a_race.py"
    out = run_python(script, "--rules", "short.yaml", "--races", 2, folder=tmp_path)
    assert [line.split(":")[0] for line in out.splitlines()] == ["race 0", "race 1"]


@pytest.mark.training
def test_a_trained_agent_enters_a_tournament(tmp_path, monkeypatch):
    pytest.importorskip("sb3_contrib")
    run_python(EXAMPLES / "maskable_ppo.py", "--steps", 1, folder=tmp_path)
    monkeypatch.syspath_prepend(REPOSITORY)
    monkeypatch.chdir(tmp_path)
    spec = make_game(None, "contest", "contest")
    agent = competitor("examples.maskable_ppo:make_agent", spec, code=True)
    game = RaceGame(load_track("Pipkin"), spec.archive, spec.rules)
    seen = game.observation(game.reset(games=6, seed=1))[0]
    moves = agent.act(seen)
    assert set(moves.tolist()) <= set(range(spec.offered))
    driven = spec.archive.nearest(own(seen, len(spec.archive.characteristics)))
    assert not duplicate_moves(spec.table[:, : spec.offered])[driven, moves].any()


@pytest.mark.training
@pytest.mark.parametrize("script", ["train_ppo.py", "self_play_ppo.py"])
def test_training_by_ppo(tmp_path, script):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("matplotlib")
    out = run_python(EXAMPLES / script, "--steps", 1, "--games", 4, folder=tmp_path)
    assert "random" in out
    if script == "train_ppo.py":
        assert "PPO over random moves: " in out
        assert {path.name for path in (tmp_path / "out" / "train_ppo").iterdir()} == {
            "learning_curve.png",
            "model.zip",
        }


@pytest.mark.training
@pytest.mark.parametrize("kind", ["line", "lidar"])
def test_a_planner_is_trained_and_a_stopped_training_goes_on(tmp_path, kind):
    for library in ("torch", "matplotlib", "tensorboard"):
        pytest.importorskip(library)
    size = ("--tracks", "Pipkin", "--tests", "Pipkin", "--random", 1, "--envs", 8, "--races", 2)
    for minutes, start in ((0.002, ()), (0.004, ("--start", f"{kind}-ppo"))):
        size = (*size, "--minutes", minutes, *start)
        out = run_python(EXAMPLES / f"train_{kind}_ppo.py", *size, folder=tmp_path)
    assert "goes on after " in out
    folder = tmp_path / "out" / f"train_{kind}_ppo"
    curves = np.genfromtxt(folder / "curves.csv", delimiter=",", names=True)
    assert len(curves) >= 3
    assert (np.diff(curves["seconds"]) >= 0.0).all()
    assert {"curves.png", "checkpoint.pt", "events"} <= {path.name for path in folder.iterdir()}
    for place in ("last", "best"):
        assert len(run_races(load_track("Pipkin"), str(folder / place), "lattice", seed=1).lead) > 0


@pytest.mark.training
def test_ppo_against_cfr(tmp_path):
    out = run_python(EXAMPLES / "ppo_against_cfr.py", "--steps", 100, "--races", 2, folder=tmp_path)
    rows = [line.split() for line in out.splitlines()]
    assert {row[0] for row in rows[2:6]} == {"ppo", "cfr-argmax", "line-ppo", "never-switch"}
    assert all(0.0 <= float(row[2]) <= 1.0 for row in rows[2:6])
    assert (tmp_path / "out" / "ppo.zip").is_file()


def test_a_tree_in_openspiel(tmp_path):
    pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    out = run_python(
        EXAMPLES / "clients" / "openspiel_tree.py", "--iterations", 50, folder=tmp_path
    )
    cells = {
        line.split(",")[0]: float(line.split()[-1])
        for line in out.splitlines()
        if line[:4] in ("Open", "pcs-")
    }
    assert list(cells) == ["OpenSpiel CFR+", "OpenSpiel MCCFR", "pcs-racing CFR+", "pcs-racing"]
    assert cells["pcs-racing CFR+"] == pytest.approx(cells["OpenSpiel CFR+"], rel=0.01)
    assert abs(cells["pcs-racing"]) < 1e-12


def test_a_dataset_holds_what_an_expert_does_in_a_race(tmp_path, monkeypatch):
    """Its return is the progress of the planner in that race, from the same start."""
    for library in ("minari", "h5py"):
        pytest.importorskip(library, reason=f"{library}, of the extra test, is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    arguments = (
        "--track",
        "Pipkin",
        "--races",
        2,
        "--duration",
        2,
        "--opponent",
        "lattice:pace=0.3",
    )
    out = run_python(EXAMPLES / "record_dataset.py", *arguments, folder=tmp_path)
    assert "2 races, 200 steps, mean return " in out
    (kept,) = re.findall(r"mean return (\S+)\n", out)
    track, config = load_track("Pipkin"), load_rules("paper", duration=2.0)
    lines = start_lines(track, config, 0, split="train")
    places = Starts(np.repeat(lines, 2), np.tile([0, 1], len(lines)))
    driven = run_races(track, "lattice", "lattice:pace=0.3", config, starts=places).state.progress[
        :, 0
    ]
    assert driven.min() - 0.1 < float(kept) < driven.max() + 0.1
