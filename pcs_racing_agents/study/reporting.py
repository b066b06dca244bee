"""The last stage: race results line by line, tables, and the report page."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcs_racing.base.files import write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.fits import load_fit
from pcs_racing_agents.base.curves import Curve
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.learning.ppo.evaluation import read_evaluations
from pcs_racing_agents.study.playing import RATING_SEED, TABLE_SEED, StudyRaces, table_races
from pcs_racing_agents.study.preparing import FITTING_SEED, RESPONSE_SEED, SAMPLED_SEED, TREE_SEED
from pcs_racing_agents.study.report import ExplainedRace, ReportContent, TitledTable, write_page
from pcs_racing_agents.study.report_inputs import (
    KINDS,
    Highlight,
    read_curves,
    select_highlights,
    software,
    watch_race,
)
from pcs_racing_agents.study.study import BEST_OPEN_LOOP, Study
from pcs_racing_agents.study.table import StudyTable, by_progress, make_table
from pcs_racing_agents.study.table_text import (
    overview_rows,
    paper_rows,
    table_markdown,
    table_text,
    verdict_text,
    write_table,
)
from pcs_racing_agents.tournament.pairings import Pairing
from pcs_racing_agents.tournament.race_files import read_results, write_results
from pcs_racing_agents.tournament.races import RaceTable, closeness_text, concatenate_races
from pcs_racing_agents.tournament.round_robin import RoundRobin, round_robin
from pcs_racing_agents.tournament.runner import play_pairings
from pcs_racing_agents.watch.explain import is_open_loop
from pcs_racing_agents.watch.situations import Situations, summarise, write_situations

SEED = 7_000_000
GAME_THEORETIC = "cfr-argmax"  # the paper's agent
FEWEST_RACES = 1000  # per agent and row; below it is a smoke test; paper: 4,000


def moves_in_situations(
    study: Study, study_races: Sequence[StudyRaces], races: int = 1000
) -> list[Situations]:
    """Count the moves of the main table's agents that use observations; write each as CSV.

    ``races``: max number per pairing, drawn by the study's seed; all agents get the same races.
    """
    pairings = []
    for table, pairing, _ in study_races:
        # An open-loop agent's moves in situations would show the situations, not the agent.
        if table == "main" and isinstance(pairing.ego, Agent) and not is_open_loop(pairing.ego):
            # Fresh generator per pairing: all agents are shown in the same races.
            rng = np.random.default_rng(
                np.random.SeedSequence(study.config.seed, spawn_key=(SEED,))
            )
            pairings.append(pairing.take(np.sort(rng.permutation(len(pairing))[:races])))
    if not pairings:
        return []
    folder = study.folder / "report" / "situations"
    with open_job(
        folder, "situations", {"archive": study.archive.content_hash, "races": races}
    ) as job:
        progress = study.progress("races (moves in situations)")
        repeated = play_pairings(
            pairings,
            name="moves",
            observations=True,
            job=job,
            executor=study.executor,
            progress=progress,
        )
        observed = [
            (pairing.names[0], races.observations[:, 0], races.moves.codes[:, 0])
            for pairing, races in zip(pairings, repeated, strict=True)
        ]
    summaries = []
    for name in dict.fromkeys(name for name, *_ in observed):
        observations, moves = (
            np.concatenate([own[k] for own in observed if own[0] == name]) for k in (1, 2)
        )
        if (moves >= 0).any():
            summaries.append(summarise(observations, moves, study.archive, study.spec.moves, name))
            write_situations(summaries[-1], study.folder / "report" / f"situations-{name}.csv")
    return summaries


def write_report(study: Study, seconds: Mapping[str, float]) -> None:
    """Write ``results.csv``, ``table.csv``, ``table.md``, ``table.txt`` and ``report.html``."""
    study_races = table_races(study)
    folder = study.folder
    write_results((row for races in study_races for row in races.races), folder / "results.csv")
    main = study_table(study, study_races, "main")
    write_table(main, folder / "table.csv")
    _write(folder / "table.md", table_markdown(main))
    _write(folder / "table.txt", table_text(main))
    write_page(_content(study, study_races, main, seconds), folder / "report.html")


def study_table(
    study: Study,
    study_races: Sequence[StudyRaces],
    name: str,
    scored: Callable[[RaceTable], RaceTable] | None = None,
) -> StudyTable:
    """Compare the arms of one of the study's tables; ``scored`` may redefine the winners."""
    races = concatenate_races(cell.races for cell in study_races if cell.table == name)
    races = races if scored is None else scored(races)
    config, open_loop = study.config, best_open_loop(study)
    learned_on = {study.track(circuit).name for circuit in config.circuits}
    table = make_table(
        races, base=config.arms[0], best=config.best, open_loop=open_loop, seen=learned_on
    )
    if config.game.race.name == "paper":
        return table
    # The paper's figures are comparable under the paper's rules only.
    return replace(table, rows=tuple(replace(row, paper=None) for row in table.rows))


def best_open_loop(study: Study) -> str | None:
    """Return the fitted baseline with the max number of training wins; None without such arms.

    Candidates are the best fixed policy, the best open-loop sequence and the best lead plan. On
    the training races the sequence is at least as good as any constant move, and the plan as any
    fixed policy, since their searches begin with the best constant move and the best fixed policy.
    """
    if not set(BEST_OPEN_LOOP) <= set(study.config.arms):
        return None
    fits = {name: load_fit(study.folder / "open-loop" / f"{name}.yaml") for name in BEST_OPEN_LOOP}
    return max(BEST_OPEN_LOOP, key=lambda name: float(fits[name].training["reached"]))  # first max


def _content(
    study: Study, study_races: Sequence[StudyRaces], main: StudyTable, seconds: Mapping[str, float]
) -> ReportContent:
    config = study.config
    sheets = list(_papers_statistic(study, study_races))
    if config.further_lines:
        further = study_table(study, study_races, "further")
        rows = overview_rows(further)
        note = (
            f"{config.further_lines * config.egos * config.variants * 2} races of each agent in"
            " each row."
        )
        sheets.append(TitledTable("More opponents, circuits and agents", rows[0], rows[1:], note))
    return ReportContent(
        title=f"Study: {config.race} race, archive {study.archive.name}",
        about=(
            f"{sum(len(cell.races) for cell in study_races):,} races of {config.game.horizon:g} s"
            f" between two cars. Every {config.game.step_seconds:g} s an agent may change its"
            f" policy, which is how its car drives, by {config.epsilon:g} of the archive's range on"
            f" an axis; {config.arms[0]} is what the others are compared"
            f" with.\n\n{closeness_text(concatenate_races(cell.races for cell in study_races))}"
        ),
        findings=list(_findings(main)),
        caution=_caution(main),
        table=main,
        archive=study.archive,
        epsilon=config.epsilon,
        curves=_curves(study),
        reward_curves=_reward_curves(study),
        round_robin=_round_robin(study),
        situations=moves_in_situations(study, study_races),
        sheets=sheets,
        races=list(_watched(study, study_races)),
        settings=plain_settings(config),
        versions=software(),
        seeds=_seeds(study),
        seconds=seconds,
    )


def _papers_statistic(study: Study, study_races: Sequence[StudyRaces]) -> Iterator[TitledTable]:
    """Write the main table by the paper's statistic and yield it; only under the paper's rules."""
    table = study_table(study, study_races, "main", by_progress)
    if GAME_THEORETIC not in table.arms or not any(row.paper for row in table.rows):
        return
    write_table(table, study.folder / "table_by_progress.csv")
    rows = paper_rows(table, GAME_THEORETIC)
    note = (
        "Mean and standard deviation over the ego's start policies; p: paired t-test over them, as"
        " in the paper."
    )
    yield TitledTable(
        "Who has progressed further at the end, crash or not: the paper's statistic",
        rows[0],
        rows[1:],
        note,
    )


def _findings(table: StudyTable) -> Iterator[str]:
    """Yield the results of the main table as sentences."""
    others = [arm for arm in table.arms if arm != table.base]
    for arm in sorted(others, key=lambda arm: arm != table.best):
        results = [
            difference.result
            for row in table.rows
            for difference in row.differences
            if difference.arm == arm
        ]
        yield verdict_text(arm, table.base, results)
    gains = [row.gain.result for row in table.rows if row.gain is not None]
    if gains and table.best is not None:
        open_loop = f"{table.open_loop}, the best baseline in training"
        yield f"What looking at the race brings: {verdict_text(table.best, open_loop, gains)}"


def _caution(table: StudyTable) -> str:
    """Return a warning if a study is too small for conclusions, else an empty text."""
    races = min(arm.races for row in table.rows for arm in row.arms)
    if races >= FEWEST_RACES:
        return ""
    return (
        f"This is a smoke test, too small to conclude from: {races} races of an agent in a row, the"
        " paper has 4,000."
    )


def _curves(study: Study) -> dict[str, list[Curve]]:
    """Return the learning curves of the networks, in the order of the configuration."""
    files = {name: study.network(name) / "learning_curves.csv" for name in study.config.targets}
    return {name: read_curves(file) for name, file in files.items() if file.is_file()}


REWARDS = {"worth": "payoff of a race", "won": "races won", "fault": "crashes by own fault"}


def _reward_curves(study: Study) -> dict[str, list[Curve]]:
    """Return PPO's learning curves, if trained: a panel per figure, a line per seed."""
    file = study.network("ppo") / "curve.csv"
    if not file.is_file():
        return {}
    curves = read_evaluations(file)
    return {
        title: [
            Curve(
                np.array(curve.steps) / 1e6,
                np.array(
                    [
                        np.mean([getattr(score, key) for score in scores.values()])
                        for scores in curve.scores
                    ]
                ),
                f"seed {curve.seed}",
            )
            for curve in curves
        ]
        for key, title in REWARDS.items()
    }


def _round_robin(study: Study) -> RoundRobin | None:
    """Return the summary of the round robin."""
    file = study.folder / "ratings.csv"
    if not file.is_file():
        return None
    return round_robin(study.config.rated, read_results(file), seed=study.config.seed)


def _seeds(study: Study) -> dict[str, int]:
    """Return the seed of each stage."""
    config = study.config
    seeds = {"study": config.seed}
    if config.pairs:
        seeds["trees"] = config.seed + TREE_SEED
    seeds["training races"] = config.seed + FITTING_SEED
    if config.responses:
        seeds["answers"] = config.seed + RESPONSE_SEED
    seeds["races of the table"] = config.seed + TABLE_SEED
    if config.sampled_cfr:
        seeds["regrets of sampled games"] = config.seed + SAMPLED_SEED
    if config.rated:
        seeds["all against all"] = config.seed + RATING_SEED
    return seeds


def _watched(study: Study, study_races: Sequence[StudyRaces]) -> Iterator[ExplainedRace]:
    """Yield the best agent's closest win by switching, loss and crash over all rows."""
    # Keyed by names: the baseline of a race is the pairing with the same track and opponent.
    raced = {
        (f.pairing.game.track.name, *f.pairing.names): f for f in study_races if f.table == "main"
    }
    found: dict[str, list[tuple[Highlight, Pairing]]] = {}
    for (track, ego, opponent), races in raced.items():
        if ego == study.config.best:
            baseline = raced[track, study.config.arms[0], opponent]
            for kind, highlight in select_highlights(races.races, baseline.races).items():
                found.setdefault(kind, []).append((highlight, races.pairing))
    for kind in KINDS:
        if kind in found:
            closest, pairing = min(found[kind], key=lambda one: one[0])
            many = sum(one.races for one, _ in found[kind] if one.rank == closest.rank)
            title = (
                f"{closest.title}: of {many} such races the closest, {closest.gap:.1f} m at the end"
            )
            yield watch_race(pairing, closest.race, title)


def _write(path: Path, text: str) -> None:
    write_atomically(path, lambda file: file.write(text.encode("utf-8")))
