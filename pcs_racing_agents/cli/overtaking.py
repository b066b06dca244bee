"""``pcs-racing overtaking``: how often drivers pass a slower car, and how often it ends in a collision."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcs_racing.base.files import write_atomically
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing_agents.agents.own_code import parse_driver
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import POLICY_HELP, TRACK_HELP, output_file


@command(
    "overtaking",
    "pcs-racing overtaking --drivers spliner mppi --track Tarnfjord Pipkin",
    "pcs-racing overtaking --drivers spliner:pace=1 --track maps/Austin maps/Hockenheim --lines lines",
)
def run(
    *,
    drivers: Annotated[Sequence[str], Option(f"drivers of the ego: {POLICY_HELP}", "POLICY")],
    track: Annotated[Sequence[str], Option(f"{TRACK_HELP} (default: all that ship)", "T")] = (),
    lines: Annotated[
        Path | None, Option("folder of CIRCUIT_line0.csv to line2.csv (default: lines made here)", "DIR")
    ] = None,
    seed: Annotated[int, Option("seed of the noise")] = 0,
    out: Annotated[Path | None, Option("file for a line for each scenario (.csv)", "FILE")] = None,
) -> None:
    """Race the scenarios of the End2Race overtaking protocol, 600 a circuit."""
    from pcs_racing_agents.benchmark.overtaking import detail, joined, made_lines, race_scenarios, read_lines, summary

    target = output_file(out, ".csv") if out else None
    policies = [parse_driver(text) for text in drivers]
    tracks = [load_track(name) for name in track or list_tracks()]
    given = [made_lines(one) if lines is None else read_lines(one, lines) for one in tracks]
    found = [joined([race_scenarios(one, policy, seed=seed) for one in given]) for policy in policies]
    print("\n".join([f"{len(found[0].start)} scenarios", "", *summary(found), "", *detail(found)]))
    if target is not None:
        text = io.StringIO()
        writer = csv.writer(text)
        names = ("circuit", "start", "line", "factor", "fault", "overtakes")
        writer.writerow(("driver", *names))
        for one in found:
            writer.writerows((one.driver, *row) for row in zip(*(getattr(one, name) for name in names), strict=True))
        write_atomically(target, lambda file: file.write(text.getvalue().encode()))
        print(f"scenarios: {target}")
