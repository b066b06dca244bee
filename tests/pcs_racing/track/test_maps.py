"""Map folders: written files read back, every common shape is found, and bad input gives one
clear error.
"""

import io
import json
import os
import struct
import zlib

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st
from PIL import Image
from refusal import refused

from pcs_racing.base.errors import MapError, UnknownNameError
from pcs_racing.track import maps
from pcs_racing.track.building.centerline import centerline_from_grid
from pcs_racing.track.map_files import MapFolder, read_map, write_map
from pcs_racing.track.maps import find_map, find_shipped, list_tracks


def _map(folder, name="Ring"):
    grid = np.zeros((30, 40), dtype=bool)
    grid[5, 5:30] = True
    t = np.linspace(0.0, 2.0 * np.pi, 25)
    lines = np.column_stack([np.cos(t), np.sin(t), np.full(25, 0.5), np.full(25, 0.6)])
    race = np.column_stack(
        [t, np.cos(t), np.sin(t), t, np.ones(25), np.full(25, 3.0), np.zeros(25)]
    )
    own = {
        "speed_range": [0.9, 1.2],
        "start_spacing": 0.45,
        "start_places": {"front": [[1.0, 5.5]]},
        "left_share": 0.5,
    }
    info = {"seed": 5, "style": "hull", "license": "MIT", "calibration": {"contest": own}}
    return MapFolder(name, folder, grid, 0.05, (-1.25, 2.5), lines[:-1], race, info)


@pytest.fixture
def folder(tmp_path):
    return write_map(_map(tmp_path / "Ring"))


def _edit(folder, **changes):
    """Change values of the map's yaml file; None takes one out."""
    file = folder / "Ring_map.yaml"
    values = yaml.safe_load(file.read_text()) | changes
    file.write_text(
        yaml.safe_dump({key: value for key, value in values.items() if value is not None})
    )


def _picture(folder, array, mode=None, name="Ring_map.png"):
    Image.fromarray(np.asarray(array, dtype=np.uint8), mode=None).convert(mode).save(folder / name)


def test_what_is_written_reads_back_and_replaces_another(folder, tmp_path):
    written, found = _map(folder), read_map(folder)
    np.testing.assert_array_equal(found.occupied, written.occupied)
    np.testing.assert_allclose(found.centerline, written.centerline, atol=1e-9)
    np.testing.assert_allclose(found.raceline, written.raceline, atol=1e-9)
    assert (found.name, found.folder, found.resolution, found.origin) == (
        "Ring",
        folder,
        0.05,
        (-1.25, 2.5),
    )
    assert found.info == written.info
    assert sorted(file.name for file in folder.parent.iterdir()) == ["Ring"]
    again = write_map(_map(tmp_path / "other"))
    for file in folder.iterdir():
        assert (again / file.name).read_bytes() == file.read_bytes()
    (folder / "notes.txt").write_text("kept")
    write_map(_map(folder)._replace(resolution=0.1))
    assert read_map(folder).resolution == 0.1
    assert (folder / "notes.txt").read_text() == "kept"


def test_foreign_folders_and_impossible_names_and_places_are_refused(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("...")
    refused("map called Ring", write_map, _map(tmp_path / "mine"), error=MapError)
    assert os.listdir(tmp_path / "mine") == ["thesis.tex"]
    for name in ("", "a/b", "..", ".hidden", "a\nb", " a"):
        refused("can't name a map", write_map, _map(tmp_path / "new", name), error=MapError)
    assert not (tmp_path / "new").exists()
    (tmp_path / "file").write_text("in the way")
    refused(
        r"can't write .*Ring: (Not a directory|File exists)",
        write_map,
        _map(tmp_path / "file" / "Ring"),
        error=MapError,
    )


def test_nothing_is_written_of_impossible_values_and_unreadable_folders_are_named(tmp_path):
    for message, change in [
        ("unknown 'color'", {"info": {"color": "red"}}),
        ("resolution is 2.0", {"resolution": 2.0}),
        ("row 1 is .*nan", {"centerline": np.full((20, 4), np.nan)}),
    ]:
        refused(message, write_map, _map(tmp_path / "new")._replace(**change), error=MapError)
    assert list(tmp_path.iterdir()) == []
    refused(r"map folder .*gone", read_map, tmp_path / "gone", error=MapError)
    (tmp_path / "a.txt").write_text("")
    refused("no map folder at", read_map, tmp_path / "a.txt", error=MapError)


def test_the_map_is_found_by_the_folders_name_or_as_the_only_one(folder, tmp_path):
    assert find_map(folder).name == "Ring"
    renamed = folder.rename(tmp_path / "with space")
    assert find_map(renamed).name == "Ring"
    assert find_map(renamed).raceline == renamed / "Ring_raceline.csv"
    assert find_map(renamed / "Ring_map.yaml") == find_map(renamed)
    (renamed / "Ring_map.yaml").rename(renamed / "Ring.yaml")
    assert find_map(renamed).name == "Ring"
    (renamed / "notes.yaml").write_text("{no yaml")
    assert find_map(renamed).name == "Ring"
    (renamed / "Other_map.yaml").write_text("image: x.png")
    refused(r"several maps \(Other_map.yaml, Ring.yaml\)", find_map, renamed, error=MapError)
    (renamed / "with space.yaml").write_text("frame: x")  # no map
    refused(r"several maps \(Other_map.yaml, Ring.yaml\)", find_map, renamed, error=MapError)
    (renamed / "with space.yaml").write_text("image: x.png")
    assert find_map(renamed).name == "with space"
    (renamed / "with space_map.yaml").write_text("image: x.png")
    refused(
        r"several maps \(with space.yaml, with space_map.yaml\)", find_map, renamed, error=MapError
    )


def test_shipped_tracks_are_found_whatever_the_case(folder, monkeypatch):
    monkeypatch.setattr(maps, "_SHIPPED", folder.parent)
    assert list_tracks() == ["Ring"]
    assert find_shipped("rInG") == folder
    refused(
        "unknown track 'Rong': .* did you mean 'Ring'?",
        find_shipped,
        "Rong",
        error=UnknownNameError,
    )


@pytest.mark.parametrize(("negate", "wall"), [(0, 0), (1, 255)])
def test_walls_are_dark_or_light_as_the_yaml_says(folder, negate, wall):
    grey = np.full((20, 20), 255 - wall, dtype=np.uint8)
    grey[0, 3:6] = wall  # the picture's first row is the grid's last
    _picture(folder, grey)
    _edit(folder, negate=negate)
    occupied = read_map(folder).occupied
    assert np.argwhere(occupied).tolist() == [[19, 3], [19, 4], [19, 5]]


@given(level=st.integers(0, 255), threshold=st.floats(0.3, 0.9))
def test_the_threshold_is_that_of_ros(tmp_path_factory, level, threshold):
    folder = write_map(_map(tmp_path_factory.mktemp("map") / "Ring"))
    grey = np.full((9, 9), 255, dtype=np.uint8)
    grey[4, 4:7] = level
    _picture(folder, grey)
    _edit(folder, occupied_thresh=threshold)
    assert read_map(folder).occupied[4, 4] == ((255 - level) / 255.0 > threshold)


def test_unknown_regions_are_walls_and_numbers_may_be_written_as_text(folder):
    grey = np.full((30, 30), 255, dtype=np.uint8)
    grey[:, :8] = 205  # as SLAM tools paint unseen cells
    grey[10, 12:20] = 180  # the fringe of a line
    grey[11, 12:20] = 40
    _picture(folder, grey)
    occupied = read_map(folder).occupied[::-1]
    assert occupied[:, :8].all()
    assert np.count_nonzero(occupied[:, 8:]) == 8
    assert occupied[11, 12:20].all()
    grey[20:22, 10:] = 180  # a line of its own
    _picture(folder, grey)
    assert read_map(folder).occupied[::-1][20:22, 10:].all()
    file = folder / "Ring_map.yaml"
    file.write_text(file.read_text().replace("0.05", "5e-2"))
    assert read_map(folder).resolution == 0.05


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA"])
def test_grey_pictures_of_any_mode_are_read(folder, mode):
    grey = np.where(_map(folder).occupied, 0, 255)[::-1]
    _picture(folder, grey, mode)
    np.testing.assert_array_equal(read_map(folder).occupied, _map(folder).occupied)


@pytest.mark.parametrize("yaw", [1e-17, 1.5707963, -3.14159265, 4.7123890])
def test_a_yaw_turns_the_picture_about_its_lower_left_corner_and_other_keys_are_ignored(
    folder, yaw
):
    grid = np.zeros((30, 40), dtype=bool)
    grid[4:9, 6:31] = grid[4:20, 6:12] = True
    _picture(folder, np.where(grid, 0, 255)[::-1])
    _edit(folder, origin=[-1.25, 2.5, yaw], frame_id="map")
    found = read_map(folder)
    i, j = np.argwhere(grid).T
    x, y = (j + 0.5) * 0.05, (i + 0.5) * 0.05
    points = np.column_stack(
        [x * np.cos(yaw) - y * np.sin(yaw) - 1.25, x * np.sin(yaw) + y * np.cos(yaw) + 2.5]
    )
    cols, rows = np.floor((points - found.origin) / found.resolution + 1e-9).astype(int).T
    assert found.occupied[rows, cols].all()
    assert np.count_nonzero(found.occupied) == len(i)


def test_single_dark_cells_are_left_out_and_said(folder, capsys):
    grid = _map(folder).occupied
    dirty = grid.copy()
    dirty[[12, 20], [8, 30]] = True
    dirty[24:26, 30:33] = True  # an obstacle
    _picture(folder, np.where(dirty, 0, 255)[::-1])
    found = read_map(folder).occupied
    assert np.count_nonzero(found) == np.count_nonzero(grid) + 6
    assert (
        "2 specks of up to 2 cells are left out, such as the one at (-0.82, 3.12) m, pixel (8, 17)"
        in (capsys.readouterr().err)
    )


def test_the_lines_of_a_race_stack_are_read_where_there_are_no_csv_files(folder):
    content = _map(folder)
    center, race = content.centerline, content.raceline[:-1]
    for kind in ("centerline", "raceline"):
        (folder / f"Ring_{kind}.csv").unlink()
    keys = ("s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2", "d_right", "d_left")
    rows = [dict(zip(keys, [*map(float, row), 0.5, 0.6], strict=True)) for row in race]
    lines = {
        "centerline_waypoints": {"wpnts": rows},
        "global_traj_wpnts_iqp": {"header": {}, "wpnts": rows},
    }
    file = folder / "global_waypoints.json"
    file.write_text(json.dumps(lines | {"map_info_str": {"data": ""}}))
    found = read_map(folder)
    np.testing.assert_array_equal(found.raceline, race)
    np.testing.assert_array_equal(found.centerline, np.column_stack([race[:, 1:3], center[:, 2:]]))
    (folder / "Ring_map.yaml").rename(
        folder / "Ring.yaml"
    )  # the race stack's name; its folder has the maps of its filter, too
    (folder / "pf_map.yaml").write_text((folder / "Ring.yaml").read_text())
    assert find_map(folder).name == "Ring"
    for wrong in (
        {},
        {"global_traj_wpnts_iqp": {"wpnts": rows[:3]}},
        {"global_traj_wpnts_iqp": {"wpnts": [{}]}},
        [],
    ):
        file.write_text(json.dumps(wrong))
        refused("global_traj_wpnts_iqp must hold", read_map, folder, error=MapError)
    del lines["centerline_waypoints"]
    file.write_text(json.dumps(lines))
    assert read_map(folder).centerline is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": None}, "missing 'resolution'"),
        ({"resolution": 0.0}, r"^.*resolution must"),
        ({"resolution": float("nan")}, "line 9 holds .nan"),
        ({"resolution": "wide"}, "resolution is .wide."),
        ({"origin": [0.0, float("inf"), 0.0]}, "line 7 holds .inf"),
        ({"origin": 3}, r"origin must be \[x, y, yaw\]"),
        ({"origin": [0.0, 0.0, 0.5]}, "origin has a yaw of 0.5 rad"),
        ({"negate": 2}, r"negate .* 2"),
        ({"mode": "raw"}, r"mode .*'raw'"),
        ({"occupied_thresh": 0.1, "free_thresh": 0.2}, r"free_thresh 0.2"),
        ({"image": 5}, r"image .* 5"),
        ({"image": "nothing.png"}, r"image 'nothing.png'"),
        ({"image": "../outside.png"}, r"'\.\./outside\.png' lies outside"),
        ({"image": "/etc/hostname"}, "lies outside"),
        ({"image": "link.png"}, r"'link.png' lies outside"),
        ({"image": "a\0b"}, "is not there"),
        ({"image": "Ring_map.yaml"}, r"can't be read as a picture \(another format\)"),
    ],
)
def test_impossible_yaml_values_are_refused(folder, changes, message):
    Image.new("L", (20, 20), 255).save(folder.parent / "outside.png")
    (folder / "link.png").symlink_to(folder.parent / "outside.png")
    _edit(folder, **changes)
    with pytest.raises(MapError, match=message) as caught:
        read_map(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize("kind", ["centerline.csv", "raceline.csv", "track.yaml", "map.yaml"])
def test_no_file_of_a_map_leads_out_of_its_folder_or_waits_for_ever(folder, kind):
    (folder.parent / "secret").write_text("root:secret\n")
    file = folder / f"Ring_{kind}"
    for make, message in (
        (lambda: file.symlink_to(folder.parent / "secret"), "link out of its folder"),
        (lambda: file.symlink_to("nowhere"), "can't read .*No such file"),
        (lambda: file.symlink_to(file.name), "can't read"),
        (lambda: os.mkfifo(file), "no ordinary file"),
    ):
        file.unlink(missing_ok=True)
        make()
        with pytest.raises(
            MapError, match=message if kind != "map.yaml" else "link out|holds no map"
        ) as caught:
            read_map(folder)
        assert "root:secret" not in str(caught.value)


def test_a_circuit_of_many_kilometres_is_refused_before_its_line_is_made(monkeypatch):
    occupied = np.ones((4004, 4004), bool)
    occupied[2:-2, 2:-2] = False
    occupied[10:-10, 10:-10] = True
    monkeypatch.setattr("pcs_racing.track.building.centerline.distance_to_walls", None)
    refused(
        r"at least 11\d\d\d m long.*resolution, 1 m",
        centerline_from_grid,
        occupied,
        1.0,
        (0.0, 0.0),
        error=MapError,
    )


def _png_header(width, height):
    """A png that claims a size and holds no pixels."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


def picture(array, **options):
    """The content of a png file."""
    file = io.BytesIO()
    Image.fromarray(np.asarray(array)).save(file, "PNG", **options)
    return file.getvalue()


def calibration(
    speeds: str = "[0.5, 1.0]", spacing: str = "0.45", places: str = "{front: [[1.0, 2.0]]}"
) -> str:
    """A track file with a calibration for one rules, as text."""
    own = (
        f"speed_range: {speeds}, start_spacing: {spacing}, start_places: {places}, left_share: 0.5"
    )
    return f"calibration: {{contest: {{{own}}}}}"


WRONG_CALIBRATIONS = {
    "speeds": ("[1.0]", "[0.0, 1.0]", "[1.0, 0.5]", "[a, b]", "3"),
    "spacing": ("-1.0", "wide"),
    "places": (
        "[]",
        "{}",
        "{front: []}",
        "{front: [1.0, 2.0]}",
        "{front: [[5.0, 1.0]]}",
        "{front: [[1.0, 2.0], [1.5, 3.0]]}",
        "{front: [[a, b]]}",
        "{1: [[1.0, 2.0]]}",
    ),
}
RED = np.zeros((10, 10, 3), np.uint8)
RED[3, 3, 0] = 255
REFUSED = {
    "map.yaml": [
        ("image: [", "is not valid YAML"),
        ("- 1", "got list"),
        ("!!python/object/apply:os.system ['true']", "is not valid YAML"),
    ],
    "map.png": [
        (b"", "can't be read as a picture"),
        (_png_header(9000, 9000), "9000 x 9000 pixels"),  # refused before it is decoded
        (_png_header(2**31 - 1, 2**31 - 1), "at most|can't be read"),
        (_png_header(100, 100), "can't be read as a picture"),
        (picture(RED), "coloured pixels"),
        (picture(np.zeros((10, 10, 4), np.uint8)), "transparent pixels"),
        (picture(np.zeros((10, 10), np.uint16)), "mode I;16"),
    ],
    "centerline.csv": [
        ("\n" * 29 + "1.0, 2.0, 1.1\n" * 10, "row 1 .* 4 finite"),
        ("1.0, 2.0, 1.1\n1.0, 2.0", "row 2; .* 4 finite"),
        ("1.0, 2.0, 1.1, 1.1\n" * 10 + "1.0, 2.0, nan, 1.1", "row 11 .* 4 finite"),
        ("1.0; 2.0; 1.1; 1.1", "4 finite numbers"),
        ("# nothing\n", r"centerline\.csv has 0 points"),
        (b"\xff\xfe\x00", "is no text"),
    ],
    "track.yaml": [
        ("sead: 5", "unknown 'sead'"),
        ("calibration: 1.0", "calibration must"),
        ("calibration: {contest: {speed_range: [0.5, 1.0]}}", "must have speed_range"),
        (calibration(speeds="[.nan, 1.0]"), "line 1 holds .nan"),
        *(
            (calibration(**{name: value}), "calibration of contest")
            for name, values in WRONG_CALIBRATIONS.items()
            for value in values
        ),
    ],
}


@pytest.mark.parametrize(
    ("name", "content", "message"), [(name, *row) for name, rows in REFUSED.items() for row in rows]
)
def test_files_of_something_else_are_refused(folder, name, content, message):
    file = folder / f"Ring_{name}"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(MapError, match=message) as caught:
        read_map(folder)
    assert str(file) in str(caught.value)
