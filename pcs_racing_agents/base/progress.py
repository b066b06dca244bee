"""Progress of long work, as a line on the terminal."""

import sys
import time
from collections.abc import Callable

Progress = Callable[[int, int, str], None]
"""``progress(done, total, label)``: called after every finished task."""


def show_progress(unit: str = "races") -> Progress:
    """Return a progress function that keeps a line on stderr up to date.

    If stderr is no terminal, it prints plain lines: at most one line every 2 s, and the last line.
    """
    begin = spoken = time.monotonic()
    first: tuple[float, int] | None = None

    def show(done: int, total: int, label: str) -> None:
        nonlocal first, spoken
        now = time.monotonic()
        # Earlier runs say nothing about the speed of this run.
        if first is None:
            first = (now, done) if now - begin < 0.2 else (begin, 0)
        line = f"{done}/{total} {unit}, {now - begin:.0f} s"
        if done < total and done > first[1]:
            left = (now - first[0]) * (total - done) / (done - first[1])
            line += f", about {duration_text(left)} left"
        if done < total:
            line += f": {label}"
        if sys.stderr.isatty():
            end = "\n" if done >= total else ""
            print(f"\r\x1b[K{line:.110}", end=end, file=sys.stderr, flush=True)
        elif done >= total or now - spoken >= 2.0:
            spoken = now
            print(line, file=sys.stderr, flush=True)

    return show


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``"90 s"``, ``"5 min"``, ``"2.5 h"``."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"
