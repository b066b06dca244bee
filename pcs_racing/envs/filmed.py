"""Environments for one agent whose step lasts many frames: a render mode returns them all."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.envs.game_batch import DrivenStep, GameBatch
from pcs_racing.envs.over_batch import FILM
from pcs_racing.envs.scalar import EnvState, ScalarEnv
from pcs_racing.race.rendering import MODES


class FilmedEnv(ScalarEnv):
    """Base class of the environments at the level of strategy.

    With ``render_mode="rgb_array_list"`` `render` returns all frames since it was last called, or since the reset, as
    Gymnasium's :class:`gymnasium.wrappers.RenderCollection` does. The races are driven again for them: what nobody asks
    for is not drawn.
    """

    metadata: dict[str, Any] = {**ScalarEnv.metadata, "render_modes": [*MODES, FILM]}  # noqa: RUF012
    batch: GameBatch
    _unseen: list[DrivenStep]

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new episode: see :meth:`ScalarEnv.reset`."""
        result = super().reset(seed=seed, options=options)
        self._unseen = []
        self._keep_step()
        return result

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Make a step: see :meth:`ScalarEnv.step`."""
        result = super().step(action)
        self._keep_step()
        return result

    def set_state(self, state: EnvState) -> NDArray[np.float32]:
        """Continue from what `get_state` returned: see :meth:`ScalarEnv.set_state`."""
        observation = super().set_state(state)
        self._unseen = []
        if self._started:
            self._keep_step()
        return observation

    def _keep_step(self) -> None:
        if self.render_mode == FILM:
            self._unseen.append(self.batch.last_step(0))

    def render(self) -> Any:
        """Return a frame (``"rgb_array"``), show it (``"human"``), or return a list of frames (``"rgb_array_list"``).

        The list holds all frames since it was last asked for, or since the reset, 25 for each second of racing; it is
        empty if nothing was driven since.
        """
        if self.render_mode != FILM:
            return super().render()
        renderer = self._open_renderer()
        steps, self._unseen = self._unseen, []
        frames = [frame for step in steps for frame in self.batch.film(renderer, 0, step=step)]
        return frames or [self.batch.draw(renderer, 0) for _ in steps[:1]]  # of a restored state, the moment
