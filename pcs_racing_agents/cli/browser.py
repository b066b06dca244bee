"""Opening of pages in a browser."""

import os
import sys
import webbrowser

__all__ = ["open_page"]


def open_page(address: str) -> None:
    """Open a browser if there is a display; without one, Python would start a browser in this terminal."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        return
    webbrowser.open(address)
