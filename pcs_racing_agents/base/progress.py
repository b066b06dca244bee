"""Progress of long work, as a line on the terminal."""

import sys
import time
from collections.abc import Callable

Progress = Callable[[int, int, str], None]
"""``progress(done, total, label)``: called after every finished task."""


def show_line() -> Callable[[str, bool], None]:
    """Return a function that keeps a line on stderr up to date: ``say(line, last)``.

    If stderr is no terminal, the function prints plain lines: at most one line every 2 s, and the
    last line.
    """
    spoken = time.monotonic()

    def say(line: str, last: bool) -> None:
        nonlocal spoken
        if sys.stderr.isatty():
            print(f"\r\x1b[K{line:.110}", end="\n" if last else "", file=sys.stderr, flush=True)
        elif last or time.monotonic() - spoken >= 2.0:
            spoken = time.monotonic()
            print(line, file=sys.stderr, flush=True)

    return say


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``"90 s"``, ``"5 min"``, ``"2.5 h"``."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def show_progress(unit: str = "races") -> Progress:
    """Return a progress function that keeps a line on stderr up to date (:func:`show_line`)."""
    say = show_line()
    begin = time.monotonic()
    first: tuple[float, int] | None = None

    def show(done: int, total: int, label: str) -> None:
        nonlocal first
        now = time.monotonic()
        # Earlier runs say nothing about the speed of this run.
        if first is None:
            first = (now, done) if now - begin < 0.2 else (begin, 0)
        fresh = done - first[1]
        left = (
            f", about {duration_text((now - first[0]) * (total - done) / fresh)} left"
            if fresh > 0
            else ""
        )
        ahead = f"{left}: {label}" if done < total else ""
        say(f"{done}/{total} {unit}, {now - begin:.0f} s{ahead}", done >= total)

    return show
