"""Matches of three races under the rules of the battery, on fresh starts.

Four arms meet every opponent of a population (a type of energy and a way of spending) with every
own type. "blind" and "gap" follow the best table of moves; "gap" sees the gap. "shown" and "told"
also see the opponent's moves: they keep a belief about who the opponent is, by Bayes' rule over all
steps and races of the match, and take the move with the max expected value. "told" knows the type.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.seeds import race_seeds
from pcs_racing.race.config import CONTEST
from pcs_racing.race.races import starts_of
from pcs_racing.track.track import Track
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games
from studies.battery.model import (
    Model,
    fit_model,
    fixed_reply,
    model_score,
    reply_values,
    start_score,
)
from studies.battery.rules import Choose, Floats, Indices, Rules, gap_bins, race
from studies.battery.spenders import SLIP, population

ARMS = ("blind", "gap", "shown", "told")
RACES = 3
USED = 0.01  # min probability of a plan in the support of an equilibrium


@dataclass(frozen=True, eq=False)
class Cell:
    """All races on one circuit with one planner under one variant of the rules."""

    track: Track
    planner: str
    rules: Rules
    lines: int  #: Start lines of the training races.
    repeats: int  #: Training races from each side of each line.
    clusters: int  #: Groups of three start lines, one for each race of a match.
    seed: int
    arms: tuple[str, ...] = ARMS  #: Arms that are raced.
    least: float = -1.0  #: Min mean ceiling; below it no arm is raced.


@dataclass(frozen=True, eq=False)
class Replies:
    """Population of J opponents, and the replies of I own types; units are padded to T."""

    full: Indices  #: shape (J,): Units of each opponent at the start.
    spends: Floats  #: shape (J, steps, moves, GAPS, T): Tables of the opponents.
    tables: dict[str, Floats]  #: Tables of the arms without belief, (I, steps, moves, GAPS, T).
    values: NDArray[np.float32]  #: shape (I, J, steps, moves, GAPS, T, T): :func:`reply_values`.


def make_replies(model: Model, plans: list[list[Floats]]) -> Replies:
    """Return the best replies in the model to the population of all plans."""
    rules = model.rules
    top = max(rules.full) + 1
    opponents = [(full, plan) for full, own in zip(rules.full, plans, strict=True) for plan in own]

    def padded(table: Floats, axes: int) -> Floats:
        room = [(0, top - size) for size in table.shape[-axes:]]
        return np.pad(table, [(0, 0)] * (table.ndim - axes) + room)

    def table(own: int, gap: bool) -> Floats:
        return padded(fixed_reply(model, rules.full[own], opponents, plans[own], gap), 1)

    types = range(len(rules.full))
    return Replies(
        np.array([full for full, _ in opponents]),
        np.stack([padded(plan, 1) for _, plan in opponents]),
        {arm: np.stack([table(own, arm == "gap") for own in types]) for arm in ARMS[:2]},
        np.stack(
            [
                [padded(reply_values(model, full, one), 2).astype(np.float32) for one in opponents]
                for full in rules.full
            ]
        ),
    )


def play(cell: Cell, replies: Replies, arm: str) -> Floats:
    """Return the scores of an arm, shape (clusters, 2 sides, I, J, RACES)."""
    shape = (cell.clusters, 2, len(cell.rules.full), len(replies.full))
    cluster, side, own, other = (one.ravel() for one in np.indices(shape))
    keys = race_seeds(cell.seed, cell.clusters * 2 * RACES).reshape(-1, 2, RACES)
    belief = np.ones((len(own), len(replies.full)))
    if arm == "told":
        belief *= replies.full == replies.full[other, None]
    scores = np.empty((len(own), RACES))
    for number in range(RACES):
        lines = RACES * cluster + number
        starts = starts_of(cell.track, CONTEST, 2 * lines + (side + number) % 2, cell.seed)
        choose = make_choice(cell, replies, arm, (own, other), belief, number)
        noise = keys[cluster, side, number]
        scores[:, number] = race(cell.track, cell.planner, cell.rules, starts, noise, choose).score
    return scores.reshape(*shape, RACES)


def make_choice(
    cell: Cell,
    replies: Replies,
    arm: str,
    pairs: tuple[Indices, Indices],
    belief: Floats,
    number: int,
) -> Choose:
    """Return the moves of both cars in a race of B matches; ``belief``, (B, J), is overwritten."""
    rules, (own, other) = cell.rules, pairs
    full = np.stack([np.array(rules.full)[own], replies.full[other]], axis=1)
    left, supposed = full.copy(), np.tile(replies.full, (len(own), 1))
    change, every = np.array([0, -rules.cost, 1]), np.arange(len(replies.full))
    rng = np.random.default_rng((cell.seed, number))

    def choose(step: int, leads: Floats, over: NDArray[np.bool_]) -> Indices:
        gap, behind = gap_bins(leads), gap_bins(-leads)
        if arm in replies.tables:
            worth = replies.tables[arm][own, step, :, gap, left[:, 0]]
        else:
            worth = np.zeros((len(own), rules.moves))
            for k in every:
                values = replies.values[own, k, step, :, gap, left[:, 0], supposed[:, k]]
                worth += belief[:, k, None] * values
        shares = replies.spends[other, step, :, behind, left[:, 1]].cumsum(axis=1)
        drawn = (shares > rng.uniform(size=(len(own), 1))).argmax(axis=1)
        moves = np.stack([worth.argmax(axis=1), drawn], axis=1)
        moves = rules.effective(moves, np.stack([gap, behind], axis=1), left)
        seen = moves[:, 1, None]
        likely = replies.spends[every, step, seen, behind[:, None], supposed]
        belief[:] *= np.where(over[:, None], 1.0, SLIP + likely)
        belief[:] /= belief.sum(axis=1, keepdims=True)
        left[:] = np.clip(left + change[moves], 0, full)
        supposed[:] = np.clip(supposed + change[seen], 0, replies.full)
        return moves

    return choose


def plan_support(model: Model, plans: list[list[Floats]]) -> Indices:
    """Return how many plans each type uses in an equilibrium of the races between all plans.

    A strategy is a plan for each type; types are drawn independently and are private.
    """
    full, types = model.rules.full, range(len(plans))
    payoffs = np.array(
        [
            [
                [
                    [model_score(model, full[e], one, (full[o], two)) for two in plans[o]]
                    for o in types
                ]
                for one in plans[e]
            ]
            for e in types
        ]
    )  # own type, own plan, other type, other plan
    strategies = np.array(list(product(range(len(plans[0])), repeat=len(plans))))
    games = sum(
        payoffs[e][strategies[:, e]][:, o][:, strategies[:, o]] for e in types for o in types
    )
    solved = solve_matrix_games(games)
    return np.array([(np.bincount(strategies[:, e], solved.rows[0]) > USED).sum() for e in types])


def run_cell(cell: Cell) -> dict[str, Floats]:
    """Fit the model and the replies on training starts, and race the arms on fresh ones.

    ``scores``, shape (arms, clusters, 2, I, J, RACES), are NaN for arms that were not raced.
    ``ceiling``, shape (I,), is the gain in the model, over the arm "gap", of a car that knows the
    opponent from the start.
    """
    rules = cell.rules
    model = fit_model(cell.track, cell.planner, rules, cell.lines, cell.repeats, cell.seed)
    plans = population(model)
    replies = make_replies(model, plans)
    pairs = [(full, plan) for full, own in zip(rules.full, plans, strict=True) for plan in own]
    ceiling = [
        np.mean([start_score(reply_values(model, full, one)) for one in pairs])
        - np.mean([model_score(model, full, table[..., : full + 1], one) for one in pairs])
        for full, table in zip(rules.full, replies.tables["gap"], strict=True)
    ]
    shape = (len(ARMS), cell.clusters, 2, len(rules.full), len(pairs), RACES)
    scores = np.full(shape, np.nan)
    for arm in cell.arms if np.mean(ceiling) >= cell.least else ():
        scores[ARMS.index(arm)] = play(cell, replies, arm)
    support = plan_support(model, plans)
    return {"scores": scores, "support": support, "ceiling": np.array(ceiling)}
