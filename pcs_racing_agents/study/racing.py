"""The stages with races of the agents and with their exploitability on game trees."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.rules import RaceGame
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.fits import save_fit
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.tasks import Task, run_tasks
from pcs_racing_agents.networks.metrics import Play, TreeScore, score_trees
from pcs_racing_agents.results.csv_files import write_csv
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
    """Simulate the races of all tables, in parallel."""
    for _ in table_races(study):
        pass


def table_races(study: Study) -> Iterator[StudyRaces]:
    """Yield the races of all tables; stored races are read, the others simulated before the first is returned."""
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
        progress = study.progress("races of the tables")
        played = play_pairings(pairings, name="tables", job=job, executor=study.executor, progress=progress)
        for table, pairing, driven in zip(tables, pairings, played, strict=True):
            yield StudyRaces(table, pairing, pairing.table(driven))


def race_rivals(study: Study) -> None:
    """Play the tournament of the rivals, for the ratings."""
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
    """Fit the meta-strategy of PSRO over those rivals that are agents, on training races."""
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
    """Write the exploitability of each agent of the tables on trees that no network was trained on."""
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
    write_csv(rows, study.folder / "exploitability.csv")


@dataclass(frozen=True, eq=False)
class _Judge:
    """A function that evaluates agents on one tree of a circuit; it is sent to other processes with the game.

    Attributes
    ----------
    game : RaceGame
    in_trees : tuple of Agent
        Agents that make only moves of the trees.
    deterministic : tuple of Agent
        Other agents, which make the same move for the same observation with probability 1.
    """

    game: RaceGame
    in_trees: tuple[Agent, ...]
    deterministic: tuple[Agent, ...]

    @classmethod
    def of(cls, game: RaceGame, agents: Sequence[Agent], trees: StoredTrees) -> "_Judge":
        """Sort agents by their moves in some trees."""
        in_trees = tuple(agent for agent in agents if _in_trees(agent, trees))
        others = (agent for agent in agents if agent not in in_trees)
        deterministic = tuple(agent for agent in others if _is_deterministic(agent, trees))
        return cls(replace(game, threads=1), in_trees, deterministic)

    def __call__(self, tree: RaceTree) -> dict[str, tuple[str, ...]]:
        """Return the losses of each agent on a tree."""
        plays = {agent.name: _play(agent) for agent in self.in_trees}
        scores = {name: tuple(f"{x:.6g}" for x in row[0]) for name, row in score_trees(plays, [tree]).items()}
        return scores | {agent.name: self._against_responses(agent, tree) for agent in self.deterministic}

    def _against_responses(self, agent: Agent, tree: RaceTree) -> tuple[str, ...]:
        """Return the losses of an agent that makes the move "stay"; those that need the tree's solution are empty."""
        start = Starts(np.array([tree.start_s]), np.array([tree.side]))
        utilities = [
            best_response_utility(self.game, agent, policies=tree.policies, start=start, seeds=tree.seeds, car=car)
            for car in range(2)
        ]
        # The value of the game cancels in the mean over both roles, since the game is zero-sum.
        lost, random = -0.5 * sum(u.best for u in utilities), 0.5 * sum(u.random for u in utilities)
        values = {"lost_to_best_response": lost, "against_random": random}
        return tuple(f"{values[name]:.6g}" if name in values else "" for name in TreeScore._fields)


def _play(agent: Agent) -> Play:
    """Return the probabilities of the moves in the trees: all but "stay"."""
    return lambda observations: agent.probabilities(observations)[:, :-1]


def _in_trees(agent: Agent, trees: StoredTrees) -> bool:
    """Return whether an agent makes only moves of the trees."""
    play = _play(agent)
    return all(np.allclose(play(observations).sum(axis=1), 1.0) for observations in _observations_in(trees))


def _is_deterministic(agent: Agent, trees: StoredTrees) -> bool:
    """Return whether an agent's moves have probability 1."""
    return all(np.allclose(agent.probabilities(o).max(axis=1), 1.0) for o in _observations_in(trees))


def _observations_in(trees: StoredTrees) -> Iterator[NDArray[np.float32]]:
    """Yield all observations in trees, level by level."""
    for tree in trees:
        for k in range(tree.game_tree().depth):
            observations = tree.observations(k)
            yield observations.reshape(-1, observations.shape[-1])
