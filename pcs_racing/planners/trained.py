"""Format of the folders of trained planners: a manifest and the weights of a network."""

from pathlib import Path

from pcs_racing.base.artifacts import ArtifactFormat
from pcs_racing.base.files import shipped_folder

PLANNER_FORMAT = ArtifactFormat(
    "planner",
    ("name", "training", "weights_sha256"),
    "save_planner",
    data_file="weights.safetensors",
    digest_key="weights_sha256",
    max_bytes=4_000_000,
    shipped=shipped_folder(Path(__file__).resolve().parents[1], "planners"),
)
"""Parts that all kinds of trained planners share; a kind replaces noun, keys and writer."""
