"""``python -m studies headroom``: the value of knowing the opponent's policy, in a pool.

Payoffs are races won minus one half, 0 between equals. They come in folds, disjoint sets of races
with different start lines and noise. A policy selected on some races is evaluated on others, since
the maximum of noisy numbers is biased.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError, check_whole
from pcs_racing.base.typing import Floats
from pcs_racing.game.archive_files import load_archive
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import Rules
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.jobs import open_job, show_progress
from pcs_racing_agents.base.tables import Column, aligned, table_rows, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    DEFAULT_TRACK,
    POLICY_HELP,
    ArchiveName,
    Circuits,
    RaceOptions,
    Workers,
    archive_for,
)
from pcs_racing_agents.tournament import (
    RaceTable,
    plan_tournament,
    play_plan,
    tournament_settings,
)
from pcs_racing_agents.tournament.races import series_of
from pcs_racing_agents.tournament.ratings import agents_of

SIZE = 16
"""Max size of a pool by default."""
FOLDS = 8
NOTE = """H: value of knowing the opponent before the start, in races won, over the best fixed
policy; low: a lower bound; error: standard error over opponents"""
COLUMNS = (
    Column("track"),
    Column("value", "H", "+.3f"),
    Column("low", format="+.3f"),
    Column("error", format=".3f"),
    Column("best_fixed", "best fixed policy"),
)


class Headroom(NamedTuple):
    """Value of knowing the opponent's policy in a pool of policies, in races won."""

    #: Mean over opponents j of ``P[best response to j, j] - P[best fixed policy, j]``. Both
    #: policies are selected on all folds but one and evaluated on the remaining fold, for every
    #: fold.
    value: float
    low: float  #: Lower bound: the same gain over the best fixed policy of the evaluation races.
    error: float  #: Standard error over opponents of the same kind.
    best_fixed: str  #: Policy with the highest mean payoff over all folds.
    track: str


def headroom(payoffs: Floats, names: Sequence[str], track: str = "") -> Headroom:
    """Estimate the headroom of a pool, cross-fitted.

    ``payoffs``, shape (F, N, N): payoff of the row's policy against the column's policy in each
    fold, antisymmetric.
    """
    total, opponents = payoffs.sum(axis=0), np.arange(len(names))
    gains, lows = [], []
    for judged in payoffs:
        training = total - judged
        responses = judged[training.argmax(axis=0), opponents]
        gains.append(responses - judged[training.sum(axis=1).argmax()])
        lows.append(responses.mean() - judged.mean(axis=1).max())
    gain = np.mean(gains, axis=0)
    return Headroom(
        float(gain.mean()),
        float(np.mean(lows)),
        float(gain.std(ddof=1) / np.sqrt(len(gain))),
        names[int(total.sum(axis=1).argmax())],
        track,
    )


def fold_payoffs(races: RaceTable, names: Sequence[str], rules: Rules) -> Floats:
    """Return payoffs of races on one track, shape (F, N, N), antisymmetric; a tie is a half."""
    payoffs = np.zeros((FOLDS, len(names), len(names)))
    races = series_of(races, rules)
    first, second = agents_of(names, races).T
    fold = races.race // 2 % FOLDS  # two races share a start line
    won = np.array([0.5, -0.5, 0.0])[races.winner]
    np.add.at(payoffs, (fold, first, second), won * FOLDS / len(np.unique(races.race)))
    return payoffs - payoffs.swapaxes(1, 2)


def spanning_policies(name: str, size: int | None) -> dict[str, Policy]:
    """Return policies evenly spaced along an archive's first axis, by name."""
    archive = load_archive(name)
    count = min(SIZE, len(archive)) if size is None else check_whole("size", size, 3, len(archive))
    order = np.argsort(archive.coordinates[:, 0], kind="stable")
    chosen = order[np.linspace(0, len(order) - 1, count).round().astype(np.intp)]
    return {f"{archive.name} {i}": archive.policy(int(i)) for i in chosen}


@command(
    "headroom",
    "python -m studies headroom --rules contest --out out/headroom",
    "python -m studies headroom --policies lattice:pace=0.2 lattice:pace=0.6 lattice --out out/a",
)
def run(
    *,
    track: Circuits = (DEFAULT_TRACK,),
    archive: ArchiveName = None,
    size: Annotated[
        int | None,
        Option(f"policies of the pool, evenly spaced on the first axis (default: at most {SIZE})"),
    ] = None,
    policies: Annotated[
        Sequence[str], Option(f"a pool of your own instead of an archive: {POLICY_HELP}", "POLICY")
    ] = (),
    rules: RaceOptions,
    races: Annotated[int, Option(f"races of each pair; a multiple of {2 * FOLDS}")] = 64,
    out: Annotated[
        Path,
        Option("folder for headroom.csv and payoffs.csv; an interrupted run resumes here", "DIR"),
    ],
    workers: Workers,
) -> None:
    """Race all pairs of a pool of policies, and print the value of knowing the opponent."""
    if races % (2 * FOLDS):
        raise InputError(f"races is {races}; it must be a multiple of {2 * FOLDS}")
    config = rules.read()
    source = archive_for(archive, config)
    plan = plan_tournament(
        [load_track(name) for name in track],
        list(policies) or spanning_policies(source, size),
        config,
        archive=source,
        races_per_pair=races,
        seed=rules.seed,
        code=True,
    )
    with workers.start() as executor, open_job(out, "headroom", tournament_settings(plan)) as job:
        raced = play_plan(plan, job=job, executor=executor, progress=show_progress()).races
        found, pairs = [], [("track", "policy", "opponent", "payoff")]
        for name in raced.track.words:
            own = raced.take(raced.track.codes == raced.track.words.index(name))
            payoffs = fold_payoffs(own, plan.names, plan.rules)
            found.append(headroom(payoffs, plan.names, name))
            for (i, j), payoff in np.ndenumerate(payoffs.mean(axis=0)):
                pairs.append((name, plan.names[i], plan.names[j], f"{payoff:.6f}"))
        rows = table_rows(COLUMNS, found)
        print("\n".join([*aligned(rows), "", NOTE]))
        print(f"written: {write_csv(rows, out / 'headroom.csv')}")
        print(f"written: {write_csv(pairs, out / 'payoffs.csv')}")
