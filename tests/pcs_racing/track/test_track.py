"""Tracks built from values, and loaded from map folders with the help of two caches."""

import dataclasses
import logging
import shutil

import numba
import numpy as np
import pytest

from pcs_racing.base.errors import MapError, UnknownNameError
from pcs_racing.track import track as track_module
from pcs_racing.track.frenet import COS, KAPPA, LEFT, PSI, RIGHT, SIN, SPEED
from pcs_racing.track.maps import MapFolder, write_map
from pcs_racing.track.track import Calibration, build_track, load_track


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A cache on disk of its own for every test, and none in memory."""
    monkeypatch.setenv("PCS_RACING_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(track_module, "_loaded", {})
    return tmp_path / "cache"


def _values(track):
    """What the oval was built from, or nearly so: its grid is cropped, and infield and outfield are walls too."""
    arrays = track.arrays
    return {
        "occupied": arrays.distance == 0.0,
        "resolution": arrays.cell,
        "origin": (arrays.origin_x, arrays.origin_y),
        "centerline": track.centerline.copy(),
        "raceline_xy": track.line[::3, :2].copy(),
    }


@pytest.fixture
def values(oval):
    return _values(oval)


@pytest.fixture
def folder(oval, tmp_path):
    """A complete map folder, its name with a space in it."""
    parts = _values(oval)
    rows = np.zeros((len(parts["raceline_xy"]) + 1, 7))
    rows[:, 1:3] = np.vstack([parts["raceline_xy"], parts["raceline_xy"][:1]])
    grid = (parts["occupied"], parts["resolution"], parts["origin"])
    own = {"speed_range": [0.9, 1.1], "start_spacing": 0.45, "start_places": {"front": [[1.0, 5.5]]}, "left_share": 0.5}
    info = {"calibration": {"contest": own}}
    return write_map(MapFolder("Big Oval", tmp_path / "Big Oval", *grid, parts["centerline"], rows, info))


# Built from values


def test_the_oval_has_the_measures_of_a_stadium(oval):
    assert abs(oval.length - (24.0 + 8.0 * np.pi)) < 0.01
    assert abs(oval.arrays.ds - 0.1) < 0.001
    np.testing.assert_allclose(oval.line[:, [RIGHT, LEFT]], 1.1, atol=0.06)
    np.testing.assert_allclose(oval.wall_distance(oval.line[:, :2]), 1.1, atol=0.06)
    bends = np.abs(oval.line[:, 0]) > 7.0
    np.testing.assert_allclose(oval.line[bends, KAPPA], 0.25, atol=0.01)
    np.testing.assert_allclose(np.hypot(oval.line[:, COS], oval.line[:, SIN]), 1.0)
    np.testing.assert_allclose(oval.line[:, SIN], np.sin(oval.line[:, PSI]), atol=1e-12)
    np.testing.assert_allclose(np.median(oval.line[bends, SPEED]), np.sqrt(5.0 * 4.0), rtol=0.01)


def test_equal_values_give_equal_tracks_and_a_changed_one_another_hash(values):
    one, two = build_track("a", **values), build_track("b", **values)
    assert one.content_hash == two.content_hash
    for first, second in zip(one.arrays, two.arrays, strict=True):
        np.testing.assert_array_equal(first, second)
    values["occupied"][5, 5] ^= True
    values["centerline"][3, 2] += 0.01
    assert build_track("a", **values).content_hash != one.content_hash


def test_driven_the_other_way_round_left_and_right_change_sides(oval, values):
    values["raceline_xy"] = values["raceline_xy"][::-1]
    back = build_track("back", **values)
    np.testing.assert_allclose(back.length, oval.length, rtol=1e-4)
    assert back.line[:, KAPPA].min() < -0.2
    assert "right-hand" in back.summary()
    assert "left-hand" in oval.summary()
    _, d = back.to_frenet([0.0, -3.5])
    assert d == pytest.approx(-0.5, abs=0.01)


def test_a_track_can_not_be_changed(oval):
    with pytest.raises(ValueError, match="read-only"):
        oval.line[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        oval.centerline[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        oval.name = "other"


def test_all_tracks_have_one_compiled_type(oval, values, folder):
    load_track(folder)
    track_module._loaded.clear()
    restored = load_track(folder)
    types = {numba.typeof(track.arrays) for track in (oval, build_track("again", **values), restored)}
    assert len(types) == 1


def test_summary_and_repr_are_short(oval):
    assert "49.1 m" in oval.summary()
    assert len(repr(oval)) < 300


def test_pairs_are_asked_for(oval):
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\)"):
        oval.to_frenet([1.0, 2.0, 3.0])


def _break(values, what):
    line, grid = values["raceline_xy"], values["occupied"]
    rows, cols = grid.shape
    if what == "gap to the border":
        values["occupied"] = np.pad(grid, 10, constant_values=False)
        values["origin"] = tuple(corner - 10 * values["resolution"] for corner in values["origin"])
        values["occupied"][:30, 200] = False
    elif what == "gap to the infield":
        far = np.hypot(np.maximum(np.abs(np.arange(cols) - cols / 2) - 80, 0.0), np.arange(rows)[:, None] - rows / 2)
        values["occupied"] = grid & ~(far < 45)
        values["occupied"][rows // 2 :, cols // 2] &= np.arange(rows // 2, rows) > rows / 2 + 80
    elif what == "self-crossing":
        values["raceline_xy"] = np.column_stack([line[:, 0], line[:, 1] * np.sign(line[:, 0]) * 0.2])
    elif what == "open":
        values["raceline_xy"] = line[: len(line) // 2]
    elif what == "open centre line":
        values["centerline"] = values["centerline"][: len(values["centerline"]) // 2]
    elif what == "in a wall":
        values["raceline_xy"] = line * 0.65
    elif what == "off the map":
        values["raceline_xy"] = line + 100.0
    elif what == "centre line in a wall":
        values["centerline"][:, :2] *= 0.6
    elif what == "nan":
        line[7, 1] = np.nan
    elif what == "zero width":
        values["centerline"][4, 2] = 0.0
    elif what == "few points":
        values["raceline_xy"] = line[:9]
    elif what == "kink":
        values["raceline_xy"] = np.insert(line, 30, line[30] + [0.0, 0.3], axis=0)
    elif what == "resolution":
        values["resolution"] = np.nan
    elif what == "grid of numbers":
        values["occupied"] = grid.astype(np.uint8)
    elif what == "origin":
        values["origin"] = (0.0, np.inf)
    return values


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("gap to the border", r"gap, probably near .* the border of the picture; close the walls"),
        ("gap to the infield", r"gap, probably near \(.*times the track"),
        ("self-crossing", "race line crosses itself near"),
        ("open", "race line is open: from its last point .* it is .* m"),
        ("open centre line", "centre line is open"),
        ("in a wall", "race line runs through a wall at"),
        ("off the map", "race line leaves the map at"),
        ("centre line in a wall", "centre line leaves the track at"),
        ("nan", "race line holds the impossible point"),
        ("zero width", "0.0 m wide to the right"),
        ("few points", "has 9 different points: at least 10"),
        ("kink", "race line has a kink at"),
        ("resolution", "resolution is nan; it must be a number above 0 up to 1"),
        ("grid of numbers", "boolean array"),
        ("origin", "origin must be two coordinates"),
    ],
)
def test_impossible_tracks_are_refused(values, what, message):
    with pytest.raises(MapError, match=message):
        build_track("broken", **_break(values, what))


def test_a_gap_is_found_where_it_is(values):
    """The message leads to the hole."""
    broken = _break(values, "gap to the border")
    x = broken["origin"][0] + 200.5 * broken["resolution"]
    with pytest.raises(MapError, match=rf"near \({x:.2f}, -5\."):
        build_track("broken", **broken)


def test_two_parts_of_a_track_with_a_thin_wall_between_are_told_apart():
    """Two legs: where the line of one hugs the wall between, points of the other beside it belong to their own."""
    cell = 0.05
    rows, cols = 90, 420
    occupied = np.ones((rows, cols), dtype=bool)
    occupied[3:44, 5:415] = False  # the lower leg
    occupied[46:87, 5:415] = False  # the upper leg; two cells of wall lie between
    occupied[3:87, 5:45] = occupied[3:87, 375:415] = False
    # The line of the upper leg lies 0.3 m above the wall, that of the lower leg 0.9 m below it.
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 15)
    bend = 0.6 * np.column_stack([np.cos(turn), np.sin(turn)])
    along = np.linspace(2.0, 19.0, 60)[1:-1]
    lower, upper = (np.column_stack([along, np.full(58, y)]) for y in (1.3, 2.5))
    line = np.vstack([lower, np.array([19.0, 1.9]) + bend, upper[::-1], np.array([2.0, 1.9]) - bend])
    track = build_track("u", occupied, cell, (0.0, 0.0), np.column_stack([line, np.ones((len(line), 2))]), line)
    points = np.column_stack([np.linspace(4.0, 17.0, 400), np.full(400, 2.15)])
    s, d = track.to_frenet(points).T
    assert np.abs(track.to_cartesian(np.column_stack([s, np.zeros(400)]))[:, 1] - 1.3).max() < 0.02
    np.testing.assert_allclose(track.to_cartesian(np.column_stack([s, d]))[:, :2], points, atol=1e-9)
    points[:, 1] = 4.2
    np.testing.assert_allclose(track.to_frenet(points)[:, 1], -1.7, atol=0.02)


# Loaded from folders


def test_a_folder_gives_the_same_track_as_its_values(folder, oval):
    loaded = load_track(folder)
    assert loaded.name == "Big Oval"
    assert loaded.calibration == {"contest": Calibration((0.9, 1.1), 0.45, {"front": ((1.0, 5.5),)})}
    assert loaded.folder == folder
    np.testing.assert_allclose(loaded.line[:, :2], oval.line[:, :2], atol=1e-3)
    np.testing.assert_array_equal(loaded.arrays.distance, oval.arrays.distance)


def test_loading_again_gives_the_same_object(folder):
    one = load_track(folder)
    assert load_track(str(folder)) is one
    assert load_track(folder / "Big Oval_map.yaml") is one


def test_the_cache_on_disk_gives_the_same_track(folder, cache, monkeypatch):
    one = load_track(folder)
    assert len(list(cache.iterdir())) == 1
    track_module._loaded.clear()
    monkeypatch.setattr(track_module, "build_track", None)  # it must not be called
    two = load_track(folder)
    assert two is not one
    for field in dataclasses.fields(one):
        if field.name not in ("arrays", "centerline"):
            assert getattr(one, field.name) == getattr(two, field.name)
    for first, second in zip((*one.arrays, one.centerline), (*two.arrays, two.centerline), strict=True):
        np.testing.assert_array_equal(first, second)
        assert type(first) is type(second)


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "other"])
def test_a_damaged_cache_file_is_made_anew(folder, cache, damage):
    one = load_track(folder)
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    middle = len(whole) // 2
    other = cache / "other.npz"
    np.savez(other, line=np.zeros(3))
    file.write_bytes(
        {
            "cut": whole[:middle],
            "flip": whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :],
            "empty": b"",
            "other": other.read_bytes(),
        }[damage]
    )
    other.unlink()
    track_module._loaded.clear()
    assert load_track(folder).content_hash == one.content_hash
    assert file.read_bytes() == whole


def test_a_cache_that_can_not_be_written_is_no_error(folder, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("PCS_RACING_CACHE", str(tmp_path / "file"))
    assert load_track(folder).name == "Big Oval"


def test_a_full_disk_leaves_no_half_a_cache_and_is_no_error(folder, cache, monkeypatch):
    def half_written(file, **arrays):
        file.write(b"PK")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", half_written)
    assert load_track(folder).name == "Big Oval"
    assert list(cache.iterdir()) == []


def test_without_a_home_nothing_is_kept(folder, monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("PCS_RACING_CACHE")
    monkeypatch.setattr("pcs_racing.track.cache.Path.home", homeless)
    assert load_track(folder).name == "Big Oval"


def test_a_changed_file_is_noticed(folder):
    one = load_track(folder)
    info = folder / "Big Oval_track.yaml"
    own = "{speed_range: [0.5, 0.6], start_spacing: 0.5, start_places: {front: [[2, 3]]}, left_share: 0.5}"
    info.write_text(f"calibration: {{contest: {own}}}")
    assert load_track(folder).calibration == {"contest": Calibration((0.5, 0.6), 0.5, {"front": ((2.0, 3.0),)})}
    info.unlink()
    assert load_track(folder).calibration == {}
    assert load_track(folder).content_hash == one.content_hash


def test_missing_lines_are_made_from_the_picture(folder, oval, caplog):
    for kind in ("centerline", "raceline"):
        (folder / f"Big Oval_{kind}.csv").unlink()
    with caplog.at_level(logging.WARNING, logger="pcs_racing"):
        made = load_track(folder)
        load_track(folder)
    assert [record.getMessage() for record in caplog.records] == [
        "track Big Oval: it has no race line and it has no centre line; it was made from the picture"
    ]
    distance = np.abs(oval.to_frenet(made.centerline[:, :2])[:, 1])
    assert distance.max() < 0.1
    assert made.wall_distance(made.line[:, :2]).min() > 0.29
    assert made.length < oval.length


def test_a_race_line_without_air_to_the_walls_is_replaced(folder, oval, caplog):
    file = folder / "Big Oval_raceline.csv"
    s = np.linspace(0.0, oval.length, 300)
    rows = np.zeros((300, 7))
    rows[:, 1:3] = oval.to_cartesian(np.column_stack([s, np.full_like(s, 0.9)]))[:, :2]
    np.savetxt(file, rows, delimiter=";")
    with caplog.at_level(logging.WARNING, logger="pcs_racing"):
        track = load_track(folder)
    assert "comes within 0.1" in caplog.text
    assert track.wall_distance(track.line[:, :2]).min() > 0.29
    track_module._loaded.clear()
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="pcs_racing"):
        load_track(folder)  # from the cache on disk, which remembers it
    assert "comes within 0.1" in caplog.text
    rows[:, 1:3] *= 0.8
    np.savetxt(file, rows, delimiter=";")
    with pytest.raises(MapError, match=r"Oval_raceline\.csv leads"):
        load_track(folder)


def test_without_the_mapping_tools_complete_maps_load_and_others_say_what_to_install(folder, monkeypatch):
    monkeypatch.setattr("pcs_racing.base.optional.find_spec", lambda name: None)
    load_track(folder)
    (folder / "Big Oval_raceline.csv").unlink()
    with pytest.raises(ModuleNotFoundError, match=r"race line; .*pcs-racing\[mapping\]"):
        load_track(folder)


def test_errors_name_the_file(folder):
    file = folder / "Big Oval_map.yaml"
    file.write_text(file.read_text().replace("resolution: 0.05", "resolution: 0.06"))
    with pytest.raises(MapError, match=r"Big Oval_(map\.yaml|raceline\.csv)"):
        load_track(folder)
    file.write_text(file.read_text().replace("resolution: 0.06", "resolution: 0.05"))
    line = folder / "Big Oval_raceline.csv"
    rows = line.read_text().splitlines()
    line.write_text("\n".join(rows[: len(rows) // 2]))
    with pytest.raises(MapError, match=r"Big Oval_raceline\.csv is open"):
        load_track(folder)


def test_points_that_are_nowhere_do_no_harm(oval):
    for point in ([np.nan, 0.0], [np.inf, 0.0], [1e15, -1e15]):
        assert oval.to_frenet(point).shape == (2,)
        assert oval.wall_distance(point) == 0.0


def test_names_that_stand_for_nothing_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownNameError, match="unknown track 'Nowhere'"):
        load_track("Nowhere")
    with pytest.raises(MapError, match=r"map folder .*nowhere"):
        load_track(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(MapError, match=r"holds no map: .*empty_map\.yaml"):
        load_track("empty")


@pytest.mark.parametrize("name", ["Spielberg", "Catalunya", "Oschersleben"])
def test_real_circuits_can_be_raced_on(real_maps, name):
    track = load_track(real_maps / name)
    assert track.wall_distance(track.line[:, :2]).min() >= 0.28
    assert np.abs(track.line[:, KAPPA]).max() < 1.3
    assert (track.line[:, [RIGHT, LEFT]] > 0.28).all()
    on_track = track.wall_distance(track.centerline[:, :2])
    assert on_track.min() > 0.4
    jumps = np.abs(np.diff(track.to_frenet(track.centerline[:, :2])[:, 0]))
    assert np.minimum(jumps, track.length - jumps).max() < 1.5


def test_a_real_map_with_nothing_but_yaml_and_picture(real_maps, tmp_path):
    folder = tmp_path / "with space"
    folder.mkdir()
    for kind in ("map.yaml", "map.png"):
        shutil.copy(real_maps / "Oschersleben" / f"Oschersleben_{kind}", folder)
    track = load_track(folder)
    assert track.name == "Oschersleben"
    assert track.wall_distance(track.line[:, :2]).min() >= 0.28
    assert abs(track.length - 251.0) < 5.0
