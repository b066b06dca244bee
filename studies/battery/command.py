"""``python -m studies battery``: is it worth seeing what the opponent has spent, when its energy is
hidden?
"""

import os
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.base.jobs import Job, open_job
from pcs_racing_agents.base.statistics import Estimate, clustered_mean
from pcs_racing_agents.base.style import new_figure, picture, save_picture, tidy
from pcs_racing_agents.base.tables import markdown, with_interval, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import can_draw, output_folder
from studies.battery.faults import OPPONENTS, Sample, race_sample, series_gain
from studies.battery.play import ARMS, Cell, run_cell
from studies.battery.rules import Floats, Rules

SHIPPED, REAL = ("Brackwater", "Tarnfjord"), ("Austin", "Zandvoort")
VARIANTS = {
    "base": Rules(),
    "long-no-charge": Rules(energy=(4.0, 12.0, 24.0), step=4.0, charge=0.0),
    "long-steps": Rules(energy=(4.0, 12.0, 24.0), step=4.0),
    "energy": Rules(energy=(4.0, 12.0, 24.0)),
    "no-charge": Rules(charge=0.0),
    "no-distance": Rules(reach=float("inf")),
}
"""Rules of the trial, and the variants that are tried before it is called refuted."""
PLANNERS = ("lattice", "line-ppo")
RACED = [(planner, "base") for planner in PLANNERS]
RACED += [("lattice", "long-no-charge"), ("lattice", "long-steps")]
"""Planners and variants that are raced whatever their ceiling; the others above the goal only."""
GOAL, SUPPORT = 0.05, 3
SEED = 5101
SIZES = {
    False: {"lines": 48, "repeats": 20, "clusters": 8},
    True: dict.fromkeys(("lines", "repeats", "clusters"), 2),
}
"""Training lines, training races from each side of each, and groups of test lines."""
HEAD = (
    "rules",
    "planner",
    "circuit",
    "ceiling",
    "plans",
    "gap",
    "shown - gap",
    "in race 1",
    "told - shown, race 1",
)


class Row(NamedTuple):
    """Results of one cell."""

    rules: str
    planner: str
    circuit: str
    ceiling: float
    support: int  #: Max number of plans in equilibrium over the types.
    gap: float  #: Score of the arm "gap" in races 2 and 3; NaN if the cell was not raced.
    shown: Estimate | None = None  #: "shown" minus "gap" in races 2 and 3.
    first: Estimate | None = None  #: The same in race 1.
    told: Estimate | None = None  #: "told" minus "shown" in race 1.

    @property
    def passes(self) -> bool:
        """Whether the cell meets the goal."""
        won = self.shown is not None and self.shown.mean >= GOAL and self.shown.low > 0.0
        return won and self.support >= SUPPORT

    def texts(self) -> tuple[str, ...]:
        """Return the row of the table."""
        found = [one and with_interval(one.mean, one.low, one.high) for one in self[-3:]]
        gap = "not raced" if self.shown is None else f"{self.gap:.3f}"
        numbers = (f"{self.ceiling:+.3f}", str(self.support), gap)
        return (*self[:3], *numbers, *(one or "" for one in found))


def gain(scores: Floats, arm: str, base: str, races: slice) -> Estimate | None:
    """Return one arm's score minus another's, clustered by group of start lines."""
    difference = (scores[ARMS.index(arm)] - scores[ARMS.index(base)])[..., races]
    if np.isnan(difference).any():
        return None
    return clustered_mean(difference.ravel(), np.indices(difference.shape)[0].ravel())


def make_row(rules: str, planner: str, circuit: str, found: Mapping[str, Any]) -> Row:
    """Return the row of a cell from the arrays of :func:`studies.battery.play.run_cell`."""
    scores, later = found["scores"], slice(1, None)
    return Row(
        rules,
        planner,
        circuit,
        float(found["ceiling"].mean()),
        int(found["support"].max()),
        float(scores[ARMS.index("gap")][..., later].mean()),
        gain(scores, "shown", "gap", later),
        gain(scores, "shown", "gap", slice(1)),
        gain(scores, "told", "shown", slice(1)),
    )


def race_cells(job: Job, tracks: Mapping[str, Track], size: Mapping[str, int]) -> Iterator[Row]:
    """Run the cells; a variant with `line-ppo` stops on the first circuit that misses the goal."""
    for planner, rules in product(PLANNERS, VARIANTS):
        for circuit, track in tracks.items():
            arms = ARMS if (planner, rules) == ("lattice", "base") else ("gap", "shown")
            least = -1.0 if (planner, rules) in RACED else GOAL
            cell = Cell(track, planner, VARIANTS[rules], arms=arms, least=least, seed=SEED, **size)
            name = f"{rules}-{planner}-{circuit.lower()}"
            row = make_row(rules, planner, circuit, job.run(name, run_cell, [cell])[0])
            yield row
            if planner == "line-ppo" and rules != "base" and not row.passes:
                break


@picture
def draw(rows: list[Row], file: Path) -> Path:
    """Draw the gain of each raced cell with its interval, and its ceiling."""
    raced = [(row, row.shown) for row in rows if row.shown is not None]
    figure = new_figure(6.4, 0.24 * len(raced) + 0.9)
    panel = figure.subplots()
    for k, (row, shown) in enumerate(raced):
        panel.plot(row.ceiling, k, "|", color="0.5", markersize=9)
        panel.plot([shown.low, shown.high], [k, k], color="C0")
        panel.plot(shown.mean, k, "o", color="C0", markersize=4)
    panel.axvline(GOAL, color="0.6", linestyle=":")
    panel.set_yticks(range(len(raced)), [", ".join(row[:3]) for row, _ in raced])
    panel.set(xlabel="gain in races 2 and 3 (grey: ceiling; dotted: goal)")
    panel.invert_yaxis()
    tidy(panel, "x")
    return save_picture(figure, file)


Out = Annotated[Path, Option("folder of the tables; a stopped run resumes there", "DIR")]
Maps = Annotated[
    Path | None, Option("folder of the real circuits (default: $PCS_RACING_MAPS)", "DIR")
]
Small = Annotated[bool, Option("a few races on one circuit")]


def circuits(small: bool, maps: Path | None) -> dict[str, Track]:
    """Load the circuits by name; the small study has the first one."""
    folder = maps or Path(os.environ.get("PCS_RACING_MAPS", ""))
    names = SHIPPED[:1] if small else (*SHIPPED, *(str(folder / name) for name in REAL))
    return {track.name: track for track in map(load_track, names)}


def job_settings(tracks: Mapping[str, Track], small: bool) -> dict[str, Any]:
    """Return the inputs of a job's results."""
    hashes = [track.content_hash for track in tracks.values()]
    return {"seed": SEED, "tracks": hashes, "small": small}


@command(
    "battery",
    "python -m studies battery --maps maps --out out/battery",
    "python -m studies battery --small --out out/small",
)
def run(*, out: Out, maps: Maps = None, small: Small = False) -> None:
    """Race the gate of the hidden battery."""
    tracks, rows = circuits(small, maps), []
    with open_job(output_folder(out), "battery", job_settings(tracks, small)) as job:
        for row in race_cells(job, tracks, SIZES[small]):
            rows.append(row)
            print(" | ".join(row.texts()), flush=True)
    table = [HEAD, *(row.texts() for row in rows)]
    print("\n" + "\n".join(markdown(table)))
    print(f"\nwritten: {write_csv(table, out / 'battery.csv')}")
    if can_draw("the picture"):
        print(f"written: {draw(rows, out / 'battery.png')}")


@command(
    "faults-series",
    "python -m studies faults-series --maps maps --out out/faults-series",
    "python -m studies faults-series --small --out out/small-series",
)
def run_series(*, out: Out, maps: Maps = None, small: Small = False) -> None:
    """Race the gate of series with faults: does risk depend on the score of the series?"""
    tracks, groups = circuits(small, maps), 2 if small else 8
    samples = {
        (name, split): [Sample(track, one, 6 * groups, split, SEED) for one in OPPONENTS]
        for name, track in tracks.items()
        for split in ("train", "test")
    }
    table: list[tuple[str, ...]] = [("circuit", "faults a race", "races won", "gain in series")]
    with open_job(output_folder(out), "faults-series", job_settings(tracks, small)) as job:
        for name in tracks:
            found = {
                split: np.stack(
                    [
                        raced["outcomes"]
                        for raced in job.run(
                            f"{split}-{name.lower()}", race_sample, samples[name, split]
                        )
                    ]
                )
                for split in ("train", "test")
            }
            estimate = series_gain(found["train"], found["test"], groups)
            faults, won = (found["test"][..., 1], found["test"][..., 0] == 0)
            spans = [span(one.mean(axis=(0, 2, 3))) for one in (faults, won)]
            table.append((name, *spans, with_interval(estimate.mean, estimate.low, estimate.high)))
            print(" | ".join(table[-1]), flush=True)
    print("\n" + "\n".join(markdown(table)))


def span(values: Floats) -> str:
    """Return the min and max over the policies."""
    return f"{values.min():.3f} to {values.max():.3f}"
