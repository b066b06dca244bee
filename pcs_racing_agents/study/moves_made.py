"""Which move the study's agents make in which situation: races driven again to see what they observed."""

from collections.abc import Sequence

import numpy as np

from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.explain.explain import is_blind
from pcs_racing_agents.explain.situations import Situations, summarise, write_situations
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.study.racing import StudyRaces
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament.runner import play_pairings

__all__ = ["moves_in_situations"]

SEED = 7_000_000


def moves_in_situations(study: Study, played: Sequence[StudyRaces], races: int = 1000) -> list[Situations]:
    """Sum up the moves of every agent of the main table that looks at the race; write each as CSV.

    Parameters
    ----------
    study : Study
    played : sequence of StudyRaces
    races : int
        Of each pairing, at most; drawn by the study's seed, the same ones for all agents.
    """
    pairings = []
    for found in played:
        ego = found.pairing.ego
        if found.table == "main" and isinstance(ego, Agent) and not is_blind(ego):
            rng = np.random.default_rng(np.random.SeedSequence(study.config.seed, spawn_key=(SEED,)))
            pairings.append(found.pairing.take(np.sort(rng.permutation(len(found.pairing))[:races])))
    if not pairings:
        return []
    folder = study.folder / "report" / "situations"
    with open_job(folder, "situations", {"archive": study.archive.content_hash, "races": races}) as job:
        told = study.progress("races (moves in situations)")
        again = play_pairings(
            pairings, name="moves", observations=True, job=job, executor=study.executor, progress=told
        )
        observed = [(pairing.names[0], m.seen[:, 0], m.moves[:, 0]) for pairing, m in zip(pairings, again, strict=True)]
    summaries = []
    for name in dict.fromkeys(name for name, *_ in observed):
        seen, moves = (np.concatenate([own[k] for own in observed if own[0] == name]) for k in (1, 2))
        if (moves >= 0).any():
            summaries.append(summarise(seen, moves, study.archive, study.setting.moves, name))
            write_situations(summaries[-1], study.folder / "report" / f"situations-{name}.csv")
    return summaries
