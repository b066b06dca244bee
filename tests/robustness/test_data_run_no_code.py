"""A file holds data: for any name in it, nothing is imported, run or called. One row for
each kind of file.
"""

import ast
import csv
import json
import shutil
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from refusal import refused
from repository import REPOSITORY

from pcs_racing import (
    InputError,
    load_archive,
    load_rules,
    load_track,
    make_game,
    racer,
)
from pcs_racing.base.files import parse_yaml, read_limited
from pcs_racing.base.settings import plain_settings
from pcs_racing.car.vehicle import F1TENTH, load_vehicle
from pcs_racing.envs.draws import load_randomization
from pcs_racing.envs.obstacles import Obstacles, load_obstacles
from pcs_racing.f1tenth.maps import load_map
from pcs_racing.planners.field.lidar_ppo import load_lidar_planner
from pcs_racing.planners.learned import load_planner
from pcs_racing.race.config import Rules
from pcs_racing.track.map_files import read_map
from pcs_racing_agents.agents import export_onnx, make
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.learning.ppo import PPOSettings, load_ppo_settings
from pcs_racing_agents.learning.responses import load_psro_settings, load_response_settings
from pcs_racing_agents.learning.self_play import load_self_play_settings
from pcs_racing_agents.networks.training import load_train_settings
from pcs_racing_agents.policies.archive_run import stage_scenarios
from pcs_racing_agents.policies.config import load_archive_config
from pcs_racing_agents.study.config import StudyConfig, load_study_config
from pcs_racing_agents.study.study import Study, open_results
from pcs_racing_agents.tournament.protocol import ProtocolConfig, load_protocol
from pcs_racing_agents.trees import load_trees

EVIL = """
import pathlib

pathlib.Path(__file__).with_name("ran").touch()

def main(*given, **named):
    raise SystemExit("called")

class Main:
    def plan(self, obs):
        return 0.0, 0.0
"""
WORDS = ("evil.py:main", "evil_module:main", "evil.py")
PROTOCOL = {
    "rules": "paper",
    "archive": "default",
    "train": ("Pipkin",),
    "test": ("Larkmoor",),
    "opponents": ("random-moves", "lattice:pace=0.4"),
}
STUDY = {
    "learning": {"tracks": ("Pipkin",), "responses": ("response-quick",)},
    "table": {
        "tracks": ("Pipkin",),
        "opponents": ("never-switch", "lattice:pace=0.4"),
        "agents": ("never-switch", "lattice:pace=0.4"),
    },
    "further": {"tracks": ("Pipkin",), "opponents": ("random-moves",), "agents": ("never-switch",)},
    "best": "never-switch",
}


class Kind(NamedTuple):
    """A kind of file that holds names."""

    make: Callable[[Path], Path]  #: Writes a sound file into a folder.
    open: Callable[[Path], object]  #: Loads it, and uses the names in it.
    readers: str = ""  #: Functions of the packages that read such a file.


def settings(name: str, values: Any) -> Callable[[Path], Path]:
    """Return a function that writes settings as YAML."""

    def write(folder: Path) -> Path:
        plain = values if isinstance(values, dict) else plain_settings(values)
        (folder / name).write_text(yaml.safe_dump(json.loads(json.dumps(plain))))
        return folder / name

    return write


def shipped(folder: str, file: str) -> Callable[[Path], Path]:
    """Return a function that copies the folder of a shipped file and returns the copied file."""
    source = REPOSITORY / folder / file
    return lambda here: (
        shutil.copytree(source.parent, here / "copy" / source.parent.name) / source.name
    )


def made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def study_agents(study: Study) -> None:
    """Use every name of a study's configuration."""
    config, learning = study.config, study.config.learning
    names = {*learning.response_opponents, *learning.fitting_opponents, config.best}
    for table in config.tables:
        names |= {*table.agents, *table.opponents}
    for name in sorted(names):
        with suppress(InputError):
            study.agent(name)
    for track in config.tracks:
        load_track(track)
    load_train_settings(learning.training)


def raced(folder: Path) -> None:
    """Use the names of a folder of results."""
    results = open_results(folder)
    row = results.row(0)
    results.pairing(row)


def tournament(folder: Path) -> Path:
    """Race two agents, and return the folder."""
    words = (
        "tournament --track Pipkin --agents never-switch lattice:pace=0.4 --races 2 --out"
        f" {folder / 'raced'}"
    )
    assert main(words.split()) == 0
    return folder / "raced"


def study_folder(folder: Path) -> Path:
    """Write the folder of a study by hand, with the races of a tournament."""
    config, place = StudyConfig(**STUDY), folder / "study"
    place.mkdir()
    shutil.copy(tournament(folder) / "results.csv", place)
    manifest = {
        "format": "pcs-racing job",
        "version": 1,
        "kind": "study",
        "settings": plain_settings(config),
    }
    (place / "job.yaml").write_text(yaml.safe_dump(manifest))
    return place


ORIGIN = {"environment": "drive", "see_opponent": "always", "vehicle": [plain_settings(F1TENTH)]}


def origin(folder: Path) -> Path:
    """Write the environment of a model's training."""
    (folder / "origin.yaml").write_text(json.dumps(ORIGIN))
    return folder / "origin.yaml"


def read_model(file: Path) -> object:
    """Return the policy of a zip whose spaces name the environment in a file."""
    torch = pytest.importorskip("torch")
    layers = {"mlp_extractor.policy_net.0": (4, 41), "action_net": (2, 4)}
    state = {f"{name}.weight": torch.zeros(shape) for name, shape in layers.items()}
    state |= {f"{name}.bias": torch.zeros(shape[0]) for name, shape in layers.items()} | {
        "log_std": torch.zeros(2)
    }
    written = {
        "policy_class": {"__module__": "stable_baselines3.common.policies"},
        "observation_space": {
            "pcs_racing": json.dumps(
                parse_yaml(file, read_limited(file, 10**6, "an origin", InputError))
            )
        },
    }
    with zipfile.ZipFile(file.with_suffix(".zip"), "w") as made_file:
        made_file.writestr("data", json.dumps(written))
        with made_file.open("policy.pth", "w") as weights:
            torch.save(state, weights)
    return racer(file.with_suffix(".zip"))


TREES = {
    "kind": "game trees",
    "settings": {
        "archive": {"name": "a", "sha256": "0"},
        "track": {"name": "t", "sha256": "0"},
        "rules": {"name": "paper", "steps": [8.0, 8.0]},
        "pairs": [[0, 1]],
        "encoding": ["step"],
        "move_names": ["a +", "a -"],
    },
}


def config(
    load: Callable[..., Any], values: Any = None, use: Callable[[Any], object] = lambda _: None
) -> Kind:
    """Return the kind of a file of settings."""
    given = load() if values is None else values
    return Kind(settings("settings.yaml", given), lambda file: use(load(file)), load.__name__)


def racers(file: Path) -> object:
    """Make racers from texts in a file."""
    game = make_game("Pipkin", "default", load_rules("paper"))
    return [racer(text, game) for text in yaml.safe_load(file.read_text())]


KINDS = {
    "results of a tournament": Kind(
        lambda folder: tournament(folder) / "results.csv",
        lambda file: raced(file.parent),
        "_read_manifest read_job read_csv",
    ),
    "job of a tournament": Kind(
        lambda folder: tournament(folder) / "job.yaml",
        lambda file: raced(file.parent),
        "_check_same",
    ),
    "results of a study": Kind(
        lambda folder: study_folder(folder) / "results.csv", lambda file: raced(file.parent)
    ),
    "job of a study": Kind(
        lambda folder: study_folder(folder) / "job.yaml", lambda file: raced(file.parent)
    ),
    "study": config(
        load_study_config,
        StudyConfig(**STUDY),
        lambda one: study_agents(Study(one, Path("none"), quiet=True)),
    ),
    "protocol": Kind(
        settings("settings.yaml", ProtocolConfig(**PROTOCOL)),
        lambda file: load_protocol(file, ["never-switch"]),
        "load_protocol",
    ),
    "archive": Kind(
        shipped("pcs_racing/data/archives", "default/manifest.yaml"),
        lambda file: load_archive(file.parent).family(),
        "read _content load_archive",
    ),
    "network": Kind(
        shipped("pcs_racing_agents/data/networks", "default-paper-regret/manifest.yaml"),
        lambda file: make(f"cfr-argmax:network={file.parent}"),
    ),
    "set of networks": Kind(
        shipped("pcs_racing_agents/data/networks", "contest-contest-psro/set.yaml"),
        lambda file: make("psro", archive="contest", rules="contest", networks=file.parent),
    ),
    "lidar driver": Kind(
        shipped("pcs_racing/data/planners", "lidar-ppo/manifest.yaml"),
        lambda file: load_lidar_planner(file.parent),
    ),
    "line planner": Kind(
        shipped("pcs_racing/data/planners", "line-ppo/manifest.yaml"),
        lambda file: load_planner(file.parent),
        "folder_kind",
    ),
    "exported planner": Kind(
        shipped("pcs_racing/data/planners", "lidar-ppo/manifest.yaml"),
        lambda file: export_onnx(file.parent, file.parent / "network.onnx"),
    ),
    "fit": Kind(
        shipped("pcs_racing_agents/data/fits", "default-paper-best-fixed.yaml"),
        lambda file: make("best-fixed", archive="default", rules="paper", fit=file),
    ),
    "trees": Kind(
        settings("job.yaml", TREES), lambda file: load_trees(file.parent), "_read_settings"
    ),
    "model": Kind(origin, read_model, "read_zip"),
    "map": Kind(
        shipped("maps", "Pipkin/Pipkin_map.yaml"),
        lambda file: [read_map(file.parent), load_map(file)],
        "parse_ros_yaml _is_map read_inside _load",
    ),
    "track": Kind(
        shipped("maps", "Pipkin/Pipkin_track.yaml"),
        lambda file: read_map(file.parent),
        "parse_info",
    ),
    "race": config(load_rules, Rules()),
    "game": config(load_rules, Rules()),
    "vehicle": config(load_vehicle, F1TENTH),
    "obstacles": config(load_obstacles, Obstacles()),
    "randomization": config(
        load_randomization, {"mu": [0.7, 1.1], "each": {"m": {"normal": [3.7, 0.2]}}}
    ),
    "synthesis": config(load_archive_config, None, stage_scenarios),
    "ppo": config(load_ppo_settings, PPOSettings()),
    "response": config(load_response_settings),
    "psro": config(load_psro_settings),
    "self-play": config(load_self_play_settings),
    "training": config(load_train_settings),
    "texts of opponents": Kind(settings("texts.yaml", {"": "lattice"}), racers),
}
NAMELESS = {
    # the readers that the others call
    "load_settings",
    "read_settings",
    "parse_yaml",
    "load_config",
    "_cached",
    "load_cached",
    "read_chunk",
    "parse_waypoints",  # numbers alone
    "unpack",
    # the text of a copy of the gym next to a running program: literals alone
    # parts of the settings of a study
    "_game",
    "_section",
    "check",
    "read_agent",  # a text; an option's value is no name of code
    "_parse_like",
    "read_origin",
    "read_onnx",
}
"""Functions that call a reader of files, and need no row."""


def planted(value: Any, word: str) -> Iterator[Any]:
    """Return copies of a value with the word in one place: each text, none, or key of a mapping."""
    if value is None or isinstance(value, str):
        yield word
    elif isinstance(value, dict):
        for key, item in value.items():
            yield {(word if other == key else other): one for other, one in value.items()}
            yield from ({**value, key: other} for other in planted(item, word))
    elif isinstance(value, list):
        for i in sorted({0, len(value) - 1}) if value else ():
            yield from ([*value[:i], other, *value[i + 1 :]] for other in planted(value[i], word))


def spoilt(file: Path) -> Iterator[bytes]:
    """Return contents of a file with a name of code in one place."""
    if file.suffix == ".csv":
        first, *rows = csv.reader(file.read_text().splitlines())
        for word in WORDS:
            for i in range(len(first)):
                lines = [first, *([*row[:i], word, *row[i + 1 :]] for row in rows)]
                yield "\n".join(map(",".join, lines)).encode()
        return
    value = (json.loads if file.suffix == ".json" else yaml.safe_load)(file.read_text())
    for word in WORDS:
        for one in planted(value, word):
            yield json.dumps(one).encode()  # which is YAML, too


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A folder with importable code; the code leaves a file if it runs."""
    for name in ("evil.py", "evil_module.py"):
        (tmp_path / name).write_text(EVIL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    assert not (tmp_path / "ran").exists()
    assert not [name for name in set(sys.modules) - before if "evil" in name]


@pytest.mark.parametrize("kind", KINDS)
def test_no_name_in_a_file_is_code_that_runs(evil, kind):
    file, tried = KINDS[kind].make(made(evil / "files")), 0
    for tried, content in enumerate(spoilt(file), start=1):  # noqa: B007
        file.write_bytes(content)
        try:
            KINDS[kind].open(file)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017
        assert not (evil / "ran").exists(), content.decode()
    assert tried > 2


def test_every_reader_of_files_has_a_row():
    """A function of the packages that calls a reader belongs to a kind of file above, or is known
    to hold no names.
    """
    readers = {
        "read_limited",
        "parse_yaml",
        "plain_yaml",
        "parse_json",
        "read_settings",
        "load_config",
        "load_settings",
        "read_job",
        "unpack_arrays",
    }
    found = {function for _, function, name, _ in calls() if name in readers}
    rows = {name for kind in KINDS.values() for name in kind.readers.split()}
    assert found - NAMELESS == rows
    assert not rows & NAMELESS


def test_code_is_run_for_words_of_the_command_line_alone():
    """Any other text that runs code must be added here, where a reader sees it."""
    doors = {"own_file", "driver_classes", "drivers_from"}
    found: dict[str, set[str]] = {}
    for file, _, name, node in calls():
        allowed = [ast.unparse(word.value) for word in node.keywords if word.arg == "code"]
        if name in doors or allowed:
            found.setdefault(file, set()).add(" ".join([name, *allowed]))
    assert found == {
        "pcs_racing/planners/imported.py": {"own_file", "driver_classes"},  # the doors themselves
        "pcs_racing/planners/own_code.py": {"drivers_from", "own_file"},
        "pcs_racing/planners/racers.py": {"racer code"},
        "pcs_racing_agents/base/executors.py": {"own_file"},  # of code that already ran
        "pcs_racing_agents/cli/agents.py": {"drivers_from"},
        "pcs_racing_agents/cli/train.py": {"competitor True"},
        "pcs_racing_agents/cli/race.py": {"policy_racer True"},
        "pcs_racing_agents/cli/tournament.py": {"plan_tournament True"},
        "pcs_racing_agents/study/study.py": {"competitor name in code"},
        "pcs_racing_agents/tournament/protocol.py": {"plan_tournament True"},
    }
    importers = {
        "import_module",
        "resolve_name",
        "spec_from_file_location",
        "__import__",
        "exec",
        "eval",
        "loads",
    }
    importing = {
        f"{file}:{ast.unparse(node.func)}" for file, _, name, node in calls() if name in importers
    }
    assert {name for name in importing if "/f1tenth/" not in name} == {
        "pcs_racing/base/files.py:json.loads",
        "pcs_racing/planners/own_files.py:spec_from_file_location",
        "pcs_racing/planners/shipped.py:resolve_name",
        "pcs_racing/track/loading.py:json.loads",  # of the cache
        "pcs_racing/track/track.py:json.loads",
        "pcs_racing_agents/agents/from_torch.py:module.eval",  # a switch of torch
        "pcs_racing/planners/own_code.py:importlib.import_module",
        "pcs_racing/envs/origins.py:json.loads",
        "pcs_racing_agents/agents/from_onnx.py:json.loads",
        "pcs_racing_agents/agents/zoo.py:resolve_name",
        "pcs_racing_agents/cli/main.py:import_module",
        "pcs_racing_agents/base/executors.py:loads",  # values that this process has packed
        "pcs_racing_agents/learning/responses.py:json.loads",
        "pcs_racing_agents/base/folders.py:json.loads",  # of settings that this process dumped
    }


@cache
def calls() -> list[tuple[str, str, str, ast.Call]]:
    """Return file, function, called name and node of all calls in the functions of the packages."""
    return [
        (path.relative_to(REPOSITORY).as_posix(), function.name, name, node)
        for package in ("pcs_racing", "pcs_racing_agents")
        for path in sorted((REPOSITORY / package).rglob("*.py"))
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(function, ast.FunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Call)
        for name in [getattr(node.func, "attr", getattr(node.func, "id", ""))]
    ]


COMMANDS = {
    "view": "view files/raced --no-open",
    "explain": "view files/raced --explain 0",
    "tournament": "tournament --protocol files/settings.yaml --agents random-moves",
}


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_opens_a_stranger_s_file_runs_no_code_of_it(evil, command, word, capsys):
    """The digests of a job are no signatures: a writer of the names can write them, too."""
    place = made(evil / "files")
    if command == "tournament":
        settings("settings.yaml", {**PROTOCOL, "opponents": ["random-moves", word]})(place)
    else:
        raced = tournament(place)
        for file in (raced / "results.csv", raced / "job.yaml"):
            file.write_text(file.read_text().replace("lattice:pace=0.4", word))
    capsys.readouterr()
    assert main(COMMANDS[command].format(word=word).split()) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("pcs-racing: error: ")
    assert f"{word!r} names code, and no file may" in error


def test_a_text_is_no_code_unless_its_caller_says_so(evil):
    for word in WORDS:
        for place in (racer, make):
            refused("names code, and no file may", place, word)
