"""A model of the Hugging Face hub: downloaded without extra files, and loaded by its manifest."""

import shutil
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType

import pytest
from refusal import refused

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import ARCHIVE_FORMAT
from pcs_racing.planners.line_ppo import LINE_FORMAT
from pcs_racing.planners.planner import Planner
from pcs_racing_agents.agents import load_from_hub
from pcs_racing_agents.agents.hub import FILES
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT

SHIPPED = {
    "archive": (ARCHIVE_FORMAT.find("default"), PolicyArchive),
    "network": (NETWORK_FORMAT.find(NETWORK_FORMAT.shipped_names()[0]), RegretNetwork),
    "planner": (LINE_FORMAT.find("line-ppo"), Planner),
}


asked = []  # patterns of each download


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """Library of the hub, replaced for tests: repositories are folders below ``tmp_path``."""

    asked.clear()

    def snapshot_download(repo_id, *, revision=None, allow_patterns=None):
        assert allow_patterns in (["manifest.yaml"], FILES)
        asked.append(allow_patterns)
        folder = tmp_path / repo_id / (revision or "main")
        if not folder.is_dir():
            raise OSError(f"404 Client Error: no repository {repo_id}\n\nSee the documentation")
        return str(folder)

    library = ModuleType("huggingface_hub")
    library.__spec__ = ModuleSpec("huggingface_hub", None)
    library.snapshot_download = snapshot_download
    monkeypatch.setitem(sys.modules, "huggingface_hub", library)
    return tmp_path


@pytest.mark.parametrize("kind", SHIPPED)
def test_a_repository_is_loaded_by_the_format_of_its_manifest(hub, kind):
    folder, wanted = SHIPPED[kind]
    shutil.copytree(folder, hub / "somebody" / "model" / "v1")
    assert isinstance(load_from_hub("somebody/model", revision="v1"), wanted)


def test_a_missing_repository_and_another_format_are_one_line(hub):
    with pytest.raises(InputError, match="can't download 'no/body' from the hub: 404") as error:
        load_from_hub("no/body")
    assert "\n" not in str(error.value)
    other = hub / "somebody" / "fit" / "main"
    other.mkdir(parents=True)
    (other / "manifest.yaml").write_text("format: pcs-racing fit\n")
    asked.clear()
    refused(r"is a folder of 'fit'; it must be of archive, network", load_from_hub, "somebody/fit")
    assert asked == [["manifest.yaml"]]  # its large files stay on the hub


@pytest.mark.parametrize(
    "name",
    [
        *(None, "model", "a/b/c", "../b/c", 'o/n")\nimport os #', "../..", "a/..", ".a/b", "a/b."),
        *("a--b/c", "a/b..c", "a/b.git", "-a/b", f"a/{97 * 'b'}", "a/b\n"),
    ],
)
def test_a_name_that_is_no_repository_is_refused(hub, name):
    refused("must be 'owner/name'", load_from_hub, name)
    refused(
        "must be a branch, a tag or a commit",
        load_from_hub,
        "somebody/model",
        revision="../../model" if name is None else f"{name}/..",
    )
