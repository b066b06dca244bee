"""What the zoo says of itself: the pages of docs/zoo.md, and the command ``pcs-racing agents``.

python -m pcs_racing_agents.agents.describe docs/zoo.md     # writes the pages again
"""

import inspect
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.measured import SETTINGS, Measured, measured
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import ALWAYS, ZOO, Entry, build, names, options

__all__ = ["describe", "facts_of", "option_meanings", "write_page", "zoo_page"]

NEEDS = {
    "": "nothing",
    "fit": "a fit to training races, the file `ARCHIVE-RACE-{name}.yaml` or `fit=FILE`",
    "network": "the network `ARCHIVE-RACE-{kind}`, or `network=FOLDER`",
    "agents": "what its member agents need",
}

HEAD = """# The zoo, agent by agent

<!-- Written by `python benchmarks/zoo.py --write`, which measures as well, and by
`python -m pcs_racing_agents.agents.describe docs/zoo.md`, which does not. -->

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


def option_meanings(function: Callable[..., Any]) -> dict[str, str]:
    """Return what a function's docstring says of its parameters, by name."""
    text = inspect.getdoc(function) or ""
    _, _, rest = text.partition("Parameters\n----------\n")
    found: dict[str, str] = {}
    names: list[str] = []
    for line in rest.splitlines():
        if re.fullmatch(r"-+", line):
            break
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
            found |= dict.fromkeys(names, "")
        else:
            for name in names:
                found[name] = f"{found[name]} {line.strip()}".strip()
    return {name: _plain(meaning) for name, meaning in found.items() if meaning}


def describe(name: str, entry: Entry) -> str:
    """Return what an agent or driver is and takes, in Markdown."""
    summary = f"{entry.summary[0].upper()}{entry.summary[1:]}."
    needs = NEEDS[entry.needs].format(name=name, kind=options(name).get("kind", ""))
    lines = [f"### `{name}`", "", summary, ""]
    if entry.source:
        lines.append(f"- Source: {entry.source}.")
    lines.append(f"- Needs {needs}.")
    meanings = option_meanings(entry.build)
    for key, default in options(name).items():
        if key not in ("kind", "planner"):
            lines.append(f"- Option `{key}`, by default `{default}`. {meanings.get(key, '')}".rstrip())
    return "\n".join(lines)


def facts_of(name: str, setting: Setting) -> list[str]:
    """Return what an agent has learned from, how strong it is, what it costs and its hash, in one game; a line each."""
    try:
        agent = build(name, setting)
    except UnknownNameError:
        return ["Not shipped for this game."]
    facts = dict(getattr(agent, "facts", {}))
    for known in ("does", "source", "weights sha256"):
        facts.pop(known, None)
    lines = [f"{key[0].upper()}{key[1:]}: {value}." for key, value in facts.items()]
    digest = competitor_hash(agent)
    found = measured(setting.archive.name, setting.race, name, digest)
    if found is None:
        lines.append("Strength and cost: not measured as it is.")
    else:
        against = ", ".join(f"{score:.3f} against {rival}" for rival, score in found.against.items())
        lines.append(
            f"Strength: score {found.score:.3f}, rating {_rating(found)}, on {found.tracks} in {found.races:.0f} races "
            f"({against}); own crashes {found.own_crash:.1%}."
        )
        lines.append(f"Cost: {_cost(found)}.")
    return [*lines, f"Hash: {digest[:16]}."]


def zoo_page() -> str:
    """Return the whole page."""
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
    blocks += [_page(name, describe(name, entry), settings) for name, entry in ZOO.items() if entry.moves]
    constant = [f"### `{ALWAYS}MOVE`", "", "Makes the same move at every step; one agent for each move.", ""]
    constant += ["- Source: baseline, never observes the race.", "- Needs nothing."]
    blocks.append("\n".join([*constant, *_constant(settings)]))
    blocks.append("## Drivers")
    blocks += [_page(name, describe(name, entry), settings) for name, entry in ZOO.items() if not entry.moves]
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
        costs = [_microseconds(value) for value in (one.one_us, one.many_us)]
        told = (f"{one.score:.3f}", _rating(one), f"{one.own_crash:.1%}", *costs, f"`{one.sha256[:12]}`")
        yield f"| `{one.agent}` | {' | '.join(told)} |"


def _rating(one: Measured) -> str:
    if np.isnan(one.rating):
        return "unknown"
    interval = "" if np.isnan(one.rating_low) else f" [{one.rating_low:+.0f}, {one.rating_high:+.0f}]"
    return f"{one.rating:+.0f}{interval}"


def _cost(one: Measured) -> str:
    first, second = _microseconds(one.one_us), _microseconds(one.many_us)
    if second:
        return f"{first} us for one observation, {second} us for each of 1,000 at once"
    kind = "decision" if one.agent not in ZOO or ZOO[one.agent].moves else "plan with 0.1 s of simulation"
    return f"{first} us for a {kind}"


def _microseconds(value: float) -> str:
    return "" if np.isnan(value) else f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _plain(text: str) -> str:
    """Sphinx roles as plain code."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")


if __name__ == "__main__":
    write_page(Path(sys.argv[1]))
