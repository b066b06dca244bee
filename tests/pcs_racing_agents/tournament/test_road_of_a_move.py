"""The way of a move from an agent's ``act`` to a row of ``results.csv``: few files, none twice,
in few forms.
"""

import csv
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from repository import REPOSITORY
from zoo_games import untrained

from pcs_racing import load_race_config
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.tournament import plan_tournament, play_plan, tournament_settings
from pcs_racing_agents.tournament.race_files import write_results

RACES = 20
PACKAGES = (REPOSITORY / "pcs_racing", REPOSITORY / "pcs_racing_agents")
ENDS = {
    "act": "agents/agent.py",
    "write_chunk": "base/chunks.py",
    "write_results": "tournament/race_files.py",
}


@cache
def project_file(name: str) -> str | None:
    """Path of a file within the project; None for that of libraries and tests."""
    file = Path(name)
    return (
        str(file.relative_to(REPOSITORY))
        if any(package in file.parents for package in PACKAGES)
        else None
    )


def holds(value, moves, depth: int = 4) -> bool:
    """Whether a value contains the first moves of all races, one after the other."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind != "i" or RACES not in value.shape:
            return False
        columns = np.moveaxis(value, value.shape.index(RACES), -1).reshape(-1, RACES)
        return bool((columns == moves).all(axis=1).any())
    if not isinstance(value, dict | list | tuple):
        value = getattr(value, "__dict__", {})
    parts = value.values() if isinstance(value, dict) else value
    return depth > 0 and any(holds(part, moves, depth - 1) for part in parts)


class Watch:
    """A profiler that notes who calls the ends of the road, and which functions hand the moves on,
    in which forms.
    """

    def __init__(self) -> None:
        self.roads: dict[str, list[str]] = {}  # by function: the files of its callers
        self.files: set[str] = set()
        self.forms: set[str] = set()
        self.moves: np.ndarray | None = None

    def __call__(self, frame, event, value) -> None:
        file, name = project_file(frame.f_code.co_filename), frame.f_code.co_name
        if file is None:
            return
        if (
            event == "call"
            and name in ENDS
            and file.endswith(ENDS[name])
            and name not in self.roads
        ):
            files = []
            while frame is not None:
                files.append(project_file(frame.f_code.co_filename))
                frame = frame.f_back
            files = [own for own in reversed(files) if own is not None]
            self.roads[name] = [
                *files[:1],
                *(later for earlier, later in pairwise(files) if later != earlier),
            ]
        elif event == "return" and self.moves is None and name == "act":
            self.moves = value
        elif event == "return" and self.moves is not None and holds(value, self.moves):
            self.files.add(file)
            self.forms.add(type(value).__name__)


def test_a_move_passes_fourteen_files_on_its_way_to_a_row_and_none_twice(oval, spec, tmp_path):
    agent, rival = (
        build("cfr-argmax", spec, network=untrained(spec, seed=0)),
        build("never-switch", spec),
    )
    rules = load_race_config("paper", duration=4.0)
    plan = plan_tournament(oval, [agent, rival], rules, archive=spec.archive, races_per_pair=RACES)
    play_plan(plan)  # a compiler that is watched takes minutes
    watch = Watch()
    with open_job(tmp_path / "job", "tournament", tournament_settings(plan)) as job:
        sys.setprofile(watch)
        try:
            written = write_results(play_plan(plan, job=job).races, tmp_path / "results.csv")
        finally:
            sys.setprofile(None)
    rows = list(csv.DictReader(written.read_text(encoding="utf-8").splitlines()))
    assert [row["ego_moves"].split("; ")[0] for row in rows] == [
        spec.moves[move] for move in watch.moves
    ]
    assert len(set(watch.moves.tolist())) > 1
    assert list(watch.roads) == list(ENDS)
    for road in watch.roads.values():
        assert len(set(road)) == len(road), f"a file is entered twice: {road}"
    files = watch.files.union(*watch.roads.values())
    assert len(files) <= 14, sorted(files)
    # Without single arrays and what holds several of one form.
    assert watch.forms - {"ndarray", "tuple", "list", "Categorical"} == {
        "_SharedGames",  # the branches of all egos
        "dict",  # columns of one ego, in a chunk
        "RaceTable",
        "Tournament",
    }
