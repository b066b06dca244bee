"""``python -m studies long-races``: gains by reacting to the lead in races of 300 s and 40 s."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple, Unpack

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import load_rules
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.base.jobs import Run, open_job, show_progress
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.base.tables import aligned, with_interval, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import Workers, output_folder
from pcs_racing_agents.tournament.fitting import TrainingRaces
from pcs_racing_agents.tournament.pairings import draw_schedule, play_pairings, schedule_pairing
from studies.circuits import real_circuits
from studies.long_races.plans import Plan, fit_plans, plan_agent

OPPONENTS = ("never-switch", "random-moves", "lattice", "iterated-best-response", "gap-follower")
"""Opponents of training and test, as in the study ``contest``."""
TRAINING = ("Brackwater", "Pipkin")
"""Circuits of the training races."""
TEST = ("Saltmere", "Vellindra")
"""Shipped circuits of the test races."""
REAL = ("Austin", "Monza")
"""Real circuits of the test races."""
RULES = {40: load_rules("contest"), 300: load_rules("contest", steps=(0.0, 4.0, *(8.0,) * 37))}
"""Rules by the length of a race in s; moves of the long races are 8 s apart."""
SEEDS = 5201, 5202
"""Seeds of the training and of the test races."""
RACES, SMALL = (4, 16), (2, 2)
"""Training and test races against each opponent on each circuit; the same in the small study."""


class Outcome(NamedTuple):
    """An arm in the test races of an archive."""

    archive: str
    seconds: int
    arm: str
    plan: Plan
    training: float  #: Score in the training races.
    score: float
    own_crash: float


def race_plans(
    spec: RaceGame,
    plans: dict[str, tuple[Plan, float]],
    tracks: Sequence[Track],
    races: int,
    name: str,
    **run: Unpack[Run],
) -> list[tuple[float, float]]:
    """Return score and own crashes of each arm in the test races, which are equal for all arms."""
    pairings = []
    for track in tracks:
        game = RaceGame(track, spec.archive, spec.rules)
        schedule = draw_schedule(track, spec.rules.for_game, races, SEEDS[1])
        for opponent in OPPONENTS:
            rival = competitor(opponent, spec)
            for arm, (plan, _) in plans.items():
                ego = plan_agent(spec, plan, arm)
                pairings.append(schedule_pairing(game, ego, rival, schedule, SEEDS[1]))
    played = play_pairings(pairings, name=name, **run)
    return [
        (
            float(np.mean([table.score.mean() for table in played[k :: len(plans)]])),
            float(np.mean([(table.fault[:, 0] == 1).mean() for table in played[k :: len(plans)]])),
        )
        for k in range(len(plans))
    ]


def gain_rows(results: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """Return a line for each length and arm: means over archives, and the gain over the best fixed
    policy with its interval by Student's t over archives.
    """
    rows: list[tuple[str, ...]] = [
        ("seconds", "arm", "score", "own crashes", "gain over best-fixed [95 %]")
    ]
    for seconds, arm in dict.fromkeys((one.seconds, one.arm) for one in results):
        own = [one for one in results if (one.seconds, one.arm) == (seconds, arm)]
        base = [one for one in results if (one.seconds, one.arm) == (seconds, "best-fixed")]
        gains = [one.score - fixed.score for one, fixed in zip(own, base, strict=True)]
        mean = clustered_mean(gains, np.arange(len(gains)))  # a cluster for each: Student's t
        score, crash = (np.mean([one[k] for one in own]) for k in (5, 6))
        gain = with_interval(mean.mean, mean.low, mean.high)
        rows.append((str(seconds), arm, f"{score:.3f}", f"{crash:.3f}", gain))
    return rows


@command(
    "long-races",
    "python -m studies long-races --archives out/all/contest-0 out/all/contest-1 --maps maps"
    " --out out/long",
)
def run(
    *,
    archives: Annotated[Sequence[str], Option("archives, two or more: names or folders", "A")],
    maps: Annotated[
        Path | None, Option(f"folder of {' and '.join(REAL)} (default: without them)", "DIR")
    ] = None,
    small: Annotated[bool, Option("two races against each opponent on each circuit")] = False,
    out: Annotated[Path, Option("folder of the tables; a stopped run resumes there", "DIR")],
    workers: Workers,
) -> None:
    """Fit plans by the lead on training races, and race them on test circuits."""
    if len(set(archives)) < max(2, len(archives)):
        raise InputError("archives are too few or repeated; give at least two different archives")
    training, test = SMALL if small else RACES
    specs = {
        (name, seconds): make_game(None, name, rules)
        for seconds, rules in RULES.items()
        for name in archives
    }
    hashes = [spec.archive.content_hash for spec in specs.values()]
    if len(set(hashes)) < len(archives):
        raise InputError("two archives are the same one; give each archive once")
    real = [] if maps is None else real_circuits(REAL, maps)
    own, others = ([load_track(name) for name in names] for names in (TRAINING, (*TEST, *real)))
    settings = {
        "races": [training, test],
        "seeds": list(SEEDS),
        "archives": hashes,
        "tracks": [track.content_hash for track in (*own, *others)],
    }
    results: list[Outcome] = []
    with workers.start() as executor, open_job(output_folder(out), "long-races", settings) as job:
        how = Run(job=job, executor=executor, progress=show_progress("races"))
        for k, ((name, seconds), spec) in enumerate(specs.items()):
            rivals = tuple(competitor(opponent, spec) for opponent in OPPONENTS)
            races = TrainingRaces(tuple(own), rivals, spec, training, SEEDS[0])
            plans = fit_plans(races, f"fit-{k}", **how)
            scores = race_plans(spec, plans, others, test, f"test-{k}", **how)
            for (arm, (plan, before)), after in zip(plans.items(), scores, strict=True):
                results.append(Outcome(name, seconds, arm, plan, before, *after))
    write_csv([Outcome._fields, *results], out / "plans.csv")
    rows = gain_rows(results)
    print("\n".join(aligned(rows)))
    print(f"written: {write_csv(rows, out / 'gains.csv')}")
