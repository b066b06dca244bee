"""Names of shipped training results, and facts about a training as text."""

from collections.abc import Mapping, Sequence
from typing import Any

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game.rules import RaceGame


def training_text(facts: Mapping[str, Any]) -> str:
    """Return the facts about an agent's training as text for reports."""
    return ", ".join(f"{key} {value}" for key, value in facts.items()) or "not said"


def shipped_name(spec: RaceGame, kind: str, known: Sequence[str], agent: str, how: str) -> str:
    """Return ``ARCHIVE-RULES-KIND``, the name of a shipped training result for a game."""
    end = f"-{spec.rules.name}-{kind}"
    name = f"{spec.archive.name}{end}"
    if name not in known:
        other = next((one.removesuffix(end) for one in known if one.endswith(end)), "")
        hint = f"give archive={other!r}, or " if other else ""
        raise UnknownNameError(
            f"{agent} needs {name!r}, which is not shipped (there are:"
            f" {', '.join(known) or 'none'}); {hint}{how}"
        )
    return name
