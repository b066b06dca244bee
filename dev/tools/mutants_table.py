"""Which files ``dev/tools/mutants.py`` puts faults into, and which tests are asked about them.

Both follow from the tree. A room is a folder of one of the packages, and its tests lie in the
folder of the same name below ``tests``. Only what that misses is a table here.
"""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PLAIN, COMPILED = "plain", "compiled"
_BRANCHES = (ast.If, ast.IfExp, ast.While, ast.BinOp, ast.Compare, ast.BoolOp, ast.AugAssign)
_SIMULATOR = tuple(f"pcs_racing/{floor}" for floor in ("base", "track", "car", "planners", "race"))

# What of a room, or of a file, is tested from another room: by its commands, or only where it
# races.
ELSEWHERE = {
    "pcs_racing/car": ("tests/pcs_racing/race/test_race_kernel.py",),
    "pcs_racing/planners": (
        "tests/pcs_racing/race/test_race_kernel.py",
        "tests/pcs_racing/race/test_race_state.py",
    ),
    "pcs_racing/game/match.py": ("tests/pcs_racing/envs/test_match.py",),
    "pcs_racing/race/random_circuits.py": ("tests/pcs_racing/envs/test_randomization.py",),
    "pcs_racing_agents/watch": (
        "tests/pcs_racing_agents/cli/test_view_command.py",
        "tests/pcs_racing_agents/cli/test_explain_command.py",
    ),
    "pcs_racing_agents/cli": ("tests/pcs_racing_agents/**/test_*command*.py",),
    "pcs_racing_agents/cli/learn.py": (
        "tests/pcs_racing_agents/learning/test_learn.py",
        "tests/pcs_racing_agents/learning/responses/test_best_reply.py",
    ),
    "pcs_racing_agents/cli/benchmark.py": ("tests/pcs_racing_agents/benchmark/test_benchmark.py",),
    "pcs_racing_agents/cli/synthesize.py": (
        "tests/pcs_racing_agents/policies/test_archive_run.py",
    ),
    "pcs_racing_agents/cli/study.py": ("tests/pcs_racing_agents/study/test_run.py",),
    "pcs_racing_agents/cli/agents.py": ("tests/pcs_racing_agents/agents/test_agents_page.py",),
}

# The code on pages shows what is there; it is no test of a room.
_LEFT_OUT = ("_docs.py", "agents_page", "ppo_page", "reports_page", "self_play_page")

# Tests that are fast as plain Python (``NUMBA_DISABLE_JIT=1``): they are asked first where a fault
# costs half a minute of compiling.
PLAIN_TESTS = frozenset(
    f"tests/pcs_racing/{folder}/test_{name}.py"
    for folder, names in {
        "base": "files settings artifacts checks",
        "track": "grid frenet",
        "track/building": "walls clearance curves raceline",
        "car": "vehicle collision ittc lidar",
        "planners": "planner",
        "race": "race_config race_state race_kernel",
    }.items()
    for name in names.split()
)


@cache
def files() -> dict[str, int]:
    """Files with arithmetic or branches, and how many: the most of a room first, and the rooms in
    turn.
    """
    found = {
        file.relative_to(ROOT).as_posix(): _branches(file)
        for file in sorted(ROOT.glob("pcs_racing*/*/**/*.py"))
    }
    order = sorted(filter(found.get, found), key=lambda file: -found[file])
    place = {
        file: [other for other in order if room_of(other) == room_of(file)].index(file)
        for file in order
    }
    return {
        file: found[file] for file in sorted(order, key=lambda file: (place[file], room_of(file)))
    }


def room_of(file: str) -> str:
    """Return the folder of a package that a file belongs to, such as ``pcs_racing/track``."""
    return "/".join(Path(file).parent.parts[:2])


@cache
def tests_of(file: str, mode: str) -> tuple[str, ...]:
    """Return the tests of a file's room that run in one of the two ways: those with its name first,
    then its users.
    """
    room, stem = room_of(file), Path(file).stem
    patterns = (f"tests/{room}/**/test_*.py", *ELSEWHERE.get(room, ()), *ELSEWHERE.get(file, ()))
    found = {
        path.relative_to(ROOT).as_posix() for pattern in patterns for path in ROOT.glob(pattern)
    }
    found = {test for test in found if not any(word in test for word in _LEFT_OUT)}
    if mode == PLAIN:
        found = found & PLAIN_TESTS if file.startswith(_SIMULATOR) else set()
    module = file.removesuffix(".py").replace("/", ".")
    uses = {test: module in (ROOT / test).read_text(encoding="utf-8") for test in found}
    return tuple(
        sorted(found, key=lambda test: (stem not in Path(test).stem, not uses[test], test))
    )


def _branches(file: Path) -> int:
    return sum(
        isinstance(node, _BRANCHES)
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    )
