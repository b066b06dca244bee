"""Learned characteristics as files: a YAML manifest of names, scales and weights, readable by people."""

import os
from pathlib import Path

from pcs_racing.base.artifacts import ManifestFormat
from pcs_racing.base.errors import InputError
from pcs_racing.game.learned import LearnedCharacteristics, register_learned

LEARNED_FORMAT = ManifestFormat(
    "set of characteristics", ("name", "inputs", "axes", "training", "sha256"), "save_learned"
)


def save_learned(learned: LearnedCharacteristics, path: str | os.PathLike[str]) -> Path:
    """Write learned characteristics as YAML; the file appears whole or not at all."""
    LEARNED_FORMAT.write(Path(path), learned.to_plain())
    return Path(path)


def load_learned(source: str | os.PathLike[str] | LearnedCharacteristics) -> LearnedCharacteristics:
    """Return learned characteristics from their file, or as they are, and register them."""
    if isinstance(source, LearnedCharacteristics):
        register_learned(source)
        return source
    if not isinstance(source, str | os.PathLike):
        raise InputError(f"learned characteristics {source!r:.80} must be the path of a file")
    fields = LEARNED_FORMAT.read(source)
    try:
        learned = LearnedCharacteristics.from_plain(fields)
        register_learned(learned)
    except InputError as error:
        raise type(error)(f"{source}: {error}") from None
    return learned
