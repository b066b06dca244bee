import dataclasses
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
import pytest
from annotated_types import Interval, Len, MinLen, MultipleOf
from refusal import refused

from pcs_racing.base import settings as loading
from pcs_racing.base.errors import ConfigError, InputError, UnknownNameError
from pcs_racing.car.vehicle import VehicleParams
from pcs_racing.envs.drive_options import DriveOptions
from pcs_racing.envs.obstacles import Obstacles
from pcs_racing.envs.random_circuits import RandomCircuits
from pcs_racing.race.config import Rules


def even(name, value):
    if value % 2:
        raise InputError(f"{name} is {value}; it must be even")
    return value


@dataclass(frozen=True)
class Pot(loading.Settings):
    """A pot."""

    litres: Annotated[float, Interval(ge=0.5, le=9.0), "Volume, l."] = 2.0


@dataclass(frozen=True)
class Soup(loading.Settings):
    """A soup."""

    salt: Annotated[float, Interval(ge=0.0, le=1.0), "Salt, g."] = 0.5
    bowls: Annotated[int, Interval(ge=1, le=9), "How many bowls."] = 2
    herbs: Annotated[loading.Names, "What is green in it."] = ("dill",)
    minutes: Annotated[float, Interval(ge=0.1, le=60.0), MultipleOf(0.1), "Time on the fire."] = (
        20.0
    )
    hot: Annotated[bool, "Whether it is served hot."] = True
    cook: Annotated[loading.Text, "Who makes it."] = "Ann"
    kind: Annotated[str, loading.OneOf(("clear", "thick")), "What it looks like."] = "clear"
    spoons: Annotated[
        tuple[Annotated[int, Interval(ge=1, le=9)], ...], Len(0, 3), "Sizes of the spoons."
    ] = (3, 4)
    parts: Annotated[
        Mapping[loading.Text, Annotated[int, Interval(ge=1, le=5)]],
        MinLen(1),
        "What is in it, and how much.",
    ] = field(default_factory=lambda: {"leek": 1}, hash=False)
    guests: Annotated[int, loading.Checked(even), "How many eat."] = 2
    bread: Annotated[loading.Text | None, "What is eaten with it; None for nothing."] = None
    plate: Annotated[Literal["deep", "flat"], "What it is eaten from."] = "deep"
    size: Annotated[tuple[float, float], loading.number_range(0.1, 2.0), "Of a leek."] = (0.5, 1.0)
    pot: Annotated[Pot, "What it is made in."] = Pot()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hot and self.minutes < 1.0:
            raise ConfigError(f"minutes is {self.minutes}; a hot soup needs 1")


@dataclass(frozen=True)
class FishSoup(Soup):
    """A soup with fish."""

    fish: Annotated[int, Interval(ge=1, le=3), "How many fish."] = 1
    cook: Annotated[loading.Text, "Who makes it."] = "Ben"


def test_values_are_kept_in_one_form_and_are_the_documentation():
    assert Soup().bowls == 2
    written = inspect.getdoc(Soup)
    assert "bowls : int\n    How many bowls; from 1 to 9 (default: 2)." in written
    assert "herbs : tuple\n" in written
    assert "bread : str\n    What is eaten with it; None for nothing." in written
    inherited = inspect.getdoc(FishSoup)
    assert "(default: 'Ben')" in inherited
    assert "(default: 'Ann')" not in inherited
    assert all(f"{field.name} : " in inherited for field in dataclasses.fields(FishSoup))
    soup = Soup(salt=np.float64(0.25), bowls=np.int64(3), herbs=["mint"], spoons=[1])
    assert soup == Soup(0.25, 3, ("mint",), spoons=(1,))
    assert [type(value) for value in (soup.salt, soup.bowls, soup.herbs)] == [float, int, tuple]
    # A whole number stays one: the hash of a manifest would change.
    assert type(Soup(salt=1).salt) is int
    assert (Soup(size=1).size, Soup(size=[0.5, 2]).size) == ((1.0, 1.0), (0.5, 2.0))
    assert Soup(pot={"litres": 3}).pot == Pot(3)
    assert Soup(minutes=1.1).minutes == 1.1  # which is no multiple of 0.1 in floating point
    hash(soup)
    assert loading.plain_settings(soup)["herbs"] == ["mint"]


WRONG = {
    "salt": (1.01, float("nan"), True, "0.5"),
    "bowls": (0, 10, 2.0, True, None),
    "herbs": ("dill", (), ("dill", "dill"), ("dill", 3)),
    "minutes": (0.25, 0.5),
    "hot": (1,),
    "cook": ("",),
    "kind": ("claer", 3),
    "spoons": ((0,), (1, 2, 3, 4), (True,)),
    "parts": ({}, {"leek": 6}, {"": 1}, ["leek"]),
    "guests": (3,),
    "bread": ("", 4),
    "plate": ("falt",),
    "size": ((2.0, 1.0), (True, 1.0)),
    "pot": (3, [1.0]),
}


def test_wrong_values_are_refused_and_options_come_from_the_declaration():
    for key, value in [(key, value) for key, values in WRONG.items() for value in values]:
        refused(f"^{key} (is|are|holds) ", Soup, error=ConfigError, **{key: value})
    unknown = "soup settings 'borscht' are unknown"
    refused(unknown, loading.load_settings, "soup", Soup(), "borscht", error=UnknownNameError)
    refused(
        "did you mean 'salty'",
        loading.load_settings,
        "soup",
        Soup(),
        "slaty",
        {"salty": Soup(1.0)},
        error=UnknownNameError,
    )
    refused(
        r"the arguments: .*'pepper'",
        loading.load_settings,
        "soup",
        Soup(),
        pepper=1,
        error=ConfigError,
    )
    refused("soup settings are 3;", loading.load_settings, "soup", Soup(), 3, error=ConfigError)


def test_the_default_of_every_option_obeys_its_rule():
    checked = 0
    for cls in [Rules, RandomCircuits, VehicleParams, Obstacles, DriveOptions, Soup]:
        made = cls()
        for name, option in loading.options_of(cls).items():
            if option.default is not None:
                assert repr(option.checked(name, option.default)) == repr(getattr(made, name))
                checked += 1
    assert checked > 70


def test_a_file_sets_some_fields_and_the_arguments_others_before_they_are_checked(tmp_path):
    file = tmp_path / "soup.yaml"
    file.write_text("salt: 0.25\nherbs: [mint, dill]\n")
    assert loading.load_settings("soup", Soup(), file, bowls=3) == Soup(0.25, 3, ("mint", "dill"))
    assert loading.load_settings("soup", Soup(), Soup(bowls=4)) == Soup(bowls=4)
    assert (
        loading.load_settings("soup", Soup(), "mine", {"mine": file, "salty": Soup(1.0)}).salt
        == 0.25
    )
    assert loading.load_settings(
        "soup", Soup(), "salty", {"mine": file, "salty": Soup(1.0)}, bowls=5
    ) == Soup(1.0, 5)
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
