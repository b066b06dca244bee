"""``pcs-racing view`` and ``play``: pages that replay a tournament, and pages to race yourself."""

import os
import sys
import webbrowser
from collections.abc import Sequence
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pcs_racing.base.checks import check_seed
from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    AGENT_HELP,
    DEFAULT_TRACK,
    RACED_CODE,
    ArchiveName,
    Circuit,
    NoOpen,
    Rules,
    Terminated,
    archive_for,
    output_file,
)

if TYPE_CHECKING:
    from pcs_racing_agents.tournament.races import RaceTable
    from pcs_racing_agents.watch.race_choice import SelectedRace
    from pcs_racing_agents.watch.results_folder import ResultsFolder
    from pcs_racing_agents.watch.view_page import ViewContent


REPLAYS = 60
MAX_REPLAYS = 2000

Port = Annotated[int | None, Option("port of the page on this machine (default: a free port)", "P")]


@command(
    "view",
    "pcs-racing view out/mine",
    "pcs-racing view out/mine --index 12 40 --out chosen.html",
    "pcs-racing view out/mine --serve",
)
def run(
    results: Annotated[
        Path, Option("folder of a tournament, of a study, or of the ratings in a study", "RESULTS")
    ],
    *,
    out: Annotated[
        Path | None,
        Option("file for the page (default: view.html in the folder of the results)", "FILE"),
    ] = None,
    replays: Annotated[
        int | None,
        Option(
            f"number of races to include, selected by a rule (default: {REPLAYS}; with --index or"
            " --serve: 0)"
        ),
    ] = None,
    index: Annotated[Sequence[int], Option("numbers of races to include", "K")] = (),
    serve: Annotated[
        bool,
        Option("write no file; serve the page from this machine, where any race can be watched"),
    ] = False,
    port: Port = None,
    agents: Annotated[Sequence[str], Option(RACED_CODE, "AGENT")] = (),
    no_open: NoOpen = False,
) -> None:
    """Write a page that lists the races of a tournament or a study and plays them."""
    from dataclasses import replace

    from pcs_racing.base.files import write_atomically
    from pcs_racing_agents.study.results import open_results
    from pcs_racing_agents.watch.race_replays import RaceRepeater
    from pcs_racing_agents.watch.view_page import view_page
    from pcs_racing_agents.watch.view_server import make_server

    if serve and out is not None:
        raise InputError("--out goes without --serve: a page that is served is not written")
    if port is not None and not serve:
        raise InputError("--port goes with --serve")
    if replays is not None and not 0 <= replays <= MAX_REPLAYS:
        raise InputError(f"--replays is {replays}; it must be from 0 to {MAX_REPLAYS}")
    if len(index) > MAX_REPLAYS:
        raise InputError(f"--index names {len(index)} races; a page holds at most {MAX_REPLAYS}")
    if not results.is_dir():
        raise InputError(f"there is no folder {results}; give one of a tournament or a study")
    target = output_file(out or results / "view.html", ".html")
    folder = open_results(results, agents)
    table = folder.races
    picks = _picks(table, index, (0 if index or serve else REPLAYS) if replays is None else replays)
    content = _content(folder, picks)
    if serve:
        served = view_page(replace(content, serve=True))
        with make_server(served, RaceRepeater(folder).answer, port or 0) as server:
            run_server(server, f"{len(table)} races", open_it=not no_open)
        return
    page = view_page(content).encode()
    write_atomically(target, page)
    print(f"{len(table)} races, {len(picks)} of them to be watched, {len(page) / 1e6:.1f} MB")
    print(f"page: {target}")
    if not no_open:
        open_page(target.resolve().as_uri())


def _picks(table: "RaceTable", numbers: Sequence[int], count: int) -> "list[SelectedRace]":
    """Return the races with replays: requested races, then ``count`` races selected by a rule."""
    from pcs_racing_agents.watch.race_choice import SelectedRace, choose_races

    for number in numbers:
        if not 0 <= number < len(table):
            raise InputError(f"--index names {number}; there are races 0 to {len(table) - 1}")
    requested = {number: SelectedRace(number, "a race that was asked for") for number in numbers}
    selected = {pick.race: pick for pick in choose_races(table, count)}
    # Order of the first, reason of the last: requested races come first, and are marked as such.
    return list({**requested, **selected, **requested}.values())


def _content(results: "ResultsFolder", picks: "Sequence[SelectedRace]") -> "ViewContent":
    """Simulate the selected races, and return the content of the page."""
    from pcs_racing_agents.watch.race_replays import RaceRepeater
    from pcs_racing_agents.watch.view_page import ViewContent

    repeater, progress = RaceRepeater(results), show_progress()
    driven = []
    try:
        for race in repeater.drive_all([pick.race for pick in picks]):
            driven.append(race)
            progress(len(driven), len(picks), race.circuit)
    except InputError as error:
        raise InputError(
            f"{error} (--replays 0 lists the races without any to be watched)"
        ) from None
    return ViewContent(
        results.folder.resolve().name,
        results.races,
        str(results.folder),
        start=results.start,
        picks=picks,
        driven=driven,
        circuits=repeater.circuits,
        space=repeater.space,
    )


@command(
    "play",
    "pcs-racing play",
    "pcs-racing play --opponent response --rules contest --track Pipkin",
    "pcs-racing play --drive --opponent lattice:pace=0.4 --no-open",
)
def run_play(
    *,
    opponent: Annotated[
        str, Option(f"agent or planner in the other car: {AGENT_HELP}", "AGENT")
    ] = "cfr-argmax",
    track: Circuit = DEFAULT_TRACK,
    rules: Rules,
    archive: ArchiveName = None,
    drive: Annotated[
        bool, Option("steer the car yourself, with keys or a gamepad, instead of making its moves")
    ] = False,
    port: Port = None,
    no_open: NoOpen = False,
) -> None:
    """Make the moves of one car yourself, or steer it, on a local page, against an agent."""
    from pcs_racing.game.archive_files import load_archive
    from pcs_racing.game.make import make_game
    from pcs_racing.track.loading import load_track
    from pcs_racing_agents.agents.game_spec import make_game_spec
    from pcs_racing_agents.agents.zoo import parse_agent
    from pcs_racing_agents.watch.person_race import PersonRaces, play_page
    from pcs_racing_agents.watch.view_server import make_server

    check_seed(rules.seed)
    config = rules.config()
    loaded = load_archive(archive_for(archive, config))
    rival = parse_agent(opponent, make_game_spec(loaded, config), seed=rules.seed, code=True)
    if drive:
        from pcs_racing_agents.watch.person_race import drive_page, make_person_drive

        wheel = make_person_drive(
            rival, rules.seed, track=load_track(track), race=config, archive=loaded
        )
        wheel.answer("/begin/0")  # report errors now
        with make_server(drive_page(wheel), wheel.answer, port or 0, method="POST") as server:
            run_server(server, "play", open_it=not no_open)
        return
    races = PersonRaces(make_game(load_track(track), loaded, config, stay=True), rival, rules.seed)
    # Report an unsuitable competitor now, and compile kernels before the page opens.
    races.situation(0, ())
    with make_server(play_page(races), races.answer, port or 0) as server:
        run_server(server, "play", open_it=not no_open)


def open_page(address: str) -> None:
    """Open a browser if there is a display (without it, Python would use this terminal)."""
    # Other systems always have a display.
    if sys.platform.startswith("linux") and not any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    ):
        return
    webbrowser.open(address)


def run_server(server: ThreadingHTTPServer, what: str, *, open_it: bool) -> None:
    """Serve a page until the command is interrupted; print its address."""
    address = f"http://127.0.0.1:{server.server_address[1]}/"
    print(f"{what} at {address} (Ctrl-C ends it)", flush=True)
    if open_it:
        open_page(address)
    try:
        server.serve_forever()
    except KeyboardInterrupt as stop:
        if isinstance(stop, Terminated):
            raise
        print("ended", file=sys.stderr)
