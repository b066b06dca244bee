"""Small settings of the long commands, for tests of clusters and of faults, and the allowed
differences between two runs.
"""

from pathlib import Path

from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.jobs import read_chunk

TREES = ["--archive", "default", "--track", "Pipkin", "--moves", "2", "--step", "2"]
SETTINGS = Path(__file__).parent / "settings"


def commands() -> dict[str, list[str]]:
    """Return a small call of every long command that runs on executors, without where it writes."""
    search = ["--config", str(SETTINGS / "synthesis.yaml"), "--track", "Pipkin"]
    search += ["--generations", "6", "--population", "6"]
    return {
        "synthesize": ["synthesize", *search, "--name", "small"],
        "tree": ["tree", *TREES, "--pairs", "12"],
        "tournament": [
            "tournament",
            "--track",
            "Pipkin",
            "--agents",
            "random-moves",
            "never-switch",
            "lane-switcher",
            "--races",
            "4",
            "--duration",
            "16",
        ],
        "ppo": [
            "train",
            "ppo",
            "--config",
            str(SETTINGS / "ppo_duel.yaml"),
            "--seeds",
            "0",
            "1",
            "2",
        ],
    }


def files(folder: Path) -> dict[str, bytes]:
    """Return the files of a command, without times in locks and PPO's chunks."""
    found = {
        str(file.relative_to(folder)): file for file in sorted(folder.rglob("*")) if file.is_file()
    }
    return {
        name: _without_times(file)
        for name, file in found.items()
        if file.name not in (".lock", "report.html")
    }


def _without_times(file: Path) -> bytes:
    if file.suffix != ".npz" or "chunks" not in file.parts:
        return file.read_bytes()
    arrays = read_chunk(file)
    if "seconds" not in arrays:
        return file.read_bytes()
    return fingerprint({key: array for key, array in arrays.items() if key != "seconds"}).encode()
