"""The configurations that come with the package."""

from pathlib import Path

__all__ = ["shipped_configs"]


def shipped_configs(kind: str) -> dict[str, Path]:
    """Configurations of a kind, by name: the files ``configs/KIND_NAME.yaml``."""
    folder = Path(__file__).resolve().parents[1] / "configs"
    return {
        file.stem.removeprefix(f"{kind}_"): file
        for file in sorted(folder.glob(f"{kind}_*.yaml"), key=lambda file: file.stem)
    }
