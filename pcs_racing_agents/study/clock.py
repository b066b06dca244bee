"""How long a stage took, with the time before it was stopped or killed."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pcs_racing.base.files import write_atomically

__all__ = ["seconds_counted"]

BEAT = 20.0  # s: what is lost at most when the process is killed


@contextmanager
def seconds_counted(file: Path) -> Iterator[Callable[[], float]]:
    """Count seconds, beginning with those that a file holds from a run that was stopped.

    Parameters
    ----------
    file : Path
        Kept up to date on the way; removed when the work is done.

    Yields
    ------
    callable
        Tells the seconds so far.
    """
    before, began, done = _read(file), time.monotonic(), threading.Event()

    def spent() -> float:
        return before + time.monotonic() - began

    def note() -> None:
        text = f"{spent():.1f}\n".encode()
        write_atomically(file, lambda out: out.write(text))

    def keep_noting() -> None:
        while not done.wait(BEAT):
            note()

    thread = threading.Thread(target=keep_noting, daemon=True)
    thread.start()
    try:
        yield spent
    except BaseException:
        done.set()
        thread.join()
        note()
        raise
    done.set()
    thread.join()
    file.unlink(missing_ok=True)


def _read(file: Path) -> float:
    """Return the seconds in a file; 0 where there are none, or none that can be."""
    try:
        found = float(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0.0
    return found if 0.0 <= found < 1e9 else 0.0
