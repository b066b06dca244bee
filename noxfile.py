"""Long checks, most of them in environments of their own: `nox --list`, `nox -s NAME [-- WORDS]`.

No target of `make` starts them; the weekly workflow runs `compare` and `wheel`.
"""

import os
import shutil
import sys
from pathlib import Path

import nox

nox.options.sessions = []
nox.options.reuse_existing_virtualenvs = True
ROOT = Path(__file__).parent
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", ".nox", "out", "build", "dist", ".*_cache")

IN_WHEEL = """
import gymnasium as gym, importlib.util, numpy as np, pcs_racing, pcs_racing_agents
assert "site-packages" in pcs_racing.__file__ and "site-packages" in pcs_racing_agents.__file__
extras = "torch", "stable_baselines3", "matplotlib", "cma", "moocore", "pandas", "skimage"
assert not [name for name in extras if importlib.util.find_spec(name)]
agent = pcs_racing_agents.make("cfr-argmax")
duel = gym.make("pcs_racing/Duel-v1", opponent="best-fixed", stay=True)
seen, over = duel.reset(seed=1)[0], False
while not over:
    seen, reward, over, _, info = duel.step(int(agent.act(np.stack([seen]))[0]))
print("cfr-argmax against best-fixed:", duel.unwrapped.outcome()["result"], reward)
"""


@nox.session
def wheel(session: nox.Session) -> None:
    """Install the wheel, use it far from the sources, then run the quick study with its extras.

    `-- dist` takes the wheel in this folder; without it one is built.
    """
    folder = Path(session.create_tmp()).resolve()
    wheels = Path(session.posargs[0]).resolve() if session.posargs else folder / "wheel"
    if not session.posargs:
        session.run("pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(wheels), str(ROOT))
    (built,) = wheels.glob("pcs_racing-*.whl")
    session.install(str(built))
    session.chdir(folder)
    # Compiled from nothing, as for a new user; PYTHONPATH would find the sources.
    env = {"NUMBA_CACHE_DIR": str(folder / "numba"), "PYTHONPATH": None}
    race = ("--track", "Pipkin", "--ego", "lattice", "--opponent", "lane-switcher:3")
    agents = ("--track", "Pipkin", "--agents", "cfr-argmax", "never-switch", "--races", "4")
    session.run("python", "-c", IN_WHEEL, env=env)
    session.run("pcs-racing", "race", *race, "--replay", "race.html", env=env)
    session.run("pcs-racing", "tournament", *agents, "--out", "zoo", env=env)
    session.run("pcs-racing", "study", "quick", "--out", "none", env=env, success_codes=[2])
    session.install(f"{built}[mapping,plots,learning]")
    session.run("pcs-racing", "study", "quick", "--out", "study", env=env)


STEP = """
import gymnasium as gym, pcs_racing, pcs_racing_agents
assert "site-packages" in pcs_racing.__file__ and "site-packages" in pcs_racing_agents.__file__
gym.register_envs(pcs_racing)
env = gym.make("pcs_racing/Drive-v1", track="Pipkin", opponent="lattice:pace=0.3", beams=108)
env.action_space.seed(1)
env.reset(seed=1)
over = False
while not over:
    seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
    over = terminated or truncated
print("an episode, its last observation of shape", seen.shape)
"""


@nox.session(python=["3.11", "3.12", "3.13", "3.14"], venv_backend="uv")
@nox.parametrize("bounds", ["lowest-direct", "highest"])
def dependencies(session: nox.Session, bounds: str) -> None:
    """Install the wheel with the oldest or newest allowed dependencies, then race and step."""
    folder = Path(session.create_tmp()).resolve()
    session.run("uv", "build", "--quiet", "--out-dir", str(folder / "dist"), str(ROOT))
    (built,) = (folder / "dist").glob("pcs_racing-*.whl")
    wheels = ("--resolution", bounds, "--only-binary", ":all:")
    session.install(*wheels, "--requirements", str(ROOT / "pyproject.toml"))
    session.install("--no-deps", "--reinstall", str(built))
    empty = folder / "empty"
    shutil.rmtree(empty, ignore_errors=True)
    empty.mkdir()
    session.chdir(empty)
    caches = {"NUMBA_CACHE_DIR": f"{folder}/numba", "PCS_RACING_CACHE": f"{folder}/tracks"}
    env = {**caches, "PYTHONPATH": None}
    session.run("pcs-racing", "race", "--track", "Pipkin", "--replay", "race.html", env=env)
    session.run("python", "-c", STEP, env=env)


@nox.session
@nox.parametrize("name", sorted(path.stem for path in ROOT.glob("examples/clients/*.py")))
def clients(session: nox.Session, name: str) -> None:
    """Run the example of a library with the versions that it names."""
    script = f"examples/clients/{name}.py"
    # Newer versions of torch would bring gigabytes of CUDA.
    limits = Path(session.create_tmp(), "limits.txt").resolve()
    limits.write_text("torch>=2.8,<2.14")
    needed = nox.project.load_toml(script)["dependencies"]
    session.install("--constraint", str(limits), "--editable", ".", *needed)
    session.run("python", script)


@nox.session
def compare(session: nox.Session) -> None:
    """Compare our code with other libraries, some of them large."""
    session.install("--editable", ".[compare]")
    session.run("pytest", "-m", "compare", "-rs", *session.posargs)


@nox.session(python=["3.11", "3.12", "3.13", "3.14"])
def tests(session: nox.Session) -> None:
    """Run the tests with another Python."""
    session.install("--only-binary=:all:", "--editable", ".[test]")
    session.run("pytest", *session.posargs)


WIDE = ("X86_V4", "AVX512_ICL", "AVX512_SPR")
"""Groups of instructions beyond AVX2 that numpy has loops for."""

MACHINES = {
    "generic": {"NUMBA_CPU_NAME": "generic"},
    "haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "libm": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"},
    "torch": {"ATEN_CPU_CAPABILITY": "default", "ONEDNN_MAX_CPU_ISA": "SSE41"},
    "threads": {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    "read-only": {},
}
"""Variables that make the libraries behave as on another processor."""


@nox.session(venv_backend="none")
@nox.parametrize("name", list(MACHINES))
def machines(session: nox.Session, name: str) -> None:
    """Run the tests as another machine would, from empty caches; words after `--` go to pytest."""
    folder = Path(session.create_tmp()).resolve() / name
    shutil.copytree(ROOT, folder, ignore=NOT_COPIED)
    caches = {"NUMBA_CACHE_DIR": f"{folder}/out/numba", "PCS_RACING_CACHE": f"{folder}/out/tracks"}
    env = {"PYTHONPATH": str(folder), "HOME": f"{folder}/out", **caches, **MACHINES[name]}
    (folder / "out").mkdir()
    who: list[str] = []
    if name == "haswell":
        from numpy._core._multiarray_umath import __cpu_features__ as features

        env["NPY_DISABLE_CPU_FEATURES"] = " ".join(word for word in WIDE if features.get(word))
    if name == "read-only":
        session.run("chmod", "-R", "a-w", str(folder))
        session.run("chmod", "-R", "a+w", f"{folder}/out")
        if os.getuid() == 0:  # root may write everywhere
            who = ["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups"]
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *session.posargs]
    session.chdir(folder)
    session.run(*who, *command, env=env)


FAST = {
    "pcs_racing/car": "collision ittc lidar vehicle",
    "pcs_racing/envs": "drive_kernel game_batch",
    "pcs_racing/race": "race_kernel",
    "pcs_racing/track": "frenet grid",
    "pcs_racing/track/building": "clearance curves raceline",
    "pcs_racing_agents/networks": "regret_network",
    "pcs_racing_agents/solvers": "cfr matrix_games",
}
"""Tests of kernels that are fast as plain Python, by folder."""


@nox.session(venv_backend="none")
def coverage(session: nox.Session) -> None:
    """Measure coverage, of compiled functions by running a part of the tests as plain Python."""
    measured = (sys.executable, "-m", "pytest", "--cov", "--cov-report=", "--cov-fail-under=0")
    session.run(*measured, "-n", "2", "--dist", "worksteal")
    # Real circuits would take minutes; warnings of overflows and of 0 / 0 are intended.
    plain = {"NUMBA_DISABLE_JIT": "1", "PCS_RACING_MAPS": "none"}
    fast = [f"tests/{room}/test_{name}.py" for room in FAST for name in FAST[room].split()]
    fast.append("tests/interpreted")
    session.run(*measured, "--cov-append", "-W", "ignore::RuntimeWarning", *fast, env=plain)
    for package in ("pcs_racing", "pcs_racing_agents"):
        session.run(sys.executable, "-m", "coverage", "report", "--include", f"{package}/*")


@nox.session(venv_backend="none")
def mutants(session: nox.Session) -> None:
    """Put small faults into a file or room, and list those that no test of its room notices.

    `-- FILE [TESTS ...]`; without tests those in the folder of `tests` with the room's name.
    """
    changed, *tests = session.posargs
    room = Path(changed).parent if changed.endswith(".py") else changed
    tests = tests or [f"tests/{room}"]
    out = ROOT / "out" / "mutants" / Path(changed).with_suffix("")
    done = str(out / "faults.sqlite")
    out.mkdir(parents=True, exist_ok=True)
    # Also after a run that was stopped, which may have left a fault behind.
    shutil.copytree(ROOT, out / "tree", ignore=NOT_COPIED, dirs_exist_ok=True)
    session.chdir(out / "tree")
    if not Path(done).exists():
        text = (ROOT / "dev" / "mutation.toml").read_text()
        command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {' '.join(tests)}"
        text = text.replace("CHANGED", changed).replace("COMMAND", command)
        (out / "mutation.toml").write_text(text)
        session.run("cosmic-ray", "init", "../mutation.toml", done)
        session.run("cr-filter-operators", done, "../mutation.toml")
    # Nothing is optimised: a compiled fault runs for seconds.
    env = {"PYTHONPATH": str(out / "tree"), "PYTHONHASHSEED": "0", "NUMBA_OPT": "1"}
    session.run("cosmic-ray", "exec", "../mutation.toml", done, env=env)
    session.chdir(ROOT)
    session.run(sys.executable, "dev/tools/survivors.py", done)
