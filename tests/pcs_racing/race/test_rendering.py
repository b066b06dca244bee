import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from recorded_races import race_on_a_straight
from refusal import refused

from pcs_racing.race.painting import COLOURS
from pcs_racing.race.rendering import Renderer
from pcs_racing.race.state import MAX_CARS, views

BLUE, AMBER, RED = (27, 111, 216), (224, 135, 0), (209, 44, 76)


def near(frame, colour, within=30):
    return np.abs(frame.astype(int) - colour).sum(axis=-1) <= within


def state(x, y, psi, delta=0.0):
    return [x, y, delta, 5.0, psi, 0.0, 0.0]


@pytest.fixture(scope="module")
def race():
    return race_on_a_straight()


def test_a_frame_shows_both_cars_where_they_are_and_the_track_between_its_walls(race):
    renderer = Renderer(race, 800, 400)
    frame = renderer.render(race.cars[0])
    assert frame.shape == (400, 800, 3)
    assert frame.dtype == np.uint8
    # the picture's middle is the track's, 20 m x 10 m fit with a margin: 36.4 pixels a metre
    scale = 0.91 * 400 / 10.0
    for colour, (x, y) in [(BLUE, race.cars[0, 0, :2]), (AMBER, race.cars[0, 1, :2])]:
        rows, columns = np.nonzero(near(frame, colour))
        assert columns.mean() == pytest.approx(400 + (x - 10.0) * scale, abs=3)
        assert rows.mean() == pytest.approx(200 - (y - 5.0) * scale, abs=3)
    asphalt, ground = (253, 253, 254), (227, 232, 237)
    for (x, y), colour in [((15.0, 0.5), asphalt), ((10.0, 5.0), ground), ((10.0, -0.2), ground)]:
        pixel = frame[round(200 - (y - 5.0) * scale), round(400 + (x - 10.0) * scale)]
        assert tuple(pixel) == colour


@pytest.mark.parametrize("view", views(2))
def test_a_frame_does_not_depend_on_those_before(race, view):
    used = Renderer(race, 320, 200, view=view)
    for cars in race.cars[:15]:
        used.render(cars)
    assert np.array_equal(
        used.render(race.cars[20]), Renderer(race, 320, 200, view=view).render(race.cars[20])
    )


def test_plans_trails_and_candidates_are_drawn(race):
    renderer = Renderer(race, 600, 400, view="car_0")
    cars = race.cars[10]
    plain = renderer.render(cars)
    reach = np.linspace(0.0, 2.0, 5)
    fan = cars[:, None, None, :2] + np.stack(
        [reach[None] + 0 * reach[:3, None], np.outer([-0.3, 0.0, 0.3], reach)], -1
    )
    assert (renderer.render(cars, plans=race.paths[5]) != plain).any()
    assert (renderer.render(cars, trails=race.cars[:11, :, :2]) != plain).any()
    assert (renderer.render(cars, text="12.0 s") != plain).any()
    all_good = renderer.render(cars, candidates=fan, costs=np.ones((2, 3)))
    one_bad = renderer.render(cars, candidates=fan, costs=np.array([[1.0, 2.0, np.inf]] * 2))
    reddish = [
        np.count_nonzero(f[..., 0].astype(int) > f[..., 1] + 20 + f[..., 2] * 0.1)
        for f in (all_good, one_bad)
    ]
    assert reddish[1] > reddish[0] + 40


def test_a_track_is_a_scene_whose_names_can_be_read(oval):
    renderer = Renderer(oval, 320, 200)
    x, y = oval.line[0, :2]
    frame = renderer.render(np.array([state(x, y, 0.0)]))
    assert frame.shape == (200, 320, 3)
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 50
    # Contrast of the letters to the halo around them: at least 4.5 to 1, as WCAG 2.2 asks for text.

    def luminance(colour):
        share = np.array(colour) / 255
        return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4) @ (
            0.2126,
            0.7152,
            0.0722,
        )

    for car in range(MAX_CARS):
        dark, light = sorted(luminance(COLOURS[name]) + 0.05 for name in (f"name{car}", "asphalt"))
        assert light / dark >= 4.5


def test_impossible_wishes_are_named(race):
    assert (
        views(3)
        == (*views(2), "car_2")
        == (*views(1), "car_2")
        == ("track", "both", "car_0", "car_1", "car_2")
    )
    for name, value in [("mode", "ansi"), ("view", "car_2"), ("width", 10), ("height", 2.5)]:
        refused(name, Renderer, race, **{name: value})
    refused("scene", Renderer, "Spielberg")
    renderer = Renderer(race, 100, 100)
    for cars in (
        np.zeros((9, 7)),
        np.zeros(7),
        np.zeros((2, 6)),
        np.zeros((0, 7)),
        np.diag([np.nan] + [0.0] * 6),
    ):
        refused("cars", renderer.render, cars)


def test_a_window_shows_frames(race, monkeypatch):
    pytest.importorskip("pygame", reason="pygame-ce is not installed")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = Renderer(race, 200, 120, mode="human", fps=1000.0)
    assert renderer.render(race.cars[0]) is None
    shown = renderer._window._pygame.surfarray.array3d(renderer._window._surface).swapaxes(0, 1)
    assert np.array_equal(shown, Renderer(race, 200, 120).render(race.cars[0]))
    waited: list[float] = []
    renderer._window._clock = SimpleNamespace(tick=waited.append)
    monkeypatch.setattr(renderer._window._pygame.event, "pump", lambda: waited.append(0.0))
    assert renderer.render(race.cars[1]) is None
    assert (waited, renderer._window._pygame.display.get_caption()[0]) == (
        [0.0, 1000.0],
        "pcs-racing",
    )
    renderer.close()
    renderer.close()


def test_one_car_and_sizes_of_its_own(race):
    sizes = np.array([[0.6, 0.3], [0.6, 0.3]])
    small = Renderer(race, 400, 200, view="car_0").render(race.cars[0, :1])
    large = Renderer(race, 400, 200, view="car_0", half_sizes=sizes).render(race.cars[0, :1])
    assert near(large, BLUE).sum() > 2 * near(small, BLUE).sum()
    from_replay = Renderer(
        dataclasses.replace(race, half_sizes=[[0.6, 0.3]] * 2), 400, 200, view="car_0"
    )
    assert np.array_equal(from_replay.render(race.cars[0, :1]), large)


NAME_BLUE, NAME_AMBER = (21, 89, 176), (148, 89, 0)


@pytest.mark.parametrize("view", views(2))
@pytest.mark.parametrize("apart", [(0.0, 0.0), (0.6, 0.0), (0.0, 0.5), (3.0, -0.3), (-3.0, 0.3)])
def test_each_car_has_its_name_beside_it(race, view, apart):
    """Even where both cars are at one place: neither name covers the other, and none leaves the
    frame.
    """
    renderer = Renderer(race, 600, 400, view=view)
    cars = np.array([state(5.0, 1.0, 0.0), state(5.0 + apart[0], 1.0 + apart[1], 0.0)])
    frame = renderer.render(cars, names=("you", "opponent"))
    alone = [renderer.render(cars, names=names) for names in (("you", ""), ("", "opponent"))]
    letters = [near(alone[0], NAME_BLUE, 9), near(alone[1], NAME_AMBER, 9)]
    for shown, colour in zip(letters, (NAME_BLUE, NAME_AMBER), strict=True):
        assert shown.sum() > 20
        assert near(frame, colour, 9)[shown].all()
    assert not (letters[0] & letters[1]).any()


def test_the_camera_shows_the_whole_track_or_the_cars_as_near_as_fits(race):
    """800 x 400 pixels of two fine ones, a track of 20 m x 10 m around (10, 5)."""

    def aim(view, *places):
        camera = Renderer(race, 800, 400, view=view)._aim(
            np.array([state(*place, 0.0) for place in places])
        )
        assert (camera.width, camera.height) == (1600, 800)
        return camera[:3]

    whole, close = 0.91 * 800 / 10.0, 800 / 9.0  # fine pixels a metre
    for view, places, *wanted in [
        ("track", [(1.0, 2.0)], 10.0, 5.0, whole),
        ("car_0", [(1.0, 2.0), (3.0, 4.0)], 1.0, 2.0, close),
        ("car_1", [(1.0, 2.0), (3.0, 4.0)], 3.0, 4.0, close),
        ("car_1", [(1.0, 2.0)], 1.0, 2.0, close),  # the last one, where there is no second
        ("both", [(1.0, 2.0), (3.0, 4.0)], 2.0, 3.0, close),
        ("both", [(1.0, 0.0), (3.0, 4.0)], 2.0, 2.0, 2.0**6.25),
        ("both", [(0.0, 0.0), (18.0, 9.0)], 9.0, 4.5, whole),
    ]:
        x, y, scale = aim(view, *places)
        assert (x, y, scale) == pytest.approx(wanted, abs=0.5 / scale), (view, places)
        assert (x * scale, y * scale) == pytest.approx((round(x * scale), round(y * scale)))
    # however small the frame
    assert Renderer(race, 100, 100, view="car_0")._aim(race.cars[0]).scale == 64.0


def test_a_renderer_may_go_on_with_another_scene_and_other_cars(race, oval):
    renderer = Renderer(race, 160, 100)
    for scene, sizes in ((oval, None), (race, None), (oval, np.full((2, 2), 0.8))):
        renderer.show(scene, sizes)
        new = Renderer(scene, 160, 100, half_sizes=sizes)
        np.testing.assert_array_equal(renderer.render(race.cars[3]), new.render(race.cars[3]))
