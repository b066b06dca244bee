"""Batch of races whose agents drive arcs by the sectors of a lidar, for the Drive environments."""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.envs.batch import BatchStep, Generators
from pcs_racing.envs.drive_batch import BEAM_US, SCAN_US, DriveBatch
from pcs_racing.envs.drive_kernel import Buffers, Eyes, Orders, make_buffers
from pcs_racing.planners.field.lidar_ppo import (
    MEMORY,
    SECTORS,
    SEEN,
    held_share,
    lay_command,
    observe,
    remember,
)
from pcs_racing.planners.planner import Planner, offsets
from pcs_racing.planners.scanning import BEAMS, SCAN_SIZE, follow_scan
from pcs_racing.planners.view import VIEW_SIZE
from pcs_racing.race.conditions import runs_of
from pcs_racing.race.kernel import WORK_SIZE, fill_view

AGENT = Planner(name="agent", parameters=(), memory_size=MEMORY + SECTORS, control=follow_scan)
"""Planner of an agent's car: it follows the last arc. Its memory ends with the present scan."""

# Scratch: view, observation, memory of a car without an agent, after the lidar's.
_VIEW, _SEEN, _MEMORY, _SCRATCH = (SCAN_SIZE + k for k in offsets(VIEW_SIZE, SEEN, MEMORY))


@kernel
def lay_arcs(inputs, races, actions, first, last, buffers):
    """Give the arcs of the actions, shape (B, players, 2), to the players' cars."""
    track, settings, _ = inputs
    state, view = races.state, buffers.scratch[_VIEW:_SEEN]
    for race in range(first, last):
        for car in range(actions.shape[1]):
            fill_view(track, state, race, car, races.vehicles[race], settings, view)
            memory = state.memory[race, car]
            remember(memory, memory[MEMORY : MEMORY + SECTORS])
            turn, push = actions[race, car, 0], actions[race, car, 1]
            lay_command(view, held_share(view), memory, turn, push, state.path[race, car])


@inner_kernel
def _see(inputs, races, race, car, scratch, out):
    track, settings, sight = inputs
    state, view, seen = races.state, scratch[_VIEW:_SEEN], scratch[_SEEN:_MEMORY]
    memory = state.memory[race, car]
    if car >= sight.players:
        memory = scratch[_MEMORY:_SCRATCH]
        memory[:] = 0.0
    fill_view(track, state, race, car, races.vehicles[race], settings, view)
    observe(track, view, held_share(view), memory, scratch, seen)
    for k in range(SEEN):
        number = min(max(seen[k], sight.low[k]), sight.high[k])
        out[k] = np.float32(number * sight.gain[k] + sight.shift[k])
    if car < sight.players:
        for k in range(SECTORS):
            memory[MEMORY + k] = seen[k]


@kernel
def observe_sectors(inputs, races, eyes, rows, first, last, buffers, out):
    """Write the observations of cars ``first`` to ``last - 1`` of the races ``rows``, as
    `observe_races` does; a second observation of the same moment is the same.
    """
    row = 0
    for race in rows:
        for car in range(first, last):
            _see(inputs, races, race, car, buffers.scratch, out[row])
            row += 1


class ArcBatch(DriveBatch):
    """Batch of races; agents choose arcs for the first ``players`` cars of each race."""

    observe_kernel: ClassVar[Any] = observe_sectors
    driver: ClassVar[Planner | None] = AGENT

    def _make_eyes(self, inputs: Any, moving: bool) -> Eyes:
        """Return nothing: the view of a car contains all."""
        return Eyes()

    def _look_us(self) -> float:
        return self.players * (SCAN_US + BEAM_US * BEAMS)

    def _make_buffers(self, scratch: int) -> Buffers:
        return make_buffers(max(scratch, _SCRATCH), WORK_SIZE, len(self.elements), self.cars)

    def _command(self, actions: NDArray[np.float64]) -> None:
        for first, last in runs_of(self._inputs):
            lay_arcs(self._inputs[first], self.races, actions, first, last, self._buffers[0])

    def _orders(self, actions: NDArray[np.float64], ticks: int) -> Orders:
        nothing = actions[:, :0].copy()  # the arcs are all the commands
        orders: Orders = super()._orders(nothing, ticks)
        return orders

    def step(self, actions: NDArray[np.float64], generators: Generators = ()) -> BatchStep:
        """Advance every race by one step."""
        if not self._in_python:
            self._command(actions)
        return super().step(actions, generators)
