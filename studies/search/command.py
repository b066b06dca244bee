"""``python -m studies search``: ablation of the search, searches against the last winner, and
tuned planners of the field.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Annotated

import yaml

from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.base.tables import write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import Workers
from pcs_racing_agents.policies.tuning import TuningConfig, TuningProgress, tune
from studies.search.arms import ARMS, FIELD, HAND_SET, ROUNDS, SEEDS, field_config, round_config

PARTS = ("arms", "rounds", "field")


@command("search", "python -m studies search arms rounds field --out out/search")
def run(
    parts: Annotated[Sequence[str], Option("searches to run", choices=PARTS)],
    *,
    out: Annotated[Path, Option("folder of the searches; a stopped run resumes there", "DIR")],
    seeds: Annotated[Sequence[int], Option("seeds of arms and rounds")] = tuple(range(SEEDS)),
    workers: Workers,
) -> None:
    """Run searches, and write their policies into policies.csv."""
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
            else:
                for planner in FIELD:
                    _tuned(out / "field" / planner, field_config(planner), executor)
    print(f"written: {_list(out)}")


def _tuned(folder: Path, config: TuningConfig, executor: Executor) -> str:
    """Run a search, or load its result, and return the text of its policy."""
    file = folder / "tuned.yaml"
    if not file.exists():
        show = show_progress("generations")

        def update(stage: str, done: int, total: int, state: TuningProgress | None) -> None:
            show(done, total, f"{folder.name}, {stage}, {state.best if state else 0:.3f}")

        tune(config, folder, executor=executor, callback=update)
    return str(yaml.safe_load(file.read_text(encoding="utf-8"))["policy"])


def _list(out: Path) -> Path:
    """Write the policies of all finished searches."""
    found = [
        (str(file.parent.relative_to(out)), yaml.safe_load(file.read_text("utf-8"))["policy"])
        for file in sorted(out.glob("*/*/tuned.yaml"))
    ]
    return write_csv([("search", "policy"), *found], out / "policies.csv")
