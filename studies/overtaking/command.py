"""``python -m studies overtaking``: the overtaking protocol of End2Race, for planners."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcs_racing.planners.racers import policy_racer
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import POLICY_HELP, TRACK_HELP


@command(
    "overtaking",
    "python -m studies overtaking --policies spliner mppi --track Tarnfjord Pipkin",
    "python -m studies overtaking --policies spliner:pace=1 --track maps/Austin maps/Hockenheim"
    " --lines lines",
)
def run(
    *,
    policies: Annotated[Sequence[str], Option(f"policies of the ego: {POLICY_HELP}", "POLICY")],
    track: Annotated[Sequence[str], Option(f"{TRACK_HELP} (default: all that ship)", "T")] = (),
    lines: Annotated[
        Path | None,
        Option("folder of CIRCUIT_line0.csv to line2.csv (default: lines made here)", "DIR"),
    ] = None,
    seed: Annotated[int, Option("seed of the noise")] = 0,
) -> None:
    """Race the scenarios of the End2Race overtaking protocol, 600 a circuit."""
    from studies.overtaking.scenarios import (
        detail,
        joined,
        made_lines,
        race_scenarios,
        read_lines,
        summary,
    )

    egos = [policy_racer(text) for text in policies]
    tracks = [load_track(name) for name in track or list_tracks()]
    given = [made_lines(one) if lines is None else read_lines(one, lines) for one in tracks]
    found = {
        policy.name: joined([race_scenarios(one, policy, seed=seed) for one in given])
        for policy in egos
    }
    count = len(next(iter(found.values())).start)
    print("\n".join([f"{count} scenarios", "", *summary(found), "", *detail(found)]))
