import argparse
import io
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pytest
import yaml
from annotated_types import Interval
from PIL import Image
from refusal import refused
from replay_pages import race_in

from pcs_racing import load_rules, load_track, racer, record_race
from pcs_racing.base.settings import OptionalNames, Settings
from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing.planners import registry
from pcs_racing.planners.racers import policy_racer
from pcs_racing.track.maps import find_shipped, list_tracks
from pcs_racing.track.track import calibration_values
from pcs_racing_agents.cli.commands import ConfigOptions, Option, add_commands, command
from pcs_racing_agents.cli.main import FILES, _parser, main

SHORT = ["--duration", "4"]
PAIR = ["--ego", "lattice:pace=0.8", "--opponent", "lattice:pace=0.2"]
PPO = ["train", "ppo", "--config", "duel-paper", "--out", "x"]
TREE = [
    "tree",
    "--archive",
    "default",
    "--track",
    "Tarnfjord",
    "--moves",
    "2",
    "--step",
    "2",
    "--out",
    "x",
]


@pytest.fixture
def copied(tmp_path) -> Path:
    """A shipped circuit, copied to a folder whose name has a space."""
    folder = tmp_path / "my maps" / "Pipkin"
    folder.mkdir(parents=True)  # one to write to, for any place of the shipped one
    for file in find_shipped("Pipkin").iterdir():
        shutil.copyfile(file, folder / file.name)
    return folder


def test_a_race_tells_who_drove_how_far_and_the_series_that_it_belongs_to(printed, tmp_path):
    """Race 4 is the second of races 3 to 5."""
    rules = tmp_path / "rules.yaml"
    rules.write_text("rules: contest\nname: sprint\nduration: 3.0\nheats: 3\n")
    words = ["race", "--track", "Pipkin", *PAIR, "--rules", rules, "--index", 4, "--seed", 2]
    out = printed(*words)
    printed(*words, "--replay", tmp_path / "race.html", "--video", tmp_path / "race.gif")
    assert (tmp_path / "race.gif").read_bytes().startswith(b"GIF89a")
    assert "candidates" in race_in((tmp_path / "race.html").read_text())
    track, config = load_track("Pipkin"), load_rules(rules)
    cars = [racer(text) for text in PAIR[1::2]]
    races = [record_race(track, *cars, config, seed=2, index=index) for index in (3, 4, 5)]
    one = races[1]
    driven = [
        f"car {car}: {PAIR[1 + 2 * car]}, {one.progress[-1, car] - one.progress[0, car]:.1f} m"
        " driven"
        for car in (0, 1)
    ]
    happened = [f"{event.time:5.1f} s  car {event.car} {event.text}" for event in one.events]
    lines = out.splitlines()
    assert lines[0] == f"Pipkin, {track.length:.1f} m a lap, rules sprint, seed 2, race 4"
    assert lines[1 : 4 + len(happened)] == [*driven, *happened, one.outcome]
    won = [sum(race.outcome.startswith(text) for race in races) for text in PAIR[1::2]]
    assert lines[-2] == f"best of 3, races 3 to 5: car 0 won {won[0]}, car 1 won {won[1]}"
    assert sum(won) == 3
    assert printed(*words).splitlines() == lines  # the same seed, the same race


def test_a_race_without_options_is_worth_watching(printed, tmp_path):
    out = printed("race", "--replay", tmp_path / "race.html")
    assert out.startswith("Brackwater, ")
    assert re.search(r" overtakes at \d+ m, \d\.\d\d m apart\n", out)
    assert re.search(r"\n(\S+) wins by \d+\.\d m after 40 s\n", out)  # no crash
    assert out.endswith(f"replay: {tmp_path / 'race.html'}\n")
    assert race_in((tmp_path / "race.html").read_text())["track_name"] == "Brackwater"


def test_a_tournament_of_agents_goes_on_where_it_was_stopped(run, told, tmp_path, monkeypatch):
    """Without a folder it prints its table and writes nothing."""
    monkeypatch.chdir(tmp_path)
    arguments = [
        "tournament",
        "--track",
        "Pipkin",
        "--agents",
        "random-moves",
        "always-restraint +",
        "--races",
        2,
    ]
    table = run(*arguments, *SHORT)[1]
    assert not list(tmp_path.iterdir())
    _, out, err = run(*arguments, *SHORT, "--out", tmp_path / "out")
    assert out.startswith("Pipkin, rules paper, seed 0: 2 races of 4 s, ")
    assert out.startswith(table)
    assert "2/2 races" in err
    results = (tmp_path / "out" / "results.csv").read_bytes()
    assert b"random-moves,always-restraint+,Pipkin" in results
    (tmp_path / "out" / "results.csv").unlink()
    assert run(*arguments, *SHORT, "--out", tmp_path / "out")[:2] == (0, out)
    assert (tmp_path / "out" / "results.csv").read_bytes() == results
    another = told(*arguments, *SHORT, "--seed", 1, "--out", tmp_path / "out")
    assert "holds another run: its seed is 0, not 1" in another


def test_the_zoo_and_all_planners_are_listed_with_their_options_and_parameters(printed):
    out = printed("agents")
    listed = [line.split()[0] for line in out.splitlines()]
    assert {"cfr-argmax", "always-MOVE", "random-policy"} <= set(listed)
    assert set(registry.SHIPPED) <= set(listed)
    assert "equilibrium strategy (ships for paper)\n" in out
    assert "counterfactual regret (ships for paper and contest)\n" in out
    assert len(listed) <= 16 + len(registry.SHIPPED)
    assert "MOVE: aggressiveness+, aggressiveness-, restraint+, restraint-\n" in out
    assert "- Option target, by default None. Index of the policy." in printed(
        "agents", "best-fixed"
    )
    lattice, switcher = (printed("agents", name) for name in ("lattice", "lane-switcher"))
    for one in registry.get_planner("lattice").parameters:
        assert re.search(
            rf"\n  {one.name} +{one.default:.4f}  \[{one.low:g}, {one.high:g}\]"
            rf" +{re.escape(one.meaning)}\n",
            lattice,
        )
    assert re.search(r"\n  parameter +default  range +meaning\n", lattice)
    assert (
        switcher.splitlines()[1]
        == f"  variants: {', '.join(registry.get_planner('lane-switcher').variants)}"
    )
    told = printed("agents", "always-restraint+")
    assert told.startswith("always-restraint+\n\nMakes the same move at every step.\n\nWith ")


def test_track_show_lists_the_circuits_or_draws_one(printed, tmp_path):
    out = printed("track", "show")
    laps = {name: f"{load_track(name).length:.1f}" for name in list_tracks()}
    assert [tuple(line.split()) for line in out.splitlines()[1:]] == list(laps.items())
    out = printed("track", "show", "pipkin", "--out", tmp_path / "picture.png")
    assert out.startswith("Pipkin")
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.width > 300


def test_track_import_completes_a_map(printed, copied, tmp_path):
    bare = tmp_path / "bare" / "hall"
    bare.mkdir(parents=True)
    shutil.copy(copied / "Pipkin_map.png", bare)
    shutil.copy(copied / "Pipkin_map.yaml", bare / "hall.yaml")
    start = load_track(copied).to_cartesian([0.0, 0.0])
    target = tmp_path / "out" / "Hall"
    way = ["--seed-point", start[0], start[1], "--direction", "clockwise"]
    assert str(target) in printed("track", "import", bare, "--out", target, *way)
    result = load_track(target)
    assert result.name == "Hall"
    assert result.length == pytest.approx(load_track(copied).length, rel=0.03)
    ahead = np.exp(1j * result.to_cartesian([0.0, 0.0])[2])
    assert (ahead * np.exp(-1j * start[2])).real < -0.9  # the other way round


def test_track_generate_is_repeatable(run, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    assert [
        run("track", "generate", "--seed", 2, "--name", "Dell", "--out", out)[0]
        for out in (one, two)
    ] == [0, 0]
    assert load_track(one).content_hash == load_track(two).content_hash


def test_track_calibrate_prints_speeds_and_start_places_and_keeps_them_if_asked(
    printed, copied, monkeypatch
):
    found = load_track("Pipkin").calibration["contest"]
    report = SimpleNamespace(table=lambda: "the table", calibration=found)
    monkeypatch.setattr("pcs_racing_agents.cli.track.calibrate", lambda *_, **__: report)
    file = copied / "Pipkin_track.yaml"
    before = yaml.safe_load(file.read_text())
    before.pop("calibration")
    file.write_text(yaml.safe_dump(before))
    command = ["track", "calibrate", copied, "--rules", "contest"]
    assert printed(*command) == "the table\n"
    assert load_track(copied).calibration == {}
    assert printed(*command, "--write").endswith(f"written: {file}\n")
    assert load_track(copied).calibration["contest"] == found
    after = yaml.safe_load(file.read_text())
    assert after.pop("calibration") == {"contest": calibration_values(found)}
    assert after == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["race", "--track", "Nurburg", *PAIR], "unknown track 'Nurburg'"),
        (
            ["race", "--track", "Pipkin", "--ego", "latice", "--opponent", "lattice"],
            "did you mean 'lattice'?",
        ),
        (
            ["race", *PAIR, "--index", "20000000000"],
            "index is 20000000000; it must be a whole number from 0 to",
        ),
        (
            ["race", "--track", "Pipkin", *PAIR, "--replay", "no/such/folder/race.html"],
            "there is no folder",
        ),
        (
            ["race", "--track", "Pipkin", *PAIR, "--replay", "race.mp4"],
            "must end in .html",
        ),
        (["race", "--ego", "cfr-argmax"], "race in 'pcs-racing tournament --agents'"),
        (["race", "--opponent", "always-speed+"], "'always-speed+' is an agent"),
        (
            ["tournament", "--track", "Pipkin", "--agents", "lattice"],
            "a tournament needs at least 2",
        ),
        (["tornament"], "command 'tornament' is unknown; did you mean 'tournament'?"),
        (["race", "--ego", "lane-switcher:33"], "no variant '33'; did you mean '3'?"),
        (["race", "--track", ""], "unknown track ''"),
        (["race", "--track", "pipkn"], "did you mean 'Pipkin'?"),
        (["race", *PAIR, "--video", "race.avi"], "must end in .mp4 or .gif"),
        (["race", "--ego", "os.path:nothing"], "os.path has no class and no function 'nothing'"),
        (["race", "--ego", "random:Random"], "can't race; give a text, a policy"),
        (["tournament", "--track", "Pipkin", "--agents", "nahs", "nash"], "did you mean 'nash'?"),
        (
            ["tournament", "--agents", "random-moves", "nash", "--archive", "x"],
            "unknown archive 'x'",
        ),
        (["track", "calibrate", "--write"], "--write changes a map folder: say which"),
        (["track", "show", "Pipkin", "--out", "picture.gif"], "must end in .png"),
        (
            ["track", "generate", "--seed", "1", "--style", "baroque", "--out", "x"],
            "style is 'baroque'; it must be one of hull, voronoi, hairpin",
        ),
        (["track", "show", "--out", "picture.png"], "--out draws a circuit: say which"),
        (["agents", "latice"], "did you mean 'lattice'?"),
        (["agents", "robot"], "agent 'robot' is unknown; there are: "),
        (["study", "contest", "--test-track", "Nowhere", "--out", "x"], "Nowhere"),
        (["study", "contest", "--test-track", "Pipkin", "--out", "x"], "Pipkin"),
        (["solve", "nowhere"], "holds no game trees"),
        (["solve", "nowhere", "--tree", "1"], "--tree goes with --export"),
        (["view", "nowhere"], "there is no folder nowhere; give one of a tournament or a study"),
        (["race", "--opponent", *["lattice"] * 8], "names 8 policies; a race has at most 7"),
        (["solve", "nowhere", "--export", "t.gbt"], "must end in .efg"),
        ([*PPO, "--config", "nonsense"], "ppo settings 'nonsense' are unknown"),
        ([*PPO, "--steps", "0"], "steps is 0"),
        ([*PPO, "--seeds", "-1"], "seeds is (-1,)"),
        ([*TREE, "--moves", "9"], "a tree of 9 moves with 4 choices for each player has"),
        ([*TREE, "--rules", "nope"], "rules 'nope' are unknown"),
    ],
)
def test_an_error_is_one_line(told, arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in told(*arguments)
    assert not list(tmp_path.iterdir())  # nothing half done


@pytest.mark.parametrize(
    ("stopped", "code", "told"),
    [
        (KeyboardInterrupt(), 130, "pcs-racing: interrupted\n"),
        (None, 143, "pcs-racing: terminated\n"),
        (
            PermissionError(13, "Permission denied", "a.csv"),
            2,
            "can't read or write a.csv: Permission denied",
        ),
        (OSError("no room for\n  two lines"), 2, "pcs-racing: error: no room for two lines\n"),
    ],
)
def test_what_stops_a_command_is_told_in_a_line(run, monkeypatch, stopped, code, told):
    def fails(_name):
        raise stopped or signal.raise_signal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr("pcs_racing_agents.cli.agents.get_planner", fails)
    result, _, err = run("agents", "lattice")
    assert result == code
    assert told in err
    assert err.count("\n") == 1
    assert signal.getsignal(signal.SIGTERM) == before
    # An error in the program itself is not hidden.
    monkeypatch.setattr("pcs_racing_agents.cli.agents.get_planner", lambda name: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("agents", "lattice")


def test_parameters_of_a_function_become_words_and_options(capsys):
    told = []

    @dataclass(frozen=True, kw_only=True)
    class Weather:
        rain: Annotated[bool, Option("whether it rains")] = False
        wind: Annotated[tuple[float, float] | None, Option("from where")] = None

    @dataclass(frozen=True)
    class Tea(Settings):
        herbs: Annotated[OptionalNames, "What is in it."] = ("mint",)
        sugar: Annotated[int, Interval(ge=0, le=9), "Pieces of sugar."] = 0

    @command("wave", "pcs-racing wave Ada")
    def wave(
        name: Annotated[str, Option("name to greet")],
        often: Annotated[int, Option("100 % of the waves")] = 1,
        *,
        loud: Annotated[float | None, Option("how")] = None,
        others: Annotated[Sequence[str], Option("who else", choices=("Bo", "Cy"))] = ("Bo",),
        weather: Weather,
        changes: Annotated[dict, ConfigOptions(Tea, "herbs", "sugar")],
    ) -> None:
        """Wave at somebody."""
        told.append((name, often, loud, tuple(others), weather, changes))

    parser = argparse.ArgumentParser()
    add_commands(parser.add_subparsers(), SimpleNamespace(wave=wave, another=3))
    many = "Ada 2 --loud 2.5 --others Cy Bo --rain --wind 1 2.5 --herbs dill sage --sugar 3"
    for words in ("Ada", many):
        parsed = parser.parse_args(["wave", *words.split()])
        parsed.run(parsed)
    weather, tea = Weather(rain=True, wind=[1.0, 2.5]), {"herbs": ("dill", "sage"), "sugar": 3}
    assert told == [
        ("Ada", 1, None, ("Bo",), Weather(), {}),
        ("Ada", 2, 2.5, ("Cy", "Bo"), weather, tea),
    ]
    with pytest.raises(SystemExit):
        parser.parse_args(["wave", "--help"])
    out = " ".join(capsys.readouterr().out.split())
    assert "Wave at somebody." in out
    assert "100 % of the waves (default: 1)" in out
    assert "who else (default: Bo)" in out
    assert "whether it rains --wind X X from where " in out
    assert "pieces of sugar; from 0 to 9 (default: 0)" in out


def commands(parser: argparse.ArgumentParser, name: str = "pcs-racing"):
    """Every command by its whole name, groups of commands included."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for key, command in action.choices.items():
                yield f"{name} {key}", command
                yield from commands(command, f"{name} {key}")


COMMANDS = dict(commands(_parser()))


def test_each_command_is_found_in_its_file():
    assert [name.split()[1] for name in COMMANDS if name.count(" ") == 1] == list(FILES)
    for name in FILES:
        assert f"pcs-racing {name}" in dict(commands(_parser(name)))
    told = _parser().format_help()
    assert _parser(brief=True).format_help() == told  # without the import of any command


def modules_after(code: str) -> set[str]:
    """Modules that a process has imported after some code."""
    code = (
        f"import sys; from pcs_racing_agents.cli.main import main, _parser; {code};"
        " print(*sys.modules)"
    )
    return set(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.split()
    )


def test_a_race_begins_without_what_other_commands_need():
    """The rest of the agents takes longer to import than the race takes."""
    assert "numba" not in modules_after("_parser(brief=True).format_help()")
    loaded = modules_after("_parser('race')")
    assert "pcs_racing_agents.cli.race" in loaded
    assert not {
        name
        for name in loaded
        if name.startswith(("pcs_racing_agents.study", "pcs_racing_agents.learning"))
    }


UNKNOWN = "rcae|race --track Pipkn|race --rules cup"


def test_an_unknown_name_is_told_before_compiled_code_is_imported():
    lines = [words.split() for words in UNKNOWN.split("|")]
    assert "numba" not in modules_after(f"assert {{main(words) for words in {lines}}} == {{2}}")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("track shw", "COMMAND is 'shw'; did you mean 'show'? there are: show, import"),
        ("race --trak Pipkin", "option --trak is unknown (did you mean '--track'?)"),
        ("track show Pipkin --seed-point 1 2", "option --seed-point belongs to another command"),
    ],
)
def test_an_unknown_word_or_option_is_one_line_with_the_nearest(capsys, words, message):
    with pytest.raises(SystemExit) as stop:
        main(words.split())
    assert stop.value.code == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


OWN = """
from dataclasses import dataclass

class Straight:
    def plan(self, obs):
        return 0.0, 1.0

@dataclass
class First:
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return 0 * observation[:, 0].astype(int), state

def last(spec):
    return type("Last", (First,), {"name": spec.archive.name})()
"""


def test_own_code_is_named_alike_wherever_a_planner_or_an_agent_is(tmp_path, monkeypatch):
    """A planner's class, an agent's class and a function of the game spec, in a file and in a
    module next to it.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(registry, "_planners", dict(registry._planners))
    (tmp_path / "own_racers.py").write_text(OWN)
    spec = make_game(None, "default", "paper")
    for place in ("own_racers.py", "own_racers"):
        assert policy_racer(f"{place}:Straight", code=True).name == f"{place}:Straight"
        for name in ("Straight", "First", "last"):
            assert competitor(f"{place}:{name}", spec, code=True).name == f"{place}:{name}"
        assert competitor(f"{place}:last", spec, code=True).model.name == "default"
        nobody = "has no class and no function 'Nobody'"
        refused(nobody, competitor, f"{place}:Nobody", spec, code=True)
        refused("is an agent, which moves", policy_racer, "own_racers:First", code=True)


def test_own_code_races_in_other_processes_and_commands_find_it_again(
    tmp_path, monkeypatch, told, printed, run
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_racers.py").write_text(OWN)
    cars = ["own_racers.py:Straight", "own_racers.py:First", "own_racers.py"]
    races = ["--races", 2, "--workers", 1, "--out", "out"]
    view = ["view", "out", "--no-open", "--agents", *cars]
    explain = [*view, "--explain"]
    for line in (
        ["tournament", "--agents", *cars, *races],
        ["view", "out", "--no-open"],
        view,
        [*explain, 0],
    ):
        # each command in a process that does not know them yet
        with monkeypatch.context() as patch:
            patch.setattr(registry, "_planners", dict(registry._planners))
            code, text, error = run(*line)
        assert code == (2 if len(line) == 3 else 0)
        # A folder alone makes no command run code: the user does.
        assert ("(in 'view' after --agents)" in error) == (len(line) == 3)
    assert "own_racers.py:First (car 1) against own_racers.py:Straight" in text
    assert "makes no moves, so there is nothing to explain; nor does" in run(*explain, 2)[2]
    assert "variants: Straight" in printed("agents", "own_racers.py")
    assert "'lattice' is not in the races of out; there are own_racers.py" in told(
        "view", "out", "--agents", "lattice"
    )


@pytest.mark.parametrize(
    ("race", "archive"),
    [("paper", "default"), ("contest", "contest"), ("roboracer", "contest")],
)
def test_rules_bring_their_archive(run, race, archive):
    assert (
        f"With archive {archive} under the rules {race}:"
        in run("agents", "random-moves", "--rules", race)[1]
    )
    assert (
        "With archive default under"
        in run("agents", "random-moves", "--rules", race, "--archive", "default")[1]
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_help_text_with_examples_that_it_understands(name, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["help", *name.split()[1:]])
    assert stop.value.code == 0
    captured = capsys.readouterr().out
    examples = re.findall(
        r"^(?:examples?:)?\s*(pcs-racing .*)$", captured[captured.rindex("example") :], re.MULTILINE
    )
    assert examples
    for example in examples:
        assert example.startswith(name)
        _parser().parse_args(shlex.split(example)[1:])
    for action in COMMANDS[name]._actions:
        assert action.help or isinstance(action, argparse._SubParsersAction), (
            f"{name} {action.dest}"
        )


def test_streams_that_are_closed_or_know_few_letters(tmp_path, monkeypatch, capsys):
    words = ["track", "show", "Pipkin", "--out", str(tmp_path / "K\u00fcche.png")]
    narrow = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", narrow)
    assert main(words) == 0
    assert narrow.buffer.getvalue().endswith(b"K\\xfcche.png\n")
    (tmp_path / "K\u00fcche.png").unlink()
    monkeypatch.setattr(sys, "stdout", None)
    assert main(words) == 2
    closed = "pcs-racing: error: the standard output is closed; send it to a file or to /dev/null\n"
    assert capsys.readouterr().err == closed
    monkeypatch.setattr(sys, "stderr", None)
    assert main(words) == 2
    sys.stderr.close()
    assert not list(tmp_path.iterdir())


def test_a_reader_that_goes_away_is_no_error():
    command = f"'{sys.executable}' -m pcs_racing_agents --version; '{sys.executable}' -m"
    command += " pcs_racing_agents agents | head -n 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"pcs-racing {version('pcs-racing')}\n")
    assert done.stderr == ""
