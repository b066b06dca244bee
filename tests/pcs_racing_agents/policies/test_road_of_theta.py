"""The way of a parameter vector theta from the search to the compiled kernel: few files, and none
of them twice.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from repository import REPOSITORY

from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race import driving
from pcs_racing_agents.policies.archive_run import synthesize
from pcs_racing_agents.policies.config import load_archive_config
from pcs_racing_agents.policies.search import CubeCMAES

pytest.importorskip("cma")
pytest.importorskip("moocore")

MARK = np.linspace(0.31, 0.69, len(LATTICE.parameters))  # in the unit cube, where it is drawn
THETA = LATTICE.bounds[:, 0] + MARK * (LATTICE.bounds[:, 1] - LATTICE.bounds[:, 0])
PACKAGES = (REPOSITORY / "pcs_racing", REPOSITORY / "pcs_racing_agents")

SETTINGS = (
    "{duration: 2, final_duration: 2, segment_seconds: 2, initial_sample: 12, opponents: 1, starts:"
    " 1, candidates: 4, choice_opponents: 1, choice_starts: 1, final_opponents: 1, final_starts: 1,"
    " crash_limit: 1.0, min_policies: 2, population: 4, generations: 1, tracks: [Pipkin]}"
)


def holds(value, depth: int = 4) -> bool:
    """Whether a value contains the marked theta."""
    if isinstance(value, np.ndarray):
        fits = value.dtype == np.float64 and value.ndim > 0 and value.shape[-1] == len(THETA)
        return fits and bool((value == THETA).all(axis=-1).any())
    if depth and isinstance(value, list | tuple):
        return any(holds(item, depth - 1) for item in value)
    return (
        depth > 0
        and isinstance(value, dict)
        and any(holds(item, depth - 1) for item in value.values())
    )


class SpyKernel:
    """The kernel, which notes the files of the callers that hold the marked theta."""

    def __init__(self, kernel):
        self.kernel, self.roads = kernel, []

    def __call__(self, *arguments):
        if holds(arguments):
            files, frame = [], sys._getframe(1)
            while frame is not None:
                file = Path(frame.f_code.co_filename)
                if any(package in file.parents for package in PACKAGES) and holds(
                    dict(frame.f_locals)
                ):
                    files.append(str(file.relative_to(REPOSITORY)))
                frame = frame.f_back
            files.reverse()
            self.roads.append(
                [*files[:1], *(later for earlier, later in pairwise(files) if later != earlier)]
            )
        return self.kernel(*arguments)

    def __getattr__(self, name):
        return getattr(self.kernel, name)


def test_theta_passes_eight_files_between_the_search_and_the_kernel_and_none_twice(
    monkeypatch, tmp_path
):
    draw = CubeCMAES.ask
    spy = SpyKernel(driving.advance_races)
    monkeypatch.setattr(driving, "advance_races", spy)
    monkeypatch.setattr(CubeCMAES, "ask", lambda self: np.vstack([MARK, draw(self)[1:]]))
    settings = tmp_path / "small.yaml"
    settings.write_text(SETTINGS)
    # Without an executor the tasks run in this thread, where the spy sees all callers.
    synthesize(load_archive_config(settings), tmp_path / "archive")
    # of the search; the choice and the measurement race policies of the archive once more
    road = spy.roads[0]
    assert road[0] == "pcs_racing_agents/policies/archive_run.py"
    assert len(road) <= 8  # one of them only guards the task against what can't be sent back
    assert len(set(road)) == len(road)
