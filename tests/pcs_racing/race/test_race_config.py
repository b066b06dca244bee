import dataclasses

import pytest
from refusal import refused

from pcs_racing import CONTEST, PAPER, load_rules
from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.race.config import FULL_SIGHT, KNOWN_RULES, ROBORACER, Rules


def test_the_presets():
    """The paper's race: side by side and undisturbed for 40 s; a crash is a no-contest."""
    assert KNOWN_RULES == {"paper": PAPER, "contest": CONTEST, "roboracer": ROBORACER}
    assert (ROBORACER.contact, ROBORACER.most_faults, ROBORACER.heats, ROBORACER.start_speed) == (
        "restart",
        3,
        3,
        0.0,
    )
    assert Rules() == PAPER
    values = dataclasses.asdict(PAPER)
    assert values.pop("start_lines") > 1
    assert values == {
        "name": "paper",
        "duration": None,
        "laps": None,
        "start": "side-by-side",
        "start_gap": 0.0,
        "start_spacing": 0.9,
        "start_speed": 4.0,
        "steering_noise": 0.0,
        "noise_time": 0.28,
        "sight": FULL_SIGHT,
        "front_pace": (1.0, 1.0),
        "speed_range": None,
        "crash_rule": "nobody",
        "aggressiveness": "lead",
        "ittc_horizon": 10.0,
        "contact": "end",
        "most_faults": 0,
        "heats": 1,
        "steps": (8.0,) * 5,
        "epsilon": 0.5,
        "stay": False,
        "utility": None,
        "fault_penalty": 0.0,
        "discount": 1.0,
        "characteristics": None,
        "mask_duplicates": True,
    }
    assert PAPER.ticks == CONTEST.ticks == 4000
    assert (PAPER.seconds, load_rules("paper", duration=6.5).seconds) == (40.0, 6.5)
    assert (CONTEST.start, CONTEST.start_gap, CONTEST.start_spacing) == ("staggered", 1.4, 0.45)
    assert (CONTEST.steering_noise, CONTEST.crash_rule, CONTEST.stay) == (
        0.02,
        "fault-loses",
        True,
    )
    assert CONTEST.aggressiveness == "speed"
    assert (CONTEST.sight, CONTEST.front_pace, CONTEST.heats) == (4.7, (0.88, 1.0), 2)
    assert (ROBORACER.sight, ROBORACER.front_pace) == (4.7, (1.0, 1.0))
    assert CONTEST.steps == ROBORACER.steps == (0.0, 2.0, 6.0, 8.0, 8.0, 8.0, 8.0)
    for wrong in ((), (8.0,), 8.0, (8.0, 0.0), (8.0, 0.05), (8.0, "8"), (8.0, 601.0)):
        refused("steps", Rules, steps=wrong, error=ConfigError)


@pytest.mark.parametrize(
    ("key", "low", "high", "more"),
    [
        ("duration", 0.1, 3600.0, {}),
        ("start_gap", 0.8, 50.0, {"start": "staggered"}),
        ("start_gap", 0.0, 50.0, {}),
        ("start_spacing", 0.4, 10.0, {}),
        ("start_spacing", 0.0, 10.0, {"start": "rolling", "start_gap": 1.0}),
        ("start_speed", 0.0, 15.0, {}),
        ("steering_noise", 0.0, 0.4, {}),
        ("noise_time", 0.01, 60.0, {}),
        ("ittc_horizon", 0.1, 1000.0, {}),
        ("start_lines", 1, 1000, {}),
        ("most_faults", 0, 100, {}),
        ("heats", 1, 99, {}),
        ("laps", 1, 100, {}),
    ],
)
def test_every_number_has_a_least_and_a_largest_value(key, low, high, more):
    step = 1 if isinstance(low, int) else 0.1 if key == "duration" else 1e-6
    for value in (low, high):
        assert getattr(Rules(**{key: value}, **more), key) == value
    optional = () if key in ("duration", "laps") else (None,)
    for value in (low - step, high + step, float("nan"), True, "1", *optional):
        refused(key, Rules, error=ConfigError, **{key: value}, **more)


def test_a_configuration_by_name_or_from_yaml_and_bad_files(tmp_path):
    file = tmp_path / "my rules.yaml"
    file.write_text("rules: contest\nname: sprint\nduration: 12.5\nspeed_range: [0.8, 1.1]\n")
    config = load_rules(file, start_gap=3.0)
    assert config == dataclasses.replace(
        CONTEST, name="sprint", duration=12.5, speed_range=(0.8, 1.1), start_gap=3.0
    )
    hash(config)  # the range is a tuple, not a list
    assert load_rules("contest", duration=16.0) == dataclasses.replace(CONTEST, duration=16.0)
    refused(r"rules 'papper' are unknown", load_rules, "papper", error=UnknownNameError)
    for text, message in [
        ("durration: 4", "rules.yaml: unknown rules setting 'durration'"),
        ("rules: cup", "rules is 'cup'"),
    ]:
        file = tmp_path / "rules.yaml"
        file.write_text(text)
        refused(message, load_rules, file, error=ConfigError)


def test_laps_have_40_s_each_unless_the_rules_have_a_duration(tmp_path):
    assert load_rules("roboracer", laps=20).seconds == 800.0
    assert load_rules("roboracer", laps=100).seconds == 3600.0
    assert load_rules("roboracer", laps=20, duration=300.0).ticks == 30_000
    file = tmp_path / "race.yaml"
    file.write_text("rules: roboracer\nlaps: 20\n")
    assert load_rules(file) == load_rules("roboracer", laps=20)
    for laps in (0, -1, 1.5, 1000):
        words = f"^laps is {laps}; it must be a whole number from 1 to 100$"
        refused(words, Rules, error=ConfigError, laps=laps)


def test_impossible_values_and_speed_ranges_are_refused_by_name():
    wrong = {
        "duration": 12.34,
        "start": "flying",
        "start_lines": 2.5,
        "crash_rule": "both",
        "name": "",
    }
    for key, value in {**wrong, "aggressiveness": "anger", "stay": 1}.items():
        refused(f"^{key} is", Rules, error=ConfigError, **{key: value})
    for name in ("two\nlines", "\x1b[31mred"):
        refused("^name is .* printable characters", Rules, error=ConfigError, name=name)
    for start in ["staggered", "rolling"]:
        refused(rf"start_gap is 0\.0 m; a {start}", Rules, start=start, error=ConfigError)
        Rules(start=start, start_gap=0.8)
    for speeds in ((0.1, 3.0), [0.5, 1]):
        assert Rules(speed_range=speeds).speed_range == tuple(speeds)
    for speeds in (
        (0.09, 1.0),
        (0.5, 3.1),
        (0.9, 0.9),
        (1.0, 0.5),
        (1.0,),
        (0.5, 0.6, 0.7),
        "ab",
        (True, 2.0),
        0.5,
    ):
        refused("speed_range", Rules, speed_range=speeds, error=ConfigError)
