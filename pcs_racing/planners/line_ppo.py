"""Lattice planner whose candidate is chosen by a network: ``line-ppo``, trained by PPO.

The planner lays 64 candidates (:mod:`pcs_racing.planners.candidates`) and weighs them with fixed
weights. Candidates within :data:`WINDOW` of the min cost stay. So a candidate that meets a wall or
the opponent is rejected, as in the lattice. If all of them meet the opponent, all stay. Of the
candidates that stay, the candidate with the max score wins:

    score = correction - SHARPNESS * root(cost - min cost)

The correction is a small network of the candidate and of the situation. With a correction of 0 the
planner is the lattice. The fourth root (:data:`SOFT`) brings small and large differences of costs
onto one scale, so that a correction of order one can overrule any of them.

Unlike in the lattice, an attack is laid at any time: for a car in front, too.

The parameters of the planner are its style. In training every car drew a style for each race. The
style shapes the candidates (speeds, air next to the opponent), is an input of the network, and set
the prices of the car's rewards: one network, a family of policies.

The first layer of the network is a sum of four parts: of the situation, of the move, of the speed
and of the candidate. Each part is computed once, in a third of the time of a dense layer.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save as save_tensors

from pcs_racing.base.compilation import identified, inner_kernel, kernel
from pcs_racing.base.dense import dense_forward, flat_layers, tensors_from_bytes
from pcs_racing.base.elementary import hyperbolic_tangent
from pcs_racing.base.errors import InputError, is_number
from pcs_racing.planners import (
    candidate_rows as rows,
    candidates as _candidates,
    choice_rows as choice,
    view as _view,
)
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SCRATCH, SPEEDS
from pcs_racing.planners.candidates import SIGHT
from pcs_racing.planners.choice_rows import (
    BENDS,
    CONTEXT,
    FEATURES,
    INNER,
    MOVE,
    PAIR,
    SPEED,
    UNITS,
)
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.line import sample_at
from pcs_racing.planners.planner import Parameter, Planner, Policy, offsets
from pcs_racing.planners.trained import PLANNER_FORMAT
from pcs_racing.track import frenet as _frenet

NAME = "line-ppo"

WINDOW = 200.0  # max cost above the min cost; beyond it a candidate is rejected
EASED = 4.0  # cost of ten times the overlap with the opponent, above the window
SHARPNESS, SOFT = 5.0, 0.01
UNASKED = 1.0  # cost of an attack that the lattice would not lay, above the profile's cost

PARAMETERS = (
    Parameter(
        "risk",
        0.0,
        1.0,
        0.25,
        "price of an own crash in training: from six lost races (0) to half of one (1)",
    ),
    Parameter(
        "assertiveness",
        0.0,
        1.0,
        0.45,
        "clearance to the opponent, from 0.4 m (0) to 0.1 m (1), and price of a lead",
    ),
    Parameter(
        "pace",
        0.0,
        2.0,
        1.45,
        "speed scale between the slowest (0) and fastest (1) of the race's speed range",
    ),
    Parameter(
        "pace_behind",
        -0.5,
        0.5,
        0.0,
        "addition to the pace while the opponent leads; the sum is at least 0, and at most 1 or"
        " the pace",
    ),
)
"""Style of the planner."""
RISK, ASSERTIVENESS, PACE, PACE_BEHIND = range(4)
STYLE = len(PARAMETERS)
DEFAULT_STYLE = tuple(one.default for one in PARAMETERS)
SIDE_MARGINS = (0.4, 0.1)  # m, air next to the opponent at assertiveness 0 and 1

LAYERS = {
    "context": (INNER, CONTEXT),
    "situation": (UNITS, INNER),
    "weights": (FEATURES, INNER),
    "candidate": (UNITS, FEATURES),
    "score": (1, UNITS),
}
"""Shape (outputs, inputs) of each layer. The outputs of ``context`` pass a tanh and enter
``situation`` and ``weights``. The sum of ``situation`` and ``candidate`` passes a ReLU and enters
``score``; the outputs of ``weights`` are linear weights of the candidate's features."""


class Weights(NamedTuple):
    """Places of the layers' numbers in the flat vector: biases, then weights input by input."""

    context: int
    situation: int
    weights: int
    candidate: int
    score: int
    end: int


AT = Weights(*offsets(*((below + 1) * above for above, below in LAYERS.values())))
WEIGHTS = AT.end  # numbers of the network
MAX_WEIGHT = 100.0

# Memory after the lattice's: opponent's speed at the last plan and 1 s after the time of this plan,
# 0 if the opponent was out of sight; and its usual speed, as a share of the profile's above 1.
_, _M_SPEED, _M_TIME, _M_USUAL, MEMORY = offsets(_candidates.MEMORY, 1, 1, 1)
RECENT = 0.05  # weight of the last plan in the usual speed

TOTAL = choice.STYLED + len(LATTICE.parameters)
"""Size of the scratch."""
FIRST = choice.SITUATION  # place of the features of the situation, before all others

# Parts of the scratch that `take` needs: moves; profiles and speed scales; predicted opponent.
_, _MOVES_END, _PROFILES_END, LAID = offsets(
    rows.KAPPA, rows.NOW_S - rows.SQUARE, SCRATCH - rows.OPP_S
)


@inner_kernel(forceinline=True)
def _bounded(x, limit):
    return min(max(x, -limit), limit)


@inner_kernel(forceinline=True)
def _root(x):
    """Return a fourth root of a cost, 0 at 0 and nearly linear below `SOFT`."""
    return np.sqrt(np.sqrt(x + SOFT)) - np.sqrt(np.sqrt(SOFT))


@inner_kernel(forceinline=True)
def _copy(numbers, out):
    for k in range(len(out)):
        out[k] = numbers[k]


@inner_kernel(forceinline=True)
def _situation(track, lattice, style, view, memory, theta):
    """Write the lattice's parameters for a style, and return the situation."""
    _copy(lattice, theta)
    wide, narrow = SIDE_MARGINS
    theta[_candidates.SIDE_MARGIN] = wide + (narrow - wide) * style[ASSERTIVENESS]
    theta[_candidates.PACE] = style[PACE]
    theta[_candidates.PACE_BEHIND] = style[PACE_BEHIND]
    return _candidates.situation(track, theta, view, memory)


@inner_kernel(forceinline=True)
def _free(now):
    """Return the situation with an attack laid at any time."""
    return _candidates.Situation(*now[:-1], True)  # type: ignore[call-arg]


@inner_kernel(forceinline=True)
def _eased(met):
    """Return the opponent's cost, with only a small rise above `WINDOW`.

    So the network chooses among all candidates where each of them meets the opponent.
    """
    return met if met < WINDOW else WINDOW + EASED * np.log10(met / WINDOW)


@inner_kernel(forceinline=True)
def _meet_all(theta, laid, scratch):
    """Add the opponent's costs to the candidates near the min cost; return the min cost."""
    now, margin = laid.now, theta[_candidates.SIDE_MARGIN]
    side_reach = now.body + (margin if now.gives_way else 0.5 * margin)
    w_near = _candidates.power_of_ten(theta[_candidates.PROXIMITY]) / 6.0
    first = np.int64(np.argmin(scratch[rows.MIN_COST : rows.COSTS]))
    best = 1e30
    for k in range(-1, CANDIDATES):
        c = np.int64(first if k < 0 else k)
        if k == first:
            continue
        cost = scratch[rows.MIN_COST + c]
        met, nearness = 0.0, 0.0
        if now.meets and cost < best + WINDOW:
            most = best + WINDOW - cost if best < WINDOW else 1e30
            met, nearness = _candidates.meet_opponent(
                scratch, now, laid.start, c // GOALS, c % GOALS, side_reach, w_near, most
            )
            met = _eased(met)
        scratch[choice.MET + c] = met
        scratch[choice.NEARNESS + c] = nearness
        scratch[rows.COSTS + c] = cost + met
        best = min(best, cost + met)
    return best


@inner_kernel(forceinline=True)
def _speeds_up(view, memory):
    """Return the opponent's acceleration since the last plan, m/s^2; 0 without a last plan."""
    passed = view[_view.TIME] - (memory[_M_TIME] - 1.0)
    if not 0.0 < passed < 0.5:
        return 0.0
    return (view[_view.OPP_V] - memory[_M_SPEED]) / passed


@inner_kernel(forceinline=True)
def _above_profile(track, view):
    """Return the opponent's speed as a share of the profile's above 1, within .5."""
    there = sample_at(track.line, 1.0 / track.ds, view[_view.OPP_S])
    profile = max(view[_view.SPEED_HIGH] * track.line[there, _frenet.SPEED], 0.5)
    return _bounded(view[_view.OPP_V] / profile - 1.0, 0.5)


@inner_kernel(forceinline=True)
def _notice(track, view, now, memory):
    """Remember the opponent's speed."""
    if abs(now.gap) < SIGHT:
        memory[_M_SPEED], memory[_M_TIME] = view[_view.OPP_V], view[_view.TIME] + 1.0
        memory[_M_USUAL] += RECENT * (_above_profile(track, view) - memory[_M_USUAL])
    else:
        memory[_M_SPEED:MEMORY] = 0.0


@inner_kernel(forceinline=True)
def _flag(true):
    return 1.0 if true else 0.0


@inner_kernel(forceinline=True)
def _describe_situation(track, style, view, memory, laid, attacks, out):
    """Write the features of the situation."""
    now, start = laid.now, laid.start
    line, per_ds, v = track.line, 1.0 / track.ds, now.v
    near = max(1.0 - abs(now.gap) / SIGHT, 0.0)
    there = sample_at(line, per_ds, view[_view.OPP_S])
    out[choice.OWN_V] = v / 8.0
    out[choice.OWN_D] = now.d
    out[choice.OWN_SLOPE] = 3.0 * now.slope
    out[choice.OWN_YAW_RATE] = view[_view.OWN_PSI_DOT] / 5.0
    out[choice.OWN_BETA] = 5.0 * view[_view.OWN_BETA]
    out[choice.OWN_DELTA] = view[_view.OWN_DELTA] / view[_view.STEER_MAX]
    out[choice.START_D] = start.d
    out[choice.START_SLOPE] = 3.0 * start.slope
    out[choice.OWN_SCALE] = 3.0 * (now.scale - 1.2)
    out[choice.NEAR] = near
    out[choice.NEAR_GAP] = near * _bounded(now.gap / 2.0, 2.0)
    out[choice.NEAR_SIDE] = near * (now.opponent_d - now.d)
    out[choice.NEAR_D] = near * now.opponent_d
    out[choice.NEAR_D_DOT] = near * _bounded(view[_view.OPP_D_DOT], 2.0)
    out[choice.NEAR_V] = near * (now.opponent_v - v) / 3.0
    out[choice.NEAR_PROFILE] = near * 2.0 * _above_profile(track, view)
    out[choice.NEAR_BEND] = near * 2.0 * line[there, _frenet.KAPPA]
    out[choice.MEETS] = _flag(now.meets)
    out[choice.RIGHT_OF_WAY] = near if now.gives_way else -near
    out[choice.FOLLOWS] = _flag(now.follows)
    out[choice.BESIDE] = _flag(now.beside)
    out[choice.ATTACKS] = _flag(attacks)
    out[choice.LEAD] = _bounded(view[_view.GAP] / 10.0, 1.0)
    out[choice.VERY_NEAR] = max(1.0 - abs(now.gap) / 3.0, 0.0)
    out[choice.NEAR_ACCELERATION] = near * _bounded(_speeds_up(view, memory) / 5.0, 2.0)
    out[choice.USUAL] = 4.0 * memory[_M_USUAL]
    out[choice.RISK] = 2.0 * style[RISK] - 1.0
    out[choice.ASSERTIVENESS] = 2.0 * style[ASSERTIVENESS] - 1.0
    out[choice.PACE] = 2.0 * (style[PACE] - 1.0)
    out[choice.PACE_BEHIND] = 4.0 * style[PACE_BEHIND]
    step = 0.8 + 0.2 * v
    for j in range(BENDS):
        i = sample_at(line, per_ds, now.s + j * step)
        out[choice.BEND + j] = 2.0 * line[i, _frenet.KAPPA]
        if j % 2 == 0:
            out[choice.WIDTH_LEFT + j // 2] = min(line[i, _frenet.LEFT], 2.0)
            out[choice.WIDTH_RIGHT + j // 2] = min(line[i, _frenet.RIGHT], 2.0)


@inner_kernel(forceinline=True)
def _describe_candidates(theta, view, now, best, scratch):
    """Write the features of the moves, the speeds and the candidates."""
    near = max(1.0 - abs(now.gap) / SIGHT, 0.0)
    blocking = _candidates.power_of_ten(theta[_candidates.BLOCKING])
    defend = _candidates.defence(theta, view, now) / blocking
    for g in range(GOALS):
        goal = scratch[rows.GOAL_D + g]
        scratch[choice.MOVE_LENGTH + g] = 2.5 / scratch[rows.LENGTH + g]
        scratch[choice.MOVE_MAX_KAPPA + g] = min(scratch[rows.MAX_KAPPA + g], 3.0)
        scratch[choice.MOVE_MEAN_KAPPA + g] = 2.0 * min(scratch[rows.MEAN_KAPPA + g], 2.0)
        scratch[choice.MOVE_CHANGE + g] = min(scratch[rows.CHANGE + g], 3.0)
        scratch[choice.MOVE_AWAY + g] = 0.5 * scratch[rows.AWAY + g]
        scratch[choice.MOVE_WALLS + g] = 3.0 * scratch[rows.WALL_COST + g]
        scratch[choice.MOVE_ABREAST + g] = min(defend * scratch[rows.ABREAST + g], 3.0)
        scratch[choice.MOVE_CLOSE + g] = 3.0 * scratch[rows.CLOSE + g]
        scratch[choice.MOVE_GOAL + g] = goal
        scratch[choice.MOVE_SIDEWAYS + g] = goal - now.d
        scratch[choice.MOVE_SIDE + g] = near * (goal - now.opponent_d)
        scratch[choice.MOVE_DISTANCE + g] = near * abs(goal - now.opponent_d)
        scratch[choice.MOVE_AIR + g] = 2.0 * _bounded(scratch[rows.MIN_AIR + g], 1.0)
        gained = scratch[rows.SLOWED + g] / scratch[rows.STRETCH + g] - 1.0
        scratch[choice.MOVE_GAIN + g] = 5.0 * gained
    fastest, profile = scratch[rows.DRIVEN], scratch[rows.DRIVEN + 1]
    for f in range(SPEEDS):
        driven = scratch[rows.DRIVEN + f]
        gained = scratch[rows.OWN_V + 4 * SPEEDS + f] - now.v
        scratch[choice.SPEED_GAIN + f] = gained / 3.0
        scratch[choice.SPEED_BRAKED + f] = scratch[rows.BRAKED + f] / 3.0
        scratch[choice.SPEED_BEHIND + f] = min(fastest / driven - 1.0, 2.0)
        scratch[choice.SPEED_AHEAD + f] = (driven - profile) / 4.0
        for k in range(SPEEDS):
            scratch[choice.SPEED_IS + k * SPEEDS + f] = _flag(k == f)
    for f in range(SPEEDS):
        fast = 0.1 * scratch[rows.FAST + f]
        for g in range(GOALS):
            c = f * GOALS + g
            aside = scratch[rows.ASIDE + c]
            above = scratch[rows.COSTS + c] - best
            rate = 2.5 * fast * scratch[rows.KAPPA_RATE + g]
            scratch[choice.PAIR_KAPPA_RATE + c] = min(rate, 3.0)
            scratch[choice.PAIR_ASIDE + c] = min(aside / 10.0, 3.0)
            scratch[choice.PAIR_STRAIN + c] = min(max(aside - now.grip, 0.0), 3.0)
            scratch[choice.PAIR_BEHIND + c] = scratch[rows.BEHIND + c] / 5.0
            scratch[choice.PAIR_NEARNESS + c] = min(scratch[choice.NEARNESS + c], 4.0)
            scratch[choice.PAIR_MET + c] = _root(min(scratch[choice.MET + c], WINDOW))
            scratch[choice.PAIR_ABOVE + c] = _root(above) if above <= WINDOW else -1.0


@inner_kernel
def describe(track, lattice, style, view, memory, scratch):
    """Lay all candidates and write all features into the scratch.

    ``lattice`` holds parameters of the lattice. The last feature of a candidate is -1 if the
    candidate is rejected.
    """
    theta = scratch[choice.STYLED : TOTAL]
    now = _situation(track, lattice, style, view, memory, theta)
    laid = _candidates.lay_candidates(track, theta, view, memory, _free(now), scratch)
    if not now.attacks:
        costs = scratch[rows.MIN_COST : rows.COSTS]
        for g in range(GOALS):
            costs[g] = costs[GOALS + g] + UNASKED
    best = _meet_all(theta, laid, scratch)
    _describe_situation(track, style, view, memory, laid, now.attacks, scratch)
    _describe_candidates(theta, view, laid.now, best, scratch)


@inner_kernel
def put_away(scratch, laid):
    """Copy all that `take` needs from a scratch into ``laid``, shape (LAID,)."""
    _copy(scratch, laid[:_MOVES_END])
    _copy(scratch[rows.SQUARE :], laid[_MOVES_END:_PROFILES_END])
    _copy(scratch[rows.OPP_S :], laid[_PROFILES_END:LAID])


@inner_kernel
def put_back(laid, scratch):
    """Copy ``laid`` of `put_away` back into a scratch."""
    _copy(laid, scratch[:_MOVES_END])
    _copy(laid[_MOVES_END:], scratch[rows.SQUARE : rows.NOW_S])
    _copy(laid[_PROFILES_END:], scratch[rows.OPP_S : SCRATCH])


@inner_kernel
def take(track, lattice, style, view, memory, scratch, chosen, path):
    """Write the path of a candidate, after `describe` with the same scratch."""
    now = _situation(track, lattice, style, view, memory, scratch[choice.STYLED : TOTAL])
    start = _candidates.plan_by_now(memory, now, track.length)
    laid = _candidates.Laid(_free(now), start, _candidates.way_back(now, start))
    _candidates.take(track, view, memory, laid, now.attacks, scratch, chosen, path)
    _notice(track, view, now, memory)


@inner_kernel(forceinline=True)
def _add(value, numbers, total):
    """Add a multiple of ``UNITS`` or fewer numbers to a total."""
    for k in range(len(total)):
        total[k] += value * numbers[k]


@inner_kernel(forceinline=True)
def _part(flat, features, step, linear, weights, part):
    """Write the part of the first layer, and the linear score, of one move or one speed.

    A feature is every ``step``-th of ``features``. Its weights to the units are a row of
    ``weights``; its linear weight is in ``linear``.
    """
    part[:] = 0.0
    units = part[:UNITS]
    for j in range(len(linear)):
        value = features[j * step]
        _add(value, weights[UNITS * j : UNITS * (j + 1)], units)
        part[UNITS] += value * linear[j]


@inner_kernel
def choose(flat, scratch):
    """Return the candidate with the max score; ``flat`` holds the network's numbers."""
    inner, hidden = scratch[choice.INNER_AT : choice.HIDDEN], scratch[choice.HIDDEN : choice.LINEAR]
    linear, units = scratch[choice.LINEAR : choice.OF_MOVES], scratch[choice.SCORES : choice.STYLED]
    situation = scratch[choice.SITUATION : choice.MOVES]
    dense_forward(flat[AT.context :], (CONTEXT, INNER), situation, inner, False)
    for k in range(INNER):
        inner[k] = hyperbolic_tangent(inner[k])
    dense_forward(flat[AT.situation :], (INNER, UNITS), inner, hidden, False)
    dense_forward(flat[AT.weights :], (INNER, FEATURES), inner, linear, False)
    _add(1.0, flat[AT.candidate : AT.candidate + UNITS], hidden)
    weights, width = flat[AT.candidate + UNITS : AT.score], UNITS + 1
    for g in range(GOALS):
        part = scratch[choice.OF_MOVES + g * width : choice.OF_MOVES + (g + 1) * width]
        _part(
            flat, scratch[choice.MOVES + g : choice.SPEEDS_AT], GOALS, linear[:MOVE], weights, part
        )
    weights = weights[UNITS * MOVE :]
    for f in range(SPEEDS):
        part = scratch[choice.OF_SPEEDS + f * width : choice.OF_SPEEDS + (f + 1) * width]
        _part(
            flat,
            scratch[choice.SPEEDS_AT + f : choice.PAIRS],
            SPEEDS,
            linear[MOVE : MOVE + SPEED],
            weights,
            part,
        )
    weights, out = weights[UNITS * SPEED :], flat[AT.score + 1 : AT.end]
    chosen, best = 0, -1e30
    for c in range(CANDIDATES):
        pair = scratch[choice.PAIRS + c : choice.INNER_AT]
        above = pair[(PAIR - 1) * CANDIDATES]
        if above < 0.0:
            continue
        move = scratch[choice.OF_MOVES + (c % GOALS) * width :]
        speed = scratch[choice.OF_SPEEDS + (c // GOALS) * width :]
        score = move[UNITS] + speed[UNITS] - SHARPNESS * above
        for u in range(UNITS):
            units[u] = hidden[u] + move[u] + speed[u]
        for j in range(PAIR):
            value = pair[j * CANDIDATES]
            score += value * linear[MOVE + SPEED + j]
            _add(value, weights[UNITS * j : UNITS * (j + 1)], units)
        for u in range(UNITS):
            score += max(units[u], 0.0) * out[u]
        if score > best:
            chosen, best = c, score
    return chosen


@kernel
def plan_by_theta(track, theta, view, memory, scratch, path):
    """Plan by a network in ``theta``: style, parameters of the lattice, the network's numbers."""
    style, lattice = theta[:STYLE], theta[STYLE : STYLE + LATTICE_SIZE]
    describe(track, lattice, style, view, memory, scratch)
    chosen = choose(theta[STYLE + LATTICE_SIZE :], scratch)
    take(track, lattice, style, view, memory, scratch, chosen, path)


LATTICE_SIZE = len(LATTICE.parameters)


@cache
def _plan(frozen: bytes) -> Any:
    """Compile a network with its weights, and the lattice's parameters, as constants."""
    constant = np.frombuffer(frozen, np.float64)
    lattice, flat = constant[:LATTICE_SIZE].copy(), constant[LATTICE_SIZE:].copy()

    @kernel
    def plan(track, theta, view, memory, scratch, path):
        describe(track, lattice, theta, view, memory, scratch)
        take(track, lattice, theta, view, memory, scratch, choose(flat, scratch), path)

    return identified(plan, frozen)


LINE_FORMAT = replace(
    PLANNER_FORMAT,
    noun="line planner",
    keys=("name", "lattice", "training", "weights_sha256"),
    writer="save_line_planner",
)


def flat_weights(tensors: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Return the numbers of a network's tensors (``context.weight``, ...), shape (WEIGHTS,)."""
    layers = [(np.asarray(tensors[f"{one}.weight"]), tensors[f"{one}.bias"]) for one in LAYERS]
    return flat_layers(layers).astype(np.float64)


def tensors_of(numbers: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the tensors of a network's numbers, shape (WEIGHTS,); see `flat_weights`."""
    tensors = {}
    for (name, (outputs, inputs)), first in zip(LAYERS.items(), AT, strict=False):
        part = numbers[first : first + outputs * (inputs + 1)].copy()
        tensors[f"{name}.bias"] = part[:outputs]
        tensors[f"{name}.weight"] = part[outputs:].reshape(inputs, outputs).T.copy()
    return tensors


@cache
def _numbered() -> Planner:
    """Return the planner of all networks: the style, then numbers of the lattice and the layers."""
    numbers = tuple(
        Parameter(f"number {k}", -1e3, 1e3, 0.0, "parameter of the lattice, or weight of a network")
        for k in range(LATTICE_SIZE + WEIGHTS)
    )
    return Planner(
        name="line-network",
        parameters=PARAMETERS + numbers,
        plan=plan_by_theta,
        memory_size=MEMORY,
        scratch_size=TOTAL,
        sight=SIGHT,
    )


def network_policy(
    tensors: Mapping[str, NDArray[Any]],
    *,
    name: str = "line-network",
    style: Mapping[str, float] | None = None,
) -> Policy:
    """Return the policy of a network, for the lattice's default parameters.

    All networks share one planner, whose parameters are their numbers. So nothing is compiled for a
    network that changes, such as a frozen copy of a network that learns.

    Parameters
    ----------
    tensors : mapping of ndarray
        As in `save_line_planner`.
    style : mapping of float
        Parameters of ``line-ppo`` that differ from their defaults.
    """
    for what, given in (("its tensors", tensors), ("its style", style or {})):
        if not isinstance(given, Mapping):
            raise InputError(f"{name}: {what} is {given!r:.80}; it must be a mapping by name")
    chosen = Planner(NAME, PARAMETERS).policy(dict(style or {})).parameters
    # Tensors of torch that require a gradient have no array before they are detached.
    arrays = {
        key: np.asarray(one.detach() if hasattr(one, "detach") else one)
        for key, one in tensors.items()
    }
    numbers = [chosen, LATTICE.policy().parameters, flat_weights(check_tensors(name, arrays))]
    return _numbered().policy(np.concatenate(numbers), name)


def save_line_planner(
    folder: str | Path,
    tensors: Mapping[str, NDArray[Any]],
    *,
    name: str = NAME,
    lattice: Mapping[str, float] | None = None,
    training: Mapping[str, Any],
) -> Path:
    """Save a line planner in a folder, created if missing.

    Parameters
    ----------
    tensors : mapping of ndarray
        ``LAYER.weight`` (outputs, inputs) and ``LAYER.bias`` (outputs,) of all :data:`LAYERS`.
    lattice : mapping of float
        Parameters of the lattice that lays and weighs the candidates (default: its own defaults).
    training : mapping
        Description of the training: texts and numbers by name.
    """
    content = save_tensors({k: np.ascontiguousarray(v, np.float32) for k, v in tensors.items()})
    _read_tensors(Path(folder), content)
    values = LATTICE.policy(dict(lattice or {}), name).parameters  # checks them
    fields = {
        "name": name,
        "lattice": dict(zip(LATTICE.parameter_names, values.tolist(), strict=True)),
        "training": dict(training),
    }
    return LINE_FORMAT.save(folder, fields, content)


def check_tensors(owner: Any, tensors: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    """Return the tensors of a line planner; refuse others."""
    shapes = {f"{layer}.weight": shape for layer, shape in LAYERS.items()}
    shapes |= {f"{layer}.bias": shape[:1] for layer, shape in LAYERS.items()}  # type: ignore[misc]
    for key in sorted(shapes.keys() | tensors.keys(), key=str):
        found = tensors[key].shape if key in tensors else None
        if found != shapes.get(key):
            raise InputError(
                f"{owner}: {key} has shape {found}; a line planner has {shapes.get(key)}"
            )
        real = tensors[key].dtype.kind in "iuf"
        if not real or not (np.abs(tensors[key]) <= MAX_WEIGHT).all():
            raise InputError(f"{owner}: {key} must be numbers within {MAX_WEIGHT:g}")
    return tensors


def _read_tensors(folder: Path, content: bytes) -> Mapping[str, NDArray[Any]]:
    file = folder / LINE_FORMAT.data_file
    return check_tensors(file, tensors_from_bytes(file, content))


def read_line_planner(source: str | Path = NAME) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """Return the manifest of a line planner and its numbers: lattice's parameters, then weights.

    The source is a shipped name or a folder.
    """
    folder = LINE_FORMAT.find(source)
    fields, content = LINE_FORMAT.load(folder)
    if not isinstance(fields["name"], str) or not isinstance(fields["training"], dict):
        raise InputError(f"{folder}: name must be a text and training a mapping")
    values = fields["lattice"]
    if not isinstance(values, dict) or not all(map(is_number, values.values())):
        raise InputError(f"{folder}: lattice must map parameters of the lattice to numbers")
    lattice = LATTICE.policy(values, fields["name"]).parameters
    return fields, np.concatenate([lattice, flat_weights(_read_tensors(folder, content))])


def load_line_planner(source: str | Path = NAME) -> Planner:
    """Return a line planner, from a shipped name or a folder."""
    fields, numbers = read_line_planner(source)
    return Planner(
        name=fields["name"],
        parameters=PARAMETERS,
        plan=_plan(numbers.tobytes()),
        memory_size=MEMORY,
        scratch_size=TOTAL,
        sight=SIGHT,
    )


def __getattr__(name: str) -> Any:
    """Return the shipped planner ``LINE_PPO``, loaded at its first use."""
    if name != "LINE_PPO":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = load_line_planner()
    return globals()[name]
