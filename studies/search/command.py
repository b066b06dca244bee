"""``python -m studies search`` and ``judge-search``: searches for strong policies, and races of
their policies on circuits held out.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive_files import load_archive
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.base.tables import aligned, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import Workers
from pcs_racing_agents.policies.tuning import (
    HELD_OUT,
    TUNING_TRACKS,
    TuningConfig,
    TuningProgress,
    tune,
)
from studies.search.arms import (
    ARMS,
    FIELD,
    FOUND,
    HAND_SET,
    OTHERS,
    PAPER,
    REAL,
    ROUNDS,
    SEEDS,
    field_config,
    round_config,
)
from studies.search.axes import axis_rows
from studies.search.judge import archive_rows, arm_rows, best_of, field_rows, round_rows

Floats = NDArray[np.float64]

SEARCHES = ("arms", "rounds", "field", "paper")
JUDGED = (*SEARCHES, "archive", "axes")


@command("search", "python -m studies search arms rounds field paper --out out/search")
def search(
    parts: Annotated[Sequence[str], Option("searches to run", choices=SEARCHES)],
    *,
    out: Annotated[Path, Option("folder of the searches; a stopped run resumes there", "DIR")],
    seeds: Annotated[Sequence[int], Option("seeds of the rounds")] = tuple(range(SEEDS)),
    workers: Workers,
) -> None:
    """Search for strong policies, and write them into policies.csv."""
    with workers.start() as executor:
        for part in parts:
            if part == "arms":
                for name, config in ARMS.items():
                    _tuned(out / "arms" / name.replace(" ", "-"), config, executor)
            elif part == "rounds":
                for seed in seeds:
                    winner = HAND_SET
                    for number in range(1, ROUNDS + 1):
                        place = out / "rounds" / f"{seed}-{number}"
                        winner = _tuned(place, round_config(winner, seed, number), executor)
            elif part == "field":
                for planner in FIELD:
                    _tuned(out / "field" / planner, field_config(planner), executor)
            else:
                _tuned(out / "paper" / "scalar", PAPER, executor)
    files = sorted(out.glob("*/*/tuned.yaml"))
    found = [(str(file.parent.relative_to(out)), _policy(file)) for file in files]
    print(f"written: {write_csv([('search', 'policy'), *found], out / 'policies.csv')}")


@command(
    "judge-search",
    "python -m studies judge-search arms rounds field archive paper --maps maps --out out/search",
)
def judge_search(
    parts: Annotated[Sequence[str], Option("parts to judge", choices=JUDGED)],
    *,
    out: Annotated[Path, Option("folder of the searches", "DIR")],
    archive: Annotated[str, Option("archive of the rules contest")] = "contest",
    paper_archive: Annotated[str, Option("archive of the rules paper")] = "default",
    maps: Annotated[Path, Option(f"folder with the real circuits {', '.join(REAL)}", "DIR")],
) -> None:
    """Race what the searches found on circuits held out, and write a table for each part."""
    tracks = (*HELD_OUT, *(str(maps / name) for name in REAL))
    for part in parts:
        if part == "arms":
            rows = arm_rows(policies(out, part), tracks)
        elif part == "rounds":
            rows = round_rows(policies(out, part), tracks)
        elif part == "field":
            rows = field_rows(best_of(archive), policies(out, part), tracks)
        elif part == "axes":
            rows = axis_rows(_near(archive), (FOUND, HAND_SET, *OTHERS), TUNING_TRACKS)
        elif part == "archive":
            rows = archive_rows(archive, tracks[:4])
        else:
            ((_, text),) = policies(out, part)
            rows = field_rows(
                text, [("best of the archive", best_of(paper_archive))], tracks, "paper"
            )
        print("\n".join(aligned(rows)))
        print(f"written: {write_csv(rows, out / f'{part}.csv')}\n")


def policies(out: Path, part: str) -> list[tuple[str, str]]:
    """Return names and policies of the finished searches of a part."""
    files = sorted((out / part).glob("*/tuned.yaml"))
    if not files:
        raise InputError(f"{out / part} holds no finished search; run the searches first")
    return [(file.parent.name, _policy(file)) for file in files]


def _policy(file: Path) -> str:
    return str(yaml.safe_load(file.read_text(encoding="utf-8"))["policy"])


def _near(archive: str) -> Floats:
    """Return parameters of an archive's policies, and of others near them, shape (K, P)."""
    theta = load_archive(archive).parameters
    low, high = get_planner("lattice").bounds.T
    rng = np.random.default_rng(0)
    steps = rng.normal(0.0, 0.1, (3, *theta.shape)) * (rng.random((3, *theta.shape)) < 0.5)
    moved = np.clip(theta + steps * (high - low), low, high)
    return np.concatenate([theta, *moved])


def _tuned(folder: Path, config: TuningConfig, executor: Executor) -> str:
    """Run a search, or load its result, and return the text of its policy."""
    file = folder / "tuned.yaml"
    if not file.exists():
        show = show_progress("generations")

        def update(stage: str, done: int, total: int, state: TuningProgress | None) -> None:
            show(done, total, f"{folder.name}, {stage}, {state.best if state else 0:.3f}")

        tune(config, folder, executor=executor, callback=update)
    return _policy(file)
