"""Behaviours of a pool of opponents, as observed in races, and the scores of an archive's policies
against them.

:func:`studies.matches.learning.learn_behaviours` measures them in training races; the agent
"remember" looks the best reply up in them.
"""

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import unpack_arrays
from pcs_racing.game.identity import GameIdentity, check_same_game
from pcs_racing.game.observation import RaceMemory
from pcs_racing_agents.agents.fits import game_fields, recorded_game
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.base.fingerprint import fingerprint

Floats = NDArray[np.float64]

BEHAVIOURS_FORMAT = ArtifactFormat(
    "table of behaviours",
    ("archive", "archive_sha256", "race", "epsilon", "moves", "opponents", "training", "sha256"),
    "save_behaviours",
    data_file="behaviours.npz",
    max_bytes=64_000_000,
)
ARRAYS = ("scores", "seen", "covariance")


def features(memory: RaceMemory) -> Floats:
    """Return what tells opponents apart, of each race that was seen, shape (B, R, G + 2).

    The opponent's coordinates, the own lead at the end, and the share of its duration that the race
    lasted. One's own coordinates are not among them: seen behaviours are compared with what the own
    policy sees.
    """
    return np.concatenate(
        [memory.opponent, memory.lead[..., None], memory.driven[..., None]], axis=-1
    )


@dataclass(frozen=True, eq=False)
class Behaviours:
    """Opponents of a pool as each policy of an archive sees them, and the scores against them."""

    game: GameIdentity  #: The game that it is for; names of moves and elements are left out.
    opponents: tuple[str, ...]  #: Names of the N opponents.
    #: shape (K, N): Mean score of each policy of the archive in races against each opponent, 0 to
    #: 1.
    scores: Floats
    #: shape (K, N, F): Mean :func:`features` of each opponent in races against each policy.
    seen: Floats
    #: shape (F, F): Of the features from race to race, for the same two policies.
    covariance: Floats
    #: How it was measured: texts and numbers by name.
    training: Mapping[str, str | int | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        policies, opponents = self.scores.shape if self.scores.ndim == 2 else (0, 0)
        width = self.covariance.shape[-1] if self.covariance.ndim else 0
        shapes = (opponents,), self.seen.shape, self.covariance.shape
        if 0 in (policies, opponents, width) or shapes != (
            (len(self.opponents),),
            (policies, opponents, width),
            (width, width),
        ):
            raise InputError(
                f"scores of shape {self.scores.shape}, seen {self.seen.shape} and covariance"
                f" {self.covariance.shape} do not fit each other and {len(self.opponents)}"
                " opponents"
            )
        if not all(np.isfinite(getattr(self, name)).all() for name in ARRAYS):
            raise InputError("a table of behaviours holds NaN or infinity")
        try:
            np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            raise InputError(
                "the covariance of a table of behaviours is not positive definite"
            ) from None

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of everything that an agent looks up here."""
        return fingerprint(self.game.archive_sha256, *(getattr(self, name) for name in ARRAYS))

    @property
    def best_fixed(self) -> int:
        """Policy with the highest mean score against the pool."""
        return int(self.scores.mean(axis=1).argmax())

    def check_fits(self, spec: GameSpec, user: str) -> None:
        """Check that this was measured with the archive and the race rules of a game spec."""
        check_same_game(self.game, spec.identity, user)

    def distances(
        self, own: NDArray[np.int64], observed: Floats, known: NDArray[np.bool_]
    ) -> Floats:
        """Squared Mahalanobis distance of what was seen in R races from each opponent, shape (B,
        N).

        Parameters
        ----------
        own : ndarray of int, shape (B, R)
            Policy that was driven in each race.
        observed : ndarray, shape (B, R, F)
            :func:`features` of the races.
        known : ndarray of bool, shape (B, R)
            Whether a race was seen; others do not count.
        """
        away = (observed[:, :, None, :] - self.seen[own]) @ np.linalg.inv(
            np.linalg.cholesky(self.covariance)
        ).T
        return np.asarray((np.square(away).sum(axis=-1) * known[:, :, None]).sum(axis=1))


def save_behaviours(table: Behaviours, folder: str | Path) -> Path:
    """Write a table into a folder, which is made if need be; returns the folder."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, allow_pickle=False, **{name: getattr(table, name) for name in ARRAYS}
    )
    fields = {
        **game_fields(table.game),
        "opponents": list(table.opponents),
        "training": dict(table.training),
    }
    return BEHAVIOURS_FORMAT.save(folder, fields, buffer.getvalue())


def load_behaviours(source: str | os.PathLike[str] | Behaviours) -> Behaviours:
    """Return a table from its folder, or as it is."""
    if isinstance(source, Behaviours):
        return source
    folder = BEHAVIOURS_FORMAT.find(source)
    fields, content = BEHAVIOURS_FORMAT.load(folder)
    where = folder / MANIFEST
    opponents, training = fields["opponents"], fields["training"]
    if not isinstance(opponents, list) or not all(isinstance(name, str) for name in opponents):
        raise InputError(f"{where}: opponents is {opponents!r:.80}; it must be a list of names")
    if not isinstance(training, dict):
        raise InputError(f"{where}: training is {training!r:.80}; it must be a mapping")
    arrays: dict[str, Any] = unpack_arrays(content)
    if set(arrays) != set(ARRAYS):
        raise InputError(
            f"{folder / BEHAVIOURS_FORMAT.data_file} holds {sorted(arrays)}; it must hold"
            f" {sorted(ARRAYS)}"
        )
    try:
        floats = {name: np.asarray(arrays[name], np.float64) for name in ARRAYS}
        return Behaviours(recorded_game(fields), tuple(opponents), **floats, training=training)
    except (TypeError, ValueError) as error:
        raise InputError(f"{folder}: {error}") from None
