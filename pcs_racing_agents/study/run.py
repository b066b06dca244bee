"""Script of a study: trees, networks, baselines, responses, then the races and the report.

Every stage is a job in the study's folder. A finished task is read from its chunk, so a stopped
study resumes, and a finished study repeats nothing. The results depend on the configuration alone.
"""

from concurrent.futures import Executor
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np

from pcs_racing.base.errors import require
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.make import make_game
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.blind import save_fit
from pcs_racing_agents.base.folders import claim_folder, clear_half_written
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.learning.responses import learn_response, load_response_settings
from pcs_racing_agents.learning.self_play import learn_self_play, load_self_play_settings
from pcs_racing_agents.networks.network_files import save_network, save_network_set
from pcs_racing_agents.networks.training import load_train_settings
from pcs_racing_agents.policies.selection import spread_out
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.study.report import write_report
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament import (
    RaceTable,
    concatenate_races,
    cross_pairing,
    play_pairings,
)
from pcs_racing_agents.tournament.fitting import (
    TrainingRaces,
    fit_best_fixed,
    fit_best_lead_plan,
    fit_best_schedule,
)
from pcs_racing_agents.trees.storage import build_trees, stored_identity

# Offsets of the study's seed: start policies and noise differ from the races of the tables.
# pcs_racing.race.races.start_lines decides which start places training and tables draw from.
TREE_SEED = 1_000_000
FITTING_SEED = 2_000_000
RESPONSE_SEED = 3_000_000
SAMPLED_SEED = 4_000
FIXED_TARGETS = 16  # candidates for the targets of best-fixed and best-lead-plan


def run_study(
    config: StudyConfig,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    quiet: bool = False,
) -> Study:
    """Run a study, or the rest of a stopped one.

    Parameters
    ----------
    folder : str or Path
        New, empty, or of the same study.
    executor : Executor, optional
        Executor of the jobs (:func:`pcs_racing_agents.base.executors.make_executor`). The results
        do not depend on it.
    """
    # Checks come before the folder: a missing library or track leaves nothing behind.
    learning = config.learning
    if learning.networks or learning.responses:
        require("torch", extra="learning")
    for name in config.tracks:
        load_track(name)
    study = Study(config, Path(folder), executor, quiet)
    with claim_folder(study.folder, "study", plain_settings(config)):
        for inner in study.folder.rglob("*/"):
            clear_half_written(inner)
        train_networks(study)
        learn_sampled_regrets(study)
        fit_baselines(study)
        learn_responses(study)
        write_report(study, race_tables(study))
    return study


def train_networks(study: Study) -> None:
    """Play game trees on every training track, and train a network on them for each target."""
    from pcs_racing_agents.networks.from_trees import train_regrets
    from pcs_racing_agents.networks.training import write_epochs

    config = study.config.learning
    stored = [
        build_trees(
            # Without "stay": trees would be six times as large.
            make_game(load_track(name), study.archive, study.config.rules, stay=False),
            study.folder / "trees" / name,
            pairs=config.trees,
            seed=study.config.seed + TREE_SEED + number,
            executor=study.executor,
            progress=study.progress(f"trees ({name})"),
        )
        for number, name in enumerate(config.tracks if config.targets else ())
    ]
    places = [(trees, i) for trees in stored for i in range(len(trees))]
    for target in config.targets:
        # The last file of a network: a network without it is trained again.
        curves = study.network(target) / "learning_curves.csv"
        if not curves.is_file():
            trained = train_regrets(
                lambda number: places[number][0][places[number][1]],
                np.concatenate([np.asarray(trees.settings["pairs"]) for trees in stored]),
                stored_identity(stored[0].settings),
                load_train_settings(config.training, target=target, seed=study.config.seed),
                name=target,
                about={"tracks": ", ".join(config.tracks)},
                executor=study.executor,
                learning=study.progress(f"epochs ({target})"),
            )
            save_network(trained.network, study.network(target))
            write_epochs(trained.result, curves)


def learn_sampled_regrets(study: Study) -> None:
    """Learn the regrets of "cfr-argmax" from sampled games, if the study configures this."""
    if study.config.learning.sampled_cfr is None:
        return
    settings = load_self_play_settings(study.config.learning.sampled_cfr)
    settings = replace(settings, seed=settings.seed + study.config.seed + SAMPLED_SEED)
    identity = {"archive": study.archive.content_hash, **plain_settings(settings)}
    name = "sampled-cfr"
    with open_job(study.folder / name, name, identity) as job:
        progress = study.progress(f"tasks ({name})")
        learned = learn_self_play(
            study.games(),
            study.spec,
            settings,
            job,
            name=name,
            executor=study.executor,
            progress=progress,
        )
    save_network_set(learned, study.network(name))
    # The last network predicts mean regrets over all iterations; the paper plays the argmax.
    training = {**learned.training, "sampled": True}
    last = replace(learned.networks[-1], name="regret", target="regret", training=training)
    save_network(last, study.network("regret"))


def fit_baselines(study: Study) -> None:
    """Fit the baselines on training races: fixed policy, open-loop move sequence, lead plan."""
    config, seed = study.config.learning, study.config.seed
    training = TrainingRaces(
        tracks=tuple(map(load_track, config.tracks)),
        opponents=tuple(map(study.agent, config.fitting_opponents)),
        spec=study.spec,
        races=config.fitting_races,
        seed=seed + FITTING_SEED,
    )
    # Candidates are spread over the archive: searching all policies of a large archive is wasteful.
    targets = None
    if len(study.archive) > FIXED_TARGETS:
        targets = sorted(spread_out(study.archive.normalised, FIXED_TARGETS).tolist())
    settings = {"archive": study.archive.content_hash}
    with open_job(study.folder / "open-loop" / "races", "fitting", settings) as job:
        for name, find in (
            ("best-fixed", partial(fit_best_fixed, targets=targets)),
            ("best-schedule", fit_best_schedule),
            ("best-lead-plan", partial(fit_best_lead_plan, targets=targets)),
        ):
            progress = study.progress(f"races ({name})")
            fit = find(training, job=job, executor=study.executor, progress=progress)
            save_fit(fit, study.fit(name))


def learn_responses(study: Study) -> None:
    """Learn the responses to the pool of opponents."""
    config, seed = study.config.learning, study.config.seed + RESPONSE_SEED
    for name in config.responses:
        settings = load_response_settings(name)
        settings = replace(settings, seed=seed + settings.seed)
        identity = {"name": name, **plain_settings(settings)}
        with open_job(study.folder / "responses" / name, "response", identity) as job:
            network = learn_response(
                study.games(),
                list(map(study.agent, config.response_opponents)),
                study.spec,
                settings,
                job,
                name=name,
                executor=study.executor,
                progress=study.progress(f"branch tasks ({name})"),
            )
        save_network(network, study.network(name))


def race_tables(study: Study) -> RaceTable:
    """Return the races of all tables, simulated in parallel."""
    # All pairings share these objects: play_pairings finds common races by object identity.
    game, agent = cache(study.game), cache(study.agent)
    pairings = [
        cross_pairing(
            game(track),
            agent(ego),
            agent(opponent),
            egos=table.egos,
            opponents=table.variants,
            lines=table.lines,
            # The seed ignores track and ego: all agents of a row drive the same races.
            seed=study.table_seeds(number)[table.opponents.index(opponent)],
        )
        for number, table in enumerate(study.config.tables)
        for track, opponent, ego in product(table.tracks, table.opponents, table.agents)
    ]
    identity = {"archive": study.archive.content_hash}
    with open_job(study.folder / "races", "races", identity) as job:
        progress = study.progress("races of the tables")
        races = play_pairings(
            pairings, name="tables", job=job, executor=study.executor, progress=progress
        )
    return concatenate_races(races)
