"""The base installation works without any extra; and the wheel holds all shipped files."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from repository import REPOSITORY, read_page

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
URLS = PROJECT["project"]["urls"]

# Makes Python find none of the libraries that only extras install.
WITHOUT_EXTRAS = """
import sys
from importlib.machinery import PathFinder

MISSING = set(
    "torch stable_baselines3 sb3_contrib tensorboard matplotlib skimage clarabel cma moocore pandas"
    " pygame pyspiel open_spiel networkx dask distributed onnx huggingface_hub".split()
)
find = PathFinder.find_spec

def find_none(cls, name, path=None, target=None):
    return None if name.partition(".")[0] in MISSING else find(name, path, target)

PathFinder.find_spec = classmethod(find_none)
"""


def without_extras(code: str, folder: Path) -> str:
    """Output of code that finds no library of any extra."""
    command = [sys.executable, "-W", "error", "-c", WITHOUT_EXTRAS + code]
    # nothing is built
    environment = {**os.environ, "PCS_RACING_CACHE": str(folder.with_name(f"{folder.name}-cache"))}
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_races_tournaments_and_agents_need_no_extra(tmp_path):
    code = """
import gymnasium as gym
import pcs_racing, pcs_racing_agents
from pcs_racing_agents.cli.main import main

track = pcs_racing.load_track("Pipkin")
lattice, other = pcs_racing.racer("lattice"), pcs_racing.racer("lane-switcher:3")
replay = pcs_racing.record_race(track, lattice, other, pcs_racing.PAPER, seed=1)
pcs_racing.save_replay(replay, "race.html")

agents = ("cfr-argmax", "never-switch", "lane-switcher")
raced = ["--agents", *agents, "--races", "2", "--out", "zoo"]
assert main(["tournament", "--track", "Pipkin", *raced]) == 0
assert main(["race", "--track", "Pipkin", "--ego", "lattice", "--opponent", "gap-follower"]) == 0
assert main(["track", "show", "Pipkin", "--out", "circuit.png"]) == 0

agent = pcs_racing_agents.make("cfr-argmax")
duel = gym.make("pcs_racing/Duel-v1", opponent=pcs_racing_agents.make("response"), stay=True)
seen, _ = duel.reset(seed=1)
(move,) = agent.act(seen[None])
duel.step(int(move))
imported = {name.partition(".")[0] for name in sys.modules}
print("none was imported:", not MISSING & imported)
"""
    assert without_extras(code, tmp_path).endswith("was imported: True\n")
    assert (tmp_path / "race.html").is_file()
    assert (tmp_path / "zoo" / "results.csv").is_file()


# Who needs an extra, how it is asked for something, and the extra.
NEEDS = {
    "Stable-Baselines3's environments": ("import pcs_racing.envs.sb3", "learning"),
    "the command train ppo": (
        'main(["train", "ppo", "--config", "duel-paper", "--out", "ppo"])',
        "learning",
    ),
    "training": (
        "from pcs_racing_agents.networks.training import train_layers; train_layers(None, None)",
        "learning",
    ),
    "a study": ('main(["study", "quick", "--out", "study"])', "learning"),
    "a picture": ("from pcs_racing_agents.base.style import picture; picture(print)()", "plots"),
    "the command synthesize": ('main(["synthesize", "--out", "archive"])', "synthesis"),
    "a hypervolume": (
        "import pcs_racing_agents.policies.pareto as p; p.hypervolume([[0, 0]])",
        "synthesis",
    ),
    "a new circuit": ('main(["track", "generate", "--seed", "7", "--out", "circuit"])', "mapping"),
    "a map without lines": ("pcs_racing.load_track('map')", "mapping"),
    "a cluster": (
        (
            'main(["tree", "--archive", "default", "--track", "Pipkin", "--out", "trees",'
            ' "--scheduler", "tcp://there:8786"])'
        ),
        "cluster",
    ),
    "a network as a file": ('main(["export", "lidar-ppo", "--out", "lidar-ppo.onnx"])', "onnx"),
    "a window": ("gym.make('pcs_racing/Duel-v1', render_mode='human').reset(seed=1)", "window"),
}


# Which library an example misses first, and the extra to install.
EXAMPLES = {
    "self_play_ppo": ("torch", '".[learning]"'),
    "train_lidar_ppo": ("torch", '".[learning,plots]"'),
    "clients/openspiel_tree": ("pyspiel", "open_spiel"),
    "maskable_ppo": ("torch", '".[learning]"'),
    "play_a_race": ("pygame", '".[window]"'),
    "train_line_ppo": ("torch", '".[learning,plots]"'),
    "train_ppo": ("torch", '".[learning,plots]"'),
}


def test_whoever_needs_an_extra_is_told_which_in_one_line(tmp_path):
    shutil.copytree(
        REPOSITORY / "maps" / "Pipkin", tmp_path / "map", ignore=shutil.ignore_patterns("*.csv")
    )
    code = f"""
import contextlib, importlib.util, io, json, runpy
import gymnasium as gym
import pcs_racing, pcs_racing_agents
from pcs_racing_agents.cli.main import main

assert importlib.util.find_spec("torch") is None and importlib.util.find_spec("yaml")
told, ends = {{}}, {{}}
for who, (code, _) in {NEEDS!r}.items():
    error = io.StringIO()
    with contextlib.redirect_stderr(error):
        try:
            exec(code)
        except ImportError as missing:
            print(missing, file=error)
    told[who] = error.getvalue()
for name in {list(EXAMPLES)!r}:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        try:
            runpy.run_path(f"{REPOSITORY / "examples"}/{{name}}.py", run_name="__main__")
        except SystemExit as end:
            ends[name] = end.code, printed.getvalue()
print(json.dumps([told, ends]))
"""
    told, ends = json.loads(without_extras(code, tmp_path).splitlines()[-1])
    for who, (_, extra) in NEEDS.items():
        assert f'pip install "pcs-racing[{extra}]"' in told[who], who
    for name, (library, missing) in EXAMPLES.items():
        assert ends[name] == [f"this example needs {library}: pip install {missing}", ""]
    assert [path.name for path in tmp_path.iterdir()] == ["map"]  # nothing was begun


def test_examples_that_import_a_library_of_an_extra_are_all_tried():
    hidden = set(
        re.search(r"set\((.*?)\.split", WITHOUT_EXTRAS, re.DOTALL)
        .group(1)
        .replace('"', " ")
        .split()
    )
    for file in (REPOSITORY / "examples").glob("*.py"):
        found = re.findall(
            r"^ *(?:from|import) (\w+)", file.read_text(encoding="utf-8"), re.MULTILINE
        )
        if file.stem != "ppo_against_cfr":  # the program of the README: Python names the library
            assert bool(hidden & set(found)) == (file.stem in EXAMPLES), file.stem


def test_every_extra_folder_and_licence_that_is_named_exists():
    files = [*REPOSITORY.glob("pcs_racing*/**/*.py")]
    text = "\n".join(file.read_text(encoding="utf-8") for file in files)
    lists = re.findall(r"pcs-racing\[([a-z,]+)\]", text)
    named = {*",".join(lists).split(","), *re.findall(r'extra="([a-z]+)"', text)}
    assert len(named) >= 6
    extras = PROJECT["project"]["optional-dependencies"]
    assert named <= set(extras)
    shown = {re.match(r"[a-z0-9-]+", one)[0] for one in extras["learning"]}
    assert {"tqdm", "rich", "tensorboard"} <= shown  # progress_bar=True and tensorboard_log
    assert set(PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]) == {"maps"}
    for name in PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]:
        assert (REPOSITORY / name).exists(), name
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == PROJECT["project"]["version"]
    assert f"version = {{{citation['version']}}}" in read_page("cite.md")
    assert citation["license"] == PROJECT["project"]["license"]
    assert {"title", "message", "authors", "cff-version", "preferred-citation"} <= set(citation)


@pytest.mark.parametrize(
    "file", sorted((REPOSITORY / ".github" / "workflows").glob("*.yml")), ids=lambda file: file.stem
)
def test_every_workflow_can_be_read(file):
    """A workflow that is no YAML never runs, and only an unread page reports it."""
    jobs = yaml.safe_load(file.read_text(encoding="utf-8"))["jobs"]
    for job in jobs.values():
        assert job["runs-on"]
        assert all({"run", "uses"} & step.keys() for step in job["steps"])


def test_the_recipe_of_conda_forge_has_the_dependencies_of_the_project():
    recipe = yaml.safe_load((REPOSITORY / "dev/conda/recipe.yaml").read_text(encoding="utf-8"))
    project, python = PROJECT["project"], "python >=${{ python_min }}"
    run = [name.replace(" ", "") for name in recipe["requirements"]["run"] if name != python]
    assert run == project["dependencies"]
    assert recipe["context"]["version"] == project["version"]
    assert recipe["about"]["summary"] == project["description"]
    (command,) = recipe["build"]["python"]["entry_points"]
    assert command.split(" = ") == ["pcs-racing", project["scripts"]["pcs-racing"]]


def test_the_workflows_and_nox_try_every_python_that_the_project_names():
    named = re.findall(r"Python :: (3\.\d+)", " ".join(PROJECT["project"]["classifiers"]))
    ci = yaml.safe_load((REPOSITORY / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    tried = ci["jobs"]["test"]["strategy"]["matrix"]["python"]
    assert set(named) <= set(tried)
    assert PROJECT["project"]["requires-python"] == f">={named[0]}" == f">={tried[0]}"
    noxfile = (REPOSITORY / "noxfile.py").read_text(encoding="utf-8")
    assert noxfile.count(f"@nox.session(python={json.dumps(tried)}") == 2


def test_files_of_services_can_be_read_and_name_what_exists():
    pages = yaml.safe_load((REPOSITORY / ".readthedocs.yaml").read_text(encoding="utf-8"))
    assert pages["version"] == 2
    assert (REPOSITORY / pages["sphinx"]["configuration"]).is_file()
    container = REPOSITORY / ".devcontainer" / "devcontainer.json"
    command = json.loads(container.read_text(encoding="utf-8"))["postCreateCommand"]
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    assert f"\n{command.removeprefix('make ')}:" in makefile
    assert {"Homepage", "Documentation", "Source", "Issues", "Changelog"} == set(URLS)


@pytest.mark.parametrize(
    "name", ["CITATION.cff", "dev/conda/recipe.yaml", "dev/tools/gallery.py", "docs/cite.md"]
)
def test_addresses_of_the_project_are_the_addresses_of_its_metadata(name):
    text = (REPOSITORY / name).read_text(encoding="utf-8")
    found = re.findall(r"https://[^\s\"'),}]*/pcs-racing[^\s\"'),}]*", text)
    known = (
        URLS["Source"],
        URLS["Documentation"],
        "https://pypi.org/packages/source/p/pcs-racing/",
    )
    assert found
    assert all(link.startswith(known) for link in found)
