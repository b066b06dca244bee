"""Atomic writing of files: a reader never sees an incomplete file."""

import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import IO

from pcs_racing.base.errors import InputError


def write_atomically(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file completely or not at all: ``write`` fills a temporary file, which then replaces ``path``."""
    if not path.parent.is_dir():
        raise InputError(f"can't write {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"can't write {path}: it is a folder")
    # In the same folder, because a file can only be renamed within one file system; cut, because names have a limit.
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}")
    try:
        with open(temporary, "xb") as file:
            write(file)
        os.replace(temporary, path)
    except OSError as error:
        if error.strerror is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        temporary.unlink(missing_ok=True)
