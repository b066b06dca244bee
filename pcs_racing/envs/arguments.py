"""Keyword arguments of the environments: those of a class and the fields of its settings."""

import inspect
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from pcs_racing.base.errors import unknown_argument

FRAME = (
    "self",
    "num_envs",
    "autoreset_mode",
    "max_episode_steps",
    "max_cycles",
    "threads",
    "render_mode",
    "view",
    "render_size",
)
"""Arguments of the environment itself; all others are the batch's."""


def batch_arguments(
    kind: type[Any], given: Mapping[str, Any], settings: type[Any], more: Mapping[str, Any]
) -> dict[str, Any]:
    """Arguments of the batch behind an environment.

    Parameters
    ----------
    kind : type
        The environment's class.
    given : Mapping
        Values of its named arguments: ``locals()`` of its ``__init__``.
    settings : type
        Dataclass of which every field may be given, too.
    more : Mapping
        The other keyword arguments.
    """
    named = [
        name
        for name, parameter in inspect.signature(kind).parameters.items()
        if parameter.kind is not parameter.VAR_KEYWORD
    ]
    known = [field.name for field in fields(settings)]
    for name in more:
        if name not in known:
            raise unknown_argument(kind.__name__, name, dict.fromkeys([*named, *known]))
    return {**{name: given[name] for name in named if name in given and name not in FRAME}, **more}
