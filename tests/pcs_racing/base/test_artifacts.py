import pytest
import yaml
from refusal import refused

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat, ManifestFormat
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.files import shipped_folder

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


@pytest.mark.parametrize("method", ["write_bytes", "mkdir"])
def test_a_half_written_folder_never_appears(album, tmp_path, monkeypatch, method):
    def full(path, *_, **__):
        if path != tmp_path:
            raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(f"pathlib.Path.{method}", full)
    with pytest.raises(OSError, match="No space left") as caught:
        album.save(tmp_path / "summer", {"name": "summer"}, b"sun")
    assert caught.value.filename == str(tmp_path / "summer")
    assert list(tmp_path.iterdir()) == []


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
