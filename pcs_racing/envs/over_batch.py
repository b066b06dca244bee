"""What all environments have in common: they are views of a batch, made from arguments that are declared once."""

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
"""What environments are views of."""

REBUILDING = ("track", "opponent")
"""Options of a reset that stand for arguments of the environment."""

_BY_PLACE, _BY_NAME = Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY


@dataclass(frozen=True)
class Declared:
    """Arguments that a class of environments takes for its batch."""

    options: type[Any]  #: Dataclass of the batch's arguments; the environment's have the same defaults, unless changed.
    positional: tuple[str, ...] = ()  #: Those that may be given by position, in order.
    more: type[Any] | None = None  #: Dataclass of which every field may be given, too, ...
    without: tuple[str, ...] = ()  #: ... but these.
    changed: Mapping[str, Any] = field(default_factory=dict)  #: Other defaults, by name.

    @cached_property
    def defaults(self) -> dict[str, Any]:
        """Value of each argument that is not given."""
        return {one.name: one.default for one in fields(self.options)} | dict(self.changed)

    def signature(self, begin: Callable[..., Any], players: int) -> Signature:
        """Signature of a class: the batch's arguments, and those of its method ``begin`` except ``arguments``."""
        own = [one for name, one in signature(begin).parameters.items() if name not in ("self", "arguments")]
        listed = [name for name in self.defaults if name not in self.positional]
        kinds = {one.name: one.type for one in fields(self.options)}
        # Python wants arguments by place first: the number of environments, the circuit, the opponent.
        parameters = [one.replace(kind=_BY_PLACE, default=players) for one in own if one.name == "num_envs"]
        for names, way in ((self.positional, _BY_PLACE), (listed, _BY_NAME)):
            parameters += [Parameter(name, way, default=self.defaults[name], annotation=kinds[name]) for name in names]
        parameters += [one.replace(kind=_BY_NAME) for one in own if one.name != "num_envs"]
        if self.more is not None:
            parameters.append(Parameter("settings", Parameter.VAR_KEYWORD, annotation=Any))
        return Signature(parameters)

    def sort(
        self, kind: type[Any], given: tuple[Any, ...], named: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the arguments of the batch, those that are not given included, and those of the environment itself."""
        own = kind.__signature__.parameters.keys() - self.defaults.keys() - {"settings"}
        more = () if self.more is None else (one.name for one in fields(self.more))
        known = dict.fromkeys([*kind.__signature__.parameters, *more])
        known.pop("settings", None)
        # Before Python binds them: its own error would not say which name was meant.
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
    "render_mode": '"rgb_array", for frames of `render`, or "human", for a window. In a duel a frame shows how a step '
    'ended; with "rgb_array_list" it gets all frames since it was last called, or since the reset, 25 for each second '
    "of racing (:class:`pcs_racing.envs.video.RecordRaces` makes a video of them).",
    "view": '"track", "both" (all cars stay in sight), or "car_0" to "car_7": what a frame shows.',
    "render_size": "Width and height of a frame in pixels.",
    "max_cycles": "Steps after which an episode is truncated.",
}
"""What arguments mean that no batch has."""


def _listed(kind: Any) -> str:
    """The arguments of a class, and what they mean: a section of its docstring."""
    declared, parameters = kind.declared, kind.__signature__.parameters
    lines = ["Parameters", "----------", *listed_settings(declared.options)]
    for name, meaning in LOOKS.items():
        if name in parameters:
            lines += listed_argument(name, type_name(parameters[name].annotation), meaning)
    if declared.more is not None:
        lines += listed_settings(declared.more, *declared.defaults, *declared.without, defaults=True)
    return "\n".join(lines)


class OverBatch:
    """What an environment over a batch knows of it, how it was made and is copied, and its frames.

    Into the docstring of a class go, where it says so in braces, its arguments and the ``observation_table`` that it is
    defined with.
    """

    batch_type: ClassVar[type[Batch]]
    declared: ClassVar[Declared]  #: Arguments of the batch.
    __signature__: ClassVar[Signature]  #: What Python shows as the class's arguments.
    players: int = 1  #: Environments that belong to the same episode: 2 for both cars of a race.
    batch: Batch
    metadata: dict[str, Any] = {"render_modes": list(MODES), "render_fps": 1}  # noqa: RUF012
    render_mode: str | None
    view: str
    render_size: tuple[int, int]  #: Width and height of a frame in pixels.
    _arguments: dict[str, Any]  # of the batch
    _spec: EnvSpec | None = None
    _renderer: Renderer | None = None

    def __init_subclass__(cls, observation_table: str = "", **options: Any) -> None:
        super().__init_subclass__(**options)
        if hasattr(cls, "declared"):
            cls.__signature__ = cls.declared.signature(cls._begin, cls.players)
            doc = cls.__doc__ or ""  # there is none with ``python -OO``
            if "{arguments}" in doc:
                for mark, text in (("{observation_table}", observation_table), ("{arguments}", _listed(cls))):
                    doc = doc.replace(mark, text.replace("\n", "\n    "))
                cls.__doc__ = doc

    def __init__(self, *given: Any, **named: Any) -> None:
        arguments, own = self.declared.sort(type(self), given, named)
        self._begin(arguments=arguments, **own)

    def _begin(self, *args: Any, **kwargs: Any) -> None:
        """Make the batch with its ``arguments``, and the environment over it with the others.

        Each of the others is kept as an attribute of its name: a copy is made with them.
        """
        raise NotImplementedError

    def _make_batch(self, arguments: dict[str, Any]) -> Batch:
        raise NotImplementedError

    def _players(self, arguments: dict[str, Any]) -> tuple[dict[str, Any], int]:
        """Return the arguments that the batch itself takes, and its players."""
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
        return self.batch.track

    # Resets

    def _options(self, options: Any, *more: str) -> dict[str, Any]:
        """Return the options of a reset, those that are None left out; ``more`` are known beside the batch's."""
        if options is None:
            return {}
        if not isinstance(options, Mapping):
            raise InputError(f"options are {options!r}; they must be None or a mapping")
        known = (*more, *REBUILDING, *self.batch.reset_options)
        for name in options:
            if name not in known:
                raise UnknownNameError(f"reset option {name!r} is unknown; {choices(str(name), known)}")
        return {name: value for name, value in options.items() if value is not None}

    def _batch_for(self, options: dict[str, Any]) -> tuple[Batch, dict[str, Any]]:
        """Return the batch of a reset and its arguments, some of which its options, taken out here, may replace."""
        changes = {name: options.pop(name) for name in REBUILDING if name in options}
        arguments = {**self._arguments, **changes}
        return (self._make_batch(arguments) if changes else self.batch), arguments

    def _change_to(self, batch: Batch, arguments: dict[str, Any]) -> None:
        """Use another batch from now on, when its first episode has begun: an error before leaves all as it was."""
        if batch is not self.batch:
            self._close_renderer()  # which knows the former circuit
            self._use(batch, arguments)

    def _check_started(self) -> None:
        """Raise an :class:`InputError` before the first reset."""
        raise NotImplementedError

    @contextmanager
    def unless_refused(self) -> Iterator[None]:
        """Leave the environment as it was if a reset within the context is refused, after its first random draws."""
        batch, arguments, state = self.batch, self._arguments, self.get_state()
        try:
            yield
        except Exception:
            self._change_to(batch, arguments)
            self.set_state(state)
            raise

    # Copies are made anew from the arguments: they share the track, and neither compiled code nor a window.

    def get_state(self) -> Any:
        """Return all that the rest of the episodes, and all later ones, depend on."""
        raise NotImplementedError

    def set_state(self, state: Any) -> Any:
        """Continue from what `get_state` returned, here or in an environment with equal arguments."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        own = {name: getattr(self, name) for name in signature(self._begin).parameters if name != "arguments"}
        return _rebuild, (type(self), {**self._arguments, **own}, self.get_state(), self._spec)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        function, arguments = self.__reduce__()
        copied: Self = function(*arguments)
        return copied

    # Frames

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
        """Show how the first environment's last step ended in the window."""
        self.batch.draw(self._open_renderer(), 0)

    def _frames_per_second(self) -> int:
        """Frame rate of what `render` returns, or the window shows."""
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
