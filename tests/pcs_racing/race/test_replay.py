import dataclasses
import json
import re

import numpy as np
import pytest
from recorded_races import race_on_a_circle
from refusal import refused

from pcs_racing.race.replay import ReplayEvent, read_replay, save_replay


def test_a_replay_is_an_immutable_copy_with_sorted_events():
    cars = race_on_a_circle().cars.copy()
    replay = race_on_a_circle(cars=cars)
    cars[:] = 0.0
    assert replay.cars[0, 0, 0] > 9.0
    refused("read-only", replay.cars.fill, 1.0, error=ValueError)
    assert replay.duration == pytest.approx(4.0)
    assert replay.lead[-1] == pytest.approx(10.0 * (5.0 / 9.7 - 4.6 / 10.3) * 4.0)
    events = (ReplayEvent(3.0, 0, "move"), ReplayEvent(1.0, 1, "move"))
    replay = race_on_a_circle(events=events, candidates=3)
    assert [event.time for event in replay.events] == [1.0, 3.0]


def _changed(array, index, value):
    array = np.array(array, float)
    array[index] = value
    return array


GOOD = race_on_a_circle(candidates=3)

WRONG = {
    "title": (3, "x" * 501, "\ud800"),
    "car_names": ((), "ab"),
    "outcome": (None,),
    "frame_dt": (0.0, float("nan")),
    "plan_dt": ("0.1",),
    "cars": (
        np.zeros((0, 2, 7)),
        np.zeros((5, 3, 7)),
        _changed(GOOD.cars, (3, 1, 0), np.nan),
        "fast",
    ),
    "progress": (GOOD.progress[:-1],),
    "walls": (np.zeros((4, 3)),),
    "line": (np.zeros((2, 2)),),
    "line_speed": (np.ones(3),),
    "ittc": (_changed(GOOD.ittc, (0, 0), np.nan),),
    "paths": tuple(_changed(GOOD.paths, (0, 0, 0, 1), value) for value in (np.nan, np.inf)),
    "candidates": (GOOD.candidates[:-1],),
    "moving": (np.zeros((3, 1, 4, 2)), np.full((len(GOOD.cars), 1, 4, 2), np.nan)),
    "costs": (None, *(_changed(GOOD.costs, (0, 0, 0), value) for value in (-np.inf, np.nan))),
    "half_sizes": (np.zeros((2, 2)), [0.29, 0.155]),
    "events": (
        "crash",
        *(ReplayEvent(*event) for event in ((-1.0, 0, "crash"), (1.0, 2, "crash"), (1.0, 0, 5))),
    ),
}


def test_impossible_values_are_named():
    for field, value in [(field, value) for field, values in WRONG.items() for value in values]:
        refused(
            field.removesuffix("s"),
            dataclasses.replace,
            GOOD,
            **{field: (value,) if field == "events" else value},
        )


NASTY = (
    '</script><b>bold</b><script>document.title="owned"</script>'
    "<!--replay--><!--title-->&amp;\"'\u2028"
)


@pytest.mark.parametrize("suffix", [".html", ".json"])
def test_a_race_comes_back_rounded(tmp_path, suffix):
    replay = race_on_a_circle(candidates=7, car_names=("Ωmega, ü", NASTY), title=NASTY)
    path = save_replay(replay, tmp_path / f"a race{suffix}")
    back = read_replay(path)
    assert (back.title, back.car_names, back.events) == (
        replay.title,
        replay.car_names,
        replay.events,
    )
    fine, coarse = (
        ("cars", "progress", "line", "paths"),
        ("candidates", "walls", "line_speed", "ittc"),
    )
    for name in fine + coarse:
        within = 0.0005 if name in fine else 0.005
        assert np.abs(getattr(back, name) - getattr(replay, name)).max() <= within + 1e-9, name
    assert np.array_equal(np.isinf(back.costs), np.isinf(replay.costs))
    assert save_replay(back, tmp_path / f"again{suffix}").read_bytes() == path.read_bytes()


def test_optional_parts_may_be_absent_and_a_race_of_40_s_is_small(tmp_path):
    bare = race_on_a_circle(
        paths=None, ittc=None, line_speed=None, events=(), walls=np.zeros((0, 4))
    )
    back = read_replay(save_replay(bare, tmp_path / "bare.html"))
    assert back.paths is None
    assert back.candidates is None
    assert back.ittc is None
    assert len(back.walls) == 0
    replay = race_on_a_circle(ittc=np.full((81, 2), np.inf))
    assert np.all(read_replay(save_replay(replay, tmp_path / "a.json")).ittc == 60.0)
    page = save_replay(race_on_a_circle(40.0), tmp_path / "a.html").stat().st_size
    assert page < 150_000
    page = save_replay(race_on_a_circle(40.0, candidates=54), tmp_path / "b.html").stat().st_size
    assert page < 1_500_000


def test_the_page_is_one_file_that_loads_nothing_and_names_can_not_break_out(tmp_path):
    page = save_replay(race_on_a_circle(candidates=3), tmp_path / "race.html").read_text()
    assert "default-src 'none'" in page
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", page)
    assert not re.search(
        r"<(link|img|iframe)|\bsrc=|@import|url\(|fetch\(|XMLHttpRequest|innerHTML|eval\(", page
    )
    calm = save_replay(race_on_a_circle(), tmp_path / "calm.html").read_text()
    events = (ReplayEvent(1.0, 0, NASTY, NASTY),)
    nasty = race_on_a_circle(
        title=NASTY, track_name=NASTY, car_names=(NASTY, NASTY), outcome=NASTY, events=events
    )
    page = save_replay(nasty, tmp_path / "nasty.html").read_text()
    for tag in ("<script", "</script", "<b>", "<!--"):
        assert page.count(tag) == calm.count(tag), tag


def test_files_are_replaced_whole_or_not_at_all_and_impossible_places_refused(tmp_path):
    path = save_replay(race_on_a_circle(1.0), tmp_path / "a.html")
    before = path.read_bytes()
    huge = race_on_a_circle(1.0, costs=None, candidates=0)
    object.__setattr__(huge, "progress", np.full((21, 2), 1e300))
    refused("numbers that are not finite", save_replay, huge, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.html"]
    replay = race_on_a_circle(1.0)
    (tmp_path / "folder.html").mkdir()
    for path in (tmp_path / "none" / "a.html", tmp_path / "a.pdf", tmp_path / "folder.html"):
        refused(path.name, save_replay, replay, path)
    refused(r"missing\.html", read_replay, tmp_path / "missing.html")


OTHERS = (
    "",
    "<html></html>",
    "[]",
    "null",
    "[" * 100_000,
    '{"format": "pcs-racing replay 1"}',
    "1" * 5000,
    "ÿþ",
)


@pytest.mark.parametrize("text", OTHERS, ids=lambda text: text[:10])
@pytest.mark.parametrize("suffix", [".html", ".json"])
def test_other_files_are_no_replays(tmp_path, text, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text.encode("latin-1"))
    refused("replay", read_replay, path)


IN_FILES = {
    "title": (["x"],),
    "frame_dt": (10**400,),
    "half_sizes": ([[10**400, 1], [1, 1]], [None, None], [[None, 1], [1, 1]]),
    "events": (
        [[1.0, 0]],
        [["soon", 0, "crash", ""]],
        [[float("nan"), 0, "crash", ""]],
        3,
    ),
    "cars": ({"shape": [1]}, [[0.0]]),
    "walls": ({"points": 1, "counts": 2},),
    "paths": ("none",),
    "costs": ({"offset": 0.0, "per_unit": 0.0, "steps": {}},),
    "line": (None,),
    "surprise": (1,),
}


def test_every_part_of_a_file_is_checked(tmp_path):
    for part, value in [(part, value) for part, values in IN_FILES.items() for value in values]:
        path = save_replay(GOOD, tmp_path / "a.json")
        path.write_text(json.dumps(json.loads(path.read_text()) | {part: value}))
        refused("is not a replay", read_replay, path)


# A clock in the test's hands: a headless browser draws frames when it likes.
CLOCK = """<head><script>
let next = null, now = 0;
window.requestAnimationFrame = (callback) => { next = callback; return 1; };
const frames = (n) => { while (n--) { const callback = next; now += 50; callback(now); } };
</script>"""

# What a viewer might do, and what the page says afterwards.
VISIT = """<script>
const seen = {};
const press = (key) =>
  window.dispatchEvent(new KeyboardEvent("keydown", { key, cancelable: true }));
started.then(() => {
frames(3);
seen.title = document.title;
seen.bold = document.querySelectorAll("b").length;
seen.start = [state.t, state.follow, state.candidates];
seen.lead = leadAt(0, duration);
seen.corner = cornerAt(1, 2, 2.025);
seen.pose = [pose(1, 2.0).x, pose(1, 2.0).y];
press("2"); press("ArrowRight"); press("c");
seen.pressed = [state.t, state.follow, state.candidates];
press("ArrowUp"); press(" ");
frames(12);
const told = [...document.querySelectorAll("#log li span")];
seen.played = [state.t, state.speed, state.playing, told.length];
press(" ");
frames(60);
const before = camera.scale;
view.dispatchEvent(new WheelEvent("wheel", { deltaY: -300, cancelable: true }));
frames(1);
seen.zoomed = camera.scale / before;
const box = chartCanvas.getBoundingClientRect();
chartCanvas.setPointerCapture = () => {};
const place = { clientX: box.left + timeToX(3), clientY: box.top + 20 };
chartCanvas.dispatchEvent(new PointerEvent("pointerdown", place));
frames(1);
seen.clicked = state.t;
seen.drawn = Number(document.documentElement.dataset.drawn);
document.body.dataset.seen = JSON.stringify(seen);
});
</script>
</body>"""


def test_the_page_answers_to_its_viewer(tmp_path, browser):
    corners = np.arange(161)[:, None, None] * [0.05, -0.02] + [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    moving = np.stack([corners, corners + 4.0], axis=1)
    replay = race_on_a_circle(
        8.0, candidates=5, title=NASTY, car_names=(NASTY, "outer"), moving=moving
    )
    path = save_replay(replay, tmp_path / "a race.html")
    path.write_text(path.read_text().replace("<head>", CLOCK).replace("</body>", VISIT))
    browser.open(f"{path.as_uri()}#t=2.5&follow=0&candidates=1")
    seen = json.loads(browser.wait("document.body.dataset.seen || ''"))
    assert browser.complaints == []
    assert seen["title"] == NASTY
    assert seen["bold"] == 1  # the clock's
    assert seen["start"] == [2.5, "0", True]
    assert seen["lead"] == pytest.approx(replay.lead[-1], abs=0.002)
    assert seen["pose"] == pytest.approx(list(replay.cars[40, 1, :2]), abs=0.001)
    assert seen["corner"] == pytest.approx([4.0 + 40.5 * 0.05, 5.0 - 40.5 * 0.02], abs=0.001)
    assert seen["pressed"] == [3.5, "1", False]
    # the move came at 4 s
    assert seen["played"] == [pytest.approx(3.5 + 12 * 0.05 * 2), 2, True, 1]
    assert seen["zoomed"] == pytest.approx(np.exp(0.48), rel=0.01)
    assert seen["clicked"] == pytest.approx(3.0, abs=0.05)
    assert seen["drawn"] == pytest.approx(seen["clicked"], abs=0.01)
