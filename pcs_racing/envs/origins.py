"""Origin of a space: the environment that made it, with its arguments, as JSON in an attribute.

Libraries keep the spaces of a training with a model. Stable-Baselines3 writes the attribute as
readable text into its zip, so that a saved model names the environment where it learned.
"""

import json
from collections.abc import Mapping
from typing import Any

from pcs_racing.base.errors import InputError

ATTRIBUTE = "pcs_racing"
"""Attribute of a space with the JSON of a mapping: "environment", and arguments by name."""

MAX_LENGTH = 100_000


def mark(space: Any, environment: str, arguments: Mapping[str, Any]) -> Any:
    """Return a space with its origin."""
    text = json.dumps({"environment": environment, **arguments})
    setattr(space, ATTRIBUTE, text)
    return space


def origin_text(owner: Any) -> str | None:
    """Return the origin of the spaces of an environment or a model, as text; None without one."""
    for name in ("single_observation_space", "observation_space"):
        text = getattr(getattr(owner, name, None), ATTRIBUTE, None)
        if isinstance(text, str):
            return text
    return None


def read_origin(text: str, owner: str) -> dict[str, Any]:
    """Return the mapping of an origin's text."""
    try:
        values = json.loads(text) if len(text) <= MAX_LENGTH else None
    except ValueError:
        values = None
    return check_origin(values, owner)


def check_origin(values: Any, owner: str) -> dict[str, Any]:
    """Return an origin; refuse other values."""
    if not isinstance(values, dict) or values.get("environment") not in ("drive", "duel", "line"):
        raise InputError(
            f"{owner}: the environment of its training is {values!r:.80}; it must be drive, duel or"
            " line, with arguments"
        )
    return values
