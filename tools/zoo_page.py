"""Write docs/zoo.md, a table of all agents and drivers, and docs/zoo/NAME.md, a page for each of them.

    python tools/zoo_page.py

``benchmarks/zoo.py --write`` measures, writes the table of measurements and then these pages. An agent without
measurements, or without a shipped network, has a page that says so.
"""

import csv
import io
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.describe import (
    AGAINST,
    NOT_SHIPPED,
    NUMBERS,
    TEXTS,
    Measured,
    describe,
    facts_of,
    measured,
    measured_file,
    measurements,
    microseconds,
    rating_text,
)
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import ALWAYS, SHIPPED, Entry, build, entries, names

DOCS = Path(__file__).resolve().parents[1] / "docs"

SETTINGS = (("default", "paper"), ("contest", "contest"))
"""Archive and rules of the games in which agents are measured: those that networks and choices are shipped for."""

TABLE = "zoo.md"
CONSTANT = f"{ALWAYS}MOVE"
"""Name under which the agents that always make the same move share a page."""

HEAD = """# The zoo

<!-- Written by `python benchmarks/zoo.py --write`, which measures as well, and by
`python tools/zoo_page.py`, which does not. -->

This page is a reference: all agents and drivers in a table, and how strong they are. Each name leads to a page with
the source of the idea, options, training, strength, cost and hash; `pcs-racing agents NAME` prints the same.
[agents.md](agents.md) explains how to use agents and how to add your own.
"""

STRENGTH = """## Strength and cost

`python benchmarks/zoo.py --write` measures all agents and drivers that race with their defaults:

- **score**: share of races won, where a tie counts half; the mean over six opponents (without the agent itself),
  {field},
  on two circuits, which the agents' pages name. With either archive, some agents trained on the first circuit and none
  on the second; the driver `ppo-drive` trained on Tarnfjord and Kestrelheim. All drive the same races.
  {precision}
- **rating**: Bradley-Terry with ties over the same races, with its 95 % interval. The mean is 0, and a difference of
  400 means odds of ten to one. Crashes that pay neither car, as all in the paper's race, are left out. An agent that
  either wins or crashes therefore has a high rating; read the rating together with score and crashes;
- **crash**: share of its races that ended in a crash by its own fault;
- **cost**: microseconds of processor time of a decision, for one observation and for each of 1,000 at once, on a shared
  2-core machine that had other work at the time. A driver plans ten times a second, and its cost is that of one plan
  with 0.1 s of simulation;
- **hash**: the beginning of the SHA-256 of everything that determines its behaviour: weights or fit, archive, rules.
  Measurements belong to a hash. After an agent has changed, the pages show none until the script has run again.
"""

CONSTANT_PAGE = """Makes the same move at every step; one agent for each move.

- Source: baseline, never observes the race.
- Needs nothing."""


def zoo_pages() -> dict[str, str]:
    """Return all pages: paths below ``docs`` and texts."""
    settings = [make_setting(*pair) for pair in SETTINGS]
    shipped = {name: entries()[name] for name in SHIPPED}
    pages = {TABLE: table_page(shipped, settings)}
    pages |= {page_path(name): agent_page(name, entry, settings) for name, entry in shipped.items()}
    pages[page_path(CONSTANT)] = constant_page(settings)
    return pages


def page_path(name: str) -> str:
    """Return the path of an agent's page below ``docs``."""
    return f"zoo/{CONSTANT if name.startswith(ALWAYS) else name}.md"


def table_page(shipped: dict[str, Entry], settings: list[Setting]) -> str:
    """Return the page with all agents in a table, and the tables of their strength."""
    every = [list(_measured(setting)) for setting in settings]
    known = [one for rows in every for one in rows]
    races = max((one.races for one in known), default=0.0)
    field = ", ".join(f"`{name}`" for name in dict.fromkeys(rival for one in known for rival in one.against))
    precision = "Nothing is measured of the agents as they are now;"
    if races:
        precision = f"With {races:.0f} races a score has a standard error of at least {0.5 / np.sqrt(races):.3f};"
    blocks = [HEAD.strip()]
    for title, moves in (("Agents", True), ("Drivers", False)):
        lines = [f"| {title.lower()[:-1]} | what it does | needs |", "|---|---|---|"]
        lines += [_row(name, entry.summary, entry.needs) for name, entry in shipped.items() if entry.moves is moves]
        if moves:
            lines.append(_row(CONSTANT, "makes the same move at every step", ""))
        blocks += [f"## {title}", "\n".join(lines)]
    blocks.append(STRENGTH.format(field=field or "named once they are measured", precision=precision).strip())
    for setting, rows in zip(settings, every, strict=True):
        blocks.append(f"### Archive `{setting.archive.name}`, {setting.race} race")
        blocks.append("\n".join(_lines(rows)) if rows else "Not measured yet with the agents as they are.")
    blocks.append("```{toctree}\n:hidden:\n:maxdepth: 1\n:glob:\n\nzoo/*\n```")
    return "\n\n".join(blocks) + "\n"


def agent_page(name: str, entry: Entry, settings: list[Setting]) -> str:
    """Return the page of an agent or a driver."""
    blocks = [_page_head(name, "an agent" if entry.moves else "a driver"), describe(name, entry)]
    shipped = []
    for setting in settings:
        facts = facts_of(name, setting)
        if facts != NOT_SHIPPED:
            shipped.append(setting)
        blocks += [
            f"## Archive `{setting.archive.name}`, {setting.race} race",
            "\n".join(f"- {line}" for line in facts),
        ]
    if shipped:
        blocks += ["## Try it", _command(name, shipped[0])]
    return "\n\n".join(blocks) + "\n"


def constant_page(settings: list[Setting]) -> str:
    """Return the page of the agents that always make the same move."""
    blocks = [_page_head(CONSTANT, "a family of agents"), CONSTANT_PAGE]
    for setting in settings:
        blocks.append(f"## Archive `{setting.archive.name}`, {setting.race} race")
        lines = []
        for name in (name for name in names(setting.archive, setting.race) if name.startswith(ALWAYS)):
            lines += [f"- `{name}`:", *(f"  - {line}" for line in facts_of(name, setting))]
        blocks.append("\n".join(lines))
    first = next(name for name in names(settings[0].archive, settings[0].race) if name.startswith(ALWAYS))
    blocks += ["## Try it", _command(first, settings[0])]
    return "\n\n".join(blocks) + "\n"


def write_pages(docs: Path = DOCS) -> Path:
    """Write all pages below a folder, and delete pages of agents that there are no more; return the table's path."""
    (docs / "zoo").mkdir(parents=True, exist_ok=True)
    pages = zoo_pages()
    for path, text in pages.items():
        (docs / path).write_text(text, encoding="utf-8")
    for file in (docs / "zoo").glob("*.md"):
        if f"zoo/{file.name}" not in pages:
            file.unlink()
    return docs / TABLE


def _page_head(name: str, kind: str) -> str:
    return (
        f"# `{name}`\n\n<!-- Written by `python tools/zoo_page.py`. -->\n\n"
        f"This reference describes `{name}`, {kind} of the [zoo](../zoo.md#strength-and-cost)."
    )


def _command(name: str, setting: Setting) -> str:
    """Return commands that race an agent where it is shipped, and show the races."""
    rival = "never-switch" if name != "never-switch" else "random-moves"
    game = f"--archive {setting.archive.name} --race {setting.race}"
    line = f"pcs-racing tournament --track Tarnfjord {game} --agents {name} {rival} --races 10 --out out/races"
    return f"```console\n{line}\npcs-racing view out/races\n```"


def _row(name: str, summary: str, needs: str) -> str:
    return f"| [`{name}`]({page_path(name)}) | {summary.replace('|', ' or ')} | {needs or 'nothing'} |"


def _measured(setting: Setting) -> list[Measured]:
    """What was measured of the agents as they are, best first."""
    found = []
    for name in names(setting.archive, setting.race):
        try:
            agent = build(name, setting)
        except UnknownNameError:  # nothing is shipped for it in this game
            continue
        found.append(measured(setting.archive.name, setting.race, name, competitor_hash(agent)))
    return sorted((one for one in found if one is not None), key=lambda one: -one.score)


def _lines(rows: list[Measured]) -> Iterator[str]:
    yield "| agent | score | rating | crash | cost, us | one of 1,000, us | hash |"
    yield "|---|---|---|---|---|---|---|"
    for one in rows:
        costs = [microseconds(value) for value in (one.one_us, one.many_us)]
        told = (f"{one.score:.3f}", rating_text(one), f"{one.own_crash:.1%}", *costs, f"`{one.sha256[:12]}`")
        yield f"| [`{one.agent}`]({page_path(one.agent)}) | {' | '.join(told)} |"


def write_measurements(rows: Iterable[Measured]) -> Path:
    """Write the table; measurements of other games or agents are not kept."""
    lines = list(rows)
    opponents = list(dict.fromkeys(name for one in lines for name in one.against))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*TEXTS, *NUMBERS, *(f"{AGAINST}{name}" for name in opponents)))
    for one in lines:
        numbers = [_number(getattr(one, name)) for name in NUMBERS]
        scores = [_number(one.against.get(name, np.nan)) for name in opponents]
        writer.writerow((*(getattr(one, name) for name in TEXTS), *numbers, *scores))
    write_atomically(measured_file(), lambda file: file.write(text.getvalue().encode("utf-8")))
    measurements.cache_clear()
    return measured_file()


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"


if __name__ == "__main__":
    print(write_pages())
