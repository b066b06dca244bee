"""Pages in a browser: opening one, and serving one until the command is interrupted."""

import os
import sys
import webbrowser
from http.server import ThreadingHTTPServer


def open_page(address: str) -> None:
    """Open a browser if there is a display; without one, Python would start a browser in this terminal."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        return
    webbrowser.open(address)


def serve(server: ThreadingHTTPServer, what: str, *, open_it: bool) -> None:
    """Serve a page until the command is interrupted; prints what is at which address."""
    address = f"http://127.0.0.1:{server.server_address[1]}/"
    print(f"{what} at {address} (Ctrl-C ends it)", flush=True)
    if open_it:
        open_page(address)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        print("ended", file=sys.stderr)
