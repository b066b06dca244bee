import threading

import pytest

from pcs_racing_agents.cli.main import main
from pcs_racing_agents.view.view_server import make_server


@pytest.fixture(scope="session")
def page(tournament_folder, tmp_path_factory):
    """Its page, with five races to watch."""
    path = tmp_path_factory.mktemp("pages") / "view.html"
    assert main(["view", str(tournament_folder[0]), "--replays", "5", "--out", str(path), "--no-open"]) == 0
    return path


@pytest.fixture
def served():
    """Serve a page until the test ends; returns its address."""
    running = []

    def serve(page, answer):
        server = make_server(page, answer)
        running.append((server, threading.Thread(target=server.serve_forever)))
        running[0][1].start()
        return f"http://127.0.0.1:{server.server_address[1]}/"

    yield serve
    for server, thread in running:
        server.shutdown()
        thread.join()
        server.server_close()
