"""Batch of races of agents that choose among candidates, for the Line environments."""

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, as_array
from pcs_racing.base.numba_parts import compiled_address
from pcs_racing.envs.batch import Rows, check_within
from pcs_racing.envs.drive_batch import DriveBatch, DriveRules, race_rules
from pcs_racing.envs.line_kernel import (
    EAGER,
    SHY,
    Choices,
    LineBuffers,
    LineInputs,
    LineOrders,
    LineSight,
    LineTerms,
    observe_lines,
    step_lines,
    take_choices,
)
from pcs_racing.envs.line_options import LINE_ELEMENTS, LineOptions, draw_style
from pcs_racing.envs.origins import mark
from pcs_racing.planners.candidate_rows import CANDIDATES
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.line_ppo import (
    ASSERTIVENESS,
    DEFAULT_STYLE,
    LAID,
    MEMORY,
    PARAMETERS,
    TOTAL,
)
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.view import VIEW_SIZE
from pcs_racing.race.conditions import runs_of
from pcs_racing.race.kernel import WORK_SIZE, KernelSettings
from pcs_racing.track.track import Track

AGENT = Planner(name="agent", parameters=(), memory_size=MEMORY)
"""Planner of an agent's car: it follows the path of the last choice."""

DESCRIBED_US = 60.0  # approximate time of an observation


class LineBatch(DriveBatch):
    """Batch of races; agents choose for the first ``players`` cars of each race."""

    step_kernel: ClassVar[Any] = step_lines
    action_dtype: ClassVar[Any] = np.int64
    noun: ClassVar[str] = "the environment of candidates"

    @property
    def effort(self) -> float:
        """Effort of the compilation of the observation."""
        return 300.0

    def _make_rules(self, options: LineOptions) -> DriveRules:  # type: ignore[override]
        rules = race_rules(options, self.players, self.randomization, AGENT)
        self.elements, ticks = LINE_ELEMENTS, rules.setup.rules.ticks
        lattice = LATTICE.policy().parameters.copy()
        self.sight = LineSight(self.players, lattice, np.array(DEFAULT_STYLE), ticks)
        self.terms = LineTerms(
            float(options.progress_reward),
            float(options.gain_reward),
            float(options.fault_penalty),
            float(options.near_penalty),
            options.win_reward > 0.0,
        )
        self.styles = options.styles
        return rules

    def _make_spaces(self) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
        low, high = (
            np.array([getattr(one, end) for one in self.elements], np.float32)
            for end in ("low", "high")
        )
        seen, acts = spaces.Box(low, high, dtype=np.float32), spaces.Discrete(CANDIDATES)
        # A model races in the default style, within the ranges of its training.
        style = np.clip(DEFAULT_STYLE, *self.styles.T)
        names = (one.name for one in PARAMETERS)
        about = {"style": dict(zip(names, style.tolist(), strict=True))}
        return mark(seen, "line", about), mark(acts, "line", about)

    def _make_inputs(self, track: Track, settings: KernelSettings) -> LineInputs:
        return LineInputs(track.arrays, settings, self.sight)

    def _begin(self) -> None:
        two = self.episodes, self.players
        self.choices = Choices(
            np.tile(DEFAULT_STYLE, (*two, 1)),
            np.zeros((*two, LAID)),
            np.ones((*two, CANDIDATES), np.bool_),
            np.zeros(two, np.int64),
            np.zeros(two, np.bool_),
        )
        self.kept = self.choices.style, self.choices.replaced
        super()._begin()

    def _make_eyes(self, inputs: Any, moving: bool) -> None:
        """Return nothing: the view of a car contains all."""

    def _look_us(self) -> float:
        return self.players * DESCRIBED_US

    def _make_buffers(self, scratch: int) -> LineBuffers:
        sizes = max(scratch, TOTAL), WORK_SIZE, VIEW_SIZE, self.setup.memory_size
        return LineBuffers(*map(np.zeros, sizes))

    def _compile(self) -> None:
        seen, inputs = self._results().observations, self._inputs[0]
        self._observe = compiled_address(
            observe_lines, inputs, self.races, self.choices, self._rows, 0, self._buffers[0], seen
        )

    def _draw_opponent(self, row: int, generator: np.random.Generator) -> None:
        super()._draw_opponent(row, generator)
        for car in range(self.players):
            self.choices.style[row, car] = draw_style(self.styles, generator)
        self.choices.replaced[row] = False

    def _see_run(self, inputs: Any, rows: Rows, players: int, out: NDArray[np.float32]) -> None:
        observe_lines(inputs, self.races, self.choices, rows, players, self._buffers[0], out)

    def check_actions(self, actions: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return choices as int64 of shape (B, players)."""
        values = as_array(actions)
        if values.shape != shape or values.dtype.kind not in "iu":
            raise InputError(
                f"action {actions!r:.80} must be whole numbers of shape {shape}: candidates"
            )
        wrong = np.flatnonzero((values < 0) | (values >= CANDIDATES))
        if len(wrong):
            where = f" of environment {wrong[0]}" if shape else ""
            raise InputError(
                f"action{where} is {values.reshape(-1)[wrong[0]]}; it must be a candidate, from 0"
                f" to {CANDIDATES - 1}"
            )
        return values.astype(np.int64).reshape(self.episodes, self.players)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the allowed candidates of each player, shape (n, 64)."""
        return self.choices.allowed.reshape(-1, CANDIDATES).copy()

    def _win_rewards(self, rows: Rows) -> Any:
        assertive = self.choices.style[rows, :, ASSERTIVENESS]
        return float(self.options.win_reward) * (SHY + (EAGER - SHY) * assertive)

    def _command(self, actions: NDArray[Any]) -> None:
        for first, last in runs_of(self._inputs):
            own = self._inputs[first], self.races, actions, self.choices
            take_choices(*own, first, last, self._buffers[0])

    def _orders(self, actions: NDArray[Any], ticks: int) -> LineOrders:
        return LineOrders(
            self._advance,
            self._observe,
            self._crew,
            self._rows,
            ticks,
            actions,
            self.choices,
            self.terms,
        )

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the infos of all players, with masks."""
        return {
            **super().infos(),
            "action_mask": self.action_masks().astype(np.int8),
            "replaced": self.choices.replaced.reshape(-1).astype(np.int64),
        }

    def info(self, environment: int) -> dict[str, Any]:
        """Return the info of one player as plain numbers, with its mask."""
        race, car = divmod(environment, self.players)
        info = super().info(environment)
        info["action_mask"] = self.choices.allowed[race, car].astype(np.int8)
        info["replaced"] = int(self.choices.replaced[race, car])
        return info

    def check_state(self, state: tuple[Any, ...]) -> list[Track]:
        """Refuse a state that `get_state` can't have returned."""
        tracks = super().check_state(state)
        for k, one in enumerate(PARAMETERS):
            check_within(f"the state's {one.name}", state[-1][0][..., k], one.low, one.high)
        return tracks
