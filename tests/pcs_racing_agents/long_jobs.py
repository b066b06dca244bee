"""Small settings of the long commands, for tests of clusters and of faults, and what may differ between two runs."""

from pathlib import Path

SYNTHESIS = (
    "{duration: 4.0, final_duration: 4.0, segment_seconds: 2.0, scouts: 12, opponents: 1, starts: 1, candidates: 12,"
    " choice_opponents: 1, choice_starts: 1, final_opponents: 1, final_starts: 1, crash_limit: 1.0, fewest: 2}"
)
TREES = ["--archive", "default", "--track", "Pipkin", "--moves", "2", "--step", "2"]


def commands(folder: Path) -> dict[str, list[str]]:
    """Return a small call of every long command that runs on executors, without where it writes.

    Parameters
    ----------
    folder : Path
        For the settings of the synthesis.
    """
    settings = folder / "small.yaml"
    settings.write_text(SYNTHESIS)
    search = ["--config", str(settings), "--track", "Pipkin", "--generations", "6", "--population", "6"]
    return {
        "synthesize": ["synthesize", *search, "--name", "small"],
        "tree": ["tree", *TREES, "--pairs", "12"],
        "ego trees": ["tree", *TREES, "--ego", "40"],
        "tournament": [
            "tournament", "--track", "Pipkin", "--agents", "random-moves", "cfr-argmax", "lane-switcher",
            "--races", "4", "--duration", "16",
        ],
    }  # fmt: skip


def files(folder: Path) -> dict[str, bytes]:
    """Return what a command left, by path: all but the locks and TensorBoard's curves, which hold times."""
    found = {str(file.relative_to(folder)): file for file in sorted(folder.rglob("*")) if file.is_file()}
    return {
        name: file.read_bytes()
        for name, file in found.items()
        if file.name != ".lock" and "tensorboard" not in Path(name).parts
    }
