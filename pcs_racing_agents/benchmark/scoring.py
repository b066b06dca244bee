"""Races of an agent by a protocol: scores, crashes, adaptivity gain, decision cost."""

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import PolicySet, Turn, competitor_name
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Competitor, as_agent
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.base.statistics import clustered_mean, compare, varied
from pcs_racing_agents.benchmark.card import CardScore, Gain
from pcs_racing_agents.benchmark.protocol import KINDS, Cell, Protocol, ProtocolConfig
from pcs_racing_agents.tournament.games import variant_count
from pcs_racing_agents.tournament.pairings import Pairing, cross_pairing
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.tournament.runner import play_pairings

Floats = NDArray[np.float64]


class CellRaces(NamedTuple):
    """The races of an agent against one opponent on one track."""

    cell: Cell
    pairing: Pairing
    races: RaceTable


def play_protocol(
    protocol: Protocol,
    agents: Sequence[Competitor],
    **run: Unpack[Run],
) -> dict[str, list[CellRaces]]:
    """Simulate the same races for all agents and for the protocol's baselines.

    A cell has the same number of races for every agent and opponent: a planner with fewer policies
    than the protocol asks for races from more start lines.

    Parameters
    ----------
    agents : sequence of Competitor
        Agents with different names.

    Returns
    -------
    dict of str to list of CellRaces
        Races by name: the agents first, then the baselines.
    """
    arms = {competitor_name(agent): as_agent(agent) for agent in agents}
    if len(arms) < len(agents):
        raise InputError(
            "two of the agents have the same name; they are"
            f" {', '.join(map(competitor_name, agents))}"
        )
    arms |= {name: protocol.opponents[name] for name in protocol.config.blind if name not in arms}
    cells = [(name, cell) for name in arms for cell in protocol.cells]
    games = {name: protocol.game(name) for name in protocol.tracks}
    pairings = [
        _pairing(
            protocol.config, games[cell.circuit], arms[name], protocol.opponents[cell.opponent]
        )
        for name, cell in cells
    ]
    played = play_pairings(pairings, name="benchmark", **run)
    results: dict[str, list[CellRaces]] = {name: [] for name in arms}
    for (name, cell), pairing, races in zip(cells, pairings, played, strict=True):
        results[name].append(CellRaces(cell, pairing, races))
    return results


def _pairing(
    config: ProtocolConfig, game: RaceGame, agent: Competitor, opponent: Competitor
) -> Pairing:
    """Return the races of an agent against an opponent on one track."""
    lines = max(1, config.egos // variant_count(game, agent)) * max(
        1, config.variants // variant_count(game, opponent)
    )
    return cross_pairing(
        game,
        agent,
        opponent,
        egos=config.egos,
        opponents=config.variants,
        lines=lines,
        seed=config.seed,
    )


class _Columns(NamedTuple):
    """Races of several cells, one entry per race."""

    score: Floats
    ego: NDArray[Any]  #: Start policy of the agent.
    opponent: NDArray[Any]  #: Opponent and its variant.
    crashed: NDArray[np.bool_]
    own_fault: NDArray[np.bool_]


def _columns(cells: Iterable[CellRaces]) -> _Columns:
    parts = [
        (
            races.score,
            races.variants[:, 0],
            np.char.add(f"{cell.opponent} ", races.variants[:, 1].astype(str)),
            races.crashed,
            races.fault[:, 0] > 0,
        )
        for cell, _, races in cells
    ]
    return _Columns(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _on(cells: Iterable[CellRaces], circuits: str) -> list[CellRaces]:
    """Return the cells on "train", "test" or "all" circuits."""
    return [one for one in cells if circuits == "all" or one.cell.train == (circuits == "train")]


def summarise(races: Iterable[CellRaces]) -> list[CardScore]:
    """Return the scores of an agent: in total, by kind of opponent, and by cell."""
    cells = list(races)
    scores = []
    for circuits in ("train", "test", "all"):
        for part in ("all", *KINDS):
            chosen = [one for one in _on(cells, circuits) if part in ("all", one.cell.kind)]
            if chosen:
                scores.append(_score(part, circuits, chosen))
    return scores + [_score(one.cell.opponent, one.cell.circuit, [one]) for one in cells]


def _score(part: str, circuits: str, cells: list[CellRaces]) -> CardScore:
    races = _columns(cells)
    # One policy against one policy: races differ only in their start lines.
    estimate = clustered_mean(races.score, *varied(races.ego, races.opponent))
    values = (
        estimate.mean,
        max(estimate.low, 0.0),
        min(estimate.high, 1.0),
        float((races.crashed & races.own_fault).mean()),
        float((races.crashed & ~races.own_fault).mean()),
    )
    return CardScore(part, circuits, len(races.score), *(round(value, 6) for value in values))


def gain(results: Mapping[str, list[CellRaces]], agent: str, circuits: str = "all") -> Gain | None:
    """Return the agent's score minus the best baseline's score, on the same races.

    The best baseline is chosen after the fact, on these races, which can only reduce the gain. None
    for a planner with other start lines than the agents (:func:`play_protocol`): no common races.

    Parameters
    ----------
    results : mapping
        Results of :func:`play_protocol`.
    circuits : {"all", "train", "test"}
        Tracks of the races.
    """
    cells = {name: _on(races, circuits) for name, races in results.items()}
    columns = {name: _columns(races) for name, races in cells.items()}
    # The agent's own result is excluded, even if the agent is a baseline.
    best = max(results, key=lambda name: columns[name].score.mean() if name != agent else -1.0)
    for own, other in zip(cells[agent], cells[best], strict=True):
        if not np.array_equal(own.races.start_s, other.races.start_s):
            return None
    races = columns[agent]
    found = compare(races.score, columns[best].score, races.ego, races.opponent)
    return Gain(best, found.difference, max(found.low, -1.0), min(found.high, 1.0))


def decision_cost(protocol: Protocol, agent: Competitor, repeats: int = 200) -> float | None:
    """Return an agent's median time per decision for one game, us; None for a planner."""
    if isinstance(agent, PolicySet):
        return None
    game = protocol.game(next(iter(protocol.tracks)))
    state = game.reset(games=1, seed=protocol.config.seed)
    observations = game.observation(state)[:, 0]
    turn = Turn(game, state, np.zeros(1, np.int64), 0, [None], (), True)
    # The median: other load on the machine only lengthens some of the times.
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        agent.act(observations, turn)
        times.append(time.perf_counter() - begun)
    return 1e6 * float(np.median(times))
