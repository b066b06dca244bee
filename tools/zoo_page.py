"""Write docs/zoo.md: what each agent and driver does, what it learned from, how strong it is and what it costs.

    python tools/zoo_page.py

``benchmarks/zoo.py --write`` measures, writes the table of measurements and then this page.
"""

import csv
import io
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.describe import describe, facts_of, microseconds, rating_text
from pcs_racing_agents.agents.measured import (
    AGAINST,
    NUMBERS,
    TEXTS,
    Measured,
    measured,
    measured_file,
    measurements,
)
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import ALWAYS, SHIPPED, build, entries, names

PAGE = Path(__file__).resolve().parents[1] / "docs" / "zoo.md"

SETTINGS = (("default", "paper"), ("contest", "contest"))
"""Archive and rules of the games in which agents are measured: those that networks and choices are shipped for."""

HEAD = """# The zoo, agent by agent

<!-- Written by `python benchmarks/zoo.py --write`, which measures as well, and by
`python tools/zoo_page.py`, which does not. -->

What each agent and driver does, the source of its idea, what it learned from, how strong it is, and what a decision
costs. This page is a reference; [agents.md](agents.md) explains how to use agents and how to add your own.
`pcs-racing agents NAME` prints the same for one of them.

`python benchmarks/zoo.py --write` measures all agents and drivers that race with their defaults:

- **score**: share of races won, where a tie counts half; the mean over six opponents (without the agent itself),
  {field}, on two circuits,
  which are named below. With either archive, some agents trained on the first circuit and none on the second; the
  driver `ppo-drive` trained on Tarnfjord and Kestrelheim. All drive the same races. With {races:.0f} races a score
  has a standard error of at least {error:.3f};
- **rating**: Bradley-Terry with ties over the same races, with its 95 % interval. The mean is 0, and a difference of
  400 means odds of ten to one. Crashes that pay neither car, as all in the paper's race, are left out. An agent that
  either wins or crashes therefore has a high rating; read the rating together with score and crashes;
- **crash**: share of its races that ended in a crash by its own fault;
- **cost**: microseconds of processor time of a decision, for one observation and for each of 1,000 at once, on a shared
  2-core machine that had other work at the time. A driver plans ten times a second, and its cost is that of one plan
  with 0.1 s of simulation;
- **hash**: the beginning of the SHA-256 of everything that determines its behaviour: weights or fit, archive, rules.
  Measurements belong to a hash. After an agent has changed, the page shows none until the script has run again.
"""


def zoo_page() -> str:
    """Return the whole page."""
    shipped = {name: entries()[name] for name in SHIPPED}
    settings = [make_setting(*pair) for pair in SETTINGS]
    every = [list(_table(setting)) for setting in settings]
    known = [one for rows in every for one in rows if one is not None]
    races = max((one.races for one in known), default=0.0)
    field = ", ".join(f"`{name}`" for name in dict.fromkeys(rival for one in known for rival in one.against))
    error = 0.5 / np.sqrt(races) if races else np.nan
    blocks = [HEAD.format(field=field or "none measured yet", races=races, error=error).strip(), "## At a glance"]
    for setting, rows in zip(settings, every, strict=True):
        blocks.append(f"Archive `{setting.archive.name}`, {setting.race} race:")
        blocks.append("\n".join(_lines([one for one in rows if one is not None])))
    blocks.append("## Agents")
    blocks += [_page(name, describe(name, entry), settings) for name, entry in shipped.items() if entry.moves]
    constant = [f"### `{ALWAYS}MOVE`", "", "Makes the same move at every step; one agent for each move.", ""]
    constant += ["- Source: baseline, never observes the race.", "- Needs nothing."]
    blocks.append("\n".join([*constant, *_constant(settings)]))
    blocks.append("## Drivers")
    blocks += [_page(name, describe(name, entry), settings) for name, entry in shipped.items() if not entry.moves]
    return "\n\n".join(blocks) + "\n"


def write_page(path: Path) -> Path:
    """Write the page to a file."""
    path.write_text(zoo_page(), encoding="utf-8")
    return path


def _page(name: str, told: str, settings: list[Setting]) -> str:
    lines = [told]
    for setting in settings:
        lines.append(f"- Archive `{setting.archive.name}`, {setting.race} race:")
        lines += [f"  - {line}" for line in facts_of(name, setting)]
    return "\n".join(lines)


def _constant(settings: list[Setting]) -> Iterator[str]:
    for setting in settings:
        for name in (name for name in names(setting.archive, setting.race) if name.startswith(ALWAYS)):
            yield f"- `{name}`, archive `{setting.archive.name}`, {setting.race} race:"
            yield from (f"  - {line}" for line in facts_of(name, setting))


def _table(setting: Setting) -> Iterator[Measured | None]:
    """What was measured of the agents as they are, best first."""
    found = []
    for name in names(setting.archive, setting.race):
        try:
            agent = build(name, setting)
        except UnknownNameError:
            continue
        found.append(measured(setting.archive.name, setting.race, name, competitor_hash(agent)))
    return iter(sorted(found, key=lambda one: 0.0 if one is None else -one.score))


def _lines(rows: list[Measured]) -> Iterator[str]:
    yield "| agent | score | rating | crash | cost, us | one of 1,000, us | hash |"
    yield "|---|---|---|---|---|---|---|"
    for one in rows:
        costs = [microseconds(value) for value in (one.one_us, one.many_us)]
        told = (f"{one.score:.3f}", rating_text(one), f"{one.own_crash:.1%}", *costs, f"`{one.sha256[:12]}`")
        yield f"| `{one.agent}` | {' | '.join(told)} |"


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
    print(write_page(PAGE))
