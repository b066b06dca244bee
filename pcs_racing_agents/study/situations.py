"""Statistics of the moves of a study's agents by situation, from races that are repeated for their observations."""

from collections.abc import Sequence

import numpy as np

from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.explain.explain import is_blind
from pcs_racing_agents.explain.situations import Situations, summarise, write_situations
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.study.racing import StudyRaces
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament.runner import play_pairings

SEED = 7_000_000


def moves_in_situations(study: Study, study_races: Sequence[StudyRaces], races: int = 1000) -> list[Situations]:
    """Count the moves of every agent of the main table that uses its observations; write each as CSV.

    Parameters
    ----------
    races : int
        Maximum number of each pairing; drawn by the study's seed, the same ones for all agents.
    """
    pairings = []
    for table, pairing, _ in study_races:
        if table == "main" and isinstance(pairing.ego, Agent) and not is_blind(pairing.ego):
            rng = np.random.default_rng(np.random.SeedSequence(study.config.seed, spawn_key=(SEED,)))
            pairings.append(pairing.take(np.sort(rng.permutation(len(pairing))[:races])))
    if not pairings:
        return []
    folder = study.folder / "report" / "situations"
    with open_job(folder, "situations", {"archive": study.archive.content_hash, "races": races}) as job:
        progress = study.progress("races (moves in situations)")
        repeated = play_pairings(
            pairings, name="moves", observations=True, job=job, executor=study.executor, progress=progress
        )
        observed = [
            (pairing.names[0], games.observations[:, 0], games.moves[:, 0])
            for pairing, games in zip(pairings, repeated, strict=True)
        ]
    summaries = []
    for name in dict.fromkeys(name for name, *_ in observed):
        observations, moves = (np.concatenate([own[k] for own in observed if own[0] == name]) for k in (1, 2))
        if (moves >= 0).any():
            summaries.append(summarise(observations, moves, study.archive, study.setting.moves, name))
            write_situations(summaries[-1], study.folder / "report" / f"situations-{name}.csv")
    return summaries
