"""``python -m studies field``: planners at their defaults and tuned, and agents, in equal races."""

from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Annotated

from pcs_racing_agents.base.jobs import Job, open_job, show_progress
from pcs_racing_agents.base.tables import aligned, markdown, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import Workers, can_draw, output_folder
from pcs_racing_agents.tournament.pairings import Pairing, play_pairings
from pcs_racing_agents.tournament.races import RaceTable
from studies.field import cost, entrants, races, tables

PARTS = ("cost", "tune", *races.RULES, "tables")


@command(
    "field",
    "python -m studies field --maps maps --out out/field",
    "python -m studies field --small --out out/small",
)
def run(
    *,
    out: Annotated[Path, Option("folder of the tables; a stopped run resumes there", "DIR")],
    part: Annotated[Sequence[str], Option("parts to run", choices=PARTS)] = PARTS,
    maps: Annotated[
        Path | None, Option("folder of the real circuits (default: $PCS_RACING_MAPS)", "DIR")
    ] = None,
    small: Annotated[bool, Option("three planners, few races, one circuit of each kind")] = False,
    workers: Workers,
) -> None:
    """Tune all planners with one small budget; race defaults, tuned planners and agents."""
    size = entrants.SMALL if small else entrants.FULL
    tracks = races.circuits(size, maps)
    out = output_folder(out)
    if "cost" in part:
        _print_costs(size, sum(map(len, tracks.values())), out)
    with workers.start() as executor:
        if "tune" in part:
            folder = out / "tuned"
            found = [
                (name, entrants.tuned_policy(name, size, folder, executor))
                for name in entrants.tunable(size)
            ]
            print(f"written: {write_csv([entrants.COLUMNS, *found], out / 'tuned.csv')}")
        for rules in (rules for rules in races.RULES if rules in part):
            lines = race_rules(rules, size, tracks, out, executor)
            print(f"written: {write_csv(tables.csv_rows(lines), out / f'{rules}.csv')}")
    if "tables" in part:
        _print_tables(out)


def race_rules(
    rules: str, size: entrants.Size, tracks: races.Tracks, out: Path, executor: Executor
) -> list[tables.Line]:
    """Race all entrants under some rules, and return the lines of the table."""
    spec = races.spec_of(rules)
    planners = entrants.planner_entrants(entrants.read_tuned(out, size), size)
    agents = entrants.agent_entrants(spec) if rules == races.RULES[0] else []
    every = planners + agents
    opponents = [entrants.Entrant(name, "default", name) for name in races.OPPONENTS]
    number = size.races[rules]
    settings = {"seed": entrants.SEED, "races": number, "tracks": races.hashes(tracks)}
    with open_job(out / rules, "field", settings) as job:
        play = partial(races.play_all, spec, tracks, play=partial(_play, job, executor))
        raced = play(every, opponents, number, name=rules)
        labels = [one.label for one in opponents]
        best = tables.best_planner(tables.lines_of(spec.rules, raced, every, labels), every)
        if best.label not in labels:
            labels.append(best.label)
            raced |= play(every, [best], number, name=f"{rules}-best")
        lines = tables.lines_of(spec.rules, raced, every, labels)
        if agents:
            title = play(agents, [best], size.title, name=f"{rules}-title")
            lines += tables.title_lines(title, agents, best.label, spec.rules)
        return lines


def _play(job: Job, executor: Executor, pairings: Sequence[Pairing], name: str) -> list[RaceTable]:
    show = show_progress("races")
    return play_pairings(pairings, name=name, job=job, executor=executor, progress=show)


def _print_costs(size: entrants.Size, circuits: int, out: Path) -> None:
    """Measure the cost of a race of each planner, and print it with an estimate of all parts."""
    planners = entrants.planner_entrants({}, size)
    costs = cost.measure_costs(size, planners)
    rows = [("planner", "ms"), *((name, f"{value:.1f}") for name, value in costs.items())]
    print(f"written: {write_csv(rows, out / 'cost.csv')}")
    print("\n".join(aligned(rows)))
    estimate = cost.minutes(costs, size, planners, circuits)
    rows = [("part", "minutes"), *((name, f"{value:.1f}") for name, value in estimate.items())]
    print("\n".join(["", *aligned([*rows, ("all", f"{sum(estimate.values()):.1f}")])]))


def _print_tables(out: Path) -> None:
    """Print the tables of all races of the folder, and write scores.csv and the picture."""
    lines = [line for rules in races.RULES for line in tables.read_lines(out / f"{rules}.csv")]
    for title, rows in tables.pages(lines, cost.read_costs(out / "cost.csv")):
        print(f"\n{title}\n\n" + "\n".join(markdown(rows)))
    print(f"\nwritten: {write_csv(tables.csv_rows(lines), out / 'scores.csv')}")
    if can_draw("the picture"):
        print(f"written: {tables.draw_scores(lines, out / 'scores.png')}")
