"""The stages in which the agents race, and are judged on trees."""

import csv
import io
from collections.abc import Iterator

import numpy as np

from pcs_racing.files import write_atomically
from pcs_racing_agents.approximator.metrics import Play, TreeScore, score_trees
from pcs_racing_agents.jobs import open_job
from pcs_racing_agents.strategies.agent import Agent
from pcs_racing_agents.study.preparing import stored_trees
from pcs_racing_agents.study.run import Study
from pcs_racing_agents.tournament.cells import Cell, play_cell
from pcs_racing_agents.trees.storage import StoredTrees, build_trees

__all__ = ["cells", "judge_on_trees", "race_cells", "race_rivals"]

CELL_SEED = 0
HELD_OUT_SEED = 4_000_000
RIVAL_SEED = 5_000_000


def race_cells(study: Study) -> None:
    """Drive the races of every cell of the table."""
    for _ in cells(study):
        pass


def cells(study: Study) -> Iterator[tuple[str, str, str, Cell]]:
    """Return every cell as (circuit, opponent, arm, cell); races that were driven are read, the others driven."""
    config = study.config
    folder = study.folder / "races"
    with open_job(folder, "races", {"archive": study.archive.content_hash}) as job:
        for track in config.tracks:
            game = study.game(track)
            for number, opponent in enumerate(config.opponents):
                rival = study.agent(opponent)
                for arm in config.arms:
                    cell = play_cell(
                        game,
                        study.agent(arm),
                        rival,
                        egos=config.egos,
                        opponents=config.variants,
                        lines=config.lines,
                        seed=config.seed + CELL_SEED + number,
                        job=job,
                        executor=study.executor,
                        progress=study.progress(f"races: {arm} against {opponent} on {track}"),
                    )
                    yield track, opponent, arm, cell


def race_rivals(study: Study) -> None:
    """Let the rivals race all against all, for the ratings."""
    if not study.config.rivals:
        return
    from pcs_racing_agents.tournament.play import plan_tournament, play_plan, tournament_settings
    from pcs_racing_agents.tournament.table import write_results

    config = study.config
    plan = plan_tournament(
        [study.track(name) for name in config.tracks],
        {name: study.agent(name) for name in config.rivals},
        study.config.game,
        archive=study.archive,
        races_per_pair=config.rival_races,
        seed=config.seed + RIVAL_SEED,
    )
    with open_job(study.folder / "rivals", "tournament", tournament_settings(plan)) as job:
        played = play_plan(plan, job=job, executor=study.executor, progress=study.progress("races of rivals"))
    write_results(played, study.folder / "rivals.csv")


def judge_on_trees(study: Study) -> None:
    """Write what each agent of the table loses on trees that no network was trained on."""
    config = study.config
    if config.pairs == 0 or not stored_trees(study):
        return
    agents = [agent for agent in map(study.agent, config.arms) if isinstance(agent, Agent)]
    rows: list[tuple[object, ...]] = [("track", "agent", "tree", *TreeScore._fields)]
    for number, track in enumerate(config.circuits):
        trees = build_trees(
            study.game(track),
            study.folder / "exploitability" / track,
            pairs=max(2, config.pairs // 4),
            seeds_per_pair=config.seeds,
            seed=config.seed + HELD_OUT_SEED + number,
            executor=study.executor,
            progress=study.progress(f"trees on {track}"),
        )
        judged = [agent for agent in agents if _in_trees(agent, trees)]
        plays = {agent.name: _play(agent) for agent in judged}
        for name, scores in score_trees(plays, (trees[i] for i in range(len(trees)))).items():
            rows += [(track, name, i, *(f"{value:.6g}" for value in score)) for i, score in enumerate(scores)]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_atomically(study.folder / "exploitability.csv", lambda file: file.write(text.getvalue().encode()))


def _play(agent: Agent) -> Play:
    """Chances of the moves that the trees know: those that the rules offer."""
    offered = agent.setting.offered
    return lambda observations: agent.probabilities(observations)[:, :offered]


def _in_trees(agent: Agent, trees: StoredTrees) -> bool:
    """Whether an agent makes only moves that the rules offer; blind ones may stay where the rules do not."""
    play = _play(agent)
    for tree in trees:
        for k in range(tree.game_tree().depth):
            seen = tree.observations(k)
            if not np.allclose(play(seen.reshape(-1, seen.shape[-1])).sum(axis=1), 1.0):
                return False
    return True
