"""What Gymnasium's environments of one and of many episodes have in common: both are views of a batch."""

import copy
from inspect import Signature
from typing import Any, ClassVar

from gymnasium.envs.registration import EnvSpec

from pcs_racing.base.errors import InputError
from pcs_racing.envs.arguments import Declared
from pcs_racing.envs.batch import Batch
from pcs_racing.race.rendering import Renderer
from pcs_racing.track.track import Track

FILM = "rgb_array_list"
"""Render mode in which `render` returns all frames since it was last called, of steps that last many."""

WINDOW_TICKS = 16
"""Simulation steps between two frames that a window shows of a long step: at 25 a second, four times as fast."""

REBUILDING = ("track", "opponent")
"""Options of a reset that stand for arguments of the environment."""


class OverBatch:
    """What an environment over a batch knows of it, how it was made, and its frames."""

    batch_type: ClassVar[type[Any]]
    declared: ClassVar[Declared]  #: Arguments of the batch.
    __signature__: ClassVar[Signature]  #: What Python shows as the class's arguments.
    players: ClassVar[int] = 1  #: Environments that belong to the same episode: 2 for both cars of a race.
    batch: Batch
    metadata: dict[str, Any]
    render_mode: str | None
    view: str
    render_size: tuple[int, int]  #: Width and height of a frame in pixels.
    _spec: EnvSpec | None = None
    _renderer: Renderer | None = None

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if hasattr(cls, "declared"):
            cls.__signature__ = cls.declared.signature(cls._begin, cls.players)

    def __init__(self, *given: Any, **named: Any) -> None:
        arguments, own = self.declared.sort(type(self), given, named)
        self._begin(arguments=arguments, **own)

    def _begin(self, *args: Any, **kwargs: Any) -> None:
        """Make the batch with its ``arguments``, and the environment over it with the other ones."""
        raise NotImplementedError

    @property
    def spec(self) -> EnvSpec | None:
        """How it was made, with the number of steps after which its episodes end as ``max_episode_steps``.

        The registry does not hold that number: it would cut episodes off that were made longer by an argument.
        """
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        if value is not None and value.max_episode_steps is None:
            value = copy.copy(value)
            value.max_episode_steps = self.batch.horizon
        self._spec = value

    @property
    def elements(self) -> list[Any]:
        """Name, unit, bounds and meaning of every element of the observation of one environment."""
        return list(self.batch.elements)

    @property
    def track(self) -> Track:
        """The circuit."""
        track: Track = self.batch.track
        return track

    def _check_started(self) -> None:
        """Raise an :class:`InputError` before the first reset."""
        raise NotImplementedError

    def _open_renderer(self) -> Renderer:
        """Return what draws the frames; made when the first one is asked for."""
        if self.render_mode is None:
            raise InputError("render_mode is None; make the environment with another one, such as 'rgb_array'")
        self._check_started()
        if self._renderer is None:
            fps = float(self.metadata["render_fps"])
            mode = "human" if self.render_mode == "human" else "rgb_array"
            self._renderer = Renderer(self.track, *self.render_size, mode, view=self.view, fps=fps)
        return self._renderer

    def _show_step(self) -> None:
        """Show the first environment's last step in the window."""
        renderer = self._open_renderer()
        frames = 0
        for _ in self.batch.film(renderer, 0, WINDOW_TICKS):
            frames += 1
        if frames == 0:
            self.batch.draw(renderer, 0)

    def _frames_per_second(self) -> int:
        """Frame rate of what `render` returns, or the window shows."""
        whole_steps = self.render_mode in (FILM, "human") and self.batch.film_rate is not None
        return self.batch.film_rate or 1 if whole_steps else self.batch.frame_rate

    def _close_renderer(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
