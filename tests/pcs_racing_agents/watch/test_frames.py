"""Frames of recorded races, GIFs of them, and pictures of tracks."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from recorded_races import race_on_a_circle, race_on_a_straight
from refusal import refused

from pcs_racing.race.painting import COLOURS
from pcs_racing.race.rendering import Renderer
from pcs_racing_agents.watch.frames import replay_frames, write_gif, write_track_picture


@pytest.fixture(scope="module")
def race():
    return race_on_a_straight()


def test_impossible_films_are_named(race, tmp_path):
    refused("fps", replay_frames, race, fps=0.0)
    refused("gif", write_gif, race, tmp_path / "race.mp4")
    refused("png", write_track_picture, None, tmp_path / "track.svg")
    refused(r"fps .* 60", write_gif, race, tmp_path / "race.gif", fps=60)
    refused("folder", write_gif, race, tmp_path / "none" / "race.gif")
    renderer = Renderer(race, 100, 100)
    renderer.mode = "human"
    refused("rgb_array", replay_frames, race, renderer)


def test_frames_show_each_moment_with_its_plan_its_trail_and_who_leads(race):
    """Inputs of the renderer, by times: frames 0.05 s apart, plans 0.1 s, trails of 2
    s.
    """
    asked = []
    renderer = SimpleNamespace(
        mode="rgb_array", render=lambda cars, **given: asked.append((cars, given)) or cars
    )
    race = race_on_a_circle(candidates=3)
    behind = dataclasses.replace(race, progress=race.progress[:, ::-1] + [0.0, 0.5])
    for replay, name, shown in ((race, "inner", False), (behind, "outer", True)):
        asked.clear()
        assert (
            len(list(replay_frames(replay, renderer, fps=5.0, speed=1.5, candidates=shown))) == 14
        )
        for k, (cars, given) in enumerate(asked):
            time = k * 0.3
            i, plan = round(time / 0.05), min(int(time / 0.1 + 1e-6), 39)
            np.testing.assert_array_equal(cars, replay.cars[i])
            np.testing.assert_array_equal(
                given.pop("trails"), replay.cars[max(0, i - 40) : i + 1, :, :2]
            )
            np.testing.assert_array_equal(given.pop("plans"), replay.paths[plan])
            if shown:
                np.testing.assert_array_equal(given.pop("candidates"), replay.candidates[plan])
                np.testing.assert_array_equal(given.pop("costs"), replay.costs[plan])
            lead = abs(np.diff(replay.progress[i])[0])
            assert given == {
                "names": ("inner", "outer"),
                "text": f"{time:.1f} s    {name} leads by {lead:.1f} m",
            }
    asked.clear()
    alone = {
        "car_names": ("one",),
        "cars": race.cars[:, :1],
        "progress": race.progress[:, :1],
        "ittc": None,
    }
    bare = {
        "paths": None,
        "candidates": None,
        "costs": None,
        "events": (),
        "half_sizes": [[0.3, 0.2]],
    }
    assert len(list(replay_frames(dataclasses.replace(race, **alone, **bare), renderer))) == 81
    assert asked[-1][1].keys() == {"trails", "names", "text"}
    assert asked[-1][1]["text"] == "4.0 s    one leads by 0.0 m"


@pytest.mark.parametrize(("fps", "lasts"), [(50.0, 20), (30.0, 30), (7.0, 140), (0.5, 2000)])
def test_a_frame_of_a_gif_lasts_whole_hundredths_of_a_second(race, tmp_path, fps, lasts):
    small = Renderer(race, 64, 64)
    with Image.open(
        write_gif(race, tmp_path / "race.gif", renderer=small, fps=fps, speed=fps / 5.0)
    ) as gif:
        assert gif.info["duration"] == lasts


def test_a_gif_plays_the_race(race, tmp_path):
    path = write_gif(
        race, tmp_path / "race.gif", renderer=Renderer(race, 160, 100), fps=10.0, speed=1.0
    )
    with Image.open(path) as gif:
        assert gif.size == (160, 100)
        assert gif.n_frames == 11
        assert gif.info["duration"] == 100
    assert [file.name for file in tmp_path.iterdir()] == ["race.gif"]
    again = write_gif(
        race, tmp_path / "b.gif", renderer=Renderer(race, 160, 100), fps=10.0, speed=1.0
    )
    assert again.read_bytes() == path.read_bytes()


def test_a_picture_of_a_circuit_shows_its_start(oval, tmp_path):
    with Image.open(write_track_picture(oval, tmp_path / "oval.png")) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    blue = np.abs(pixels - COLOURS["car0"]).sum(axis=-1) < 40
    assert pixels.shape[1] == 960
    assert 20 < np.count_nonzero(blue) < 2000
