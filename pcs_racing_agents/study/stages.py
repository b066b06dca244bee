"""Stages of a study, in order: archive, game trees, training of all agents, races, report."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.artifacts import MANIFEST
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.make import make_game
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.fits import save_fit
from pcs_racing_agents.base.jobs import open_job, run_groups
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.base.tasks import in_other_processes, numbered_tasks, run_tasks
from pcs_racing_agents.learning.responses.learner import learn_response, load_response_settings
from pcs_racing_agents.learning.self_play import (
    RaceSampler,
    learn_self_play,
    load_self_play_settings,
)
from pcs_racing_agents.networks.network_files import (
    NETWORK_FORMAT,
    load_network,
    save_network,
    save_network_set,
)
from pcs_racing_agents.networks.settings import TrainSettings, load_train_settings
from pcs_racing_agents.policies.config import load_archive_config
from pcs_racing_agents.policies.diverse import select_diverse
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament import (
    Pairing,
    RaceTable,
    cross_pairing,
    plan_tournament,
    play_pairings,
    play_plan,
    tournament_settings,
    write_results,
)
from pcs_racing_agents.trees.storage import load_trees, open_trees, stored_identity
from pcs_racing_agents.trees.tree import RaceTree

if TYPE_CHECKING:
    from pcs_racing_agents.networks.from_trees import TrainedOnTrees


# Offsets of the study's seed: start policies and noise differ from the races of the tables.
# pcs_racing.race.races.start_lines decides which start places training and tables draw from.
TREE_SEED = 1_000_000
FITTING_SEED = 2_000_000
RESPONSE_SEED = 3_000_000
SAMPLED_SEED = 4_000
RATING_SEED = 5_000_000
PPO_SEEDS = 2**31  # upper limit of torch
FIXED_TARGETS = 16  # candidates for the targets of best-fixed and best-lead-plan


def make_the_archive(study: Study) -> None:
    """Make the archive by the configuration's synthesis, unless it names an existing archive."""
    if study.config.synthesis is not None:
        from pcs_racing_agents.policies.archive_run import synthesize

        config = load_archive_config(study.config.synthesis)
        synthesize(config, study.folder / "archive", executor=study.executor)


def play_trees(study: Study) -> None:
    """Play game trees on every training track, in parallel."""
    config = study.config.learning
    if config.trees == 0:
        return
    # All tracks in parallel: no worker waits for the last trees of a track.
    with ExitStack() as opened:
        groups = []
        for number, name in enumerate(config.tracks):
            # Without "stay": trees would be six times as large.
            game = make_game(load_track(name), study.archive, study.config.game, stay=False)
            trees = open_trees(
                game,
                study.folder / "trees" / name,
                pairs=config.trees,
                seeds_per_pair=config.seeds,
                seed=study.config.seed + TREE_SEED + number,
                one_thread=study.executor is not None,
            )
            groups.append(opened.enter_context(trees))
        run_groups(groups, executor=study.executor, progress=study.progress("trees"), keep=False)


def train_networks(study: Study) -> None:
    """Train a network per target, in parallel processes if any; all share validation trees."""
    from pcs_racing_agents.networks.training import write_epochs

    config = study.config.learning
    whole = {MANIFEST, NETWORK_FORMAT.data_file, "learning_curves.csv"}
    missing = [
        name
        for name in config.targets
        if not whole <= {file.name for file in study.network(name).glob("*")}
    ]
    if config.trees == 0 or not missing:
        return
    stored = [load_trees(study.folder / "trees" / name, study.archive) for name in config.tracks]
    settings = [
        load_train_settings(config.training, target=name, seed=study.config.seed)
        for name in missing
    ]
    elsewhere = in_other_processes(study.executor)
    # Other processes may not see local files, so the trees are sent; they can't show progress.
    trees = stored if elsewhere is None else [list(each) for each in stored]
    train = partial(
        _train,
        trees,
        np.concatenate([np.asarray(each.settings["pairs"]) for each in stored]),
        stored_identity(stored[0].settings),
        tracks=", ".join(config.tracks),
        progress=study.progress if elsewhere is None else None,
    )
    progress = None if elsewhere is None else study.progress("networks")
    tasks = numbered_tasks(train, settings)
    for done, (i, trained) in enumerate(run_tasks(tasks, elsewhere, "networks"), start=1):
        save_network(trained.network, study.network(missing[i]))
        write_epochs(trained.result, study.network(missing[i]) / "learning_curves.csv")
        if progress is not None:
            progress(done, len(missing), missing[i])


def _train(
    trees: Sequence[Sequence[RaceTree]],
    pairs: NDArray[np.int64],
    identity: GameIdentity,
    settings: TrainSettings,
    tracks: str,
    progress: Callable[[str], Progress | None] | None,
) -> "TrainedOnTrees":
    """Train a network on the trees of all tracks, here or in another process.

    ``pairs`` (ndarray of int, shape (trees, 2)): starting policies of the trees. ``progress``:
    factory of a progress function for epochs.
    """
    from pcs_racing_agents.networks.from_trees import train_regrets

    places = [(own, i) for own in trees for i in range(len(own))]
    return train_regrets(
        lambda number: places[number][0][places[number][1]],
        pairs,
        identity,
        settings,
        name=settings.target,
        about={"tracks": tracks},
        learning=None if progress is None else progress(f"epochs ({settings.target})"),
    )


def learn_sampled_regrets(study: Study) -> None:
    """Learn the regrets of "cfr-argmax" from sampled games, if the study configures this."""
    if study.config.learning.sampled_cfr is None:
        return
    settings = load_self_play_settings(study.config.learning.sampled_cfr)
    settings = replace(settings, seed=settings.seed + study.config.seed + SAMPLED_SEED)
    samplers = [RaceSampler(game, study.spec, settings.worth) for game in study.games()]
    identity = {"archive": study.archive.content_hash, **plain_settings(settings)}
    name = "sampled-cfr"
    with open_job(study.folder / name / name, name, identity) as job:
        progress = study.progress(f"tasks ({name})")
        learned = learn_self_play(
            samplers, settings, job, name=name, executor=study.executor, progress=progress
        )
    save_network_set(learned, study.network(name))
    # The last network predicts mean regrets over all iterations; the paper plays the argmax.
    training = {**learned.training, "sampled": True}
    last = replace(learned.networks[-1], name="regret", target="regret", training=training)
    save_network(last, study.network("regret"))


def choose_open_loop(study: Study) -> None:
    """Fit the baselines on training races: fixed policy, open-loop move sequence, lead plan."""
    from pcs_racing_agents.tournament.fitting import (
        TrainingRaces,
        fit_best_fixed,
        fit_best_lead_plan,
        fit_best_schedule,
    )

    config, seed = study.config.learning, study.config.seed + FITTING_SEED
    training = TrainingRaces(
        tracks=tuple(map(load_track, config.tracks)),
        opponents=tuple(map(study.agent, config.fitting_opponents)),
        spec=study.spec,
        races=config.fitting_races,
        seed=seed,
    )
    # Candidates are spread over the archive: searching all policies of a large archive is wasteful.
    targets = None
    if len(study.archive) > FIXED_TARGETS:
        stream = np.random.SeedSequence(study.config.seed, spawn_key=(FITTING_SEED,))
        rng = np.random.default_rng(stream)
        targets = select_diverse(study.archive, FIXED_TARGETS, "map", rng).tolist()
    folder = study.folder / "open-loop"
    settings = {"archive": study.archive.content_hash}
    with open_job(folder / "races", "fitting", settings) as job:
        for name, find in (
            ("best-fixed", partial(fit_best_fixed, targets=targets)),
            ("best-schedule", fit_best_schedule),
            ("best-lead-plan", partial(fit_best_lead_plan, targets=targets)),
        ):
            fit = find(
                training,
                job=job,
                executor=study.executor,
                progress=study.progress(f"races ({name})"),
            )
            save_fit(fit, folder / f"{name}.yaml")


def learn_responses(study: Study) -> None:
    """Learn the responses to the pool of opponents."""
    config, seed = study.config.learning, study.config.seed + RESPONSE_SEED
    pool = list(map(study.agent, config.response_opponents))
    for name in config.responses:
        settings = load_response_settings(name)
        seeded = replace(settings, seed=seed + settings.seed)
        with open_job(
            study.folder / "responses" / name, "response", {"name": name, **plain_settings(seeded)}
        ) as job:
            network = learn_response(
                study.games(),
                pool,
                study.spec,
                seeded,
                job,
                name=name,
                executor=study.executor,
                progress=study.progress(f"branch tasks ({name})"),
            )
        save_network(network, study.network(name))


def train_ppo_baseline(study: Study) -> None:
    """Train PPO on the study's game, if the study configures this.

    The study gives tracks, archive and rules; the settings give everything else.
    """
    config = study.config
    if config.learning.ppo is None:
        return
    from pcs_racing_agents.learning.ppo.evaluation import write_evaluations
    from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
    from pcs_racing_agents.learning.ppo.train import train_ppo

    # Training uses the study's own game: a comparison with its agents needs the same game.
    settings = load_ppo_settings(config.learning.ppo, tracks=config.learning.tracks)
    trained = train_ppo(
        settings,
        study.folder / "ppo" / "training",
        name="ppo",
        executor=study.executor,
        progress=study.progress("steps (ppo)"),
        policies=study.archive,
        rules=config.game,
        seeds=tuple((config.seed + seed) % PPO_SEEDS for seed in settings.seeds),
    )
    save_network(load_network(trained.folder), study.network("ppo"))
    write_evaluations(trained.curves, study.network("ppo") / "curve.csv")


class StudyRaces(NamedTuple):
    """Races of an agent against one kind of opponent on a track, for one of the study's tables."""

    table: str
    pairing: Pairing
    races: RaceTable


def table_races(study: Study) -> list[StudyRaces]:
    """Return the races of all tables, simulated in parallel; stored races are read."""
    # All pairings share these objects: play_pairings finds common races by object identity.
    games, agents = cache(study.game), cache(study.agent)
    tables, pairings = [], []
    for number, (name, table) in enumerate(study.config.tables.items()):
        for track, opponent, agent in product(table.tracks, table.opponents, table.agents):
            # The seed ignores track and agent: all agents of a row drive the same races.
            seed = study.config.seed + 100 * number + table.opponents.index(opponent)
            pairing = cross_pairing(
                games(track),
                agents(agent),
                agents(opponent),
                egos=table.egos,
                opponents=table.variants,
                lines=table.lines,
                seed=seed,
            )
            tables.append(name)
            pairings.append(pairing)
    identity = {"archive": study.archive.content_hash}
    with open_job(study.folder / "races" / "job", "races", identity) as job:
        progress = study.progress("races of the tables")
        races = play_pairings(
            pairings, name="tables", job=job, executor=study.executor, progress=progress
        )
    return [StudyRaces(*own) for own in zip(tables, pairings, races, strict=True)]


def race_for_ratings(study: Study) -> None:
    """Race all pairs of agents, for the ratings."""
    config = study.config
    if not config.rated:
        return
    plan = plan_tournament(
        list(map(load_track, config.table.tracks)),
        {name: study.agent(name) for name in config.rated},
        config.game,
        archive=study.archive,
        races_per_pair=config.rating_races,
        seed=config.seed + RATING_SEED,
    )
    progress = study.progress("races for the ratings")
    with open_job(study.folder / "ratings", "tournament", tournament_settings(plan)) as job:
        played = play_plan(plan, job=job, executor=study.executor, progress=progress)
    write_results(played.races, study.folder / "ratings.csv")
