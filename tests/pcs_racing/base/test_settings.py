import argparse
import dataclasses
import inspect
from dataclasses import dataclass

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base.errors import ConfigError, InputError, UnknownNameError
from pcs_racing.base.settings import (
    Settings,
    add_setting_options,
    checked,
    choice,
    flag,
    load_settings,
    names,
    number,
    plain_settings,
    setting,
    stated_options,
    tenths,
    text,
    weights,
    whole,
    wholes,
)


def even(value):
    if value % 2:
        raise InputError(f"guests is {value}; it must be even")
    return value


@dataclass(frozen=True)
class Soup(Settings):
    """A soup."""

    salt: float = setting(0.5, number(0.0, 1.0), "Salt, g.")
    bowls: int = setting(2, whole(1, 9), "How many bowls.")
    herbs: tuple[str, ...] = setting(("dill",), names(), "What is green in it.")
    minutes: float = setting(20.0, tenths(0.1, 60.0), "Time on the fire.")
    hot: bool = setting(True, flag(), "Whether it is served hot.")
    cook: str = setting("Ann", text(), "Who makes it.")
    kind: str = setting("clear", choice(("clear", "thick")), "What it looks like.")
    spoons: tuple[int, ...] = setting((3, 4), wholes(1, 9, longest=3), "Sizes of the spoons.")
    parts: dict[str, int] = setting({"leek": 1}, weights(1, 5), "What is in it, and how much.")
    guests: int = setting(2, checked(even), "How many eat.")
    bread: str | None = setting(None, text(), "What is eaten with it; None for nothing.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hot and self.minutes < 1.0:
            raise ConfigError(f"minutes is {self.minutes}; a hot soup needs 1")


@dataclass(frozen=True)
class FishSoup(Soup):
    """A soup with fish."""

    fish: int = setting(1, whole(1, 3), "How many fish.")
    cook: str = setting("Ben", text(), "Who makes it.")


def test_the_declaration_is_the_default_and_the_documentation():
    assert Soup().bowls == 2
    written = inspect.getdoc(Soup)
    assert "bowls : int\n    How many bowls; from 1 to 9 (default: 2)." in written
    assert "herbs : tuple[str, ...]\n" in written
    assert "bread : str | None\n    What is eaten with it; None for nothing.\n" in written
    inherited = inspect.getdoc(FishSoup)
    assert "(default: 'Ben')" in inherited
    assert "(default: 'Ann')" not in inherited
    assert all(f"{field.name} : " in inherited for field in dataclasses.fields(FishSoup))


WRONG = {
    "salt": (1.01, float("nan"), True, "0.5"),
    "bowls": (0, 10, 2.0, True, None),
    "herbs": ("dill", (), ("dill", "dill"), ("dill", 3)),
    "minutes": (0.25, 0.5),
    "hot": (1,),
    "cook": ("",),
    "kind": ("claer",),
    "spoons": ((0,), (1, 2, 3, 4)),
    "parts": ({}, {"leek": 6}, ["leek"]),
    "guests": (3,),
    "bread": ("",),
}


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in WRONG.items() for value in values])
def test_a_value_out_of_its_range_is_refused_by_name(key, value):
    refused(f"^{key} (is|are|holds) ", Soup, error=ConfigError, **{key: value})


def test_values_are_kept_in_one_form():
    soup = Soup(salt=np.float64(0.25), bowls=np.int64(3), herbs=["mint"], spoons=[1])
    assert soup == Soup(0.25, 3, ("mint",), spoons=(1,))
    assert [type(value) for value in (soup.salt, soup.bowls, soup.herbs)] == [float, int, tuple]
    hash(soup)
    assert plain_settings(soup)["herbs"] == ["mint"]


def test_a_file_sets_some_fields_and_the_arguments_others(tmp_path):
    file = tmp_path / "soup.yaml"
    file.write_text("salt: 0.25\nherbs: [mint, dill]\n")
    assert load_settings("soup", Soup(), file, bowls=3) == Soup(0.25, 3, ("mint", "dill"))
    assert load_settings("soup", Soup(), Soup(bowls=4)) == Soup(bowls=4)
    assert load_settings("soup", Soup(), "mine", {"mine": file, "salty": Soup(1.0)}).salt == 0.25
    assert load_settings("soup", Soup(), "salty", {"mine": file, "salty": Soup(1.0)}, bowls=5) == Soup(1.0, 5)
    file.write_text("base: salty\nbowls: 6\n")
    assert load_settings("soup", Soup(), file, {"salty": Soup(1.0)}, "base") == Soup(1.0, 6)


def test_what_follows_changes_a_file_before_it_is_checked(tmp_path):
    file = tmp_path / "soup.yaml"
    file.write_text("minutes: 0.5\n")
    assert load_settings("soup", Soup(), file, hot=False).minutes == 0.5


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("bowl: 1", "unknown soup setting 'bowl'; known are salt, bowls, herbs"),
        ("7: 1", "unknown soup setting 7"),
        ("bowls: 0", "bowls is 0; it must be a whole number from 1 to 9"),
        ("bowls: true", "bowls is True; it must be a whole number"),
        ("salt: .nan", "salt is nan; it must be a number from 0 to 1"),
        ("kind: claer", "kind is 'claer'; it must be one of clear, thick (did you mean 'clear'?)"),
        ("[1, 2]", "it must be a mapping"),
        ("a: [", "not valid YAML"),
        ("#" * 250_000, "soup.yaml has more than 200000 bytes; that is not a file of settings"),
        ("!!python/object/apply:os.system [ls]", "not valid YAML"),
        ("base: sweet", "base is 'sweet'; it must be one of salty"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path, written, message):
    file = tmp_path / "soup.yaml"
    file.write_text(written)
    with pytest.raises(ConfigError) as error:
        load_settings("soup", Soup(), file, {"salty": Soup(1.0)}, "base")
    assert message in str(error.value)
    assert "soup.yaml" in str(error.value)


def test_an_unknown_name_lists_what_there_is():
    refused("soup settings 'borscht' are unknown", load_settings, "soup", Soup(), "borscht", error=UnknownNameError)
    with pytest.raises(UnknownNameError, match="did you mean 'salty'"):
        load_settings("soup", Soup(), "slaty", {"salty": Soup(1.0)})
    refused(r"the arguments: .*'pepper'", load_settings, "soup", Soup(), pepper=1, error=ConfigError)
    refused("soup settings are 3;", load_settings, "soup", Soup(), 3, error=ConfigError)


def test_options_of_a_command_line_come_from_the_declaration():
    parser = argparse.ArgumentParser()
    add_setting_options(parser, Soup, "salt", "bowls", "herbs", "spoons")
    arguments = parser.parse_args(["--bowls", "3", "--herbs", "mint", "dill", "--spoons", "5"])
    stated = stated_options(arguments, Soup)
    assert stated == {"bowls": 3, "herbs": ["mint", "dill"], "spoons": [5]}
    assert load_settings("soup", Soup(), **stated) == Soup(bowls=3, herbs=("mint", "dill"), spoons=(5,))
    assert "from 1 to 9 (default: 2)" in " ".join(parser.format_help().split())
