"""Installs the wheel into a clean environment and uses it there, far from the source tree.

    python dev/tools/try_wheel.py dist --parts base demo

First the base installation alone: what ships is inside, a race, a tournament and an agent with its
network run, and whoever asks for an extra that is missing is told its name. The part ``demo`` is
the extras of `make demo` and the quick study. Prints sizes and times, and ends with an error at the
first thing that does not work.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path
from zipfile import ZipFile

EXTRAS = "mapping,plots,learning"
NOT_IN_BASE = (
    "torch",
    "stable_baselines3",
    "matplotlib",
    "cma",
    "moocore",
    "pandas",
    "skimage",
    "clarabel",
)
INSIDE = (
    "pcs_racing/race/replay.html",
    "pcs_racing/py.typed",
    "pcs_racing/shipped_maps/Tarnfjord/",
    "pcs_racing/shipped_archives/default/archive.npz",
    "pcs_racing/shipped_drivers/ppo-drive/weights.safetensors",
    "pcs_racing_agents/py.typed",
    "pcs_racing_agents/data/configurations/study_quick.yaml",
    "pcs_racing_agents/shipped_networks/default-paper-regret/weights.safetensors",
    "pcs_racing_agents/agents/fits/default-paper-best-fixed.yaml",
    "pcs_racing_agents/study/report.html",
)
WHERE = """
import importlib.util, pcs_racing, pcs_racing_agents
from pcs_racing_agents.networks import list_networks
print(pcs_racing.__file__)
print(len(pcs_racing.list_tracks()), "circuits,", len(pcs_racing.list_archives()), "archives,",
      len(list_networks()), "networks,", len(pcs_racing_agents.names()), "agents")
print("not here:", *(name for name in {names!r} if importlib.util.find_spec(name) is None))
"""
AGENT = """
import gymnasium as gym
import pcs_racing, pcs_racing_agents
agent = pcs_racing_agents.make("cfr-argmax")
duel = gym.make("pcs_racing/Duel-v1", opponent="best-fixed", stay=True)
seen, info = duel.reset(seed=1)
over = False
while not over:
    (move,) = agent.act(seen[None])
    seen, reward, over, _, info = duel.step(int(move))
print("cfr-argmax against best-fixed:", duel.unwrapped.outcome()["result"], round(float(reward), 2))
"""


def processor_seconds() -> float:
    """Processor time of all programs run so far, s; on Windows, which does not tell, a clock."""
    times = os.times()
    return time.perf_counter() if os.name == "nt" else times.children_user + times.children_system


class Environment:
    """A virtual environment in a folder that nothing else knows of."""

    def __init__(self, folder: Path, python: str) -> None:
        self.folder = folder / "work"
        self.folder.mkdir()
        home = folder / "environment"
        if python:
            subprocess.run([python, "-m", "venv", home], check=True)
        else:
            venv.create(home, with_pip=True)
        self.scripts = home / ("Scripts" if os.name == "nt" else "bin")
        self.packages = home
        # PYTHONPATH would find the source tree instead of the wheel.
        self.variables = {
            name: value for name, value in os.environ.items() if not name.startswith("PYTHON")
        }
        # compiled from nothing, as at a user's
        self.variables["NUMBA_CACHE_DIR"] = str(folder / "numba")

    def run(self, *command: object, failing: bool = False) -> str:
        """Run a program of the environment in the empty folder; return what it printed."""
        program, *arguments = map(str, command)
        print(
            "$",
            program,
            *(argument if len(argument) < 80 else "..." for argument in arguments),
            flush=True,
        )
        begin, before = time.perf_counter(), processor_seconds()
        done = subprocess.run(
            [self.scripts / program, *arguments],
            cwd=self.folder,
            env=self.variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        spent = processor_seconds() - before
        lines = [f"  {line}" for line in done.stdout.rstrip().splitlines()[-8:]]
        print(*lines, f"  [{time.perf_counter() - begin:.1f} s, processor {spent:.1f} s]", sep="\n")
        if (done.returncode == 0) == failing:
            print(done.stdout)
            sys.exit(f"{program} ended with {done.returncode}")
        return done.stdout

    def install(self, *what: object) -> None:
        """Install packages by pip."""
        self.run("python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet", *what)

    def seconds(self, statement: str) -> float:
        """Processor time of a statement in a new process, the shortest of five runs, s."""
        times = []
        for _ in range(5):
            before = processor_seconds()
            subprocess.run(
                [self.scripts / "python", "-c", statement],
                cwd=self.folder,
                env=self.variables,
                check=True,
            )
            times.append(processor_seconds() - before)
        return min(times)


def check_contents(wheel: Path) -> None:
    """End with an error if something that must ship is not inside."""
    names = ZipFile(wheel).namelist()
    missing = [name for name in INSIDE if not any(inside.startswith(name) for inside in names)]
    if missing:
        sys.exit(f"{wheel.name} lacks {', '.join(missing)}")
    # What was run before the build must not ship: bytecode, and tests that need the checkout.
    strays = [name for name in names if "__pycache__" in name or name.startswith("tests/")]
    if strays:
        sys.exit(f"{wheel.name} should not hold {strays[0]}")
    unpacked = sum(entry.file_size for entry in ZipFile(wheel).infolist())
    print(
        f"{wheel.name}: {len(names)} files, {wheel.stat().st_size / 1e6:.2f} MB, unpacked"
        f" {unpacked / 1e6:.2f} MB"
    )


def try_base(environment: Environment, wheel: Path) -> None:
    """Use the base installation."""
    environment.install(wheel)
    told = environment.run("python", "-c", WHERE.format(names=NOT_IN_BASE))
    if str(environment.packages) not in told:
        sys.exit("the package that was imported is not the one that was installed")
    if told.strip().splitlines()[-1].split()[2:] != list(NOT_IN_BASE):
        sys.exit("the base installation brought something along that it should not")
    bare = environment.seconds("pass")
    # writes the bytecode
    environment.run("python", "-c", "import pcs_racing, pcs_racing_agents.cli.main")
    print("beyond those of an empty program:")
    for package in ("numpy", "numba", "gymnasium, pettingzoo", "pcs_racing", "pcs_racing_agents"):
        print(
            f"import {package}: {environment.seconds(f'import {package}') - bare:.2f} s of"
            " processor time"
        )
    race = (
        "race",
        "--track",
        "Pipkin",
        "--ego",
        "lattice",
        "--opponent",
        "lane-switcher:3",
        "--seed",
        1,
    )
    environment.run("pcs-racing", *race, "--replay", "race.html")
    environment.run(
        "pcs-racing",
        "tournament",
        "--track",
        "Pipkin",
        "--agents",
        "cfr-argmax",
        "never-switch",
        "--races",
        4,
        "--out",
        "zoo",
    )
    environment.run("python", "-c", AGENT)
    told = environment.run(
        "pcs-racing", "ppo", "--config", "duel-paper", "--out", "ppo", failing=True
    )
    if 'pip install "pcs-racing[learning]"' not in told:
        sys.exit("PPO without its extra does not say which one is missing")
    for made in ("race.html", "zoo/results.csv"):
        if not (environment.folder / made).is_file():
            sys.exit(f"{made} was not written")


def try_demo(environment: Environment, wheel: Path) -> None:
    """Use it with the extras of `make demo`."""
    environment.install(f"{wheel}[{EXTRAS}]")
    environment.run("pcs-racing", "study", "quick", "--out", "demo")
    for made in ("results.csv", "table.csv", "report.html"):
        if not (environment.folder / "demo" / made).is_file():
            sys.exit(f"demo/{made} was not written")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path, help="the wheel, or a folder that holds one")
    parser.add_argument("--python", default="", help="another interpreter, for instance python3.13")
    parser.add_argument(
        "--parts", nargs="+", choices=("base", "demo"), default=["base"], help="default: base"
    )
    arguments = parser.parse_args()
    wheel = arguments.wheel.resolve()
    if wheel.is_dir():
        wheels = sorted(wheel.glob("*.whl"))
        if len(wheels) != 1:
            sys.exit(f"{wheel} holds {len(wheels)} wheels; there must be one")
        wheel = wheels[0]
    check_contents(wheel)
    with tempfile.TemporaryDirectory(prefix="pcs-racing-") as folder:
        environment = Environment(Path(folder).resolve(), arguments.python)
        environment.run("python", "--version")
        if "base" in arguments.parts:
            try_base(environment, wheel)
        if "demo" in arguments.parts:
            try_demo(environment, wheel)
    print("the wheel works")


if __name__ == "__main__":
    main()
