"""Command line and folder of a training: checked numbers, a lock, a checkpoint, and its races."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from filelock import FileLock, Timeout

from pcs_racing import InputError, load_track, racer
from pcs_racing.envs.draws import load_randomization

OF_THE_RACES = ("seed", "tracks", "cars", "random", "each", "batches")
"""Arguments that, with the draws of the cars, determine the races; others begin races again."""
MAY_BE_ZERO = {
    *("seed", "random", "checks", "updates", "every", "entropy"),
    *("warm", "fade", "bold", "progress", "gain", "win", "passing"),
}


def read_arguments(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Read the command line; refuse impossible numbers and unknown names."""
    arguments = parser.parse_args()
    for name, value in vars(arguments).items():
        if isinstance(value, list) and not value:
            parser.error(f"--{name} needs at least one name")
        zero = name in MAY_BE_ZERO
        if isinstance(value, int | float) and not (value >= 0.0 if zero else value > 0.0):
            parser.error(f"--{name} is {value:g}; it must be {'at least' if zero else 'above'} 0")
    if arguments.device.startswith("cuda") and not torch.cuda.is_available():
        parser.error(f"--device is {arguments.device!r}, but torch finds no such device")
    try:
        arguments.randomize = load_randomization(arguments.randomize)
        arguments.randomize.check_cars(2)
        for name in arguments.tracks:
            load_track(name)
        for name in arguments.rivals:
            racer(name)
    except InputError as error:
        parser.error(str(error))
    return arguments


class RunFolder:
    """Folder that one training at a time holds."""

    def __init__(self, arguments: argparse.Namespace, say: Callable[[str], None]) -> None:
        self.path: Path = arguments.out
        self.settings = {name: getattr(arguments, name) for name in OF_THE_RACES}
        self.settings["randomize"] = arguments.randomize.plain()
        self.say = say
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self.lock = FileLock(self.path / ".lock")
            self.lock.acquire(timeout=0)
        except Timeout:
            raise SystemExit(f"error: another training writes to {self.path}") from None
        except OSError as error:
            raise SystemExit(f"error: can't write to {self.path}: {error.strerror}") from None

    def checkpoint(self) -> dict[str, Any] | None:
        """Return the last checkpoint."""
        file = self.path / "checkpoint.pt"
        if not file.exists():
            return None
        try:
            return dict(torch.load(file, "cpu", weights_only=True))
        except Exception as error:  # whatever torch makes of a damaged file
            raise SystemExit(f"error: {file} is no checkpoint: {error}") from None

    def best(self, saved: dict[str, Any]) -> float:
        """Return the best merit of a checkpoint; merits on other cars do not count."""
        same = saved.get("randomize", {}) == self.settings["randomize"]
        return float(saved["best"]) if same else -1e9

    def races(self, updates: int) -> dict[str, Any] | None:
        """Return the races of the checkpoint; without equal settings there are none."""
        file = self._races(updates)
        if updates == 0:
            return None
        try:
            saved = torch.load(file, weights_only=True)
        except Exception:  # missing, or whatever torch makes of a damaged file
            self.say(f"races begin again: {file.name} is missing or damaged")
            return None
        before = saved["settings"]
        changed = [f"--{name}" for name in self.settings if before.get(name) != self.settings[name]]
        if changed:
            self.say(f"races begin again: they were driven with another {', '.join(changed)}")
            return None
        return dict(saved)

    def save(self, updates: int, races: dict[str, Any], checkpoint: dict[str, Any]) -> None:
        """Write races and checkpoint; a stop at any time leaves a pair that belongs together."""
        self._write(self._races(updates), {"settings": self.settings, **races})
        self._write(
            self.path / "checkpoint.pt",
            {"updates": updates, "randomize": self.settings["randomize"], **checkpoint},
        )
        for file in self.path.glob("races-*.pt"):
            if file != self._races(updates):
                file.unlink()

    def _races(self, updates: int) -> Path:
        return self.path / f"races-{updates}.pt"

    def _write(self, file: Path, values: dict[str, Any]) -> None:
        new = file.with_suffix(".new")
        torch.save(values, new)
        new.replace(file)
