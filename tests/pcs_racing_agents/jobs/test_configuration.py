from dataclasses import dataclass

import pytest

from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing_agents.jobs.configuration import check_numbers, check_wholes, load_settings, plain_settings


@dataclass(frozen=True)
class Soup:
    salt: float = 0.5
    bowls: int = 2
    herbs: tuple[str, ...] = ("dill",)

    def __post_init__(self) -> None:
        check_numbers(self, salt=(0.0, 1.0))
        check_wholes(self, bowls=(1, 9))


def test_a_file_sets_some_fields_and_the_arguments_others(tmp_path):
    file = tmp_path / "soup.yaml"
    file.write_text("salt: 0.25\nherbs: [mint, dill]\n")
    assert load_settings("soup", Soup(), file, bowls=3) == Soup(0.25, 3, ("mint", "dill"))
    assert load_settings("soup", Soup(), Soup(bowls=4)) == Soup(bowls=4)
    assert plain_settings(Soup())["herbs"] == ["dill"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pepper: 1", "unknown soup setting 'pepper'; known are salt, bowls, herbs"),
        ("bowls: 0", "bowls is 0; it must be a whole number from 1 to 9"),
        ("bowls: true", "bowls is True; it must be a whole number"),
        ("salt: .nan", "salt is nan; it must be a number from 0 to 1"),
        ("[1, 2]", "it must be a mapping"),
        ("a: [", "not valid YAML"),
        ("#" * 250_000, "soup.yaml has more than 200000 bytes; that is not a configuration"),
        ("!!python/object/apply:os.system [ls]", "not valid YAML"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path, text, message):
    file = tmp_path / "soup.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message.replace("(", r"\(")) as error:
        load_settings("soup", Soup(), file)
    assert "soup.yaml" in str(error.value)


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(UnknownNameError, match="soup settings 'borscht' are unknown; use none or the path of a YAML"):
        load_settings("soup", Soup(), "borscht")
    with pytest.raises(ConfigError, match="the arguments: unknown soup setting 'pepper'"):
        load_settings("soup", Soup(), pepper=1)
