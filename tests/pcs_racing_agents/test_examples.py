import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from repository import REPOSITORY, run_python

from pcs_racing import load_rules, load_track, run_races
from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.field.lidar_ppo import read_lidar_planner
from pcs_racing.planners.line_ppo import read_line_planner
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


@pytest.mark.parametrize(
    ("script", "library"), [("maskable_ppo.py", "sb3_contrib"), ("cleanrl_self_play.py", "torch")]
)
def test_a_trained_agent_enters_a_tournament(tmp_path, monkeypatch, script, library):
    pytest.importorskip(library)
    run_python(EXAMPLES / script, "--steps", 1, folder=tmp_path)
    monkeypatch.syspath_prepend(REPOSITORY)
    monkeypatch.chdir(tmp_path)
    spec = make_game(None, "contest", "contest")
    agent = competitor(f"examples.{Path(script).stem}:make_agent", spec, code=True)
    game = RaceGame(load_track("Pipkin"), spec.archive, spec.rules)
    seen = game.observation(game.reset(games=6, seed=1))[0]
    moves = agent.act(seen)
    assert set(moves.tolist()) <= set(range(spec.offered))
    if script == "maskable_ppo.py":
        from pcs_racing.game.moves import duplicate_moves

        driven = spec.archive.nearest(own(seen, len(spec.archive.characteristics)))
        assert not duplicate_moves(spec.table[:, : spec.offered])[driven, moves].any()


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


def test_self_play_of_steering_and_speed(tmp_path):
    pytest.importorskip("stable_baselines3")
    size = ("--steps", "512", "--envs", "8", "--rollout", "64", "--races", "2", "--duration", "2")
    out = run_python(EXAMPLES / "drive_self_play.py", *size, "--track", "Pipkin", folder=tmp_path)
    row = r"^ +512 steps .* about +0\.0 left .* won against the archive: \d+% .paper., \d+% "
    assert re.search(row, out, re.M)
    rows = re.findall(r"^(\S.*?) +(paper|contest) +([\d.]+)% +\S+ +([\d.]+)%$", out, re.M)
    assert [row[1] for row in rows] == ["paper", "paper", "contest", "contest"]
    opponents = [row[0] for row in rows]
    assert opponents[1::2] == ["lidar-ppo", "lidar-ppo"]
    assert all(name.startswith("archive ") for name in opponents[::2])
    assert all(0.0 <= float(won) <= 100.0 for _, _, won, _ in rows)


def test_a_league_grows_with_a_training_that_goes_on_from_its_folder(tmp_path):
    pytest.importorskip("stable_baselines3")
    size = ("--steps", "512", "--rounds", "2", "--envs", "8", "--races", "2", "--track", "Pipkin")
    for copies in ("self-0002", "self-0004"):
        out = run_python(EXAMPLES / "league_ppo.py", *size, folder=tmp_path)
        assert re.search(rf"^{copies} +won \d+%$", out, re.M)
    assert re.search(r"^ +1,024 +\d\.\d +4  \d+% \d+% \d+% \d+%$", out, re.M)
    assert (tmp_path / "out" / "league_ppo" / "league" / "self-0004.zip").is_file()


def train_whole_and_in_parts(script, *size, rival, folder):
    """Train twice for two updates, once with a stop; return both checkpoints."""
    torch = pytest.importorskip("torch")
    file = EXAMPLES.parent / "dev" / "training" / script
    size += ("--tracks", "Pipkin", "--random", 0, "--cars", 8, "--steps", 8, "--rivals", rival)
    size += ("--races", 2, "--minibatch", 16, "--device", "cpu")
    run_python(file, *size, "--updates", 2, "--out", "whole", folder=folder)
    for updates in (1, 2):
        out = run_python(file, *size, "--updates", updates, "--out", "parts", folder=folder)
        assert re.search(rf"^  eval [\d.-]+  {rival[:9]} [\d.]+/[\d.]+$", out, re.M)
    whole, parts = (
        torch.load(folder / name / "checkpoint.pt", weights_only=True)
        for name in ("whole", "parts")
    )
    for net in ("actor", "critic", "averaged"):
        assert all(torch.equal(whole[net][key], parts[net][key]) for key in whole[net])
    changed = ("--seed", 7, "--randomize", folder / "others.yaml")
    (folder / "others.yaml").write_text("m: 4.0\n")
    out = run_python(file, *size, "--updates", 2, *changed, "--out", "parts", folder=folder)
    assert "races begin again: they were driven with another --seed, --randomize" in out
    again = torch.load(folder / "parts" / "checkpoint.pt", weights_only=True)
    assert again["randomize"] == {"m": [4.0, 4.0]}
    return whole, parts


@pytest.mark.training
def test_a_line_planner_is_trained_and_a_stopped_training_goes_on(tmp_path):
    cars = tmp_path / "cars.yaml"
    cars.write_text("mu: [0.8, 1.1]\neach: {steer_delay: [0.0, 0.06]}\n")
    size = ("--each", 1, "--randomize", cars)
    whole, _ = train_whole_and_in_parts("line_ppo.py", *size, rival="lattice", folder=tmp_path)
    assert whole["choices"] == 2 * 8 * 8
    fields, _ = read_line_planner(tmp_path / "whole" / "last")
    assert (fields["name"], fields["training"]["choices"]) == ("line-ppo", 128)
    assert json.loads(fields["training"]["randomize"]) == yaml.safe_load(cars.read_text())


@pytest.mark.training
def test_a_planner_by_lidar_is_trained_and_a_stopped_training_goes_on(tmp_path):
    # The first update only imitates, the second one does both.
    size = ("--checks", 0, "--warm", 3e-5, "--fade", 1e-3, "--teacher", "pure-pursuit")
    whole, parts = train_whole_and_in_parts(
        "lidar_ppo.py", *size, rival="pure-pursuit", folder=tmp_path
    )
    assert whole["choices"] == parts["choices"] > 0
    assert read_lidar_planner(tmp_path / "whole" / "last")[0] == "lidar-ppo"


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
