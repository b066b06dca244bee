"""Archives, networks and learned planners of the Hugging Face hub.

A repository holds one folder as this package saves it. No code of a downloaded file runs.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pcs_racing.base.artifacts import MANIFEST
from pcs_racing.base.errors import InputError, require
from pcs_racing.game.archive_files import ARCHIVE_FORMAT, load_archive
from pcs_racing.planners.learned import LOADERS, folder_kind, load_planner, wrong_kind
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network

PART = r"\w(?:[\w.-]{0,94}\w)?"  # of a name, as the hub allows it
REPO = re.compile(rf"(?!.*(?:--|\.\.|\.git$)){PART}/{PART}", re.ASCII)
REVISION = re.compile(r"(?!.*\.\.)\w[\w./-]{0,199}", re.ASCII)
FILES = [MANIFEST, "*.npz", "*.safetensors"]
"""Names of the downloaded files; all other files of a repository stay on the hub."""

KINDS: dict[str, Callable[[Path], Any]] = {
    ARCHIVE_FORMAT.noun: load_archive,
    NETWORK_FORMAT.noun: load_network,
    **dict.fromkeys(LOADERS, load_planner),
}
"""Loader of each kind of folders."""


def load_from_hub(repo_id: str, *, revision: str | None = None) -> Any:
    """Download a repository of the Hugging Face hub; return its archive, network or planner.

    Parameters
    ----------
    repo_id : str
        Name of the repository, as ``"owner/name"``.
    revision : str, optional
        Branch, tag or commit; by default the newest commit. A commit gives the same files always.

    Returns
    -------
    PolicyArchive, RegretNetwork or Planner
        Object of the format that the manifest names.
    """
    _check_repo(repo_id)
    if revision is not None and not (isinstance(revision, str) and REVISION.fullmatch(revision)):
        raise InputError(f"revision is {revision!r:.80}; it must be a branch, a tag or a commit")
    require("huggingface_hub", extra="hub")
    from huggingface_hub import snapshot_download

    def download(*names: str) -> Path:
        try:
            return Path(snapshot_download(repo_id, revision=revision, allow_patterns=list(names)))
        except (OSError, ValueError) as error:
            reason = str(error).strip().partition("\n")[0]
            raise InputError(f"can't download {repo_id!r} from the hub: {reason}") from None

    # The manifest alone comes first: large files of a foreign repository stay on the hub.
    kind = _kind(download(MANIFEST))
    return KINDS[kind](download(*FILES))


def _check_repo(repo_id: str) -> None:
    """Check that a name of a repository is ``owner/name``."""
    if not isinstance(repo_id, str) or not REPO.fullmatch(repo_id):
        raise InputError(
            f"repo_id is {repo_id!r:.80}; it must be 'owner/name': letters, digits, and '-', '_' or"
            " '.' between them"
        )


def _kind(folder: Path) -> str:
    """Return the kind of a folder, if it is one of :data:`KINDS`."""
    kind = folder_kind(folder)
    if kind not in KINDS:
        raise wrong_kind(folder, kind, KINDS)
    return kind
