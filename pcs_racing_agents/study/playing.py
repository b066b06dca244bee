"""Racing stages: the races of the tables, and the round robin of all agents for the ratings."""

from functools import cache
from itertools import product
from typing import NamedTuple

from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament.pairings import Pairing, cross_pairing
from pcs_racing_agents.tournament.play import plan_tournament, play_plan, tournament_settings
from pcs_racing_agents.tournament.race_files import write_results
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.tournament.runner import play_pairings

TABLE_SEED = 0
RATING_SEED = 5_000_000


class StudyRaces(NamedTuple):
    """Races of an agent against one kind of opponent on a track, for one of the study's tables."""

    table: str
    pairing: Pairing
    races: RaceTable


def race_tables(study: Study) -> None:
    """Simulate the races of all tables, in parallel."""
    table_races(study)


def table_races(study: Study) -> list[StudyRaces]:
    """Return the races of all tables; stored races are read."""
    config = study.config
    # All pairings share these objects: play_pairings finds common races by object identity.
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
                    # The seed ignores circuit and arm: all arms of a row drive the same races.
                    seed=config.seed + TABLE_SEED + 100 * number + opponents.index(opponent),
                )
            )
    with open_job(
        study.folder / "races" / "job", "races", {"archive": study.archive.content_hash}
    ) as job:
        progress = study.progress("races of the tables")
        races = play_pairings(
            pairings, name="tables", job=job, executor=study.executor, progress=progress
        )
    return [StudyRaces(*own) for own in zip(tables, pairings, races, strict=True)]


def race_for_ratings(study: Study) -> None:
    """Race all pairs of agents, for the ratings."""
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
        played = play_plan(
            plan, job=job, executor=study.executor, progress=study.progress("races for the ratings")
        )
    write_results(played.races, study.folder / "ratings.csv")
