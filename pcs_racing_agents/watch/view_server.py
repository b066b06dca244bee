"""A small local server for a page that requests races while it is open.

It listens on 127.0.0.1 only. It answers ``/`` with the page, and passes every other address to a
service, such as the repeater of a results folder's races. Requests from pages of other sites are
refused by the requested host name (a page that rebinds its own name to 127.0.0.1 still requests
that name) and by the origin that the browser reports.
"""

import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

from pcs_racing.base.errors import InputError, check_whole
from pcs_racing.race.replay import safe_json

MAX_PATH = 100
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
}


class Answer(NamedTuple):
    """The answer to a request."""

    status: int  #: HTTP status.
    body: bytes
    kind: str = "application/json"  #: Media type of the body.


def error_answer(status: int, text: str) -> Answer:
    """Return the answer to a failed request: JSON with one line, ``error``."""
    return Answer(status, safe_json({"error": " ".join(text.split())}).encode())


def make_server(page: str, answer: Callable[[str], Answer], port: int = 0) -> ThreadingHTTPServer:
    """Return a server on 127.0.0.1, ready for ``serve_forever``.

    Parameters
    ----------
    page : str
        Content of ``/``.
    answer : callable
        Function ``answer(path) -> Answer`` for every other address of at most 100 characters,
        called one at a time.
    port : int
        Port; 0 takes a free port.
    """
    check_whole("port", port, 0, 65535)
    # Each request has its own thread, but the service holds shared data of the races.
    content, busy = Answer(200, page.encode(), "text/html; charset=utf-8"), threading.Lock()

    class _Handler(BaseHTTPRequestHandler):
        """Handler of a viewer's requests, one per connection: no body becomes a next request."""

        timeout = 60

        def do_GET(self) -> None:
            """Send the page, or the service's answer."""
            # The port chosen for port 0 is known only now; the host of a request includes it.
            own_port = self.connection.getsockname()[1]
            hosts, sites, origins = (
                self.headers.get_all(name, []) for name in ("Host", "Sec-Fetch-Site", "Origin")
            )
            # With two headers the first might pass and the second might count.
            if hosts not in ([f"127.0.0.1:{own_port}"], [f"localhost:{own_port}"]):
                self._send(error_answer(403, "this server answers for 127.0.0.1 only"))
            elif sites not in ([], ["none"], ["same-origin"]) or origins not in (
                [],
                [f"http://{hosts[0]}"],
            ):
                self._send(error_answer(403, "another site's page asked for this"))
            elif self.path == "/":
                self._send(content)
            elif len(self.path) > MAX_PATH:
                self._send(error_answer(404, f"an address here has at most {MAX_PATH} characters"))
            else:
                with busy:
                    found = answer(self.path)
                self._send(found)

        def _send(self, sent: Answer) -> None:
            self.send_response(sent.status)
            sizes = {"Content-Type": sent.kind, "Content-Length": str(len(sent.body))}
            for name, value in {**sizes, **HEADERS}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(sent.body)

        def log_message(self, *_: Any) -> None:
            """Log nothing."""

    class _Server(ThreadingHTTPServer):
        """Server that does not report disconnected viewers."""

        request_queue_size = 128  # max waiting connections; 5 refuses most of 200 at once

        def handle_error(self, *_: Any) -> None:
            """Ignore a viewer that disconnects during an answer."""

    try:
        return _Server(("127.0.0.1", port), _Handler)
    except OSError as error:
        raise InputError(f"can't listen on port {port}: {error.strerror}") from None
