import json
import re

import numpy as np
import pytest
from recorded_races import PYTHON, race_on_a_circle
from refusal import refused
from replay_pages import race_in
from scipy.interpolate import CubicSpline

from pcs_racing import InputError, load_rules, record_race
from pcs_racing.car.vehicle import VehicleParams
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.view import PATH_SPEED, PATH_X
from pcs_racing.race import recording
from pcs_racing.race.config import PLAN_EVERY
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceResult, RaceSetup, run_races, start_races
from pcs_racing.race.recording import LAST_INDEX, record_drive, tell_apart
from pcs_racing.race.replay import ReplayEvent, save_replay
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import empty_state, take
from pcs_racing.track.moving import moving_outlines
from pcs_racing.track.obstacles import with_obstacles

PAPER = load_rules("paper", duration=6.0)
CONTEST = load_rules("contest", duration=6.0)


def policies(kind: str):
    blind = Planner("blind", (), drive=lambda track, theta, view, memory: (0.0, 6.0))
    others = {
        "lattice": LATTICE.policy({"pace": 0.9}),
        "python": PYTHON.policy(),
        "blind": blind.policy(),
    }
    return LATTICE.policy({"pace": 0.3}), others[kind]


@pytest.mark.parametrize("config", [PAPER, CONTEST], ids=lambda config: config.name)
@pytest.mark.parametrize("kind", ["lattice", "python", "blind"])
def test_a_recorded_race_is_the_race(oval, config, kind):
    """Stopping to write down does not change a bit of where it ends."""
    ego, opponent = policies(kind)
    result = run_races(oval, [ego] * 4, opponent, config, seed=3)
    for index in (0, 3):
        replay = record_race(oval, ego, opponent, config, seed=3, index=index)
        np.testing.assert_array_equal(replay.cars[-1], result.state.cars[index])
        np.testing.assert_array_equal(replay.progress[-1], result.state.progress[index])
        crashes = {event.car for event in replay.events if event.kind == "crash"}
        assert crashes == set(np.flatnonzero(result.state.fault[index]))
        overtakes = [
            sum(e.kind == "overtake" and e.car == car for e in replay.events) for car in range(2)
        ]
        np.testing.assert_array_equal(overtakes, result.state.overtakes[index])
        assert ("crash" in replay.outcome) == bool(result.crashed[index])


def test_policies_may_change_on_the_way(oval):
    setup = RaceSetup(oval, CONTEST, (LATTICE, LATTICE))
    start, noise = Starts(np.array([3.0]), np.array([1])), np.array([7], np.uint64)
    paces = [(0.3, 0.4), (0.9, 0.4), (0.9, 0.1)]
    pairs = [[LATTICE.policy({"pace": pace}) for pace in pair] for pair in paces]
    theta = np.stack([pad_parameters(pair, setup.theta_size) for pair in pairs])
    state = start_races(setup, start, noise)
    for step in range(3):
        advance(setup, state, theta[step : step + 1], 200)
    replay = record_drive(
        setup, start, noise[0], theta, names=("a", "b"), ends=(200, 400), candidates=False
    )
    np.testing.assert_array_equal(replay.cars[-1], state.cars[0])
    np.testing.assert_array_equal(replay.progress[-1], state.progress[0])
    assert replay.car_names == ("a", "b")
    assert replay.candidates is None
    assert replay.paths is not None
    refused("ends are", record_drive, setup, start, noise[0], theta, names=("a", "b"), ends=(15,))
    with pytest.raises(InputError, match="there are 2 starts"):
        record_drive(setup, start.take([0, 0]), noise[0], theta, names=("a", "b"), ends=(200,))


def test_what_a_replay_holds(oval):
    ego, opponent = policies("lattice")
    cars = (VehicleParams(), VehicleParams(length=0.5, width=0.25))
    replay = record_race(oval, ego, opponent, PAPER, vehicle=cars)
    frames = round(PAPER.duration / replay.frame_dt) + 1
    plans = PAPER.ticks // PLAN_EVERY
    assert replay.cars.shape == (frames, 2, 7)
    assert replay.duration == pytest.approx(PAPER.duration)
    assert replay.paths.shape[:2] == (plans, 2)
    assert len(replay.candidates) == plans
    # Both policies are of one name.
    assert (
        replay.car_names
        == tell_apart(("lattice", "lattice"))
        == ("lattice (car 0)", "lattice (car 1)")
    )
    assert tell_apart(("lattice", "python")) == ("lattice", "python")
    assert re.match(r"lattice \(car [01]\) wins by ", replay.outcome)
    np.testing.assert_allclose(replay.half_sizes, [[0.29, 0.155], [0.25, 0.125]])
    assert ((replay.ittc > 0.0) & (replay.ittc <= PAPER.ittc_horizon)).all()


def test_the_line_has_the_max_driven_speed(oval):
    """Also across the start of the line; NaN where no car drove."""
    length, count = oval.length, len(oval.line)
    points = np.arange(count) * oval.arrays.ds
    place = length - 2.0 + np.arange(11) * 0.5  # 5 m, across the start of the line
    back = np.minimum(place, length)
    places, speeds = np.stack([place, back], axis=1), np.stack([0.1 * place, 0.0 * back + 3.0], 1)
    found = recording._driven_speed(oval, places, speeds)
    ahead = np.where(points <= 3.0, points + length, points)
    driven = (ahead >= length - 2.0) & (ahead <= length + 3.0)
    np.testing.assert_allclose(
        found[driven], np.where(ahead <= length, np.maximum(0.1 * ahead, 3.0), 0.1 * ahead)[driven]
    )
    assert np.isnan(found[~driven]).all()
    assert recording._driven_speed(oval, places[:1] + 0.01, speeds[:1]) is None


def test_a_replay_shows_moving_obstacles(oval, tmp_path):
    boxes = [[0.0, -4.0, 0.2, 0.4, 0.3, 1.0, 0.3], [0.0, 4.0, 0.0, 0.4, 0.0, 1.0, 0.0]]
    busy = with_obstacles(oval, boxes)
    rules = load_rules("paper", duration=1.0)
    replay = record_race(busy, "pure-pursuit", "pure-pursuit", rules, candidates=False)
    assert replay.moving.shape == (len(replay.cars), 2, 16, 2)
    square, circle = moving_outlines(busy.arrays, 5 * replay.frame_dt)
    np.testing.assert_allclose(replay.moving[5, 0, :4], square)
    assert (replay.moving[5, 0, 4:] == square[3]).all()
    np.testing.assert_allclose(replay.moving[5, 1], circle)
    race = race_in(save_replay(replay, tmp_path / "a.html").read_text())
    np.testing.assert_allclose(race["moving"], replay.moving, atol=6e-4)


def test_plans_begin_near_the_car_and_follow_the_cheapest_candidate(oval):
    """The first at the car itself; the others continue the last plan, moved by half of the car's
    deviation.
    """
    replay = record_race(oval, *policies("lattice"), PAPER)
    times = replay.paths[..., 3]
    assert (times[..., 0] == 0.0).all()
    assert (np.diff(times, axis=-1) > 0.0).all()
    every = round(2 * replay.plan_dt / replay.frame_dt)  # frames and plans meet every second plan
    at_plan = replay.cars[::every, :, :2][: len(replay.paths[::2])]
    away = np.hypot(*(replay.paths[::2, :, 0, :2] - at_plan).T)
    np.testing.assert_allclose(away[:, 0], 0.0, atol=1e-9)
    assert away.max() < 0.1
    # Candidates are asked for before the plan is made: they show all candidates, farther than
    # the path is.
    compared = 0
    for row in range(len(replay.candidates)):
        for car in range(2):
            costs = replay.costs[row, car]
            # without a free candidate it takes the least bad one, not the cheapest
            if np.isinf(costs).all():
                continue
            best = replay.candidates[row, car, int(np.argmin(costs)), 1:]
            curve = CubicSpline(np.arange(8), best)(np.linspace(0.0, 7.0, 400))
            # the first of the candidate's pieces begins at the car
            ahead = replay.paths[row, car, 4:, :2]
            assert np.hypot(*(ahead[:, None] - curve).T).min(axis=0).max() < 0.03
            compared += 1
    assert compared > 0.9 * replay.costs.shape[0] * replay.costs.shape[1]


def test_a_driver_without_plans_leaves_them_out_and_a_crash_ends_the_replay(oval):
    replay = record_race(oval, *policies("python"), PAPER)
    assert np.isnan(replay.paths[:, 1]).all()
    assert np.isfinite(replay.paths[:, 0]).all()
    assert np.isinf(replay.costs[:, 1]).all()
    neither = record_race(oval, PYTHON.policy(), PYTHON.policy({"pace": 0.4}), PAPER)
    assert neither.paths is None
    assert neither.candidates is None
    replay = record_race(oval, *policies("blind"), PAPER)
    (crash,) = [event for event in replay.events if event.kind == "crash"]
    assert crash.car == 1
    assert crash.text == "crashes into the wall"
    assert replay.duration == pytest.approx(crash.time, abs=replay.frame_dt)
    assert "fault of blind: nobody wins" in replay.outcome
    loser = record_race(oval, *policies("blind"), CONTEST)
    assert "fault of blind: lattice wins" in loser.outcome


NAMES = ("a", "b", "c")


@pytest.mark.parametrize(
    ("rules", "progress", "crash", "fault", "words"),
    [
        ("paper", (9.0, 7.5), (0, 0), (0, 0), "a wins by 1.5 m after 6 s"),
        ("paper", (7.0, 7.5, 2.0), (0, 0, 0), (0, 0, 1), "b wins by 0.5 m after 6 s"),
        ("paper", (7.5, 7.5), (0, 0), (0, 0), "a tie after 6 s"),
        ("paper", (7.5,), (0,), (0,), "7.5 m in 6 s"),
        ("paper", (9.0, 7.5), (1, 0), (1, 0), "crash after 6.3 s, fault of a: nobody wins"),
        ("contest", (9.0, 7.5), (1, 0), (1, 0), "crash after 6.3 s, fault of a: b wins"),
        ("contest", (9.0, 7.5), (2, 2), (1, 1), "crash after 6.3 s, fault of a and b: nobody wins"),
        ("contest", (9.0, 7.5), (2, 2), (0, 0), "crash after 6.3 s, fault of nobody: a wins"),
        ("roboracer", (9.0, 7.5), (0, 1), (0, 3), "out after 6.3 s, fault of b: a wins"),
    ],
)
def test_the_end_of_a_race_in_words(rules, progress, crash, fault, words):
    cars = len(progress)
    state = empty_state(1, 0, cars)
    state.progress[0], state.crash[0], state.fault[0], state.tick[:] = progress, crash, fault, 628
    result = RaceResult(load_rules(rules), state, Starts(np.zeros(1), np.zeros(1, np.int64)))
    assert recording._outcome(result, NAMES[:cars]) == words


def test_what_happened_is_told_with_the_time_and_a_plan_with_its_times():
    state = empty_state(1, 0, 3)
    state.tick[:], state.ahead[0], state.fault[0] = 150, (0, 4, 0), (1, 1, 2)
    state.crash[0], state.contact[0], state.frenet[0, 1, 0] = (1, 0, 0), (0, 2, 1), 12.4
    frames = np.zeros((2, 3, 7))
    frames[:, 2, 1] = 0.8, 0.6
    # Car 2 was ahead of car 1.
    log = recording._Log(cars=list(frames))
    events = recording._overtakes(state, np.array([0, 0, 2], np.uint8), log)
    assert events == [ReplayEvent(1.5, 1, "overtake", "overtakes car 2 at 12 m, 0.60 m apart")]
    assert recording._faults(state, np.array([0, 0, 2], np.int8)) == [
        ReplayEvent(1.5, 0, "crash", "crashes into the wall"),
        ReplayEvent(1.5, 1, "crash", "crashes into another car"),
    ]
    two = take(empty_state(1, 0, 2), [0])
    two.fault[0, 1] = 1
    assert recording._faults(two, np.zeros(2, np.int8))[0].text == "crashes into the other car"
    path = np.zeros((2, 4, 4))
    path[0, :, PATH_X], path[0, :, PATH_SPEED] = [1.0, 2.0, 4.0, 4.5], [1.0, 3.0, 0.0, 0.0]
    followed = recording._followed(path)
    np.testing.assert_array_equal(followed[0, :, :3], path[0, :, :3])
    # Each piece at the mean speed of its ends, of 0.1 m/s at least.
    np.testing.assert_allclose(followed[0, :, 3], np.cumsum([0.0, 1.0 / 2.0, 2.0 / 1.5, 0.5 / 0.1]))
    assert np.isnan(followed[1]).all()


def test_the_race_of_a_large_number_is_drawn_without_those_before_it(oval):
    """Starts repeat when every line was driven from both sides; the noise is the race's own."""
    ego, opponent = policies("lattice")
    short = load_rules("contest", duration=0.5)
    period = 2 * short.start_lines
    indices = (1, LAST_INDEX // period * period + 1)
    near, far = (record_race(oval, ego, opponent, short, seed=3, index=index) for index in indices)
    np.testing.assert_array_equal(near.cars[0], far.cars[0])
    assert not np.array_equal(near.cars[-1], far.cars[-1])
    for index in [-1, 1.5, True, LAST_INDEX + 1, 10**12]:
        refused(f"index is {index}", record_race, oval, *policies("lattice"), PAPER, index=index)


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
        8.0, candidates=5, title=NASTY, car_names=(NASTY, "outer"), moving=moving, sight=4.7
    )
    replay.paths[0, 1, 9:] = np.nan
    path = save_replay(replay, tmp_path / "a race.html")
    path.write_text(path.read_text().replace("<head>", CLOCK).replace("</body>", VISIT))
    browser.open(f"{path.as_uri()}#t=2.5&follow=0&candidates=1&sight=1")
    seen = json.loads(browser.wait("document.body.dataset.seen || ''"))
    assert browser.complaints == []
    assert seen["title"] == NASTY
    assert seen["bold"] == 1  # the clock's
    assert seen["start"] == [2.5, "0", True]
    blind = "91\u00b0 behind a car: unseen"
    assert seen["legend"] == f"driven speed 4.06.0 m/sbestworst candidaterejected{blind}"
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
