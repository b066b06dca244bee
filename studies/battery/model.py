"""A model of one step of a race, and replies to opponents in it.

The model counts, in races with random moves on training starts, where a gap goes in one step under
both cars' moves. Its states are the step, the gap and both cars' units left; a reply is found by
dynamic programming. Tables of moves have shape (steps, moves, GAPS, full + 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcs_racing.base.seeds import race_seeds
from pcs_racing.race.config import CONTEST
from pcs_racing.race.races import starts_of
from pcs_racing.track.track import Track
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games
from studies.battery.rules import (
    BOOST,
    CHARGE,
    GAPS,
    HOLD,
    MIDDLES,
    Floats,
    Indices,
    Rules,
    gap_bins,
    race,
)

LOST, WON = GAPS, GAPS + 1
"""Bins of a race that a crash has ended."""
PHASES = 3  # the first and the second step differ from the later ones
PRIOR = 0.02  # weight of the other phases' counts
FLOOR = 1e-4  # weight of states that no race of the model visits
SWEEPS = 5
ENDS = np.concatenate([MIDDLES > 0.0, [0.0, 1.0]]).astype(np.float64)
GRID = gap_bins(np.array([CONTEST.start_gap, -CONTEST.start_gap]))

Opponent = tuple[int, Floats]
"""Units at the start, and table of moves."""


@dataclass(frozen=True, eq=False)
class Model:
    """Probabilities of the gap after a step."""

    rules: Rules
    #: shape (PHASES, GAPS, moves, moves, GAPS + 2): by gap, own move and the opponent's.
    chances: Floats

    def expected(self, step: int, own: int, other: int, values: Floats) -> Floats:
        """Return the expected values after both moves, (moves, moves, GAPS, own + 1, other + 1).

        ``values``, shape (GAPS + 2, own + 1, other + 1), are those after the step. Boosts that do
        not work count as holding.
        """
        rules, chances = self.rules, self.chances[min(step, PHASES - 1)]
        found = np.empty((rules.moves, rules.moves, GAPS, own + 1, other + 1))
        for a, left in enumerate(rules.after(own)):
            for b, others in enumerate(rules.after(other)):
                later = values[:, left][:, :, others]
                found[a, b] = np.tensordot(chances[:, a, b], later, 1)
        found[BOOST] = np.where(rules.works(own)[..., None], found[BOOST], found[HOLD])
        works = rules.works(other)[:, None]
        found[:, BOOST] = np.where(works, found[:, BOOST], found[:, HOLD])
        return found

    def against(self, step: int, own: int, opponent: Opponent, values: Floats) -> Floats:
        """Return the expected values of own moves, shape (moves, GAPS, own + 1, other + 1)."""
        other, table = opponent
        facing = table[step, :, ::-1, None]
        return np.asarray((facing * self.expected(step, own, other, values)).sum(axis=1))


def fit_model(
    track: Track, planner: str, rules: Rules, lines: int, repeats: int, seed: int
) -> Model:
    """Count steps of races with random moves, from both sides of training start lines."""
    count = 2 * lines * repeats
    rng = np.random.default_rng(seed)
    starts = starts_of(track, CONTEST, np.arange(count) % (2 * lines), seed, split="train")
    boosts, charges = rng.uniform(size=(2, count, 2))
    charges = 0.5 * charges * (rules.moves > CHARGE)

    def choose(step: int, leads: Floats, over: object) -> Indices:
        first, second = rng.uniform(size=(2, count, 2))
        return np.where(first < charges, CHARGE, np.where(second < boosts, BOOST, HOLD))

    raced = race(track, planner, rules, starts, race_seeds(seed, count), choose)
    counts = np.zeros((PHASES, GAPS, rules.moves, rules.moves, GAPS + 2))
    for step, moves in enumerate(raced.moves):
        going, ended = raced.last >= step, raced.last == step
        for car, sign in enumerate((1.0, -1.0)):
            before, after = (gap_bins(sign * raced.leads[step + k]) for k in (0, 1))
            won = (raced.score > 0.5) == (car == 0)
            after = np.where(ended, np.where(won, WON, LOST), after)
            cell = (before, moves[:, car], moves[:, 1 - car], after)
            np.add.at(counts[min(step, PHASES - 1)], tuple(one[going] for one in cell), 1.0)
    counts += PRIOR * counts.sum(axis=0) + 1e-6 * np.eye(GAPS, GAPS + 2)[:, None, None]
    return Model(rules, counts / counts.sum(axis=-1, keepdims=True))


def ending(values: Floats) -> Floats:
    """Return the values of the bins of a running race, and of an ended race below them."""
    ends = np.broadcast_to(ENDS[GAPS:, None, None], (2, *values.shape[1:]))
    return np.concatenate([values, ends])


def final_values(own: int, other: int) -> Floats:
    """Return the values at the end of a race, shape (GAPS + 2, own + 1, other + 1)."""
    return np.broadcast_to(ENDS[:, None, None], (GAPS + 2, own + 1, other + 1))


def reply_values(model: Model, own: int, opponent: Opponent) -> Floats:
    """Return the value of each move against a known opponent, with best moves afterwards.

    The shape is (steps, moves, GAPS, own + 1, other + 1).
    """
    values, found = final_values(own, opponent[0]), []
    for step in reversed(range(model.rules.steps)):
        found.append(model.against(step, own, opponent, values))
        values = ending(found[-1].max(axis=0))
    return np.array(found[::-1])


def visits(model: Model, own: int, table: Floats, opponent: Opponent) -> Floats:
    """Return the probability of each state before each step, and after the last one.

    The shape is (steps + 1, GAPS + 2, own + 1, other + 1).
    """
    rules, (other, against) = model.rules, opponent
    found = np.zeros((rules.steps + 1, GAPS + 2, own + 1, other + 1))
    found[0, GRID, own, other] = 0.5
    for step in range(rules.steps):
        chances = model.chances[min(step, PHASES - 1)]
        found[step + 1, GAPS:] = found[step, GAPS:]
        for a, left in enumerate(rules.after(own)):
            for b, others in enumerate(rules.after(other)):
                share = table[step, a, :, :, None] * against[step, b, ::-1, None]
                gone = np.tensordot(chances[:, a, b].T, share * found[step, :GAPS], 1)
                cells: Any = (slice(None), left[:, None], others)
                np.add.at(found[step + 1], cells, gone)
    return found


def start_score(values: Floats) -> float:
    """Return the score expected on the grid, from the values of moves in the first step."""
    return float(values[0].max(axis=0)[GRID, -1, -1].mean())


def model_score(model: Model, own: int, table: Floats, opponent: Opponent) -> float:
    """Return the expected score of a table of moves."""
    return float((visits(model, own, table, opponent)[-1].sum(axis=(1, 2)) * ENDS).sum())


def effective(rules: Rules, table: Floats) -> Floats:
    """Return a table of moves with holding in place of boosts that do not work."""
    works = rules.works(table.shape[-1] - 1)
    found = table.copy()
    found[:, HOLD] += np.where(works, 0.0, table[:, BOOST])
    found[:, BOOST] = np.where(works, table[:, BOOST], 0.0)
    return found


def fixed_reply(
    model: Model, own: int, opponents: Sequence[Opponent], plans: Sequence[Floats], gap: bool
) -> Floats:
    """Return the best table of moves against unknown opponents, all equally probable.

    Moves depend on the step, the units left and, with ``gap``, the gap. From the best of some plans
    on, each sweep improves the moves of one step after the other, from the last one backwards.
    """
    rules = model.rules
    scores = [sum(model_score(model, own, plan, one) for one in opponents) for plan in plans]
    table = plans[int(np.argmax(scores))]
    moves = np.arange(rules.moves)[:, None, None]
    for _ in range(SWEEPS):
        weights = [visits(model, own, table, one)[:-1, :GAPS] + FLOOR for one in opponents]
        values = [final_values(own, other) for other, _ in opponents]
        better = np.empty_like(table)
        for step in reversed(range(rules.steps)):
            worth = [
                model.against(step, own, one, after)
                for one, after in zip(opponents, values, strict=True)
            ]
            total = sum(
                (weight[step] * one).sum(axis=3) for weight, one in zip(weights, worth, strict=True)
            )
            if not gap:
                total = np.broadcast_to(total.sum(axis=1, keepdims=True), total.shape)
            better[step] = total.argmax(axis=0) == moves
            values = [ending((better[step][..., None] * one).sum(axis=0)) for one in worth]
        table = effective(rules, better)
    return table


def public_equilibrium(model: Model) -> Floats:
    """Return the moves in equilibrium where energy is public and both cars have the same left.

    The shape is that of a table of the type with the max energy.
    """
    rules, full = model.rules, max(model.rules.full)
    values, found = final_values(full, full), []
    for step in reversed(range(rules.steps)):
        games = np.moveaxis(model.expected(step, full, full, values), (0, 1), (3, 4))
        solved = solve_matrix_games(games.reshape(-1, rules.moves, rules.moves))
        values = ending(solved.values.reshape(games.shape[:3]))
        rows = solved.rows.reshape(*games.shape[:4])
        found.append(np.moveaxis(rows.diagonal(axis1=1, axis2=2), 1, 0))
    return np.array(found[::-1])
