import dataclasses
import inspect
from dataclasses import dataclass

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base import settings as loading
from pcs_racing.base.errors import ConfigError, InputError, UnknownNameError


def even(value):
    if value % 2:
        raise InputError(f"guests is {value}; it must be even")
    return value


@dataclass(frozen=True)
class Soup(loading.Settings):
    """A soup."""

    salt: float = loading.setting(0.5, loading.number(0.0, 1.0), "Salt, g.")
    bowls: int = loading.setting(2, loading.whole(1, 9), "How many bowls.")
    herbs: tuple[str, ...] = loading.setting(("dill",), loading.names(), "What is green in it.")
    minutes: float = loading.setting(20.0, loading.tenths(0.1, 60.0), "Time on the fire.")
    hot: bool = loading.setting(True, loading.flag(), "Whether it is served hot.")
    cook: str = loading.setting("Ann", loading.text(), "Who makes it.")
    kind: str = loading.setting("clear", loading.choice(("clear", "thick")), "What it looks like.")
    spoons: tuple[int, ...] = loading.setting((3, 4), loading.wholes(1, 9, longest=3), "Sizes of the spoons.")
    parts: dict[str, int] = loading.setting({"leek": 1}, loading.weights(1, 5), "What is in it, and how much.")
    guests: int = loading.setting(2, loading.checked(even), "How many eat.")
    bread: str | None = loading.setting(None, loading.text(), "What is eaten with it; None for nothing.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hot and self.minutes < 1.0:
            raise ConfigError(f"minutes is {self.minutes}; a hot soup needs 1")


@dataclass(frozen=True)
class FishSoup(Soup):
    """A soup with fish."""

    fish: int = loading.setting(1, loading.whole(1, 3), "How many fish.")
    cook: str = loading.setting("Ben", loading.text(), "Who makes it.")


def test_values_are_kept_in_one_form_and_are_the_documentation():
    assert Soup().bowls == 2
    written = inspect.getdoc(Soup)
    assert "bowls : int\n    How many bowls; from 1 to 9 (default: 2)." in written
    assert "herbs : tuple[str, ...]\n" in written
    assert "bread : str | None\n    What is eaten with it; None for nothing." in written
    inherited = inspect.getdoc(FishSoup)
    assert "(default: 'Ben')" in inherited
    assert "(default: 'Ann')" not in inherited
    assert all(f"{field.name} : " in inherited for field in dataclasses.fields(FishSoup))
    soup = Soup(salt=np.float64(0.25), bowls=np.int64(3), herbs=["mint"], spoons=[1])
    assert soup == Soup(0.25, 3, ("mint",), spoons=(1,))
    assert [type(value) for value in (soup.salt, soup.bowls, soup.herbs)] == [float, int, tuple]
    hash(soup)
    assert loading.plain_settings(soup)["herbs"] == ["mint"]


WRONG = {
    "salt": (1.01, float("nan"), True, "0.5"), "bowls": (0, 10, 2.0, True, None),
    "herbs": ("dill", (), ("dill", "dill"), ("dill", 3)), "minutes": (0.25, 0.5), "hot": (1,), "cook": ("",),
    "kind": ("claer",), "spoons": ((0,), (1, 2, 3, 4)), "parts": ({}, {"leek": 6}, ["leek"]), "guests": (3,),
    "bread": ("",),
}  # fmt: skip


def test_wrong_values_are_refused_and_options_come_from_the_declaration():
    for key, value in [(key, value) for key, values in WRONG.items() for value in values]:
        refused(f"^{key} (is|are|holds) ", Soup, error=ConfigError, **{key: value})
    unknown = "soup settings 'borscht' are unknown"
    refused(unknown, loading.load_settings, "soup", Soup(), "borscht", error=UnknownNameError)
    with pytest.raises(UnknownNameError, match="did you mean 'salty'"):
        loading.load_settings("soup", Soup(), "slaty", {"salty": Soup(1.0)})
    refused(r"the arguments: .*'pepper'", loading.load_settings, "soup", Soup(), pepper=1, error=ConfigError)
    refused("soup settings are 3;", loading.load_settings, "soup", Soup(), 3, error=ConfigError)


def test_a_file_sets_some_fields_and_the_arguments_others_before_they_are_checked(tmp_path):
    file = tmp_path / "soup.yaml"
    file.write_text("salt: 0.25\nherbs: [mint, dill]\n")
    assert loading.load_settings("soup", Soup(), file, bowls=3) == Soup(0.25, 3, ("mint", "dill"))
    assert loading.load_settings("soup", Soup(), Soup(bowls=4)) == Soup(bowls=4)
    assert loading.load_settings("soup", Soup(), "mine", {"mine": file, "salty": Soup(1.0)}).salt == 0.25
    assert loading.load_settings("soup", Soup(), "salty", {"mine": file, "salty": Soup(1.0)}, bowls=5) == Soup(1.0, 5)
    file.write_text("base: salty\nbowls: 6\n")
    assert loading.load_settings("soup", Soup(), file, {"salty": Soup(1.0)}, "base") == Soup(1.0, 6)
    file.write_text("minutes: 0.5\n")
    assert loading.load_settings("soup", Soup(), file, hot=False).minutes == 0.5


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("bowl: 1", "unknown soup setting 'bowl'; known are salt, bowls, herbs"),
        ("7: 1", "unknown soup setting 7"),
        ("bowls: 0", "bowls is 0; it must be a whole number from 1 to 9"),
        ("bowls: true", "bowls is True; it must be a whole number"),
        ("salt: .nan", "line 1 holds .nan; numbers must be finite"),
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
        loading.load_settings("soup", Soup(), file, {"salty": Soup(1.0)}, "base")
    assert message in str(error.value)
    assert "soup.yaml" in str(error.value)
