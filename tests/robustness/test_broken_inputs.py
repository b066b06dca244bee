"""Damaged inputs of every reader of files, every class of settings and every environment: each is
accepted, or refused by one line of ours.

Any other exception, any warning and any dead process fails. `HYPOTHESIS_PROFILE=long` tries many
more examples, and other ones each time.
"""

import inspect
import json
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, get_args, get_type_hints, is_typeddict

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from test_data_run_no_code import KINDS, made
from test_found_by_fuzzing import tree

from pcs_racing import InputError, load_archive, load_track, racer
from pcs_racing.base.settings import Settings, load_settings
from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv
from pcs_racing.game.make import make_game
from pcs_racing_agents.trees.tree import tree_from_arrays

# A tenth of the profile's examples for each of the hundred readers and environments.
few = settings(max_examples=settings().max_examples // 10, suppress_health_check=[*HealthCheck])

WORDS = [
    *(b"nan", b"-.inf", b"1e999", b"-1", b"0", b"9" * 400, b"1_000", b"2024-02-31", b"0xffffffff"),
    *(b"", b"null", b"true", b"[]", b"{}", b"&a [*a]", b"<<: *a", b"!!binary", b"? ", b"- ", b": "),
    *(
        b"\t",
        b"\n",
        b"\r\n",
        b"\x00",
        b"\xff",
        b"'",
        b'"',
        b",",
        b";",
        b"../",
        b"/dev/zero",
        b"[[[[",
    ),
]
SIZES = st.sampled_from([-(2**63), -1, 0, 1, 2, 3, 255, 2**31, 2**64, 10**30])
SIMPLE = st.none() | st.booleans() | SIZES | st.floats() | st.text(max_size=20)
VALUES = st.recursive(
    SIMPLE,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=2)
    ),
    max_leaves=4,
)
"""Values that a YAML or a JSON file can hold."""

NUMBERS = arrays(
    st.sampled_from(["f8", "f4", "i8", "u1", "?", "U3"]),
    array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3),
)
OBJECTS = (
    VALUES
    | NUMBERS
    | st.binary(max_size=3)
    | st.complex_numbers()
    | st.sampled_from([(), (0.5, 1.0), range(3), object, np.float32(0.5), np.int64(3), "\ud800"])
)
"""Values that a call in Python can be given."""


@contextmanager
def refusals() -> Iterator[None]:
    """Expect no warning, and no exception but a refusal of one line."""
    with warnings.catch_warnings(action="error"):
        try:
            yield
        except InputError as error:
            assert len(str(error).splitlines()) == 1  # noqa: PT017


@st.composite
def damaged(draw: Any, valid: bytes) -> bytes:
    """Change a few stretches of bytes."""
    for _ in range(draw(st.integers(1, 3))):
        begin = draw(st.integers(0, len(valid)))
        end = draw(st.integers(begin, min(begin + 20, len(valid))))
        new = draw(st.sampled_from(WORDS) | st.binary(max_size=8) | st.just(5 * valid[begin:end]))
        valid = valid[:begin] + new + valid[end:]
    return valid


FORMS = {".yaml": (yaml.safe_load, yaml.safe_dump), ".json": (json.loads, json.dumps)}
"""Functions that read and write the text of a file, by its ending."""


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every container of nested lists and mappings, with each of its keys."""
    pairs = {dict: lambda: value.items(), list: lambda: enumerate(value)}
    for key, item in list(pairs.get(type(value), lambda: ())()):
        yield value, key
        yield from places(item)


@st.composite
def misfilled(draw: Any, file: Path) -> bytes:
    """Put another value into one place of a file's structure, or leave the place out."""
    load, dump = FORMS[file.suffix]
    value = [load(file.read_text())]
    container, key = draw(st.sampled_from(list(places(value))))
    container[key] = draw(VALUES)
    if container is not value and draw(st.integers(0, 3)) == 0:
        del container[key]
    # The form may not hold such a value.
    with suppress(yaml.YAMLError, UnicodeError):
        return str(dump(value[0])).encode()
    return b""


@pytest.fixture(scope="module", params=[name for name in KINDS if name != "texts of opponents"])
def kind(request, tmp_path_factory):
    """A kind of file, a file of this kind, and its sound content."""
    file = KINDS[request.param].make(made(tmp_path_factory.mktemp("files") / "made"))
    return KINDS[request.param], file, file.read_bytes()


@few
@given(st.data())
def test_damaged_bytes_of_a_file(kind, data):
    what, file, sound = kind
    file.write_bytes(data.draw(damaged(sound)))
    with refusals():
        what.open(file)


@few
@given(st.data())
def test_another_value_in_one_place_of_a_file(kind, data):
    what, file, sound = kind
    if file.suffix not in FORMS:
        pytest.skip("a table has no structure")
    file.write_bytes(sound)
    file.write_bytes(data.draw(misfilled(file)))
    with refusals():
        what.open(file)


def test_something_else_in_the_place_of_a_file(kind):
    what, file, sound = kind
    for put in (
        file.mkdir,
        lambda: os.mkfifo(file),
        *(
            lambda to=to: file.symlink_to(to)
            for to in ("/dev/zero", file.name, ".", "..", "nowhere")
        ),
    ):
        file.unlink()
        put()
        with refusals():
            what.open(file)
        file.rmdir() if file.is_dir() and not file.is_symlink() else file.unlink()
        file.write_bytes(sound)


DATA = [
    ("archive", "archive.npz"),
    ("network", "weights.safetensors"),
    ("map", "Pipkin_map.png"),
    ("map", "Pipkin_centerline.csv"),
    ("map", "Pipkin_raceline.csv"),
]
"""Kinds of folder with a file of data; a manifest holds the digest of some."""


@pytest.mark.parametrize(("name", "beside"), DATA)
@few
@given(st.data())
def test_damaged_data_whose_digest_is_right(name, beside, tmp_path_factory, data):
    file = KINDS[name].make(made(tmp_path_factory.mktemp("data") / "made"))
    content = (file.parent / beside).read_bytes()
    changed = data.draw(damaged(content))
    (file.parent / beside).write_bytes(changed)
    old, new = (sha256(part).hexdigest() for part in (content, changed))
    file.write_text(file.read_text().replace(old, new))
    with refusals():
        KINDS[name].open(file)


@few
@given(st.data())
def test_other_arrays_in_a_game_tree(data):
    sound = tree()
    name = data.draw(st.sampled_from(sorted(sound)))
    with refusals():
        tree_from_arrays({**sound, name: data.draw(NUMBERS)}, 1, "it")


TEXTS = {
    load_track: "Pipkin",
    load_archive: "default",
    racer: "lattice:pace=0.8,side_margin=0.2",
    lambda text: racer(text, make_game(None)): "cfr-argmax:network=default-paper-regret",
}


@pytest.mark.parametrize("read", TEXTS)
@few
@given(st.data())
def test_a_damaged_name(read, data):
    text = data.draw(damaged(TEXTS[read].encode()))
    with refusals():
        read(text.decode("utf-8", "surrogateescape"))


def classes(base: type[Settings] = Settings) -> Iterator[type[Settings]]:
    """Yield the classes of settings that can be made without arguments."""
    for cls in base.__subclasses__():
        yield from classes(cls)
        complete = all(one.default is not inspect.Parameter.empty for one in parameters(cls))
        if complete and cls.__module__.startswith("pcs_racing") and cls.__name__[0] != "_":
            yield cls


def parameters(cls: type) -> list[inspect.Parameter]:
    given = inspect.signature(cls).parameters.values()
    return [one for one in given if one.kind != inspect.Parameter.VAR_KEYWORD]


def arguments(data: Any, cls: type) -> dict[str, Any]:
    """Draw values of a few arguments of a class, also of those listed as a typed dictionary."""
    listed = [get_args(hint) for hint in get_type_hints(cls.__init__).values()]
    more = [name for of in listed if of and is_typeddict(of[0]) for name in of[0].__annotations__]
    names = st.sampled_from([one.name for one in parameters(cls)] + more)
    return data.draw(st.dictionaries(names, OBJECTS, min_size=1, max_size=3))


@pytest.mark.parametrize("cls", list(classes()), ids=lambda cls: cls.__name__)
@few
@given(st.data())
def test_other_values_in_settings(cls, data):
    with refusals():
        load_settings("settings", cls(), None, **arguments(data, cls))


ENVS: dict[type, dict[str, Any]] = {
    DriveEnv: {"opponent": "pure-pursuit"},
    DriveVectorEnv: {"opponent": None, "num_envs": 3, "threads": 1},
    DriveHeadToHeadEnv: {},
    DuelEnv: {"steps": (0.1,) * 3},
    DuelVectorEnv: {"steps": (0.1,) * 3, "num_envs": 2, "threads": 1},
    HeadToHeadEnv: {"steps": (0.1,) * 3},
}


@cache
def environment(cls: type) -> Any:
    return cls(track="Pipkin", **ENVS[cls])


@pytest.mark.parametrize("cls", ENVS, ids=lambda cls: cls.__name__)
@few
@given(st.data())
def test_other_arguments_of_an_environment(cls, data):
    with refusals():
        env = cls(**{"track": "Pipkin", **ENVS[cls], **arguments(data, cls)})
        env.reset(seed=1)
        env.close()


@pytest.mark.parametrize("cls", ENVS, ids=lambda cls: cls.__name__)
@few
@given(st.data())
def test_other_inputs_of_an_environment(cls, data):
    env = environment(cls)
    sides = st.lists(OBJECTS, max_size=2)
    options = OBJECTS | st.fixed_dictionaries({"policies": sides}) | st.just({"start": None})
    with refusals():
        env.reset(seed=data.draw(st.just(0) | OBJECTS), options=data.draw(st.none() | options))
    env.reset(seed=0)
    actions = OBJECTS | st.dictionaries(st.sampled_from(["car_0", "car_1"]), OBJECTS)
    with refusals(), np.errstate(all="ignore"):
        env.step(data.draw(actions))
    with refusals():
        env.set_state(data.draw(OBJECTS))
