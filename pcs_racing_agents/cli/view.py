"""``pcs-racing view``: write or serve a page that lists the races of a tournament and plays them."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pcs_racing.base.errors import InputError
from pcs_racing_agents.cli.options import Commands, add_command, open_page, output_file, serve

if TYPE_CHECKING:
    from pcs_racing_agents.results.races import RaceTable
    from pcs_racing_agents.view.race_choice import SelectedRace
    from pcs_racing_agents.view.results_folder import ResultsFolder
    from pcs_racing_agents.view.view_page import ViewContent


REPLAYS = 60
MOST_REPLAYS = 2000
LONE_FILE = "there is no job.yaml beside this file that says how its races were driven, so they can't be driven again"


def add(commands: Commands) -> None:
    """Add the command ``view``."""
    parser = add_command(
        commands,
        "view",
        "write a page that lists the races of a tournament or a study and plays them",
        "pcs-racing view out/mine",
        "pcs-racing view out/mine --races 12 40 --out chosen.html",
        "pcs-racing view out/mine --serve",
    )
    parser.add_argument(
        "results", type=Path, metavar="RESULTS", help="folder of a tournament or a study, or its results.csv"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="file for the page (default: view.html in the folder of the results)"
    )
    parser.add_argument(
        "--replays",
        type=int,
        metavar="N",
        help=f"number of races to include, selected by a rule (default: {REPLAYS}; with --races or --serve: 0)",
    )
    parser.add_argument("--races", type=int, nargs="+", default=[], metavar="K", help="numbers of races to include")
    parser.add_argument(
        "--serve",
        action="store_true",
        help="write no file; serve the page from this machine, where any race can be watched",
    )
    parser.add_argument("--port", type=int, metavar="P", help="with --serve: port of the server (default: a free port)")
    parser.add_argument("--no-open", action="store_true", help="do not open the page in a browser")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write the page, or serve it."""
    from pcs_racing_agents.results.race_files import read_results

    target = _check(arguments)
    results, file = _find(arguments.results)
    races = results.races if results is not None else read_results(file)
    picks = _picks(arguments, races, results)
    if arguments.serve:
        assert results is not None  # _picks has checked
        _serve(arguments, races, results, picks)
        return
    from pcs_racing.base.files import write_atomically
    from pcs_racing_agents.view.view_page import view_page

    content = _content(arguments, races, results, picks)
    page = view_page(content).encode()
    write_atomically(target, lambda stream: stream.write(page))
    print(f"{len(races)} races, {len(picks)} of them to be watched, {len(page) / 1e6:.1f} MB")
    if results is None:
        print(f"{LONE_FILE}; the page lists them")
    print(f"page: {target}")
    if not arguments.no_open:
        open_page(target.resolve().as_uri())


def _check(arguments: argparse.Namespace) -> Path:
    """Refuse options that can't be combined, before any work; return the path of the page."""
    if arguments.serve and arguments.out is not None:
        raise InputError("--out goes without --serve: a page that is served is not written")
    if arguments.port is not None and not arguments.serve:
        raise InputError("--port goes with --serve")
    if arguments.replays is not None and not 0 <= arguments.replays <= MOST_REPLAYS:
        raise InputError(f"--replays is {arguments.replays}; it must be from 0 to {MOST_REPLAYS}")
    if len(arguments.races) > MOST_REPLAYS:
        raise InputError(f"--races names {len(arguments.races)} races; a page holds at most {MOST_REPLAYS}")
    if not arguments.results.exists():
        raise InputError(f"there is no {arguments.results}; give the folder of a tournament or a study")
    path = arguments.results
    if arguments.out is None and path.is_file():
        name = "view.html" if path.name == "results.csv" else f"{path.stem}-view.html"
        return output_file(path.with_name(name), ".html")
    return output_file(arguments.out or path / "view.html", ".html")


def _find(path: Path) -> "tuple[ResultsFolder | None, Path]":
    """Return the folder of the races and their file; None for a file without a manifest."""
    from pcs_racing_agents.view.results_folder import open_results

    folder = path
    if path.is_file():
        if path.suffix != ".csv":
            raise InputError(f"{path} is no results file; give a folder, or the results.csv in it")
        # The races of a study's ratings have a folder of their own, of the same name as their file.
        beside = path.resolve().parent if path.name == "results.csv" else path.resolve().with_suffix("")
        if not (beside / "job.yaml").is_file():
            return None, path
        folder = path.parent if path.name == "results.csv" else path.with_suffix("")
    elif not (path / "job.yaml").is_file() and (path / "results.csv").is_file():
        return None, path / "results.csv"
    results = open_results(folder)
    ratings = results.tournament and results.study is not None
    return results, folder.with_suffix(".csv") if ratings else folder / "results.csv"


def _picks(arguments: argparse.Namespace, races: "RaceTable", results: "ResultsFolder | None") -> "list[SelectedRace]":
    """Return the races with replays."""
    from pcs_racing_agents.view.race_choice import SelectedRace, choose_races

    if results is None:
        if arguments.replays or arguments.races or arguments.serve:
            raise InputError(f"can't drive races of {arguments.results} again: {LONE_FILE[:1].lower()}{LONE_FILE[1:]}")
        return []
    for number in arguments.races:
        if not 0 <= number < len(races):
            raise InputError(f"--races names {number}; there are races 0 to {len(races) - 1}")
    default = 0 if arguments.races or arguments.serve else REPLAYS
    count = default if arguments.replays is None else arguments.replays
    requested = {number: SelectedRace(number, "a race that was asked for") for number in arguments.races}
    selected = {pick.race: pick for pick in choose_races(races, count)}
    return list({**requested, **selected, **requested}.values())


def _content(
    arguments: argparse.Namespace, races: "RaceTable", results: "ResultsFolder | None", picks: "Sequence[SelectedRace]"
) -> "ViewContent":
    """Simulate the selected races, and return the content of the page."""
    from pcs_racing_agents.jobs.progress import show_progress
    from pcs_racing_agents.view.race_replays import RaceRepeater
    from pcs_racing_agents.view.view_page import ViewContent

    title = arguments.results.resolve()
    name = title.parent.name if title.name == "results.csv" else title.name
    if results is None:
        return ViewContent(name, races, str(arguments.results), why_not=f"{LONE_FILE[:1].upper()}{LONE_FILE[1:]}.")
    driver, progress = RaceRepeater(results), show_progress()
    driven = []
    try:
        for race in driver.drive_all([pick.race for pick in picks]):
            driven.append(race)
            progress(len(driven), len(picks), race.circuit)
    except InputError as error:
        raise InputError(f"{error} (--replays 0 lists the races without any to be watched)") from None
    return ViewContent(
        name,
        races,
        str(arguments.results),
        start=_kind_of_start(results),
        picks=picks,
        driven=driven,
        circuits=driver.circuits,
        space=driver.space,
    )


def _kind_of_start(results: "ResultsFolder") -> str:
    """Return the kind of start of the races, if the folder holds it; else the default."""
    if results.study is not None:
        return results.study.config.game.race.start
    game = results.settings.get("game")
    race = game.get("race") if isinstance(game, dict) else None
    return str(race.get("start", "side-by-side")) if isinstance(race, dict) else "side-by-side"


def _serve(
    arguments: argparse.Namespace, races: "RaceTable", results: "ResultsFolder", picks: "Sequence[SelectedRace]"
) -> None:
    """Serve the page until the command is interrupted."""
    from dataclasses import replace

    from pcs_racing_agents.view.race_replays import RaceRepeater
    from pcs_racing_agents.view.view_page import view_page
    from pcs_racing_agents.view.view_server import RaceService, make_server

    page = view_page(replace(_content(arguments, races, results, picks), serve=True))
    service = RaceService(RaceRepeater(results), len(races))
    with make_server(page, service.answer, arguments.port or 0) as server:
        serve(server, f"{len(races)} races", open_it=not arguments.no_open)
