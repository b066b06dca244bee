"""Races of an agent by a protocol: scores, crashes, adaptivity gain, rating, decision cost."""

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import PolicySet, Turn, competitor_name
from pcs_racing.race.replay import Replay
from pcs_racing_agents.agents.agent import Competitor, as_agent
from pcs_racing_agents.agents.describe import measurements
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.benchmark.card_values import CardScore, Gain
from pcs_racing_agents.benchmark.protocol import KINDS, Cell, Protocol
from pcs_racing_agents.tournament.games import variant_count
from pcs_racing_agents.tournament.pairings import Pairing, cross_pairing
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.tournament.runner import play_pairings, record_game
from pcs_racing_agents.tournament.statistics import clustered_mean, compare

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

    A planner with fewer policies than the protocol's start policies drives the same number of
    races, from more start lines.

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
    config = protocol.config
    # A planner has few policies or one, and gets more lines instead: as many races as the agents.
    pairings = [
        cross_pairing(
            games[cell.circuit],
            arms[name],
            protocol.opponents[cell.opponent],
            egos=config.egos,
            opponents=config.variants,
            lines=max(1, config.egos // variant_count(games[cell.circuit], arms[name])),
            seed=config.seed,
        )
        for name, cell in cells
    ]
    played = play_pairings(pairings, name="benchmark", **run)
    results: dict[str, list[CellRaces]] = {name: [] for name in arms}
    for (name, cell), pairing, races in zip(cells, pairings, played, strict=True):
        results[name].append(CellRaces(cell, pairing, races))
    return results


def summarise(races: Iterable[CellRaces]) -> list[CardScore]:
    """Return the scores of an agent: in total, by kind of opponent, and by cell."""
    cells = list(races)
    scores = []
    for circuits, wanted in (("seen", (True,)), ("unseen", (False,)), ("all", (True, False))):
        for part in ("all", *KINDS):
            chosen = [
                played
                for played in cells
                if played.cell.seen in wanted and part in ("all", played.cell.kind)
            ]
            if chosen:
                scores.append(_score(part, circuits, chosen))
    return scores + [
        _score(played.cell.opponent, played.cell.circuit, [played]) for played in cells
    ]


def _columns(cells: list[CellRaces]) -> tuple[Floats, NDArray[Any], NDArray[Any]]:
    """Return scores and labels of start policies and opponents' variants, one entry per race."""
    scores = np.concatenate([played.races.score for played in cells])
    egos = np.concatenate([played.races.variants[:, 0] for played in cells])
    opponents = np.concatenate(
        [
            np.char.add(f"{played.cell.opponent} ", played.races.variants[:, 1].astype(str))
            for played in cells
        ]
    )
    return scores, egos, opponents


def _score(part: str, circuits: str, cells: list[CellRaces]) -> CardScore:
    scores, egos, opponents = _columns(cells)
    # Labels without variation have no measurable spread, and are taken as given.
    clusters = [labels for labels in (egos, opponents) if len(np.unique(labels)) > 1]
    # One policy against one policy: races differ only in their start lines.
    estimate = clustered_mean(scores, *(clusters or [np.arange(len(scores))]))
    own = np.concatenate([played.races.fault[:, 0] > 0 for played in cells])
    crashed = np.concatenate([played.races.crashed for played in cells])
    return CardScore(
        part,
        circuits,
        len(scores),
        estimate.mean,
        max(estimate.low, 0.0),
        min(estimate.high, 1.0),
        float((crashed & own).mean()),
        float((crashed & ~own).mean()),
    )


def gain(
    results: Mapping[str, list[CellRaces]], agent: str, seen: bool | None = None
) -> Gain | None:
    """Return the agent's score minus the best baseline's score, on the same races.

    The best baseline is chosen after the fact, on these races, which can only reduce the gain. None
    for a planner with other start lines than the agents (:func:`play_protocol`): no common races.

    Parameters
    ----------
    results : mapping
        Results of :func:`play_protocol`.
    seen : bool, optional
        True for training tracks only, False for test tracks only (default: all).
    """

    def rows(name: str) -> list[CellRaces]:
        return [played for played in results[name] if seen is None or played.cell.seen == seen]

    # The agent's own result is excluded, even if the agent is a baseline.
    blind = {name: float(_columns(rows(name))[0].mean()) for name in results if name != agent}
    best = max(blind, key=lambda name: blind[name])
    for own, other in zip(rows(agent), rows(best), strict=True):
        if not np.array_equal(own.races.start_s, other.races.start_s):
            return None
    scores, egos, opponents = _columns(rows(agent))
    difference = compare(scores, _columns(rows(best))[0], egos, opponents)
    return Gain(best, difference.difference, max(difference.low, -1.0), min(difference.high, 1.0))


def rating(protocol: Protocol, races: Iterable[CellRaces]) -> float | None:
    """Return the Bradley-Terry rating that explains an agent's score against rated opponents.

    None if no opponent has a measured rating (:mod:`pcs_racing_agents.agents.describe`), or if the
    agent won or lost all races against rated opponents.
    """
    from scipy.optimize import brentq  # the import takes a second

    table = measurements()
    archive, race = protocol.spec.archive.name, protocol.spec.race
    pairs = [
        (table[archive, race, played.cell.opponent].rating, float(played.races.score.mean()))
        for played in races
        if (archive, race, played.cell.opponent) in table
    ]
    known = [(strength, score) for strength, score in pairs if np.isfinite(strength)]
    if not known:
        return None
    strengths, scores = np.array(known).T

    def excess(own: float) -> float:
        return float((1.0 / (1.0 + 10.0 ** ((strengths - own) / 400.0)) - scores).mean())

    # An agent that won (or lost) every race has no finite rating.
    return (
        float(brentq(excess, -4000.0, 4000.0)) if excess(-4000.0) < 0.0 < excess(4000.0) else None
    )


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


def telling_races(
    own: Sequence[CellRaces], others: Sequence[CellRaces], count: int
) -> list[tuple[str, Replay]]:
    """Return titled recordings of the races with the max score difference between two agents.

    ``own``, ``others``: the same cells in the same order, raced by the agent and by the other
    agent. ``count``: number of races; each cell offers one race.
    """
    telling: list[tuple[float, CellRaces, int]] = []
    for cell, other in zip(own, others, strict=True):
        # Alternately a race won by the agent and lost by the other agent, and the reverse.
        difference = (cell.races.score - other.races.score) * (
            1.0 if len(telling) % 2 == 0 else -1.0
        )
        race = int(np.argmax(difference))
        telling.append((float(difference[race]), cell, race))
    telling.sort(key=lambda entry: -entry[0])
    races = []
    for _, cell, race in telling[:count]:
        pairing = cell.pairing
        recording = record_game(
            pairing.game,
            pairing.ego,
            pairing.opponent,
            **pairing.race_arguments(race),
            candidates=False,
        )
        races.append(
            (f"{cell.cell.circuit}, race {race}: {recording.replay.outcome}", recording.replay)
        )
    return races
