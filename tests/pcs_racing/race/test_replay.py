import json
import re

import numpy as np
import pytest
from recorded_races import race_on_a_circle
from refusal import refused
from replay_pages import race_in

from pcs_racing.race.replay import ReplayEvent, save_replay


def test_a_replay_knows_its_duration_and_lead():
    replay = race_on_a_circle()
    assert replay.duration == pytest.approx(4.0)
    assert replay.lead[-1] == pytest.approx(10.0 * (5.0 / 9.7 - 4.6 / 10.3) * 4.0)
    alone = {"car_names": ("a",), "cars": replay.cars[:, :1], "progress": replay.progress[:, :1]}
    assert not race_on_a_circle(**alone).lead.any()


NASTY = (
    '</script><b>bold</b><script>document.title="owned"</script>'
    "<!--replay--><!--title-->&amp;\"'\u2028"
)


def test_a_page_holds_the_race_rounded(tmp_path):
    replay = race_on_a_circle(candidates=7, car_names=("Ωmega, ü", NASTY), title=NASTY)
    race = race_in(save_replay(replay, tmp_path / "a race.html").read_text())
    assert (race["title"], race["car_names"]) == (NASTY, list(replay.car_names))
    assert race["events"] == [[2.0, 0, "move", "aggressiveness +"], [4.0, 1, "crash", "wall"]]
    fine, coarse = (0.0005 + 1e-9, 0.005 + 1e-9)
    np.testing.assert_allclose(race["cars"], replay.cars[..., :5], atol=fine)
    np.testing.assert_allclose(race["progress"], replay.progress, atol=fine)
    np.testing.assert_allclose(race["line"], replay.line, atol=fine)
    np.testing.assert_allclose(race["line_speed"], [-1.0, *replay.line_speed[1:]], atol=coarse)
    np.testing.assert_allclose(race["ittc"], replay.ittc, atol=coarse)
    np.testing.assert_allclose(race["paths"], replay.paths[..., [0, 1, 3]], atol=coarse)
    np.testing.assert_allclose(race["candidates"], replay.candidates, atol=coarse)
    assert race["walls"]["counts"] == [65, 65]
    for costs, ranks in zip(replay.costs.reshape(-1, 7), race["ranks"].reshape(-1, 7), strict=True):
        kept = ranks > 0
        assert kept.tolist() == np.isfinite(costs).tolist()
        assert (np.diff(costs[kept][np.argsort(ranks[kept])]) <= 0.0).all()  # the best is the last


def test_optional_parts_may_be_absent_and_a_race_of_40_s_is_small(tmp_path):
    absent = dict.fromkeys(("paths", "ittc", "line_speed"))
    bare = race_on_a_circle(**absent, events=(), walls=np.zeros((0, 4)))
    race = race_in(save_replay(bare, tmp_path / "bare.html").read_text())
    assert not race.keys() & {*absent, "candidates", "ranks", "moving"}
    assert race["walls"]["counts"] == []
    page = save_replay(race_on_a_circle(40.0), tmp_path / "a.html").stat().st_size
    assert page < 150_000
    page = save_replay(race_on_a_circle(40.0, candidates=54), tmp_path / "b.html").stat().st_size
    assert page < 1_000_000


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
    replay = race_on_a_circle(1.0)
    path = save_replay(replay, tmp_path / "a.html")
    before = path.read_bytes()
    huge = race_on_a_circle(1.0, progress=np.full((21, 2), 1e300))
    refused("numbers that are not finite", save_replay, huge, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.html"]
    (tmp_path / "folder.html").mkdir()
    for path in (tmp_path / "none" / "a.html", tmp_path / "a.pdf", tmp_path / "folder.html"):
        refused(path.name, save_replay, replay, path)


# A clock in the test's hands: a headless browser draws frames when it likes.
CLOCK = """<head><script>
let next = null, now = 0;
window.requestAnimationFrame = (callback) => { next = callback; return 1; };
const frames = (n) => { while (n--) { const callback = next; now += 50; callback(now); } };
</script>"""

# Keys that a viewer might press, and the page's texts afterwards.
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
seen.legend = document.getElementById("legend").textContent;
seen.rows = [0, 1].map((index) => rowsOf(plans, index)[1]);
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
    replay.paths[0, 1, 9:] = np.nan
    path = save_replay(replay, tmp_path / "a race.html")
    path.write_text(path.read_text().replace("<head>", CLOCK).replace("</body>", VISIT))
    browser.open(f"{path.as_uri()}#t=2.5&follow=0&candidates=1")
    seen = json.loads(browser.wait("document.body.dataset.seen || ''"))
    assert browser.complaints == []
    assert seen["title"] == NASTY
    assert seen["bold"] == 1  # the clock's
    assert seen["start"] == [2.5, "0", True]
    assert seen["legend"] == "driven speed 4.06.0 m/sbestworst candidaterejected"
    assert seen["rows"] == [12, 9]
    assert seen["lead"] == pytest.approx(replay.lead[-1], abs=0.002)
    assert seen["pose"] == pytest.approx(list(replay.cars[40, 1, :2]), abs=0.001)
    assert seen["corner"] == pytest.approx([4.0 + 40.5 * 0.05, 5.0 - 40.5 * 0.02], abs=0.001)
    assert seen["pressed"] == [3.5, "1", False]
    # the move came at 4 s
    assert seen["played"] == [pytest.approx(3.5 + 12 * 0.05 * 2), 2, True, 1]
    assert seen["zoomed"] == pytest.approx(np.exp(0.48), rel=0.01)
    assert seen["clicked"] == pytest.approx(3.0, abs=0.05)
    assert seen["drawn"] == pytest.approx(seen["clicked"], abs=0.01)
