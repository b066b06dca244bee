"""The page of the zoo: all agents and fixed policies, with their options and measured strength.

``dev/benchmarks/zoo.py --write`` measures, and writes the table of measurements (``measured.csv``).
The page is made of this table and of the zoo whenever the site is built (``docs/site_pages.py``).
"""

import csv
import io
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from pcs_racing.base.files import write_atomically
from pcs_racing.game.players import ALWAYS
from pcs_racing_agents.agents.describe import (
    AGAINST,
    NUMBERS,
    SHIPPED_GAMES,
    TEXTS,
    Measured,
    describe,
    measured_file,
    measurements,
    microseconds,
    rating_text,
)
from pcs_racing_agents.agents.zoo import SHIPPED, entries

HEAD = """# The zoo

`pcs-racing agents NAME` prints what an agent has learned from and the hash of the agent as it is
now. [Agents](../agents.md) explains how to use agents and how to add your own.
"""

CONSTANT = f"{ALWAYS}MOVE"

STRENGTH = """## Strength and cost

`python dev/benchmarks/zoo.py --write` measures all agents with their defaults, and the planners of
the archives' policies:

- **score**: share of races won, where a tie counts half; the mean over six opponents (without the
  agent itself), {field}, on a training track and a test track ({tracks}). All drive the same races.
  With {races:.0f} races a score has a standard error of at least {error:.3f};
- **rating**: Bradley-Terry with ties over the same races, with its 95 % interval. The mean is 0,
  and a difference of 400 means odds of ten to one. Crashes that pay neither car, as all in the
  paper's race, are left out. An agent that either wins or crashes therefore has a high rating; read
  the rating together with score and crashes;
- **crash**: share of its races that ended in a crash by its own fault;
- **cost**: microseconds of processor time of a decision, for one observation and for each of 1,000
  at once, on a busy 2-core machine. For a fixed policy: one plan with 0.1 s of simulation;
- **hash**: the beginning of the SHA-256 of everything that determines its behaviour: weights or
  fit, archive, rules. A measurement holds for the agent with this hash alone.
"""


def zoo_page() -> str:
    """Return the page: a description of each agent, and the tables of their strength."""
    shipped = {name: entries()[name] for name in SHIPPED}
    blocks = [HEAD.strip()]
    for title, moves in (("Agents", True), ("Fixed policies", False)):
        blocks.append(f"## {title}")
        for name, entry in shipped.items():
            if entry.moves is moves:
                blocks += [f"### `{name}`", describe(name, entry)]
        if moves:
            blocks += [
                f"### `{CONSTANT}`",
                "Makes the same move at every step; one agent for each move.",
            ]
    every = [one for one in measurements().values() if (one.archive, one.rules) in SHIPPED_GAMES]
    if every:
        races = max(one.races for one in every)
        blocks.append(
            STRENGTH.format(
                field=", ".join(
                    f"`{name}`"
                    for name in dict.fromkeys(rival for one in every for rival in one.against)
                ),
                tracks="; ".join(dict.fromkeys(one.tracks for one in every)),
                races=races,
                error=0.5 / np.sqrt(races),
            ).strip()
        )
    for archive, race in SHIPPED_GAMES:
        rows = [one for one in every if (one.archive, one.rules) == (archive, race)]
        blocks.append(f"### Archive `{archive}`, {race} race")
        blocks.append("\n".join(_lines(rows)) if rows else "Not measured yet.")
    return "\n\n".join(blocks) + "\n"


def _lines(rows: list[Measured]) -> Iterator[str]:
    yield "| agent | score | rating | crash | cost, us | one of 1,000, us | hash |"
    yield "|---|---|---|---|---|---|---|"
    for one in sorted(rows, key=lambda one: -one.score):
        costs = [microseconds(value) for value in (one.one_us, one.many_us)]
        told = (
            f"{one.score:.3f}",
            rating_text(one),
            f"{one.own_crash:.1%}",
            *costs,
            f"`{one.sha256[:12]}`",
        )
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
    write_atomically(measured_file(), text.getvalue())
    measurements.cache_clear()
    return measured_file()


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
