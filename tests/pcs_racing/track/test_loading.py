"""Tracks loaded from map folders with the help of two caches."""

import dataclasses
import json
import re

import numba
import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_track
from pcs_racing.base.errors import MapError, UnknownNameError
from pcs_racing.track import loading, map_files
from pcs_racing.track.building.tracks import build_track
from pcs_racing.track.map_files import MapFolder, read_map, write_map
from pcs_racing.track.track import Calibration

ANGLES = np.linspace(0.0, 2.0 * np.pi, 60)
SMALL = np.zeros((60, 7))
SMALL[:, 1:3] = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])  # a circle about a point


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A cache on disk of its own for every test, and none in memory."""
    monkeypatch.setenv("PCS_RACING_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(loading, "_loaded", {})
    return tmp_path / "cache"


@pytest.fixture
def folder(values, tmp_path):
    """A complete map folder of the oval, its name with a space in it."""
    line = values["raceline_xy"]
    rows = np.zeros((len(line) + 1, 7))
    rows[:, 1:3] = np.vstack([line, line[:1]])
    grid = (values["occupied"], values["resolution"], values["origin"])
    own = {
        "speed_range": [0.9, 1.1],
        "start_spacing": 0.45,
        "start_places": {"front": [[1.0, 5.5]]},
        "left_share": 0.5,
    }
    info = {"calibration": {"contest": own}}
    return write_map(
        MapFolder("Big Oval", tmp_path / "Big Oval", *grid, values["centerline"], rows, info)
    )


def test_a_folder_gives_the_same_track_as_its_values_and_again_the_same_object(
    folder, oval, values
):
    loaded = load_track(folder)
    assert loaded.name == "Big Oval"
    assert loaded.calibration == {
        "contest": Calibration((0.9, 1.1), 0.45, {"front": ((1.0, 5.5),)})
    }
    assert loaded.folder == folder
    np.testing.assert_allclose(loaded.line[:, :2], oval.line[:, :2], atol=1e-3)
    np.testing.assert_array_equal(loaded.arrays.distance, oval.arrays.distance)
    assert load_track(str(folder)) is loaded
    assert load_track(folder / "Big Oval_map.yaml") is loaded
    loading._loaded.clear()
    restored = load_track(folder)
    types = {
        numba.typeof(track.arrays) for track in (oval, build_track("again", **values), restored)
    }
    assert len(types) == 1


def test_the_cache_on_disk_gives_the_same_track(folder, cache, monkeypatch):
    one = load_track(folder)
    assert len(list(cache.iterdir())) == 1
    loading._loaded.clear()
    # It must not be called.
    monkeypatch.setattr("pcs_racing.track.building.tracks.build_track", None)
    two = load_track(folder)
    assert two is not one
    for field in dataclasses.fields(one):
        if field.name not in ("arrays", "centerline"):
            assert getattr(one, field.name) == getattr(two, field.name)
    for first, second in zip(
        (*one.arrays, one.centerline), (*two.arrays, two.centerline), strict=True
    ):
        np.testing.assert_array_equal(first, second)
        assert type(first) is type(second)


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "other circuit"])
def test_a_damaged_cache_file_is_made_anew(folder, cache, damage):
    load_track("Pipkin")
    (other,) = cache.iterdir()
    one = load_track(folder)
    (file,) = set(cache.iterdir()) - {other}
    whole = file.read_bytes()
    middle = len(whole) // 2
    file.write_bytes(
        {
            "cut": whole[:middle],
            "flip": whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :],
            "empty": b"",
            "other circuit": other.read_bytes(),
        }[damage]
    )
    loading._loaded.clear()
    assert load_track(folder).content_hash == one.content_hash
    assert file.read_bytes() == whole


def test_what_other_code_has_cached_is_made_anew(folder, cache, monkeypatch):
    load_track(folder)
    loading._loaded.clear()
    monkeypatch.setattr(
        "pcs_racing.track.cache.algorithm_digest", lambda module: f"another {module}".encode()
    )
    load_track(folder)
    assert len(list(cache.iterdir())) == 2


def test_a_full_disk_leaves_no_half_a_cache_and_is_no_error(folder, cache, monkeypatch):
    def full(source, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    assert load_track(folder).name == "Big Oval"
    assert list(cache.iterdir()) == []


def test_where_nothing_can_be_written_nothing_is_kept_and_that_is_no_error(
    folder, monkeypatch, tmp_path
):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("PCS_RACING_CACHE", str(tmp_path / "file"))
    assert load_track(folder).name == "Big Oval"
    loading._loaded.clear()
    monkeypatch.delenv("PCS_RACING_CACHE")
    monkeypatch.setattr("pcs_racing.track.cache.Path.home", homeless)
    assert load_track(folder).name == "Big Oval"


def test_a_changed_file_is_noticed_and_errors_name_the_file(folder):
    one = load_track(folder)
    info = folder / "Big Oval_track.yaml"
    own = (
        "{speed_range: [0.5, 0.6], start_spacing: 0.5, start_places: {front: [[2, 3]]}, left_share:"
        " 0.5}"
    )
    info.write_text(f"calibration: {{contest: {own}}}")
    assert load_track(folder).calibration == {
        "contest": Calibration((0.5, 0.6), 0.5, {"front": ((2.0, 3.0),)})
    }
    info.unlink()
    assert load_track(folder).calibration == {}
    assert load_track(folder).content_hash == one.content_hash
    file = folder / "Big Oval_map.yaml"
    file.write_text(file.read_text().replace("resolution: 0.05", "resolution: 0.06"))
    refused(r"Big Oval_(map\.yaml|raceline\.csv)", load_track, folder, error=MapError)
    file.write_text(file.read_text().replace("resolution: 0.06", "resolution: 0.05"))
    line = folder / "Big Oval_raceline.csv"
    rows = line.read_text().splitlines()
    line.write_text("\n".join(rows[: len(rows) // 2]))
    refused(r"Big Oval_raceline.csv: the race line is open", load_track, folder, error=MapError)


def test_missing_lines_are_made_from_the_picture(folder, oval, caplog):
    for kind in ("centerline", "raceline"):
        (folder / f"Big Oval_{kind}.csv").unlink()
    made = load_track(folder)
    load_track(folder)
    warning = (
        "track Big Oval: it has no race line and it has no centre line; a new one was made from the"
        " picture"
    )
    assert [record.getMessage() for record in caplog.records] == [warning]
    assert np.abs(oval.to_frenet(made.centerline[:, :2])[:, 1]).max() < 0.1
    assert made.wall_distance(made.line[:, :2]).min() > 0.29
    assert made.length < oval.length


def test_a_race_line_without_air_to_the_walls_is_replaced(folder, oval, caplog):
    file = folder / "Big Oval_raceline.csv"
    s = np.linspace(0.0, oval.length, 300)
    rows = np.zeros((300, 7))
    rows[:, 1:3] = oval.to_cartesian(np.column_stack([s, np.full_like(s, 0.9)]))[:, :2]
    np.savetxt(file, rows, delimiter=";")
    track = load_track(folder)
    assert "comes within 0.1" in caplog.text
    assert track.wall_distance(track.line[:, :2]).min() > 0.29
    loading._loaded.clear()
    caplog.clear()
    load_track(folder)  # from the cache on disk, which remembers it
    assert "comes within 0.1" in caplog.text
    rows[:, 1:3] *= 0.8
    np.savetxt(file, rows, delimiter=";")
    refused(r"Oval_raceline.csv: the race line leads", load_track, folder, error=MapError)


def write_lines(folder, race, center):
    """Write the lines of a folder as the json file of a race stack, in place of its csv files."""
    for kind in ("centerline", "raceline"):
        (folder / f"Big Oval_{kind}.csv").unlink()
    columns = (map_files.RACELINE_COLUMNS, map_files.WAYPOINT_CENTERLINE)
    keys = ("global_traj_wpnts_iqp", "centerline_waypoints")
    lines = {
        key: {"wpnts": [dict(zip(names, row, strict=True)) for row in np.asarray(rows).tolist()]}
        for key, names, rows in zip(keys, columns, (race, center), strict=True)
    }
    (folder / "global_waypoints.json").write_text(json.dumps(lines))


@pytest.mark.parametrize("form", ["csv", "json"])
@pytest.mark.parametrize(
    ("line", "message"),
    [
        (lambda race: race[::-1], "race line is driven clockwise, but the centre line counter"),
        (lambda race: np.random.default_rng(0).permutation(race), "race line crosses itself near"),
        (lambda race: race * 1e300, "race line holds the impossible point"),
        (lambda race: np.vstack([race[:-1], race]), "race line crosses itself"),
        (lambda race: 0.5 * SMALL + race[0], "race line is .* leads round no wall"),
    ],
)
def test_a_race_line_of_another_direction_order_or_way_is_refused(folder, line, message, form):
    content = read_map(folder)
    race = line(content.raceline)
    write_map(content._replace(raceline=race))
    if form == "json":
        write_lines(folder, race, content.centerline)
    refused(message, load_track, folder, error=MapError)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda center: center * [1.0, 1.0, 0.0, 1.0], "0.0 m wide to the right"),
        (lambda center: center * [1.0, 1.0, 1.0, -1.0], "m to the left of point .* positive"),
        (lambda center: np.random.default_rng(0).permutation(center), "crosses itself"),
        (lambda center: center * [1e307, 1.0, 1.0, 1.0], "holds the impossible point"),
    ],
)
def test_a_bad_centre_line_is_named_with_its_fault(folder, change, message, caplog):
    content = read_map(folder)
    center = change(content.centerline)
    write_map(content._replace(centerline=center))
    refused(f"Oval_centerline.csv: .*{message}", load_track, folder, error=MapError)
    write_lines(folder, content.raceline, center)
    load_track(folder)
    (record,) = caplog.records
    assert re.search(f"it has a bad centre line .*{message}", record.getMessage())


def test_widths_of_the_other_sides_are_named(folder, oval):
    content = read_map(folder)
    s, d = oval.to_frenet(content.centerline[:, :2]).T
    center = content.centerline.copy()
    center[:, :2] = oval.to_cartesian(np.column_stack([s, d + 0.5]))[:, :2]
    center[:, 2:] = [1.6, 0.6]
    write_map(content._replace(centerline=center))
    load_track(folder)
    write_map(content._replace(centerline=center[:, [0, 1, 3, 2]]))
    refused("m more room to the left .* right and left are exchanged", load_track, folder)


def test_an_obstacle_stays_on_the_track_and_the_line_goes_past_it(folder, oval):
    content = read_map(folder)
    occupied = content.occupied.copy()
    at = content.centerline[20, :2]
    i, j = np.floor((at - content.origin) / content.resolution).astype(int)[::-1]
    occupied[i - 4 : i + 5, j - 4 : j + 5] = True
    track = load_track(
        write_map(
            content._replace(
                folder=folder.parent / "Box", name="Box", occupied=occupied, raceline=None
            )
        )
    )
    assert track.wall_distance(at) == 0.0 < oval.wall_distance(at)
    assert track.wall_distance(track.line[:, :2]).min() > 0.29
    write_map(
        content._replace(folder=folder.parent / "No", name="No", occupied=np.zeros_like(occupied))
    )
    refused("the picture has no wall", load_track, folder.parent / "No", error=MapError)


def test_names_that_stand_for_nothing_and_missing_mapping_tools_are_told(
    tmp_path, monkeypatch, folder
):
    monkeypatch.chdir(tmp_path)
    refused("unknown track 'Nowhere'", load_track, "Nowhere", error=UnknownNameError)
    refused(r"map folder .*nowhere", load_track, tmp_path / "nowhere", error=MapError)
    (tmp_path / "empty").mkdir()
    refused(r"holds no map: .*empty_map\.yaml", load_track, "empty", error=MapError)
    monkeypatch.setattr("pcs_racing.base.errors.find_spec", lambda name: None)
    load_track(folder)
    (folder / "Big Oval_raceline.csv").unlink()
    refused(r"race line; .*pcs-racing\[mapping\]", load_track, folder, error=ModuleNotFoundError)
