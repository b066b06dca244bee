"""``pcs-racing view``: what it writes, what it serves, and what it refuses."""

import json
import shutil
import socket
import threading
from http.client import HTTPConnection
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from refusal import refused

from pcs_racing_agents.cli import view
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.study.results import open_results
from pcs_racing_agents.watch.race_choice import SelectedRace, choose_races
from pcs_racing_agents.watch.race_replays import MAX_ANSWERS, RaceRepeater, RepeatedRace
from pcs_racing_agents.watch.view_server import Answer, make_server


@pytest.fixture
def folder(tournament_folder, tmp_path):
    """A copy of a tournament's folder, to be spoilt."""
    place = tmp_path / "mine"
    shutil.copytree(tournament_folder[0], place)
    return place


def test_the_page_lies_beside_the_results(folder, capsys, monkeypatch):
    opened = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(view.webbrowser, "open", opened.append)
    assert main(["view", str(folder), "--replays", "2"]) == 0
    page = folder / "view.html"
    assert capsys.readouterr().out.splitlines()[-1] == f"page: {page}"
    assert opened == [page.as_uri()]
    content = page.read_text()
    assert content.count('<script type="application/json" id="race-') == 2
    assert '"title":"mine"' in content.replace('": ', '":')
    assert '"front"' in content  # the contest's cars start one behind the other
    assert "http://" not in content.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in content
    assert main(["view", str(folder), "--index", "3", "17", "--no-open"]) == 0
    assert opened == [page.as_uri()]
    content = page.read_text()
    assert content.count('<script type="application/json" id="race-') == 2
    assert 'id="race-3"' in content
    assert 'id="race-17"' in content


def test_what_is_asked_for_stands_first_and_then_what_the_rule_selects(tournament_folder):
    races = open_results(tournament_folder[0]).races
    chosen = choose_races(races, 4)
    first, other = (
        chosen[2].race,
        next(k for k in range(18) if k not in [pick.race for pick in chosen]),
    )
    asked = [SelectedRace(number, "a race that was asked for") for number in (other, first)]
    assert view._picks(races, [other, first], 4) == [
        *asked,
        *(pick for pick in chosen if pick.race != first),
    ]
    assert view._picks(races, [], 0) == []


def test_a_browser_is_opened_where_there_is_a_screen(monkeypatch):
    asked = []
    monkeypatch.setattr(view.webbrowser, "open", asked.append)
    for platform, variable in [("linux", "HOME"), ("linux", "DISPLAY"), ("win32", "HOME")]:
        monkeypatch.setattr(view.sys, "platform", platform)
        monkeypatch.setattr(view.os, "environ", {variable: "x"})
        view.open_page(f"{platform} {variable}")
    assert asked == ["linux DISPLAY", "win32 HOME"]


def test_a_study_and_its_ratings_are_viewed_too(study_folder, tmp_path, printed):
    folder = shutil.copytree(study_folder[0], tmp_path / "study")
    assert "40 races, 2 of them to be watched" in printed(
        "view", folder, "--index", 0, 12, "--no-open"
    )
    assert "2 races, 1 of them to be watched" in printed(
        "view", folder / "ratings", "--index", 1, "--no-open"
    )
    assert (folder / "ratings" / "view.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{folder}/nothing"], "there is no folder"),
        (["{folder}/chunks"], "holds no races"),
        (["{folder}/results.csv"], "there is no folder"),
        (["{folder}", "--out", "page.txt"], "its name must end in .html"),
        (["{folder}", "--out", "{folder}/none/page.html"], "there is no folder"),
        (["{folder}", "--out", "a.html", "--serve"], "--out goes without --serve"),
        (["{folder}", "--port", "80"], "--port goes with --serve"),
        (["{folder}", "--replays", "-1"], "--replays is -1; it must be from 0 to 2000"),
        (["{folder}", "--replays", "2001"], "--replays is 2001; it must be"),
        (
            ["{folder}", "--index", *["1"] * 2001],
            "--index names 2001 races; a page holds at most 2000",
        ),
        (["{folder}", "--index", "18"], "--index names 18; there are races 0 to 17"),
        (["{folder}", "--index", "-1"], "--index names -1"),
        (["{folder}", "--serve", "--port", "70000"], "port is 70000"),
    ],
)
def test_what_is_asked_for_wrongly_is_named(folder, arguments, message, told):
    assert message in told("view", *(text.format(folder=folder) for text in arguments), "--no-open")
    assert not (folder / "view.html").exists()


def another_agent(folder):
    manifest = yaml.safe_load((folder / "job.yaml").read_text())
    manifest["settings"]["agents"] = dict.fromkeys(manifest["settings"]["agents"], "0" * 64)
    (folder / "job.yaml").write_text(yaml.safe_dump(manifest))


def test_a_changed_folder_is_one_clear_error_and_its_races_can_still_be_listed(folder, run):
    another_agent(folder)
    code, _, error = run("view", folder, "--replays", 4, "--no-open")
    assert code == 2
    assert "has changed since the races were driven" in error
    assert "--replays 0 lists the races" in error
    assert run("view", folder, "--replays", 0, "--no-open")[0] == 0


@pytest.fixture
def ask(folder, served):
    """Asks a running server; returns status and content."""
    repeater = RaceRepeater(open_results(folder))
    port = int(served("<p>the page", repeater.answer).strip("/").rpartition(":")[2])

    def get(path, method="GET", **headers):
        connection = HTTPConnection("127.0.0.1", port, timeout=120)
        names = {name.replace("_", "-"): value.format(port=port) for name, value in headers.items()}
        connection.putrequest(method, path, skip_host="Host" in names)
        for name, value in names.items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer, content

    return get


def test_the_server_drives_what_it_is_asked_for(ask, tournament_folder):
    answer, content = ask("/")
    assert (answer.status, content) == (200, b"<p>the page")
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    answer, content = ask("/race/4")
    race = json.loads(content)
    assert answer.status == 200
    assert race["race"]["car_names"] == [
        tournament_folder[1].races[4].ego,
        tournament_folder[1].races[4].opponent,
    ]
    assert race["circuit"][0] == "Pipkin"
    assert ask("/race/4", Host="localhost:{port}", Sec_Fetch_Site="same-origin")[1] == content


NOWHERE = (
    "/race/18 /race/99999999 /race/-1 /race/1/../../job.yaml /../job.yaml /race/%31 /race/1?x"
    f" /race/{'1' * 5000}"
)


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        *((path, {}, 404) for path in NOWHERE.split()),
        ("/", {"Host": "example.com:{port}"}, 403),
        ("/", {"Host": "127.0.0.1:1"}, 403),
        ("/race/1", {"Sec_Fetch_Site": "cross-site"}, 403),
        ("/", {"Sec_Fetch_Site": "same-site"}, 403),
        ("/race/1", {"Origin": "http://evil.example"}, 403),
    ],
)
def test_the_server_answers_nothing_else(ask, path, headers, status):
    answer, content = ask(path, **headers)
    assert answer.status == status
    assert "error" in json.loads(content)


def test_the_server_is_for_reading(ask):
    for method, status in (("POST", 405), ("PUT", 501), ("DELETE", 501)):
        assert ask("/race/1", method)[0].status == status


def test_a_race_that_can_not_be_driven_is_told(folder):
    another_agent(folder)
    answer = RaceRepeater(open_results(folder)).answer("/race/3")
    assert answer.status == 409
    assert "has changed since the races were driven" in json.loads(answer.body)["error"]


def exchange(server, *requests):
    """Send requests on a connection each, all before the first answer is read; return the answers'
    first lines.
    """
    host = f"127.0.0.1:{server.server_address[1]}"
    lines = []
    for request in requests:
        with socket.create_connection(server.server_address, 60) as one:
            one.sendall(request.format(host=host).replace("\n", "\r\n").encode())
            lines.append(one.makefile("rb").readline().decode().strip())
    return lines


def test_what_changes_something_is_asked_for_by_post_and_two_origins_are_none():
    asked = []
    with make_server(
        "", lambda path: asked.append(path) or Answer(200, b"{}"), method="POST"
    ) as server:
        threading.Thread(target=server.serve_forever).start()
        head, end = "/begin/1 HTTP/1.1\nHost: {host}\n", "Connection: close\n\n"
        own, other = "Origin: http://{host}\n", "Origin: http://evil.example\n"
        answers = exchange(
            server,
            f"GET {head}{end}",
            f"POST / HTTP/1.1\nHost: {{host}}\n{end}",
            f"POST {head}{own}{other}{end}",
            f"POST {head}{own}{own}{end}",
            f"POST {head}Host: evil\n{own}{end}",
            f"POST {head}{own}{end}",
        )
        # What follows as the body of a request is no request of its own.
        exchange(server, f"POST {head}Content-Length: 5\n\nPOST {head}{end}")
        server.shutdown()
    assert [line.split()[1] for line in answers] == ["405", "405", "403", "403", "403", "200"]
    assert asked == ["/begin/1"] * 2


def test_no_race_is_driven_for_a_viewer_who_has_left():
    asked, first, go_on = [], threading.Event(), threading.Event()

    def answer(path):
        asked.append(path)
        first.set()
        assert go_on.wait(60)
        return Answer(200, b"{}")

    with make_server("", answer) as server:
        threading.Thread(target=server.serve_forever).start()
        ask = (
            f"GET /race/{{}} HTTP/1.1\r\nHost: 127.0.0.1:{server.server_address[1]}\r\nConnection:"
            " close\r\n\r\n"
        )
        waiting = [socket.create_connection(server.server_address, 60) for _ in range(3)]
        waiting[0].sendall(ask.format(0).encode())
        assert first.wait(60)
        for number in (1, 2):
            waiting[number].sendall(ask.format(number).encode())
        waiting[1].close()
        go_on.set()
        with waiting[0], waiting[2], waiting[2].makefile("rb") as answered:
            assert answered.readline().startswith(b"HTTP/1.1 200")
        server.shutdown()
    assert sorted(asked) == ["/race/0", "/race/2"]


def test_answers_are_kept_but_not_for_ever():
    asked = []

    def drive(number):
        asked.append(number)
        return RepeatedRace(number, "c", {})

    repeater = RaceRepeater(SimpleNamespace(races=range(MAX_ANSWERS + 10)))
    repeater.circuits["c"], repeater.drive = {}, drive
    for number in (0, 1, 0, *range(2, MAX_ANSWERS + 1)):
        assert repeater.answer(f"/race/{number}").status == 200
    assert asked == list(range(MAX_ANSWERS + 1))
    repeater.answer("/race/0")
    assert asked[-1] == MAX_ANSWERS  # was used again later than 1, so it is still there
    repeater.answer("/race/1")
    assert asked[-1] == 1


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["view", "{folder}", "--serve"], "18 races"),
        (["play", "--opponent", "never-switch", "--track", "Pipkin"], "play"),
        (
            [
                "play",
                "--drive",
                "--opponent",
                "random-moves",
                "--track",
                "Pipkin",
                "--rules",
                "contest",
            ],
            "play",
        ),
    ],
)
def test_a_command_serves_until_it_is_ended(folder, arguments, what, capsys, monkeypatch):
    addresses = []

    def end(self, *_):
        addresses.append(self.server_address)
        raise KeyboardInterrupt

    monkeypatch.setattr(view, "open_page", addresses.append)
    monkeypatch.setattr("http.server.ThreadingHTTPServer.serve_forever", end)
    assert main([text.format(folder=folder) for text in arguments]) == 0
    assert addresses[0] == f"http://127.0.0.1:{addresses[1][1]}/"
    assert addresses[1][0] == "127.0.0.1"
    assert f"{what} at {addresses[0]}" in capsys.readouterr().out
    assert not (folder / "view.html").exists()


def test_a_port_that_is_taken_is_named():
    with make_server("", lambda path: Answer(200, b"")) as server:
        taken = int(np.int64(server.server_address[1]))
        refused("can't listen on port", make_server, "", lambda path: Answer(200, b""), port=taken)
