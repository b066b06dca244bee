"""Configurations of a kind: those that come with the package, and files of a user."""

from pathlib import Path
from typing import Any, TypeVar

from pcs_racing.base.settings import Settings, load_settings

Kind = TypeVar("Kind", bound=Settings)


def shipped_configs(kind: str) -> dict[str, Path]:
    """Configurations of a kind, by name: the files ``data/configurations/KIND_NAME.yaml``."""
    folder = Path(__file__).resolve().parents[1] / "data" / "configurations"
    return {
        file.stem.removeprefix(f"{kind}_"): file
        for file in sorted(folder.glob(f"{kind}_*.yaml"), key=lambda file: file.stem)
    }


def load_config(
    kind: str, default: Kind, source: str | Path | Kind | None, /, **changes: Any
) -> Kind:
    """Return a configuration from a shipped one's name, a YAML file or settings, with some fields
    changed.
    """
    return load_settings(kind, default, source, shipped_configs(kind), **changes)
