"""``pcs-racing view``: a page that replays the races of a tournament or study; moves explained."""

import os
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pcs_racing.base.errors import InputError, check_whole
from pcs_racing_agents.base.jobs import show_progress
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import RACED_CODE, output_file

if TYPE_CHECKING:
    from pcs_racing_agents.tournament.races import RaceTable
    from pcs_racing_agents.watch.results_folder import ResultsFolder


REPLAYS, MAX_REPLAYS = 60, 2000


@command(
    "view",
    "pcs-racing view out/mine",
    "pcs-racing view out/mine --index 12 40 --out chosen.html",
    "pcs-racing view out/mine --explain 12",
    "pcs-racing view out/mine --explain 12 --car 1",
)
def run(
    results: Annotated[Path, Option("folder of a tournament or of a study", "RESULTS")],
    *,
    explain: Annotated[
        int | None,
        Option(
            "number of a race; instead of a page, print an agent's observations, moves and their"
            " effect",
            "K",
        ),
    ] = None,
    car: Annotated[
        int | None,
        Option(
            "with --explain: explained car (default: the first that makes moves)", choices=(0, 1)
        ),
    ] = None,
    out: Annotated[
        Path | None,
        Option("file for the page (default: view.html in the folder of the results)", "FILE"),
    ] = None,
    replays: Annotated[
        int | None,
        Option(
            f"number of races to include, selected by a rule (default: {REPLAYS}; with --index: 0)"
        ),
    ] = None,
    index: Annotated[Sequence[int], Option("numbers of races to include", "K")] = (),
    agents: Annotated[Sequence[str], Option(RACED_CODE, "AGENT")] = (),
    track: Annotated[
        Sequence[str], Option("map folder that was moved since the races were driven", "T")
    ] = (),
    no_open: Annotated[bool, Option("do not open the page in a browser")] = False,
) -> None:
    """Write a page that lists and plays the races of a tournament or study, or explain a race."""
    from pcs_racing.base.files import write_atomically
    from pcs_racing_agents.study.study import open_results
    from pcs_racing_agents.watch.race_replays import RaceRepeater, view_page

    if replays is not None:
        check_whole("--replays", replays, 0, MAX_REPLAYS)
    if explain is not None and (index or out or replays is not None):
        raise InputError("--explain goes without --index, --out and --replays: it makes no page")
    if car is not None and explain is None:
        raise InputError("--car goes with --explain")
    if not results.is_dir():
        raise InputError(f"there is no folder {results}; give one of a tournament or a study")
    if explain is not None:
        _explain(open_results(results, agents, track), explain, car)
        return
    target = output_file(out or results / "view.html", ".html")
    folder = open_results(results, agents, track)
    default = 0 if index else REPLAYS
    picks = _picks(folder.races, index, default if replays is None else replays)
    repeater = RaceRepeater(folder)
    try:
        driven = repeater.drive_all(picks, show_progress())
    except InputError as error:
        raise InputError(
            f"{error} (--replays 0 lists the races without any to be watched)"
        ) from None
    write_atomically(target, view_page(repeater, picks, driven).encode())
    size = f"{target.stat().st_size / 1e6:.1f} MB"
    print(f"{len(folder.races)} races, {len(picks)} of them to be watched, {size}")
    print(f"page: {target}")
    if not no_open:
        open_page(target.resolve().as_uri())


def _explain(results: "ResultsFolder", number: int, car: int | None) -> None:
    """Print the explanation of a race."""
    from pcs_racing.planners.planner import PolicySet
    from pcs_racing_agents.watch.explain import explain_race
    from pcs_racing_agents.watch.words import story

    row = results.row(number)
    pairing = results.pairing(row)
    if car is None:
        # A planner has no moves to explain: then the other car is explained.
        car = int(isinstance(pairing.ego, PolicySet))
    explanation = explain_race(pairing, row.race, car=car)
    results.check_lead(number, explanation.played.lead[0])
    print(story(explanation))


def _picks(races: "RaceTable", numbers: Sequence[int], count: int) -> dict[int, str]:
    """Return the races to include with reasons: requested races, then ``count`` by a rule."""
    from pcs_racing_agents.watch.race_choice import choose_races

    for number in numbers:
        if not 0 <= number < len(races):
            raise InputError(f"--index names {number}; there are races 0 to {len(races) - 1}")
    requested = dict.fromkeys(numbers, "a race that was asked for")
    # Order of the first, reason of the last: requested races come first, and are marked as such.
    return {**requested, **choose_races(races, count), **requested}


def open_page(address: str) -> None:
    """Open a browser if there is a display (without it, Python would use this terminal)."""
    # Other systems always have a display.
    if sys.platform.startswith("linux") and not any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    ):
        return
    webbrowser.open(address)
