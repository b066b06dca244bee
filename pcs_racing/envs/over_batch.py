"""Common base of all environments: views of a batch, with arguments declared once."""

import copy
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property
from inspect import Parameter, Signature, signature
from typing import TYPE_CHECKING, Any, ClassVar, Self, Union

from gymnasium.envs.registration import EnvSpec

from pcs_racing.base.checks import check_choice
from pcs_racing.base.errors import InputError, UnknownNameError, choices, unknown_argument
from pcs_racing.base.settings import listed_argument, listed_settings, type_name
from pcs_racing.race.rendering import MODES, Renderer, views
from pcs_racing.track.track import Track

if TYPE_CHECKING:  # so that an environment imports its own batch alone
    from pcs_racing.envs.drive_batch import DriveBatch
    from pcs_racing.envs.game_batch import GameBatch

Batch = Union["DriveBatch", "GameBatch"]
"""Batch below an environment."""

REBUILDING = ("track", "opponent")
"""Options of a reset that replace arguments of the environment."""

_BY_PLACE, _BY_NAME = Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY


@dataclass(frozen=True)
class Declared:
    """Batch arguments of an environment class."""

    options: type[Any]  #: Dataclass of the batch's arguments, with their defaults.
    positional: tuple[str, ...] = ()  #: Positional arguments, in order.
    more: type[Any] | None = None  #: Dataclass with further arguments.
    without: tuple[str, ...] = ()  #: Fields of ``more`` that are no arguments.
    changed: Mapping[str, Any] = field(default_factory=dict)  #: Changed defaults, by name.

    @cached_property
    def defaults(self) -> dict[str, Any]:
        """Default of each argument."""
        return {one.name: one.default for one in fields(self.options)} | dict(self.changed)

    def signature(self, begin: Callable[..., Any], players: int) -> Signature:
        """Return the signature of a class: arguments of the batch and of its method ``begin``.

        The argument ``arguments`` of ``begin`` is left out.
        """
        own = [
            one
            for name, one in signature(begin).parameters.items()
            if name not in ("self", "arguments")
        ]
        listed = [name for name in self.defaults if name not in self.positional]
        kinds = {one.name: one.type for one in fields(self.options)}
        # Positional arguments come first: the number of environments, the track, the opponent.
        parameters = [
            one.replace(kind=_BY_PLACE, default=players) for one in own if one.name == "num_envs"
        ]
        for names, way in ((self.positional, _BY_PLACE), (listed, _BY_NAME)):
            parameters += [
                Parameter(name, way, default=self.defaults[name], annotation=kinds[name])
                for name in names
            ]
        parameters += [one.replace(kind=_BY_NAME) for one in own if one.name != "num_envs"]
        if self.more is not None:
            parameters.append(Parameter("settings", Parameter.VAR_KEYWORD, annotation=Any))
        return Signature(parameters)

    def sort(
        self, kind: type[Any], given: tuple[Any, ...], named: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the arguments of the batch, with defaults, and the environment's own arguments."""
        own = kind.__signature__.parameters.keys() - self.defaults.keys() - {"settings"}
        more = () if self.more is None else (one.name for one in fields(self.more))
        known = dict.fromkeys([*kind.__signature__.parameters, *more])
        known.pop("settings", None)
        # Check before binding: Python's own error would not suggest the right name.
        for name in named:
            if name not in known:
                raise unknown_argument(kind.__name__, name, known)
        bound = kind.__signature__.bind(*given, **named).arguments
        bound |= bound.pop("settings", {})
        return (
            {**self.defaults, **{name: value for name, value in bound.items() if name not in own}},
            {name: value for name, value in bound.items() if name in own},
        )


LOOKS = {
    "render_mode": (
        '"rgb_array", for frames of `render`, or "human", for a window. In a duel a frame shows how'
        ' a step ended; with "rgb_array_list" it gets all frames since it was last called, or since'
        " the reset, 25 for each second of racing (:class:`pcs_racing.envs.video.RecordRaces` makes"
        " a video of them)."
    ),
    "view": '"track", "both" (all cars stay in sight), or "car_0" to "car_7": what a frame shows.',
    "render_size": "Width and height of a frame in pixels.",
    "max_cycles": "Steps after which an episode is truncated.",
}
"""Meanings of the environment's own arguments."""


def _listed(kind: Any) -> str:
    """Return the docstring section with the arguments of a class and their meanings."""
    declared, parameters = kind.declared, kind.__signature__.parameters
    lines = ["Parameters", "----------", *listed_settings(declared.options)]
    for name, meaning in LOOKS.items():
        if name in parameters:
            lines += listed_argument(name, type_name(parameters[name].annotation), meaning)
    if declared.more is not None:
        lines += listed_settings(
            declared.more, *declared.defaults, *declared.without, defaults=True
        )
    return "\n".join(lines)


class OverBatch:
    """Base class of environments over a batch: construction, copies, and frames.

    Placeholders in braces in the docstring of a class are replaced by its arguments and its
    ``observation_table``.
    """

    batch_type: ClassVar[type[Batch]]
    declared: ClassVar[Declared]  #: Arguments of the batch.
    __signature__: ClassVar[Signature]  #: Signature of the class in Python's help.
    players: int = 1  #: Number of environments of an episode: 2 for both cars of a race.
    batch: Batch
    metadata: dict[str, Any] = {"render_modes": list(MODES), "render_fps": 1}  # noqa: RUF012
    render_mode: str | None
    view: str
    render_size: tuple[int, int]  #: Width and height of a frame in pixels.
    _arguments: dict[str, Any]  # arguments of the batch
    _spec: EnvSpec | None = None
    _renderer: Renderer | None = None

    def __init_subclass__(cls, observation_table: str = "", **options: Any) -> None:
        super().__init_subclass__(**options)
        if hasattr(cls, "declared"):
            cls.__signature__ = cls.declared.signature(cls._begin, cls.players)
            doc = cls.__doc__ or ""  # there is none with ``python -OO``
            if "{arguments}" in doc:
                for mark, text in (
                    ("{observation_table}", observation_table),
                    ("{arguments}", _listed(cls)),
                ):
                    doc = doc.replace(mark, text.replace("\n", "\n    "))
                cls.__doc__ = doc

    def __init__(self, *given: Any, **named: Any) -> None:
        arguments, own = self.declared.sort(type(self), given, named)
        self._begin(arguments=arguments, **own)

    def _begin(self, *args: Any, **kwargs: Any) -> None:
        """Make the batch from its ``arguments``, and the environment from the other arguments.

        Each other argument is stored as an attribute with the same name, for copies.
        """
        raise NotImplementedError

    def _make_batch(self, arguments: dict[str, Any]) -> Batch:
        raise NotImplementedError

    def _players(self, arguments: dict[str, Any]) -> tuple[dict[str, Any], int]:
        """Return the batch's own arguments and its number of players."""
        return arguments, self.players

    def _use(self, batch: Batch, arguments: dict[str, Any]) -> None:
        check_choice("view", self.view, views(batch.cars))
        self.batch, self._arguments = batch, arguments
        own = {"render_fps": self._frames_per_second(), "codes": batch.codes}
        self.metadata = {**type(self).metadata, **own}

    def _set_looks(self, render_mode: str | None, view: str, render_size: tuple[int, int]) -> None:
        if render_mode is not None:
            check_choice("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode, self.view, self.render_size = render_mode, view, render_size

    @property
    def spec(self) -> EnvSpec | None:
        """Specification of the environment, with the max number of steps as ``max_episode_steps``.

        The registry does not hold this number: it would truncate episodes with a longer duration.
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
        """Name, unit, bounds and meaning of every element of an environment's observation."""
        return list(self.batch.elements)

    @property
    def track(self) -> Track:
        """Track of the environment."""
        return self.batch.track

    # Resets

    def _options(self, options: Any, *more: str) -> dict[str, Any]:
        """Return the options of a reset except None; ``more`` are further known names."""
        if options is None:
            return {}
        if not isinstance(options, Mapping):
            raise InputError(f"options are {options!r}; they must be None or a mapping")
        known = (*more, *REBUILDING, *self.batch.reset_options)
        for name in options:
            if name not in known:
                raise UnknownNameError(
                    f"reset option {name!r} is unknown; {choices(str(name), known)}"
                )
        return {name: value for name, value in options.items() if value is not None}

    def _batch_for(self, options: dict[str, Any]) -> tuple[Batch, dict[str, Any]]:
        """Return the batch of a reset and its arguments.

        Options that replace arguments are removed from ``options``.
        """
        changes = {name: options.pop(name) for name in REBUILDING if name in options}
        arguments = {**self._arguments, **changes}
        return (self._make_batch(arguments) if changes else self.batch), arguments

    def _change_to(self, batch: Batch, arguments: dict[str, Any]) -> None:
        """Switch to another batch after the start of its first episode.

        An earlier error leaves the environment unchanged.
        """
        if batch is not self.batch:
            self._close_renderer()  # it shows the former track
            self._use(batch, arguments)

    def _check_started(self) -> None:
        """Raise an :class:`InputError` before the first reset."""
        raise NotImplementedError

    @contextmanager
    def unless_refused(self) -> Iterator[None]:
        """Restore the environment if a reset within the context is refused after random draws."""
        batch, arguments, state = self.batch, self._arguments, self.get_state()
        try:
            yield
        except Exception:
            self._change_to(batch, arguments)
            self.set_state(state)
            raise

    # Copies are made from the arguments: they share the track, but no compiled code and no window.

    def get_state(self) -> Any:
        """Return the full state, which determines the current and all later episodes."""
        raise NotImplementedError

    def set_state(self, state: Any) -> Any:
        """Continue from a state of `get_state`, from an environment with equal arguments."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        own = {
            name: getattr(self, name)
            for name in signature(self._begin).parameters
            if name != "arguments"
        }
        return _rebuild, (type(self), {**self._arguments, **own}, self.get_state(), self._spec)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        function, arguments = self.__reduce__()
        copied: Self = function(*arguments)
        return copied

    # Frames

    def _open_renderer(self) -> Renderer:
        """Return the renderer of the frames; it is made for the first frame."""
        if self.render_mode is None:
            raise InputError(
                "render_mode is None; make the environment with another one, such as 'rgb_array'"
            )
        self._check_started()
        if self._renderer is None:
            fps = float(self.metadata["render_fps"])
            mode = "human" if self.render_mode == "human" else "rgb_array"
            self._renderer = Renderer(self.track, *self.render_size, mode, view=self.view, fps=fps)
        return self._renderer

    def _show_step(self) -> None:
        """Show the end of the first environment's last step in the window."""
        self.batch.draw(self._open_renderer(), 0)

    def _frames_per_second(self) -> int:
        """Return the frame rate of `render` or the window."""
        return self.batch.frame_rate

    def _close_renderer(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _rebuild(kind: type[Any], arguments: dict[str, Any], state: Any, spec: EnvSpec | None) -> Any:
    made = kind(**arguments)
    made.set_state(state)
    made.spec = spec
    return made
