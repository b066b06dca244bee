"""Folders with a manifest: a data file, and ``manifest.yaml`` with their description and SHA-256.

Policy archives, networks and trained policies are saved in such folders; a choice made on training
races is a manifest alone. Files may come from untrusted sources: their size is limited, no content
is executed, and invalid content raises one clear error.
"""

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from pcs_racing.base.errors import InputError, UnknownNameError, check_path
from pcs_racing.base.files import (
    MAX_YAML,
    parse_yaml,
    read_limited,
    write_atomically,
    write_together,
)

MANIFEST = "manifest.yaml"


@dataclass(frozen=True)
class ManifestFormat:
    """Format of a YAML manifest, with its writer and reader."""

    noun: str  #: Name of the described object in messages: "archive".
    keys: tuple[str, ...]  #: Fields in addition to ``format`` ("pcs-racing NOUN") and ``version``.
    writer: str  #: Name of the writing function, for messages.
    version: int = 1  #: Version of the format; manifests of other versions are refused.

    @property
    def a_noun(self) -> str:
        """Noun with its article: "an archive"."""
        return f"{'an' if self.noun[0] in 'aeiou' else 'a'} {self.noun}"

    def write(self, file: Path, fields: Mapping[str, Any]) -> None:
        """Write a manifest; the file appears whole or not at all."""
        write_atomically(file, self.text(fields))

    def read(self, file: str | os.PathLike[str]) -> dict[str, Any]:
        """Return the fields of a manifest."""
        manifest = parse_yaml(file, self._content(file, MAX_YAML))
        form = f"pcs-racing {self.noun}"
        if not isinstance(manifest, dict) or manifest.get("format") != form:
            raise InputError(f"{file} is no manifest of {self.a_noun}: format must be {form!r}")
        if manifest.get("version") != self.version:
            raise InputError(
                f"{file} has version {manifest.get('version')!r}; this release reads {self.version}"
            )
        odd = set(manifest) ^ {"format", "version", *self.keys}
        if odd:
            names = ", ".join(sorted(map(str, odd)))
            raise InputError(
                f"{file}: unknown or missing {names}; a manifest holds {', '.join(self.keys)}"
            )
        return {key: manifest[key] for key in self.keys}

    def text(self, fields: Mapping[str, Any]) -> bytes:
        """Return the content of a manifest."""
        values = {
            "format": f"pcs-racing {self.noun}",
            "version": self.version,
            **{key: fields[key] for key in self.keys},
        }
        return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=110).encode()

    def _content(self, file: str | os.PathLike[str], limit: int) -> bytes:
        try:
            return read_limited(file, limit, self.a_noun)
        except OSError as error:
            raise InputError(
                f"can't read {file}: {error.strerror}; {self.a_noun} must have been written by"
                f" {self.writer}"
            ) from None


@dataclass(frozen=True)
class ArtifactFormat(ManifestFormat):
    """Format of a folder: its manifest, its data file, and the folder of the shipped artifacts."""

    data_file: str = "data"  #: Name of the data file.
    digest_key: str = "sha256"  #: Manifest field with the SHA-256 of the data; in ``keys``.
    max_bytes: int = 32_000_000  #: Maximum size of the data.
    shipped: Path = Path()  #: Folder of the shipped artifacts, with a folder for each name.
    manifest_file: str = MANIFEST  #: Name of the manifest.

    def files(self, fields: Mapping[str, Any], data: bytes) -> dict[str, bytes]:
        """Return the files of a folder: data and manifest (``fields`` and the digest)."""
        digest = hashlib.sha256(data).hexdigest()
        manifest = self.text({**fields, self.digest_key: digest})
        return {self.data_file: data, self.manifest_file: manifest}

    def save(self, folder: str | Path, fields: Mapping[str, Any], data: bytes) -> Path:
        """Write data and manifest into a folder, made if missing; return the folder."""
        folder = Path(check_path(f"the folder of {self.a_noun}", folder))
        write_together(folder, self.files(fields, data))
        return folder

    def load(self, folder: str | os.PathLike[str]) -> tuple[dict[str, Any], bytes]:
        """Return the fields of the manifest and the data, after a check of the data's digest."""
        folder = Path(folder)
        manifest = folder / self.manifest_file
        fields = self.read(manifest)
        file = folder / self.data_file
        data = self._content(file, self.max_bytes)
        if hashlib.sha256(data).hexdigest() != fields[self.digest_key]:
            raise InputError(
                f"{file} is not the file that {manifest} describes: its digest differs"
            )
        return fields, data

    def shipped_names(self) -> list[str]:
        """Return the names of the shipped artifacts, sorted."""
        return sorted(path.parent.name for path in self.shipped.glob(f"*/{self.manifest_file}"))

    def find(self, source: str | os.PathLike[str]) -> Path:
        """Return the folder of a shipped artifact, given its name, or a given folder unchanged."""
        if not isinstance(source, str | os.PathLike):
            raise InputError(f"{self.noun} {source!r} must be a name or a folder")
        names = self.shipped_names()
        if source in names:
            return self.shipped / str(source)
        if not os.path.isdir(source):
            raise UnknownNameError(
                f"unknown {self.noun} {str(source)!r}: neither a folder nor one of those shipped "
                f"({', '.join(names) or 'none'})"
            )
        return Path(source)
