import dataclasses

import numpy as np
import pytest
from PIL import Image
from recorded_races import race_on_a_straight

from pcs_racing.base.errors import InputError
from pcs_racing.race.frames import replay_frames, write_gif
from pcs_racing.race.rendering import Renderer


@pytest.fixture(scope="module")
def race():
    return race_on_a_straight()


def test_frames_of_a_replay(race):
    frames = list(replay_frames(race, Renderer(race, 160, 100), fps=10.0))
    assert len(frames) == 11
    assert len(list(replay_frames(race, Renderer(race, 160, 100), fps=10.0, speed=0.5))) == 21
    # Candidates that were not kept are not missed.
    assert len(list(replay_frames(race, Renderer(race, 160, 100), fps=5.0, candidates=True))) == 6


def test_frames_show_the_candidates_that_were_kept(race):
    """From the plan on for which they were kept; before, there are none."""
    fan = np.stack([race.cars[10, :, None, :2] + [[0.0, 0.0], [4.0, slope]] for slope in (-1.0, 0.0, 1.0)], axis=1)
    kept = dataclasses.replace(race, candidate_steps=[5], candidates=fan[None], costs=np.array([[[1.0, 2.0, 3.0]] * 2]))
    with_them, without = (
        list(replay_frames(kept, Renderer(kept, 160, 100), fps=10.0, candidates=shown)) for shown in (True, False)
    )
    assert [bool((a != b).any()) for a, b in zip(with_them, without, strict=True)] == [False] * 5 + [True] * 6


def test_a_gif_plays_the_race(race, tmp_path):
    path = write_gif(race, tmp_path / "race.gif", renderer=Renderer(race, 160, 100), fps=10.0, speed=1.0)
    with Image.open(path) as gif:
        assert gif.size == (160, 100)
        assert gif.n_frames == 11
        assert gif.info["duration"] == 100
    assert [file.name for file in tmp_path.iterdir()] == ["race.gif"]
    again = write_gif(race, tmp_path / "b.gif", renderer=Renderer(race, 160, 100), fps=10.0, speed=1.0)
    assert again.read_bytes() == path.read_bytes()


def test_impossible_arguments_are_named(race, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="fps"):
        replay_frames(race, fps=0.0)
    with pytest.raises(InputError, match="gif"):
        write_gif(race, tmp_path / "race.mp4")
    with pytest.raises(InputError, match=r"fps .* 60"):
        write_gif(race, tmp_path / "race.gif", fps=60)
    with pytest.raises(InputError, match="folder"):
        write_gif(race, tmp_path / "none" / "race.gif")
    renderer = Renderer(race, 100, 100)
    renderer.mode = "human"
    with pytest.raises(InputError, match="rgb_array"):
        replay_frames(race, renderer)
