"""The configurations that come with the package, by kind and name."""

from refusal import refused

from pcs_racing_agents.base.configurations import load_config, shipped_configs
from pcs_racing_agents.policies.config import ArchiveConfig


def test_names_are_sorted_and_without_their_kind():
    names = list(shipped_configs("study"))
    assert names == sorted(names)
    assert {"contest", "paper", "quick"} < set(names)
    assert shipped_configs("nothing") == {}


def test_a_configuration_is_found_by_name_and_its_fields_may_be_changed():
    found = load_config("archive", ArchiveConfig(), "contest", seed=7)
    assert (found.name, found.seed) == ("contest", 7)
    refused("contest, default", load_config, "archive", ArchiveConfig(), "contests")
