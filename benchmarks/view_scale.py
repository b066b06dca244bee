"""The race viewer with many races: what it takes to write the page, to open it, and to filter and sort its list.

    python benchmarks/view_scale.py [--rows 2000 20000 200000] [--results FOLDER] [--screenshot FILE.png]

Without ``--results`` the races are made up, like those of a tournament of six agents on seven circuits; with it, they
are the first lines of that folder's results. None of them can be watched in the page. All times are processor time,
which other programs on the machine disturb far less than the time on the clock: of the command; of all of Chromium's
processes until the page is ready; of the page's own thread from a filter or an order to the list that shows it, the
median of three. Below each size stands how many times the row above it took. It runs on Linux and needs Chromium.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import combinations, islice, pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from pcs_racing_agents.tournament import RaceRow, write_results

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/pcs_racing_agents/view"))

TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim", "Pipkin", "Saltmere", "Larkmoor", "Quillburg")
AGENTS = ("never-switch", "random-moves", "random-policy", "cfr-argmax", "lane-switcher", "pure-pursuit")
MOVES = ("aggressiveness +", "aggressiveness -", "restraint +", "restraint -", "stay")

CLEAR = "byId('reset').click()"
ACTIONS = {
    "agent": "filters.agent = 1; refilter()",
    "two agents, a loss": "filters.agent = 1; filters.opponent = 0; filters.winner = 'loses'; refilter()",
    "own crash": "filters.agent = 1; filters.crash = 'own'; refilter()",
    "search": "filters.text = 'random restraint'; refilter()",
    "leads": "filters.low = -5; filters.high = 5; refilter()",
    "all again": "{clear}",
    "by lead": "Object.assign(sorting, {{ key: 'lead', down: true }}); refilter()",
    "by agent": "Object.assign(sorting, {{ key: 'first', down: false }}); refilter()",
    "by policies": "Object.assign(sorting, {{ key: 'variants', down: false }}); refilter()",
    "walk down": "step(1); step(1); step(1)",
    "scroll": "list.scrollTop = list.scrollHeight * Math.random(); drawList()",
}


class Figures(NamedTuple):
    """What a number of races took; seconds of processor time, megabytes."""

    races: int
    writing: float
    writing_megabytes: float
    page_megabytes: float
    loading: float
    open_megabytes: float
    actions: dict[str, float]


def made_up_rows(count: int) -> Iterator[RaceRow]:
    """Races like those of a tournament, that nobody drove."""
    rng = np.random.default_rng(0)
    pairs = [(track, ego, opponent) for track in TRACKS for ego, opponent in combinations(AGENTS, 2)]
    races = max(2, -(-count // len(pairs)))
    starts = np.repeat(rng.uniform(0.0, 300.0, -(-races // 2)), 2)
    for number in range(count):
        pair, race = divmod(number, races)
        track, ego, opponent = pairs[pair]
        crash = ("none", "wall", "car")[int(rng.integers(1, 3)) if rng.random() < 0.2 else 0]
        duration = float(np.round(rng.uniform(1.0, 40.0), 2)) if crash != "none" else 40.0
        steps = min(int(duration // 8), 4)
        moves = [tuple(MOVES[k] for k in rng.integers(0, 5, steps)) for _ in range(2)]
        paths = [tuple(rng.integers(0, 46, steps + 1).tolist()) for _ in range(2)]
        lead = float(rng.normal(0.0, 20.0))
        yield RaceRow(
            preset="paper",
            ego=ego,
            opponent=opponent,
            track=track,
            race=race,
            start_s=float(starts[race]),
            side=race % 2,
            seed=0,
            lead=lead,
            winner="none" if crash != "none" else ("ego" if lead > 0.0 else "opponent"),
            crash=crash,
            fault=("ego", "opponent", "both")[int(rng.integers(3))] if crash != "none" else "none",
            ego_overtakes=int(rng.integers(3)),
            opponent_overtakes=int(rng.integers(3)),
            duration=duration,
            ego_variant=paths[0][0],
            opponent_variant=paths[1][0],
            ego_path=paths[0],
            opponent_path=paths[1],
            ego_moves=moves[0],
            opponent_moves=moves[1],
        )


def results_file(path: Path, count: int, results: Path | None) -> None:
    """Write a results file of so many races."""
    if results is None:
        write_results(made_up_rows(count), path)
        return
    with open(results / "results.csv", "rb") as lines, open(path, "wb") as file:
        file.writelines(islice(lines, count + 1))


def write_page(results: Path, page: Path) -> tuple[float, float]:
    """Run the command in a process of its own; its seconds of processor time and the most memory it held, MB."""
    command = [sys.executable, "-m", "pcs_racing_agents", "view", str(results), "--out", str(page), "--no-open"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"'{' '.join(command)}' ended with {process.returncode}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


def tree(process: int) -> list[Path]:
    """Folders in /proc of a process and of all that it started and that has not ended."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has just ended
            continue
    ours, found = {process}, 0
    while len(ours) > found:
        found = len(ours)
        ours |= {one for one, parent in parents.items() if parent in ours}
    return [Path("/proc") / str(one) for one in ours if one in parents]


def tree_seconds(process: int) -> float:
    """Processor time of a process and its children."""
    fields = [(folder / "stat").read_text().rpartition(")")[2].split() for folder in tree(process)]
    return sum(int(own[11]) + int(own[12]) for own in fields) / os.sysconf("SC_CLK_TCK")


def largest_page(process: int) -> float:
    """Memory that the largest of Chromium's processes for pages holds, MB."""
    pages = [folder for folder in tree(process) if b"--type=renderer" in (folder / "cmdline").read_bytes()]
    sizes = [int((folder / "statm").read_text().split()[1]) for folder in pages]
    return max(sizes, default=0) * os.sysconf("SC_PAGE_SIZE") / 1e6


def in_the_browser(page: Path, folder: Path, screenshot: Path | None) -> tuple[float, float, dict[str, float]]:
    """Open a page, filter and sort its list; seconds of processor time, megabytes that its process holds."""
    from chromium_pipe import Browser  # type: ignore[import-not-found]
    from PIL import Image

    browser: Any = Browser(folder / f"profile-{page.stem}")
    try:
        browser.open(f"{page.as_uri().replace(page.name, 'empty.html')}")
        before = tree_seconds(browser.process.pid)
        browser.open(f"{page.as_uri()}#theme=light")
        browser.wait("document.body.dataset.shown")
        browser.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        loading = tree_seconds(browser.process.pid) - before
        megabytes = largest_page(browser.process.pid)
        spent = {}
        for name, action in ACTIONS.items():
            times = []
            for _ in range(3):
                browser.run(f"{CLEAR}; 0")
                start = browser.thread_seconds()
                browser.run(action.format(clear=CLEAR) + "; document.body.offsetHeight")
                times.append(browser.thread_seconds() - start)
            spent[name] = median(times)
        if screenshot is not None:
            browser.open(f"{page.as_uri()}#theme=light&agent=random-moves&crash=none&sort=lead&down=1", 1440, 900)
            browser.run(
                "list.scrollTop = list.scrollHeight / 3; drawList(); choose(shown[Math.floor(shown.length / 3)])"
            )
            time.sleep(1.0)
            Image.fromarray(browser.screenshot().astype(np.uint8)).save(screenshot)
    finally:
        browser.close()
    return loading, megabytes, spent


def measure(count: int, folder: Path, results: Path | None, screenshot: Path | None) -> Figures:
    """Measure a number of races."""
    file, page = folder / f"races-{count}.csv", folder / f"races-{count}.html"
    results_file(file, count, results)
    writing, megabytes = write_page(file, page)
    (folder / "empty.html").write_text("<title>empty</title>")
    return Figures(count, writing, megabytes, page.stat().st_size / 1e6, *in_the_browser(page, folder, screenshot))


def tell(found: list[Figures]) -> None:
    """Print a table."""
    names = list(found[0].actions)
    print(f"{'races':>34}" + "".join(f"{one.races:12,d}" for one in found))
    lines: list[tuple[str, list[float], str]] = [
        ("write the page, s", [one.writing for one in found], ".2f"),
        ("most memory meanwhile, MB", [one.writing_megabytes for one in found], ".0f"),
        ("page, MB", [one.page_megabytes for one in found], ".2f"),
        ("open it, s", [one.loading for one in found], ".2f"),
        ("memory of its process, MB", [one.open_megabytes for one in found], ".0f"),
        *((f"{name}, ms", [1e3 * one.actions[name] for one in found], ".1f") for name in names),
    ]
    for name, values, form in lines:
        ratios = "".join(f"{new / old:10.1f} x" for old, new in pairwise(values) if old > 0)
        print(f"{name:>34}" + "".join(f"{value:12{form}}" for value in values) + "   " + ratios)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, nargs="+", default=[2_000, 20_000, 200_000])
    parser.add_argument("--results", type=Path, help="folder of a tournament of at least that many races")
    parser.add_argument("--screenshot", type=Path, help="picture of the page with the most races, as PNG")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        sizes = sorted(given.rows)
        tell(
            [
                measure(count, Path(place), given.results, given.screenshot if count == sizes[-1] else None)
                for count in sizes
            ]
        )


if __name__ == "__main__":
    main()
