import dataclasses
import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from PIL import Image

from pcs_racing.base.errors import InputError
from pcs_racing.race.replay import Replay, ReplayEvent, read_replay, save_replay, write_html

NASTY = '</script><b>bold</b><script>document.title="owned"</script><!--replay--><!--title-->&amp;"\'\u2028'


def race_on_a_circle(seconds=4.0, candidates=0, every=1, seed=0, **changes):
    """Two cars on circles around the origin, counterclockwise, with plans and any number of candidates."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / 0.05) + 1) * 0.05
    radius, speed = np.array([9.7, 10.3]), np.array([5.0, 4.6])
    angle = 0.3 + speed * time[:, None] / radius
    steering = np.broadcast_to(np.arctan(0.33 / radius), angle.shape) + 0.02 * rng.standard_normal(angle.shape)
    rest = np.broadcast_to(speed, angle.shape), angle + np.pi / 2, np.broadcast_to(speed / radius, angle.shape)
    cars = np.stack([radius * np.cos(angle), radius * np.sin(angle), steering, *rest, 0.0 * angle], axis=-1)

    ahead = np.linspace(0.0, 1.0, 12)
    turn = angle[:-1:2, :, None] + speed[:, None] * ahead / radius[:, None]
    points = [radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)]
    paths = np.stack(
        [*points, np.broadcast_to(speed[:, None], turn.shape), np.broadcast_to(ahead, turn.shape)], axis=-1
    )
    extra = {}
    if candidates:
        steps = np.arange(0, len(paths), every)
        bend = np.linspace(-0.8, 0.8, candidates)[:, None] * ahead[:10] ** 2
        wide = (radius[:, None, None] + bend)[..., None]
        turn = turn[steps][:, :, None, :10, None]
        extra["candidates"] = wide * np.concatenate([np.cos(turn), np.sin(turn)], axis=-1)
        costs = 1.0 + bend[:, -1] ** 2 + 0.1 * rng.random((len(steps), 2, candidates))
        extra["costs"] = np.where(bend[:, -1] > 0.6 * bend[-1, -1], np.inf, costs)
        extra["candidate_steps"] = steps

    around = np.linspace(0.0, 2.0 * np.pi, 65)
    loops = [r * np.column_stack([np.cos(around), np.sin(around)]) for r in (8.9, 11.1)]
    fields = {
        "title": "A race on a circle",
        "track_name": "circle",
        "car_names": ("inner", "outer"),
        "cars": cars,
        "progress": angle * 10.0,
        "walls": np.vstack([np.hstack([loop[:-1], loop[1:]]) for loop in loops]),
        "line": 10.0 * np.column_stack([np.cos(around), np.sin(around)])[:-1],
        "line_speed": 5.0 + np.cos(around[:-1]),
        "ittc": np.full((len(time), 2), 2.0),
        "paths": paths,
        "events": (ReplayEvent(seconds / 2, 0, "move", "aggressiveness +"), ReplayEvent(seconds, 1, "crash", "wall")),
        "outcome": "inner wins",
    }
    return Replay(**(fields | extra | changes))


# The value


def test_a_replay_is_an_immutable_copy():
    cars = race_on_a_circle().cars.copy()
    replay = race_on_a_circle(cars=cars)
    cars[:] = 0.0
    assert replay.cars[0, 0, 0] > 9.0
    with pytest.raises(ValueError, match="read-only"):
        replay.cars[0, 0, 0] = 1.0
    assert replay.duration == pytest.approx(4.0)
    assert replay.lead[-1] == pytest.approx(10.0 * (5.0 / 9.7 - 4.6 / 10.3) * 4.0)


def test_events_are_sorted_and_steps_default_to_all_plans():
    events = (ReplayEvent(3.0, 0, "move"), ReplayEvent(1.0, 1, "move"))
    replay = race_on_a_circle(events=events, candidates=3, candidate_steps=None)
    assert [event.time for event in replay.events] == [1.0, 3.0]
    assert replay.candidate_steps.tolist() == list(range(len(replay.paths)))


def _changed(array, index, value):
    array = np.array(array, float)
    array[index] = value
    return array


GOOD = race_on_a_circle(candidates=3)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("title", 3),
        ("title", "x" * 501),
        ("title", "\ud800"),
        ("car_names", ("alone",)),
        ("car_names", "ab"),
        ("outcome", None),
        ("frame_dt", 0.0),
        ("frame_dt", float("nan")),
        ("plan_dt", "0.1"),
        ("cars", np.zeros((0, 2, 7))),
        ("cars", np.zeros((5, 3, 7))),
        ("cars", _changed(GOOD.cars, (3, 1, 0), np.nan)),
        ("cars", "fast"),
        ("progress", GOOD.progress[:-1]),
        ("walls", np.zeros((4, 3))),
        ("line", np.zeros((2, 2))),
        ("line_speed", np.ones(3)),
        ("ittc", _changed(GOOD.ittc, (0, 0), np.nan)),
        ("paths", _changed(GOOD.paths, (0, 0, 0, 1), np.nan)),
        ("paths", _changed(GOOD.paths, (0, 0, 0, 1), np.inf)),
        ("costs", None),
        ("costs", _changed(GOOD.costs, (0, 0, 0), -np.inf)),
        ("costs", _changed(GOOD.costs, (0, 0, 0), np.nan)),
        ("candidate_steps", [0]),
        ("candidate_steps", np.arange(len(GOOD.candidates))[::-1]),
        ("candidate_steps", np.arange(len(GOOD.candidates)) + 1),
        ("candidate_steps", np.arange(len(GOOD.candidates)) + 0.5),
        ("half_sizes", np.zeros((2, 2))),
        ("half_sizes", [0.29, 0.155]),
        ("events", ("crash",)),
        ("events", (ReplayEvent(-1.0, 0, "crash"),)),
        ("events", (ReplayEvent(1.0, 2, "crash"),)),
        ("events", (ReplayEvent(1.0, 0, 5),)),
    ],
)
def test_impossible_values_are_named(field, value):
    with pytest.raises(InputError, match=field.removesuffix("s")):
        dataclasses.replace(GOOD, **{field: value})


# Writing and reading


@pytest.mark.parametrize("suffix", [".html", ".json"])
def test_a_race_comes_back_rounded(tmp_path, suffix):
    replay = race_on_a_circle(candidates=7, every=3, car_names=("Ωmega, ü", NASTY), title=NASTY)
    path = save_replay(replay, tmp_path / f"a race{suffix}")
    back = read_replay(path)
    assert (back.title, back.car_names, back.events) == (replay.title, replay.car_names, replay.events)
    assert np.array_equal(back.candidate_steps, replay.candidate_steps)
    for name, within in [("cars", 0.0005), ("progress", 0.0005), ("line", 0.0005), ("paths", 0.0005)]:
        assert np.abs(getattr(back, name) - getattr(replay, name)).max() <= within + 1e-9, name
    for name, within in [("candidates", 0.005), ("walls", 0.005), ("line_speed", 0.005), ("ittc", 0.005)]:
        assert np.abs(getattr(back, name) - getattr(replay, name)).max() <= within + 1e-9, name
    assert np.array_equal(np.isinf(back.costs), np.isinf(replay.costs))
    again = save_replay(back, tmp_path / f"again{suffix}")
    assert again.read_bytes() == path.read_bytes()


def test_optional_parts_may_be_absent(tmp_path):
    bare = race_on_a_circle(paths=None, ittc=None, line_speed=None, events=(), walls=np.zeros((0, 4)))
    back = read_replay(save_replay(bare, tmp_path / "bare.html"))
    assert back.paths is None
    assert back.candidates is None
    assert back.ittc is None
    assert len(back.walls) == 0


def test_infinite_time_to_collision_is_stored_as_a_minute(tmp_path):
    replay = race_on_a_circle(ittc=np.full((81, 2), np.inf))
    assert np.all(read_replay(save_replay(replay, tmp_path / "a.json")).ittc == 60.0)


def test_the_page_is_one_file_that_loads_nothing(tmp_path):
    page = write_html(race_on_a_circle(candidates=3), tmp_path / "race.html").read_text()
    assert "default-src 'none'" in page
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", page)
    assert not re.search(r"<(link|img|iframe)|\bsrc=|@import|url\(|fetch\(|XMLHttpRequest|innerHTML|eval\(", page)


def test_names_can_not_break_out_of_their_place(tmp_path):
    calm = write_html(race_on_a_circle(), tmp_path / "calm.html").read_text()
    events = (ReplayEvent(1.0, 0, NASTY, NASTY),)
    nasty = race_on_a_circle(title=NASTY, track_name=NASTY, car_names=(NASTY, NASTY), outcome=NASTY, events=events)
    page = write_html(nasty, tmp_path / "nasty.html").read_text()
    for tag in ("<script", "</script", "<b>", "<!--"):
        assert page.count(tag) == calm.count(tag), tag


def test_the_same_race_gives_the_same_bytes(tmp_path):
    first = write_html(race_on_a_circle(candidates=3), tmp_path / "a.html").read_bytes()
    assert write_html(race_on_a_circle(candidates=3), tmp_path / "b.html").read_bytes() == first


def test_a_race_of_40_s_is_small(tmp_path):
    page = write_html(race_on_a_circle(40.0), tmp_path / "a.html").stat().st_size
    assert page < 150_000
    page = write_html(race_on_a_circle(40.0, candidates=54), tmp_path / "b.html").stat().st_size
    assert page < 1_500_000


def test_files_are_replaced_whole_or_not_at_all(tmp_path):
    path = write_html(race_on_a_circle(1.0), tmp_path / "a.html")
    before = path.read_bytes()
    huge = race_on_a_circle(1.0, costs=None, candidates=0)
    object.__setattr__(huge, "progress", np.full((21, 2), 1e300))
    with pytest.raises(InputError):
        write_html(huge, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.html"]


def test_impossible_places_are_refused(tmp_path):
    replay = race_on_a_circle(1.0)
    (tmp_path / "folder.html").mkdir()
    for path in (tmp_path / "none" / "a.html", tmp_path / "a.pdf", tmp_path / "folder.html"):
        with pytest.raises(InputError, match=path.name):
            save_replay(replay, path)
    with pytest.raises(InputError, match=r"missing\.html"):
        read_replay(tmp_path / "missing.html")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<html></html>",
        "[]",
        "{}",
        "null",
        "[" * 100_000,
        '{"format": "pcs-racing replay 2"}',
        "NaN",
        "1" * 5000,
        b"\xff\xfe".decode("latin-1"),
    ],
)
@pytest.mark.parametrize("suffix", [".html", ".json"])
def test_other_files_are_no_replays(tmp_path, text, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match="replay"):
        read_replay(path)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("title", ["x"]),
        ("frame_dt", 10**400),
        ("half_sizes", [[10**400, 1], [1, 1]]),
        ("events", [[1.0, 0, "crash"]]),
        ("events", [["soon", 0, "crash", ""]]),
        ("events", [[float("nan"), 0, "crash", ""]]),
        ("events", {}),
        ("cars", {"shape": [1]}),
        ("cars", [[0.0]]),
        ("walls", {"points": 1, "counts": 2}),
        ("paths", "none"),
        ("costs", {"offset": 0.0, "per_unit": 0.0, "steps": {}}),
        ("line", None),
        ("surprise", 1),
    ],
)
def test_every_part_of_a_file_is_checked(tmp_path, part, value):
    path = save_replay(GOOD, tmp_path / "a.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {part: value}))
    with pytest.raises(InputError, match="is not a replay"):
        read_replay(path)


# In a browser

# A clock in the test's hands: a headless browser draws frames when it likes.
CLOCK = """<head><script>
let next = null, now = 0;
window.requestAnimationFrame = (callback) => { next = callback; return 1; };
const frames = (n) => { while (n--) { const callback = next; now += 50; callback(now); } };
</script>"""

# What a viewer might do, and what the page says afterwards.
VISIT = """<script>
const seen = {};
const press = (key) => window.dispatchEvent(new KeyboardEvent("keydown", { key, cancelable: true }));
frames(3);
seen.title = document.title;
seen.bold = document.querySelectorAll("b").length;
seen.start = [state.t, state.follow, state.candidates];
seen.lead = leadAt(duration);
seen.pose = [pose(1, 2.0).x, pose(1, 2.0).y];
press("2"); press("ArrowRight"); press("c");
seen.pressed = [state.t, state.follow, state.candidates];
press("ArrowUp"); press(" ");
frames(12);
seen.played = [state.t, state.speed, state.playing, [...document.querySelectorAll("#log li span")].length];
press(" ");
frames(60);
const before = camera.scale;
view.dispatchEvent(new WheelEvent("wheel", { deltaY: -300, cancelable: true }));
frames(1);
seen.zoomed = camera.scale / before;
const box = chartCanvas.getBoundingClientRect();
chartCanvas.setPointerCapture = () => {};
chartCanvas.dispatchEvent(new PointerEvent("pointerdown", { clientX: box.left + timeToX(3), clientY: box.top + 20 }));
frames(1);
seen.clicked = state.t;
seen.drawn = Number(document.documentElement.dataset.drawn);
document.body.dataset.seen = JSON.stringify(seen);
</script>
</body>"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Opens a page without a display; gives what it printed (its DOM) and what it complained about."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no chromium on PATH to open the page with")

    def visit(path, moment, *arguments):
        quiet = "--disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-component-update"
        command = [program, "--headless", "--no-sandbox", *quiet.split(), "--disable-sync", "--enable-logging=stderr"]
        command += [f"--user-data-dir={tmp_path_factory.mktemp('profile')}", "--window-size=1200,800"]
        command += ["--virtual-time-budget=4000", *arguments, f"{path.as_uri()}#{moment}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return visit


def test_the_page_answers_to_its_viewer(tmp_path, browser):
    replay = race_on_a_circle(8.0, candidates=5, title=NASTY, car_names=(NASTY, "outer"))
    path = write_html(replay, tmp_path / "a race.html")
    path.write_text(path.read_text().replace("<head>", CLOCK).replace("</body>", VISIT))
    dom, complaints = browser(path, "t=2.5&follow=0&candidates=1", "--dump-dom")
    assert complaints == []
    seen = json.loads(html.unescape(re.search(r'data-seen="([^"]*)"', dom).group(1)))
    assert seen["title"] == NASTY
    assert seen["bold"] == 1  # the clock's
    assert seen["start"] == [2.5, "0", True]
    assert seen["lead"] == pytest.approx(replay.lead[-1], abs=0.002)
    assert seen["pose"] == pytest.approx(list(replay.cars[40, 1, :2]), abs=0.001)
    assert seen["pressed"] == [3.5, "1", False]
    assert seen["played"] == [pytest.approx(3.5 + 12 * 0.05 * 2), 2, True, 1]  # the move came at 4 s
    assert seen["zoomed"] == pytest.approx(np.exp(0.48), rel=0.01)
    assert seen["clicked"] == pytest.approx(3.0, abs=0.05)
    assert seen["drawn"] == pytest.approx(seen["clicked"], abs=0.01)


@pytest.mark.parametrize(
    "moment", ["t=2&follow=both&theme=light", "t=4&theme=dark&candidates=1", "t=nonsense&follow=7"]
)
def test_the_page_draws_both_cars(tmp_path, browser, moment):
    path = write_html(race_on_a_circle(4.0, candidates=5, every=2), tmp_path / "race.html")
    _, complaints = browser(path, moment, f"--screenshot={tmp_path / 'shot.png'}")
    assert complaints == []
    stage = np.array(Image.open(tmp_path / "shot.png").convert("RGB"))[120:430].astype(int)
    colours = [(88, 166, 255), (255, 176, 59)] if "dark" in moment else [(27, 111, 216), (224, 135, 0)]
    for colour in colours:
        assert np.count_nonzero(np.abs(stage - colour).sum(axis=-1) < 12) > 40


def test_a_bare_race_draws_too(tmp_path, browser):
    bare = race_on_a_circle(0.0, paths=None, ittc=None, line_speed=None, events=(), walls=np.zeros((0, 4)))
    path = write_html(bare, tmp_path / "bare.html")
    path.write_text(path.read_text().replace("<head>", CLOCK).replace("</body>", "<script>frames(3)</script></body>"))
    dom, complaints = browser(path, "follow=1&play=1", "--dump-dom")
    assert complaints == []
    assert 'data-drawn="0.00"' in dom
