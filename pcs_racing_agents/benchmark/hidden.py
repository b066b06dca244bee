"""The hidden part of a protocol: circuits and a seed of races that nobody can train on before they are published.

The maintainers keep its file until the next release. A protocol states the file's SHA-256 from the beginning, so that
everybody can check later that nothing was chosen in between. Its seeds are large, or the hash could be guessed.
"""

import hashlib
from dataclasses import MISSING, dataclass, replace
from pathlib import Path

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import MAX_YAML, read_limited
from pcs_racing.base.settings import Settings, names, read_settings, setting, whole, wholes
from pcs_racing_agents.benchmark.card_values import HiddenScore
from pcs_racing_agents.benchmark.protocol import Protocol
from pcs_racing_agents.benchmark.scoring import CellRaces, summarise


@dataclass(frozen=True)
class HiddenConfig(Settings):
    """What a hidden part is made from."""

    circuits: tuple[int, ...] = setting(
        MISSING, wholes(2**32, 2**62, fewest=2, longest=8, different=True), "Seeds of generated circuits."
    )
    styles: tuple[str, ...] = setting(MISSING, names(), "Their styles, in turn.")
    seed: int = setting(MISSING, whole(2**32, 2**62), "Seed of the starts, policies and noise.")


def load_hidden(protocol: Protocol, file: Path, folder: Path) -> tuple[str, Protocol]:
    """Return the SHA-256 of a hidden part's file, and the protocol on its circuits, which are written into a folder."""
    from pcs_racing.track.mapping.folders import generate_map

    try:
        digest = hashlib.sha256(read_limited(file, MAX_YAML, "a hidden part")).hexdigest()
    except OSError as error:
        raise InputError(f"can't read {file}: {error.strerror}") from None
    if digest != protocol.config.hidden:
        raise InputError(
            f"{file} has the SHA-256 {digest}; protocol {protocol.config.name!r} states {protocol.config.hidden}"
        )
    config = HiddenConfig(**read_settings(file))
    tracks = {}
    for i, seed in enumerate(config.circuits):
        name = f"Hidden{i + 1}"
        tracks[name] = generate_map(folder / name, seed, config.styles[i % len(config.styles)], name=name)
    # A protocol has circuits of both kinds; nobody has seen any of these, and only their sum is told.
    first, *others = tracks
    races = replace(protocol.config, seen=(first,), unseen=tuple(others), seed=config.seed, hashes=())
    return digest, replace(protocol, config=races, tracks=tracks)


def hidden_score(digest: str, races: list[CellRaces]) -> HiddenScore:
    """Return the score of an agent over all races of the hidden part."""
    total = next(score for score in summarise(races) if (score.part, score.circuits) == ("all", "all"))
    return HiddenScore(digest, total.races, total.score, total.low, total.high, total.own_crash)
