"""Compiled step of the environments with a choice among candidates: from choices to observations.

The agents' cars follow the paths of their chosen candidates, as cars of the planner ``line-ppo``
do. Rows of observations and rewards count the players of all races, as in
:mod:`pcs_racing.envs.drive_kernel`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.numba_parts import call_with
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.envs.drive_kernel import end_race
from pcs_racing.planners import choice_rows as choice
from pcs_racing.planners.candidate_rows import CANDIDATES
from pcs_racing.planners.line_ppo import ASSERTIVENESS, RISK, describe, put_away, put_back, take
from pcs_racing.race.kernel import Crew, KernelSettings, Scratch, fill_view
from pcs_racing.track.frenet import TrackArrays

LIMIT = 10.0  # bound of the elements of an observation
NEAR = 0.9  # m: distance of two cars below which nearness costs
FAR = 20.0  # m: largest lead that counts
BOLD = 1.0 / 12.0  # price of a fault at risk 1, as a share of its price at risk 0
SHY, EAGER = 0.25, 1.5  # prices of a gain and a win at assertiveness 0 and 1

NUMBERS = choice.INNER_AT - choice.SITUATION
"""Number of features of an observation; the race's share that is left and the handicap follow."""


class LineSight(NamedTuple):
    """Observation of the players of a race."""

    players: int  #: Number of observing cars: the first cars.
    lattice: NDArray[np.float64]  #: Parameters of the lattice that lays the candidates.
    style: NDArray[np.float64]  #: Style of cars without an agent.
    end_tick: int  #: Duration of a race in steps of 0.01 s.


class LineInputs(NamedTuple):
    """Inputs of the kernel that are the same for races on one track."""

    track: TrackArrays
    settings: KernelSettings
    sight: LineSight


class Choices(NamedTuple):
    """Candidates of the players, from an observation to the next step."""

    style: NDArray[np.float64]  #: shape (B, players, 4): Style of each car in its race.
    laid: NDArray[np.float64]  #: shape (B, players, LAID): Candidates.
    allowed: NDArray[np.bool_]  #: shape (B, players, 64): False for a rejected candidate.
    best: NDArray[np.int64]  #: shape (B, players): Candidate with the min cost.
    replaced: NDArray[np.bool_]  #: shape (B, players): Flag: the last choice was a rejected one.


class LineTerms(NamedTuple):
    """Terms of the reward."""

    progress: float  #: Reward of a metre.
    gain: float  #: Reward of a metre gained on the nearest rival.
    fault: float  #: Cost of an own fault at risk 0.
    nearness: float  #: Cost of 0.1 s at another car at assertiveness 0.
    decided: bool  #: Flag: the end of the time decides a race, and terminates it.


class LineOrders(NamedTuple):
    """Orders of a step: its duration, and the drivers with their commands."""

    advance: Any  #: Address of `advance_races`.
    observe: Any  #: Address of `observe_lines`.
    crew: Crew
    rows: NDArray[np.int64]  #: shape (B,): Numbers of the races.
    ticks: int  #: Number of simulation steps; 0 after a drive in Python.
    actions: NDArray[np.int64]  #: shape (B, players): Chosen candidates.
    choices: Choices
    terms: LineTerms


class LineBuffers(NamedTuple):
    """Scratch memory of a thread; its contents are undefined after a call."""

    scratch: NDArray[np.float64]  #: Scratch memory of the planners and of the candidates.
    work: NDArray[np.float64]  #: shape (``WORK_SIZE``,): Scratch memory of the races.
    seen: NDArray[np.float64]  #: shape (``VIEW_SIZE``,): View of a car.
    memory: NDArray[np.float64]  #: Memory of a car without an agent: zeros.


_call = call_with()


@kernel
def take_choices(inputs, races, actions, choices, first, last, buffers):
    """Give the paths of the chosen candidates to the players; the best replaces a rejected one."""
    track, settings, sight = inputs
    state, vehicles = races.state, races.vehicles
    for race in range(first, last):
        for car in range(sight.players):
            chosen = actions[race, car]
            choices.replaced[race, car] = not choices.allowed[race, car, chosen]
            if choices.replaced[race, car]:
                chosen = choices.best[race, car]
            fill_view(track, state, race, car, vehicles[race], settings, buffers.seen)
            put_back(choices.laid[race, car], buffers.scratch)
            take(
                track,
                sight.lattice,
                choices.style[race, car],
                buffers.seen,
                state.memory[race, car],
                buffers.scratch,
                chosen,
                state.path[race, car],
            )


@inner_kernel
def _see(inputs, races, choices, race, car, buffers, out):
    """Describe the candidates of a car; a player's candidates are also stored for the next step."""
    track, settings, sight = inputs
    state, scratch, plays = races.state, buffers.scratch, car < sight.players
    memory = state.memory[race, car] if plays else buffers.memory
    style = choices.style[race, car] if plays else sight.style
    fill_view(track, state, race, car, races.vehicles[race], settings, buffers.seen)
    describe(track, sight.lattice, style, buffers.seen, memory, scratch)
    for k in range(NUMBERS):
        number = scratch[choice.SITUATION + k]
        out[k] = np.float32(min(max(number, -LIMIT), LIMIT))
    out[NUMBERS] = np.float32(1.0 - state.tick[race] / sight.end_tick)
    out[NUMBERS + 1] = np.float32(state.handicap[race, car])
    if plays:
        put_away(scratch, choices.laid[race, car])
        lowest = 1e30
        for c in range(CANDIDATES):
            above = scratch[choice.PAIR_ABOVE + c]
            choices.allowed[race, car, c] = above >= 0.0
            if 0.0 <= above < lowest:
                lowest, choices.best[race, car] = above, c


@kernel
def observe_lines(inputs, races, choices, rows, cars, buffers, out):
    """Write the observations of the first ``cars`` cars of the races ``rows``, as successive rows
    of ``out``.
    """
    row = 0
    for race in rows:
        for car in range(cars):
            _see(inputs, races, choices, race, car, buffers, out[row])
            row += 1


@inner_kernel(forceinline=True)
def price(style):
    """Return the price of a gain and a win for a style."""
    return SHY + (EAGER - SHY) * style[ASSERTIVENESS]


@inner_kernel(forceinline=True)
def _lead(progress, car):
    """Return the lead (m) of a car over the foremost other one, within `FAR`."""
    lead = FAR
    for other in range(len(progress)):
        if other != car:
            lead = min(lead, progress[car] - progress[other])
    return max(lead, -FAR)


@inner_kernel(forceinline=True)
def _nearness(cars, car):
    """Return the nearness of a car to the nearest other one: 1 at the same place, 0 from `NEAR`."""
    nearest = 0.0
    for other in range(len(cars)):
        if other != car:
            x = cars[car, _vehicle.X] - cars[other, _vehicle.X]
            y = cars[car, _vehicle.Y] - cars[other, _vehicle.Y]
            nearest = max(nearest, 1.0 - np.sqrt(x * x + y * y) / NEAR)
    return nearest


@inner_kernel
def _end_step(state, sight, terms, choices, results, first, last):
    """Write rewards and ends of a step, from the progress before it and the state after it."""
    for race in range(first, last):
        end_race(state, race, sight.end_tick, terms.decided, sight.players, results)
        now, before = state.progress[race], results.before[race]
        for car in range(sight.players):
            style = choices.style[race, car]
            gained = _lead(now, car) - _lead(before, car)
            shy = 1.0 - style[ASSERTIVENESS]
            reward = terms.progress * (now[car] - before[car])
            reward += price(style) * terms.gain * gained
            reward -= terms.nearness * shy * _nearness(state.cars[race], car)
            if state.fault[race, car] > results.faults[race, car]:
                reward -= terms.fault * BOLD ** style[RISK]
            results.reward[race * sight.players + car] = reward


@kernel
def step_lines(inputs, races, orders, first, last, buffers, results):
    """Step races ``first`` to ``last - 1``: choose and drive, then reward and observe."""
    track, settings, sight = inputs
    choices = orders.choices
    if orders.ticks > 0:
        take_choices(inputs, races, orders.actions, choices, first, last, buffers)
        own = Scratch(buffers.scratch, buffers.work)
        _call(orders.advance, (track, races, settings, orders.crew, orders.ticks, first, last, own))
    _end_step(races.state, sight, orders.terms, choices, results, first, last)
    rows = orders.rows[first:last]
    out = results.observations[first * sight.players : last * sight.players]
    _call(orders.observe, (inputs, races, choices, rows, sight.players, buffers, out))
