import io
import os
import zipfile

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st
from refusal import refused

from pcs_racing import InputError
from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat, ManifestFormat
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.files import (
    plain_yaml,
    read_limited,
    shipped_folder,
    unpack_arrays,
    write_atomically,
    write_together,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**62), 2**62) | finite | st.text(max_size=10),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=10,
)


@given(plain)
def test_what_yaml_writes_is_read_as_yaml_reads_it(value):
    text = yaml.safe_dump(value, allow_unicode=True)
    assert plain_yaml(text.encode()) == yaml.safe_load(text)


def bomb(line: str, count: int = 40) -> str:
    return "\n".join(["a0: &a0 {k: v}", *(line.format(i, i - 1) for i in range(1, count))])


def test_other_texts_are_refused_in_one_line():
    for text, why in [
        (bomb("a{0}: &a{0} [*a{1}, *a{1}]"), "too many values"),
        (bomb("a{0}: &a{0} {{<<: [*a{1}, *a{1}]}}"), "too many values"),
        ("a: &a [*a]", "too many values"),
        ("[" * 60 + "]" * 60, "nested"),
        ("[" * 100_000, "nested too deeply"),
        ("seed: " + "9" * 5000, "has 5000 characters"),
        ("seed: 0x" + "f" * 5000, "has 5002 characters"),
        ("seed: " + "1:" * 200 + "1", "has 401 characters"),
        ("day: 2020-13-45", "month"),
        ("!!int ''", "index"),
        ("!!bool maybe", "maybe"),
        ("!!timestamp x", "NoneType"),
        ("!!python/object/apply:os.system [ls]", "constructor"),
        (b"\xff\xfe\xfa", "utf"),
        ("a: *b", "undefined alias"),
        ("? [1]\n: 2", "unhashable"),
        ("\x00", "special characters"),
    ]:
        refused(why, plain_yaml, text)


def test_names_that_stand_for_little_are_read():
    assert plain_yaml("a: &a [1, 2]\nb: [*a, *a]\nc: {<<: {d: 1}}") == {
        "a": [1, 2],
        "b": [[1, 2], [1, 2]],
        "c": {"d": 1},
    }
    assert plain_yaml("") is None
    assert plain_yaml("name: " + "x" * 5000) == {"name": "x" * 5000}  # only numbers must be short


def npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def test_arrays_are_read_as_numpy_reads_them():
    arrays = {
        "matrix": np.arange(6.0).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6, dtype=np.int8).reshape(2, 3)),
        "scalar": np.array(2.5),
        "empty": np.zeros((0, 3), np.float32),
        "texts": np.array(["a", "bcd"]),
        "truths": np.array([True, False]),
    }
    found = unpack_arrays(npz(**arrays))
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
        assert found[name].flags.writeable


def member(header: str, body: bytes = b"") -> bytes:
    """A file with one array whose header says anything."""
    text = header.encode().ljust(118) + b"\n"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body)
    return buffer.getvalue()


def test_other_files_of_arrays_are_refused():
    for content, why in [
        (b"", "zip"),
        (b"PK\x03\x04 and no more", "zip"),
        (npz(a=np.zeros(9))[:-30], "zip"),
        (
            member("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"),
            "allocate|EOF",
        ),
        (
            member("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 10000000000000), }"),
            "float64 and shape",
        ),
        (member("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }"), "negative"),
        (member("{'descr': '<U500000000', 'fortran_order': False, 'shape': (), }"), "allocate|EOF"),
        (member("{'descr': '<U0', 'fortran_order': False, 'shape': (1000000,), }"), "of type <U0"),
        (member("{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }", bytes(15)), "EOF"),
        (
            member("{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }", bytes(17)),
            "more follows",
        ),
        (
            member(
                "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
                b"cos\nsystem\n(S'ls'\ntR.",
            ),
            "allow_pickle",
        ),
        (
            member("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }", bytes(8)),
            "of type",
        ),
        (member("__import__('os')"), "."),
    ]:
        refused(why, unpack_arrays, content)


def test_files_are_read_and_unpacked_up_to_a_limit(tmp_path):
    content = npz(a=np.zeros(1_000_000))
    assert len(content) < 20_000
    refused("more than 1000000 bytes", unpack_arrays, content, 1_000_000)
    path = tmp_path / "file"
    path.write_bytes(bytes(10))
    assert read_limited(path, 10, "a test") == bytes(10)
    refused("more than 9 bytes", read_limited, path, 9, "a test")
    refused("No such file", read_limited, tmp_path / "none", 9, "a test", error=OSError)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_pipes_and_devices_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    for name in ("pipe", "zeros"):
        refused("no ordinary file", read_limited, tmp_path / name, 9, "a test")
    with pytest.raises((InputError, OSError)):
        read_limited(tmp_path, 9, "a test")


@pytest.mark.parametrize("there", [False, True])
def test_files_are_written_together_or_not_at_all(tmp_path, there):
    folder = tmp_path / "above" / "new"
    if there:
        write_together(folder, {"a": b"0", "notes": b"mine"})
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    with pytest.raises(OSError, match="File name too long") as caught:
        write_together(folder, {"a": b"1", "x" * 300: b"2"})
    assert caught.value.filename == str(folder)
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before
    write_together(folder, {"a": b"1", "deep/b": b"2"})
    found = {str(file.relative_to(folder)) for file in folder.rglob("*")}
    assert found == {"a", "deep", "deep/b", *(["notes"] if there else [])}
    assert (folder / "a").read_bytes() == b"1"
    assert [file.name for file in folder.parent.iterdir()] == ["new"]


def test_a_file_is_replaced_by_text_bytes_or_a_function(tmp_path):
    for content in ("é", "é".encode(), lambda file: file.write("é".encode())):
        write_atomically(tmp_path / "a", content)
        assert (tmp_path / "a").read_text(encoding="utf-8") == "é"


NOTE = ManifestFormat("note", ("text", "pages"), "write_note")


@pytest.fixture
def album(tmp_path) -> ArtifactFormat:
    return ArtifactFormat(
        "album",
        ("name", "photos_sha256"),
        "save_album",
        data_file="photos.bin",
        digest_key="photos_sha256",
        max_bytes=10,
        shipped=tmp_path / "albums",
    )


def test_what_is_saved_is_loaded_and_data_of_another_manifest_are_noticed(album, tmp_path):
    folder = album.save(tmp_path / "deep" / "summer", {"name": "summer"}, b"sun")
    fields, data = album.load(folder)
    assert (fields["name"], data) == ("summer", b"sun")
    assert {file.name for file in folder.iterdir()} == {"photos.bin", MANIFEST}
    # no temporary folder is left
    assert [file.name for file in folder.parent.iterdir()] == ["summer"]
    album.save(folder, {"name": "autumn"}, b"rain")  # into a folder that exists
    assert album.load(folder)[1] == b"rain"
    folder = album.save(tmp_path / "summer", {"name": "summer"}, b"sun")
    (folder / "photos.bin").write_bytes(b"moon")
    refused("digest differs", album.load, folder)
    (folder / "photos.bin").write_bytes(bytes(11))
    refused("more than 10 bytes", album.load, folder)
    (folder / "photos.bin").unlink()
    refused(r"can't read .*photos.bin.*written by save_album", album.load, folder)


def test_the_shipped_ones_are_listed_and_lie_beside_the_package_or_in_it(album, tmp_path):
    assert album.shipped_names() == []
    for name in ("winter", "summer"):
        album.save(tmp_path / "albums" / name, {"name": name}, b"")
    (tmp_path / "albums" / "notes").mkdir()  # no manifest: none of them
    assert album.shipped_names() == ["summer", "winter"]
    assert album.find("winter") == tmp_path / "albums" / "winter"
    assert album.find(tmp_path) == tmp_path
    refused(
        r"unknown album 'spring': .*\(summer, winter\)",
        album.find,
        "spring",
        error=UnknownNameError,
    )
    refused("album 3 ", album.find, 3)
    package = tmp_path / "package"
    package.mkdir()
    assert shipped_folder(package, "albums") == tmp_path / "albums"
    (package / "data" / "albums").mkdir(parents=True)
    assert shipped_folder(package, "albums") == package / "data" / "albums"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "pcs-racing album"}, r"manifest of a note: .*'pcs-racing note'"),
        ({"version": 2}, "has version 2"),
        ({"colour": "red"}, "unknown or missing colour"),
        ({"pages": ...}, "unknown or missing pages"),
    ],
)
def test_a_manifest_of_something_else_is_refused(tmp_path, change, message):
    file = tmp_path / "note.yaml"
    NOTE.write(file, {"text": "Grüße", "pages": 2})
    assert NOTE.read(file) == {"text": "Grüße", "pages": 2}
    values = {**yaml.safe_load(file.read_text(encoding="utf-8")), **change}
    file.write_text(
        yaml.safe_dump({key: value for key, value in values.items() if value is not ...})
    )
    refused(message, NOTE.read, file)
    file.write_text("- 1")
    refused("manifest of a note", NOTE.read, file)
