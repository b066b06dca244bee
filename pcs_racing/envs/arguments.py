"""Arguments of the environments: declared once, as fields of a dataclass, for all classes over the same batch."""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property
from inspect import Parameter, Signature, signature
from typing import Any

from pcs_racing.base.errors import unknown_argument

_BY_PLACE, _BY_NAME = Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY


@dataclass(frozen=True)
class Declared:
    """Arguments that a class of environments takes for its batch."""

    options: type[Any]  #: Dataclass of the batch's arguments; the environment's have the same defaults, unless changed.
    positional: tuple[str, ...] = ()  #: Those that may be given by position, in order.
    named: tuple[str, ...] | None = None  #: The others that the class describes itself; all of them by default.
    more: type[Any] | None = None  #: Dataclass of which every field may be given, too.
    changed: Mapping[str, Any] = field(default_factory=dict)  #: Other defaults, by name.

    @cached_property
    def defaults(self) -> dict[str, Any]:
        """Value of each argument that is not given."""
        declared = {
            one.name: one.default if one.default_factory is MISSING else one.default_factory()
            for one in fields(self.options)
        }
        return declared | dict(self.changed)

    def signature(self, begin: Callable[..., Any], players: int) -> Signature:
        """Signature of a class: the batch's arguments, and those of its method ``begin`` except ``arguments``."""
        own = [one for name, one in signature(begin).parameters.items() if name not in ("self", "arguments")]
        listed = [name for name in self.defaults if name not in self.positional]
        if self.named is not None:
            listed = [name for name in listed if name in self.named]
        kinds = {one.name: one.type for one in fields(self.options)}
        parameters = [one.replace(kind=_BY_PLACE, default=players) for one in own if one.name == "num_envs"]
        for names, way in ((self.positional, _BY_PLACE), (listed, _BY_NAME)):
            parameters += [Parameter(name, way, default=self.defaults[name], annotation=kinds[name]) for name in names]
        parameters += [one.replace(kind=_BY_NAME) for one in own if one.name != "num_envs"]
        if self.more is not None or self.named is not None:
            parameters.append(Parameter("settings", Parameter.VAR_KEYWORD, annotation=Any))
        return Signature(parameters)

    def sort(
        self, kind: type[Any], given: tuple[Any, ...], named: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the arguments of the batch, those that are not given included, and those of the environment itself.

        Raises
        ------
        TypeError
            If one is given twice, or too many are given by position, in Python's words.
        """
        own = kind.__signature__.parameters.keys() - self.defaults.keys() - {"settings"}
        more = () if self.more is None else (one.name for one in fields(self.more))
        known = dict.fromkeys([*kind.__signature__.parameters, *self.defaults, *more])
        known.pop("settings", None)
        for name in named:
            if name not in known:
                raise unknown_argument(kind.__name__, name, known)
        bound = kind.__signature__.bind(*given, **named).arguments
        bound |= bound.pop("settings", {})
        return (
            {**self.defaults, **{name: value for name, value in bound.items() if name not in own}},
            {name: value for name, value in bound.items() if name in own},
        )
