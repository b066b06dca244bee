"""The configurations that come with the package, by kind and name."""

import yaml
from refusal import refused
from repository import load_tool

from pcs_racing.base.settings import options_of
from pcs_racing_agents.base.configurations import load_config, shipped_configs
from pcs_racing_agents.policies.config import SELECTIONS, FrontConfig


def test_names_are_sorted_and_without_their_kind():
    names = list(shipped_configs("study"))
    assert names == ["contest", "paper", "quick"]
    assert shipped_configs("nothing") == {}


def test_every_kind_has_a_schema_and_every_shipped_file_obeys_its_own():
    """``python dev/tools/write_schemas.py`` writes the schemas again."""
    tool = load_tool("write_schemas")
    assert {
        file.stem: file.read_text(encoding="utf-8") for file in tool.FOLDER.glob("*.json")
    } == tool.schemas()
    files = {kind: shipped_configs(kind).values() for kind in tool.schemas()}
    for kind, file in [(kind, file) for kind, of_kind in files.items() for file in of_kind]:
        text = file.read_text(encoding="utf-8")
        assert text.startswith(f"# yaml-language-server: $schema=../schemas/{kind}.json\n"), file
        values = yaml.safe_load(text)
        cls = tool.KINDS.get(kind) or type(SELECTIONS[values.get("selection", "pareto")])
        options = options_of(cls)
        assert set(values) <= set(tool.schema_of(cls)["properties"])
        for name, value in values.items():
            options[name].checked(name, value)


def test_a_configuration_is_found_by_name_and_its_fields_may_be_changed():
    found = load_config("archive", FrontConfig(), "default", seed=7)
    assert (found.name, found.seed) == ("default", 7)
    refused("contest, default", load_config, "archive", FrontConfig(), "contests")
