"""Time of a stage, including earlier runs that were stopped or killed."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pcs_racing.base.files import write_atomically

BEAT = 20.0  # s: longest time that is lost when the process is killed


@contextmanager
def seconds_counted(file: Path) -> Iterator[Callable[[], float]]:
    """Measure the time of a stage, starting at the seconds in a file of a stopped run.

    Parameters
    ----------
    file : Path
        Updated regularly; removed when the work is done.

    Yields
    ------
    callable
        Returns the seconds so far.
    """
    before, began, done = _read(file), time.monotonic(), threading.Event()

    def spent() -> float:
        return before + time.monotonic() - began

    def write() -> None:
        text = f"{spent():.1f}\n".encode()
        write_atomically(file, lambda out: out.write(text))

    def write_regularly() -> None:
        while not done.wait(BEAT):
            write()

    thread = threading.Thread(target=write_regularly, daemon=True)
    thread.start()
    try:
        yield spent
    except BaseException:
        done.set()
        thread.join()
        write()
        raise
    done.set()
    thread.join()
    file.unlink(missing_ok=True)


def _read(file: Path) -> float:
    """Return the seconds in a file; 0 if there are none or they are impossible."""
    try:
        seconds = float(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0.0
    return seconds if 0.0 <= seconds < 1e9 else 0.0
