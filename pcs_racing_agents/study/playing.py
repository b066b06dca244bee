"""The stages that play: agents that learn by playing, best replies, and the races of all agents."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.base.jobs import Job, open_job
from pcs_racing_agents.learning.responses.best_reply import BestReply, best_reply, write_replies
from pcs_racing_agents.learning.responses.learner import load_response_settings
from pcs_racing_agents.learning.robust import learn_psro, learn_robust, load_psro_settings, load_robust_settings
from pcs_racing_agents.learning.self_play import RaceSampler, learn_self_play, load_self_play_settings
from pcs_racing_agents.networks import NetworkSet, save_network, save_network_set
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament.pairings import Pairing, cross_pairing
from pcs_racing_agents.tournament.play import plan_tournament, play_plan, tournament_settings
from pcs_racing_agents.tournament.race_files import write_results
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.tournament.runner import play_pairings

PLAYING_SEED = 4_000
REPLY_SEED = 7_000_000
"""Added to the study's seed: other games than those of responses and tables."""


def learn_robust_agent(study: Study) -> None:
    """Learn the agent "robust"; nothing to do without settings for it."""
    if study.config.robust is not None:
        _learn_from_pool(study, "robust", load_robust_settings(study.config.robust), learn_robust)


def learn_psro_agent(study: Study) -> None:
    """Learn the agent "psro"; nothing to do without settings for it."""
    if study.config.psro is not None:
        _learn_from_pool(study, "psro", load_psro_settings(study.config.psro), learn_psro)


def _learn_from_pool(study: Study, name: str, settings: Any, learn_agent: Callable[..., NetworkSet]) -> None:
    """Learn an agent that begins with the study's pool of opponents."""
    seeded = replace(settings, seed=settings.seed + study.config.seed + PLAYING_SEED)
    pool = [study.agent(opponent) for opponent in study.config.response_pool]

    def learn(job: Job, **told: Any) -> NetworkSet:
        return learn_agent(study.games(), pool, study.setting, seeded, job, **told)

    _learn(study, name, name, plain_settings(seeded), learn)


def play_against_itself(study: Study) -> None:
    """Learn the agent "self-play" and the regrets of "cfr-argmax" from sampled games, as far as there are settings."""
    for name, source in (("self-play", study.config.self_play), ("sampled-cfr", study.config.sampled_cfr)):
        if source is None:
            continue
        settings = load_self_play_settings(source)
        seeded = replace(settings, seed=settings.seed + study.config.seed + PLAYING_SEED)
        samplers = [RaceSampler(game, study.setting, seeded.worth) for game in study.games()]

        def learn(job: Job, **told: Any) -> NetworkSet:
            return learn_self_play(samplers, seeded, job, **told)  # noqa: B023 - called at once

        learned = _learn(study, "self-play", name, plain_settings(seeded), learn)
        if name == "sampled-cfr":
            # The last network predicts mean regrets over all iterations; the paper plays the move of the highest.
            regrets = replace(
                learned.networks[-1], name="regret", target="regret", training={**learned.training, "sampled": True}
            )
            save_network(regrets, study.network("regret"))


def measure_replies(study: Study) -> None:
    """Learn a best reply to each agent that the configuration names, and write what the agents lose."""
    config = study.config
    if not config.replies:
        return
    # Added to the seed of the settings, so that studies with other seeds and settings with other seeds both differ.
    settings = load_response_settings(config.reply)
    settings = load_response_settings(settings, seed=config.seed + REPLY_SEED + settings.seed)
    replies: dict[str, BestReply] = {}
    for name in config.replies:
        agent = study.agent(name)
        identity = {"agent": competitor_hash(agent), "races": config.reply_races, **plain_settings(settings)}
        with open_job(study.folder / "best-replies" / name, "best reply", identity) as job:
            replies[name] = best_reply(
                study.games(),
                agent,
                study.setting,
                settings,
                job,
                races=config.reply_races,
                executor=study.executor,
                progress=study.progress(f"tasks (best reply to {name})"),
            )
    write_replies(replies, study.folder / "best_replies.csv")


def _learn(
    study: Study, stage: str, name: str, settings: dict[str, Any], learn: Callable[..., NetworkSet]
) -> NetworkSet:
    """Learn a set of networks in a job of its own, in the folder of a stage, and write it to the study's networks."""
    identity = {"archive": study.archive.content_hash, **settings}
    with open_job(study.folder / stage / name, name, identity) as job:
        learned = learn(job, name=name, executor=study.executor, progress=study.progress(f"tasks ({name})"))
    save_network_set(learned, study.network(name))
    return learned


TABLE_SEED = 0
RATING_SEED = 5_000_000


class StudyRaces(NamedTuple):
    """Races of an agent against one kind of opponent on a circuit, for one of the study's tables."""

    table: str
    pairing: Pairing
    races: RaceTable


def race_tables(study: Study) -> None:
    """Simulate the races of all tables, in parallel."""
    table_races(study)


def table_races(study: Study) -> list[StudyRaces]:
    """Return the races of all tables; those that are stored are read."""
    config = study.config
    # The same objects for all pairings: by them it is seen which races agents have in common (play_pairings).
    games, agents = cache(study.game), cache(study.agent)
    tables, pairings = [], []
    for number, (table, (tracks, opponents, arms, lines)) in enumerate(config.tables.items()):
        for track, opponent, arm in product(tracks, opponents, arms):
            tables.append(table)
            pairings.append(
                cross_pairing(
                    games(track),
                    agents(arm),
                    agents(opponent),
                    egos=config.egos,
                    opponents=config.variants,
                    lines=lines,
                    # By opponent and table, but not by circuit and arm: all arms of a row drive the same races.
                    seed=config.seed + TABLE_SEED + 100 * number + opponents.index(opponent),
                )
            )
    with open_job(study.folder / "races" / "job", "races", {"archive": study.archive.content_hash}) as job:
        progress = study.progress("races of the tables")
        races = play_pairings(pairings, name="tables", job=job, executor=study.executor, progress=progress)
    return [StudyRaces(*own) for own in zip(tables, pairings, races, strict=True)]


def race_for_ratings(study: Study) -> None:
    """Play all agents against all others, for the ratings."""
    if not study.config.rated:
        return
    config = study.config
    plan = plan_tournament(
        [study.track(name) for name in config.tracks],
        {name: study.agent(name) for name in config.rated},
        study.config.game,
        archive=study.archive,
        races_per_pair=config.rating_races,
        seed=config.seed + RATING_SEED,
    )
    with open_job(study.folder / "ratings", "tournament", tournament_settings(plan)) as job:
        played = play_plan(plan, job=job, executor=study.executor, progress=study.progress("races for the ratings"))
    write_results(played.races, study.folder / "ratings.csv")
