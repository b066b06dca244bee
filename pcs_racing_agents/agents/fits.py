"""Choices made on training races, as small files: a sequence of moves, or target policies.

:mod:`pcs_racing_agents.tournament.fitting` makes the choices; the agents read them from here.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcs_racing.base.artifacts import ManifestFormat
from pcs_racing.base.checks import check_text, check_whole, is_whole
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.game.identity import GameIdentity, check_same_game
from pcs_racing_agents.agents.game_spec import GameSpec, shipped_name

FIT_FORMAT = ManifestFormat(
    "fit",
    ("kind", "choice", "archive", "archive_sha256", "race", "epsilon", "moves", "training"),
    "save_fit",
)
KINDS: dict[str, tuple[type, str]] = {
    "best-schedule": (list, "a list of moves"),
    "best-fixed": (int, "the index of a policy"),
    "best-lead-plan": (dict, "the indices of two policies, behind and ahead"),
}
"""Kinds of fits: type and description of the choice."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A choice made on training races, with the game that it is valid for."""

    kind: str  #: Name of the agent that follows the choice.
    choice: Any  #: Names of moves, index of a policy, or indices of the policies behind and ahead.
    #: Game of the training races; a file records no names of moves and elements.
    game: GameIdentity
    #: Facts about the training and its result: texts and numbers by name.
    training: Mapping[str, str | int | float | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in KINDS:
            raise UnknownNameError(
                f"fit of {self.kind!r} is unknown; there are fits of {', '.join(KINDS)}"
            )
        kind, wanted = KINDS[self.kind]
        # A bool is an int in Python, but no index of a policy.
        if not (is_whole(self.choice) if kind is int else isinstance(self.choice, kind)):
            raise InputError(f"the choice of {self.kind} is {self.choice!r}; it must be {wanted}")
        if not isinstance(self.training, Mapping):
            raise InputError(f"training is {self.training!r}; it must be a mapping")

    def check_fits(self, spec: GameSpec) -> None:
        """Check that a choice is valid for a game."""
        check_same_game(self.game, spec.identity, f"the fit of {self.kind}")


def make_fit(kind: str, choice: Any, spec: GameSpec, training: Mapping[str, Any]) -> Fit:
    """Return the fit of a choice for a game spec."""
    return Fit(kind, choice, spec.identity._replace(elements=(), moves=()), dict(training))


def save_fit(fit: Fit, path: str | Path) -> Path:
    """Write a fit as YAML, atomically."""
    fields = {
        "kind": fit.kind,
        "choice": fit.choice,
        **game_fields(fit.game),
        "training": dict(fit.training),
    }
    FIT_FORMAT.write(Path(path), fields)
    return Path(path)


def load_fit(path: str | Path) -> Fit:
    """Read a fit."""
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"fit {path!r} must be the path of a file")
    fields = FIT_FORMAT.read(path)
    try:
        return Fit(fields["kind"], fields["choice"], recorded_game(fields), fields["training"])
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None


def shipped_fits() -> Path:
    """Return the folder of the shipped fits; files have names ``ARCHIVE-RACE-KIND.yaml``."""
    return Path(__file__).resolve().parents[1] / "data" / "fits"


FitSource = str | Path | Fit | None
"""A fit, its file, or None for the shipped fit."""


def find_fit(kind: str, spec: GameSpec, source: FitSource = None) -> Fit:
    """Return a fit for a game spec: the given fit, a fit from a file, or the shipped fit."""
    if source is None:
        known = sorted(path.stem for path in shipped_fits().glob("*.yaml"))
        how = "choose one with pcs_racing_agents.tournament.fitting and give it as fit=FILE"
        name = shipped_name(spec, kind, known, f"agent {kind!r}", how)
        source = shipped_fits() / f"{name}.yaml"
    fit = source if isinstance(source, Fit) else load_fit(source)
    if fit.kind != kind:
        raise InputError(f"the fit is one of {fit.kind!r}; agent {kind!r} needs its own")
    fit.check_fits(spec)
    return fit


def game_fields(game: GameIdentity) -> dict[str, Any]:
    """Return the fields of a game for a manifest, without the names of moves and elements."""
    return {
        "archive": game.archive,
        "archive_sha256": game.archive_sha256,
        "race": game.preset,
        "epsilon": list(game.epsilon),
        "moves": game.decisions,
    }


def recorded_game(fields: Mapping[str, Any]) -> GameIdentity:
    """Return the identity of the game that :func:`game_fields` recorded."""
    archive, digest, preset = (
        check_text(key, fields[key]) for key in ("archive", "archive_sha256", "race")
    )
    epsilon = fields["epsilon"]
    if not isinstance(epsilon, list) or not all(isinstance(length, float) for length in epsilon):
        raise InputError(f"epsilon is {epsilon!r}; it must be a list of numbers")
    decisions = check_whole("moves", fields["moves"], 1)
    return GameIdentity((), (), tuple(epsilon), archive, digest, preset, decisions)
