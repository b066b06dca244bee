"""The stages in which the agents race, and are judged on trees."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.files import write_atomically
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.fits import save_fit
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.tasks import Task, run_tasks
from pcs_racing_agents.networks.metrics import Play, TreeScore, score_trees
from pcs_racing_agents.results.race_files import write_results
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.study.preparing import play_on_circuits, stored_trees
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament.best_response import best_response_utility
from pcs_racing_agents.tournament.fitting import TrainingRaces, fit_psro
from pcs_racing_agents.tournament.pairings import Pairing, cross_pairing
from pcs_racing_agents.tournament.play import plan_tournament, play_plan, tournament_settings
from pcs_racing_agents.tournament.runner import play_pairings
from pcs_racing_agents.trees.storage import StoredTrees
from pcs_racing_agents.trees.tree import RaceTree

__all__ = ["StudyRaces", "judge_on_trees", "race_rivals", "race_tables", "table_races"]

TABLE_SEED = 0
HELD_OUT_SEED = 4_000_000
RIVAL_SEED = 5_000_000
MIXING_SEED = 6_000_000


class StudyRaces(NamedTuple):
    """Races of an agent against one kind of opponent on a circuit, for one of the study's tables.

    Attributes
    ----------
    table : str
    pairing : Pairing
    races : RaceTable
    """

    table: str
    pairing: Pairing
    races: RaceTable


def race_tables(study: Study) -> None:
    """Drive the races of every table, all of them side by side."""
    for _ in table_races(study):
        pass


def table_races(study: Study) -> Iterator[StudyRaces]:
    """Return the races of all tables; those that were driven are read, the others driven before the first is there."""
    config = study.config
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
                    seed=config.seed + TABLE_SEED + 100 * number + opponents.index(opponent),
                )
            )
    with open_job(study.folder / "races" / "job", "races", {"archive": study.archive.content_hash}) as job:
        told = study.progress("races of the tables")
        played = play_pairings(pairings, name="tables", job=job, executor=study.executor, progress=told)
        for table, pairing, matches in zip(tables, pairings, played, strict=True):
            yield StudyRaces(table, pairing, pairing.table(matches))


def race_rivals(study: Study) -> None:
    """Let the rivals race all against all, for the ratings."""
    if not study.config.rivals:
        return
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
    write_results(played.races, study.folder / "rivals.csv")
    _mix_rivals(study)


def _mix_rivals(study: Study) -> None:
    """Find how often to draw each of the rivals that are agents: the meta-strategy of PSRO, on training races."""
    config = study.config
    members = [agent for agent in map(study.agent, config.rivals) if isinstance(agent, Agent)]
    if len(members) < 2:
        return
    training = TrainingRaces(
        tracks=tuple(study.track(name) for name in config.circuits),
        opponents=(members[0],),
        setting=study.setting,
        races=config.rival_races,
        seed=config.seed + MIXING_SEED,
    )
    with open_job(study.folder / "rivals" / "mixing", "fitting", {"archive": study.archive.content_hash}) as job:
        fit = fit_psro(
            training, members, job=job, executor=study.executor, progress=study.progress("races for the mixture")
        )
    save_fit(fit, study.folder / "rivals" / "psro.yaml")


def judge_on_trees(study: Study) -> None:
    """Write what each agent of the table loses on trees that no network was trained on."""
    config = study.config
    if config.pairs == 0 or not stored_trees(study):
        return
    held_out = play_on_circuits(study, "exploitability", max(2, config.pairs // 4), HELD_OUT_SEED)
    agents = [agent for agent in map(study.agent, config.every_arm) if isinstance(agent, Agent)]
    judges = [_Judge.of(study.tree_game(track), agents, trees) for track, trees in held_out.items()]
    tasks = (
        Task((track, i), judge, tree)
        for (track, trees), judge in zip(held_out.items(), judges, strict=True)
        for i, tree in enumerate(trees)
    )
    lost = dict(run_tasks(tasks, study.executor, "judging"))
    rows: list[tuple[object, ...]] = [("track", "agent", "tree", *TreeScore._fields)]
    for track, trees in held_out.items():
        rows += [(track, name, i, *lost[track, i][name]) for name in lost[track, 0] for i in range(len(trees))]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_atomically(study.folder / "exploitability.csv", lambda file: file.write(text.getvalue().encode()))


@dataclass(frozen=True, eq=False)
class _Judge:
    """What judges agents on a circuit's trees, one at a time; it travels to other processes together with the game.

    Attributes
    ----------
    game : RaceGame
    in_trees : tuple of Agent
        Those whose moves the trees know.
    certain : tuple of Agent
        Others that draw nothing.
    """

    game: RaceGame
    in_trees: tuple[Agent, ...]
    certain: tuple[Agent, ...]

    @classmethod
    def of(cls, game: RaceGame, agents: Sequence[Agent], trees: StoredTrees) -> "_Judge":
        """Look at what agents do in some trees."""
        in_trees = tuple(agent for agent in agents if _in_trees(agent, trees))
        others = (agent for agent in agents if agent not in in_trees)
        return cls(replace(game, threads=1), in_trees, tuple(agent for agent in others if _certain(agent, trees)))

    def __call__(self, tree: RaceTree) -> dict[str, tuple[str, ...]]:
        """Return what each agent loses on a tree."""
        plays = {agent.name: _play(agent) for agent in self.in_trees}
        scores = {name: tuple(f"{x:.6g}" for x in row[0]) for name, row in score_trees(plays, [tree]).items()}
        return scores | {agent.name: self._by_replies(agent, tree) for agent in self.certain}

    def _by_replies(self, agent: Agent, tree: RaceTree) -> tuple[str, ...]:
        """Judge an agent that stays where it is, at the root of a tree; what only the tree could tell is left open."""
        start = Starts(np.array([tree.start_s]), np.array([tree.side]))
        found = [
            best_response_utility(self.game, agent, policies=tree.policies, start=start, seeds=tree.seeds, car=car)
            for car in range(2)
        ]
        # The value of the game is what one role wins and the other loses: it is not in the mean of both.
        lost, random = -0.5 * (found[0].best + found[1].best), 0.5 * (found[0].random + found[1].random)
        values = {"lost_to_best_response": lost, "against_random": random}
        return tuple(f"{values[name]:.6g}" if name in values else "" for name in TreeScore._fields)


def _play(agent: Agent) -> Play:
    """Chances of the moves that the trees know: all but "stay"."""
    return lambda observations: agent.probabilities(observations)[:, :-1]


def _in_trees(agent: Agent, trees: StoredTrees) -> bool:
    """Whether an agent makes only moves that the trees know."""
    play = _play(agent)
    return all(np.allclose(play(seen).sum(axis=1), 1.0) for seen in _seen_in(trees))


def _certain(agent: Agent, trees: StoredTrees) -> bool:
    """Whether an agent draws nothing."""
    return all(np.allclose(agent.probabilities(seen).max(axis=1), 1.0) for seen in _seen_in(trees))


def _seen_in(trees: StoredTrees) -> Iterator[NDArray[np.float32]]:
    """All observations in trees, level by level."""
    for tree in trees:
        for k in range(tree.game_tree().depth):
            seen = tree.observations(k)
            yield seen.reshape(-1, seen.shape[-1])
