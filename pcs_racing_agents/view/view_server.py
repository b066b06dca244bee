"""A small server for one viewer on this machine: the page, and any race of it driven again when it is asked for.

It listens on 127.0.0.1 only and answers two addresses, ``/`` and ``/race/NUMBER``. Requests that another site's page
makes a browser send are refused: by the name of the host that they ask for (a page that has rebound its own name to
127.0.0.1 would still ask for that name), and by what the browser says about where they come from.
"""

import re
import threading
from collections import OrderedDict
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.race.replay import safe_json
from pcs_racing_agents.view.race_replays import RaceDriver

__all__ = ["MOST_KEPT", "RaceService", "make_server"]

MOST_KEPT = 200  # answers kept in memory, some 40 kB each
LONGEST_PATH = 100

_RACE = re.compile(r"/race/([0-9]{1,7})")


class RaceService:
    """Drives races one at a time and keeps the last answers.

    Parameters
    ----------
    driver : RaceDriver
    races : int
        How many there are.
    """

    def __init__(self, driver: RaceDriver, races: int) -> None:
        self.driver = driver
        self.races = races
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def answer(self, number: int) -> tuple[int, bytes]:
        """Return the status and the JSON for a race: the race with its circuit and space, or ``error``."""
        if not 0 <= number < self.races:
            return 404, _error(f"there is no race {number}; there are races 0 to {self.races - 1}")
        with self._lock:
            if number not in self._kept:
                try:
                    race = self.driver.drive(number)
                except (InputError, ModuleNotFoundError, OSError) as error:
                    return 409, _error(" ".join(str(error).split()))
                circuit = [race.circuit, self.driver.circuits[race.circuit]]
                content = {"race": race.values, "circuit": circuit, "space": self.driver.space}
                self._kept[number] = safe_json(content).encode()
                while len(self._kept) > MOST_KEPT:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(number)
            return 200, self._kept[number]


def _error(text: str) -> bytes:
    return safe_json({"error": text}).encode()


def make_server(page: str, answer: Callable[[int], tuple[int, bytes]], port: int = 0) -> ThreadingHTTPServer:
    """Return a server on 127.0.0.1 that is ready to be started with ``serve_forever``.

    Parameters
    ----------
    page : str
        What ``/`` shows.
    answer : callable
        ``answer(number) -> (status, JSON)`` for ``/race/NUMBER``.
    port : int
        0 takes a free one.

    Raises
    ------
    InputError
        If the port is impossible or taken.
    """
    check_whole("port", port, 0, 65535)  # 0 takes any free one
    content = page.encode()

    class Handler(BaseHTTPRequestHandler):
        """Answers a viewer."""

        protocol_version = "HTTP/1.1"
        server_version = "pcs-racing"
        sys_version = ""
        timeout = 60

        def do_GET(self) -> None:
            """Send the page or a race."""
            here = self.connection.getsockname()[1]
            host = self.headers.get("Host", "")
            site = self.headers.get("Sec-Fetch-Site", "none")
            found = _RACE.fullmatch(self.path)
            if host not in (f"127.0.0.1:{here}", f"localhost:{here}"):
                self._send(403, _error("this server answers for 127.0.0.1 only"))
            elif site not in ("none", "same-origin"):
                self._send(403, _error("another site's page asked for this"))
            elif self.path == "/":
                self._send(200, content, "text/html; charset=utf-8")
            elif len(self.path) <= LONGEST_PATH and found is not None:
                self._send(*answer(int(found.group(1))))
            else:
                self._send(404, _error("there is / and /race/NUMBER here"))

        def _send(self, status: int, body: bytes, kind: str = "application/json") -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("X-Frame-Options", "DENY")
            self.send_header("Cross-Origin-Resource-Policy", "same-origin")
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            """Keep quiet."""

    class Server(ThreadingHTTPServer):
        """Ends with the command, and does not tell of viewers who went away."""

        daemon_threads = True

        def handle_error(self, *_: Any) -> None:
            """A viewer that goes away in the middle of an answer is no error."""

    try:
        return Server(("127.0.0.1", port), Handler)
    except OSError as error:
        raise InputError(f"can't listen on port {port}: {error.strerror}") from None
