"""Map folders: generated, imported from a bare picture, and the shipped ones made again."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from refusal import refused
from repository import REPOSITORY

from pcs_racing import load_track
from pcs_racing.base.errors import MapError
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.curves import resample, signed_area
from pcs_racing.track.building.raceline import raceline_rows
from pcs_racing.track.map_files import read_map, write_map
from pcs_racing.track.mapping.circuits import generate_circuit, generate_map, import_map

SHIPPED = sorted(path for path in (REPOSITORY / "maps").iterdir() if path.is_dir())


def bare(folder: Path, source: Path) -> Path:
    """Copy of a map folder with nothing but the grid."""
    folder.mkdir()
    found = read_map(source)
    head = yaml.safe_load((source / f"{found.name}_map.yaml").read_text())
    head["image"] = f"{folder.name}_map.png"
    (folder / f"{folder.name}_map.yaml").write_text(yaml.safe_dump(head))
    (folder / f"{folder.name}_map.png").write_bytes((source / f"{found.name}_map.png").read_bytes())
    return folder


def test_a_generated_folder_holds_the_circuit(tmp_path):
    folder = tmp_path / "Round the Houses"
    made = generate_map(folder, 2, "hull", description="A test")
    names = ("_map.yaml", "_map.png", "_centerline.csv", "_raceline.csv", "_track.yaml")
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        f"Round the Houses{name}" for name in names
    )
    circuit, found = generate_circuit(2, "hull"), read_map(folder)
    np.testing.assert_array_equal(found.occupied, circuit.occupied)
    np.testing.assert_allclose(found.origin, circuit.origin)
    np.testing.assert_allclose(found.centerline, circuit.centerline, atol=1e-5)
    np.testing.assert_allclose(
        found.raceline[:, 1:3], raceline_rows(circuit.raceline)[:, 1:3], atol=1e-5
    )
    assert found.info["seed"] == 2
    assert found.info["description"] == "A test"
    loaded = load_track(folder)
    assert loaded.name == made.name == "Round the Houses"
    assert loaded.length == pytest.approx(made.length, abs=1e-3)


def test_an_import_follows_the_direction_and_start_of_the_shipped_line(tmp_path):
    clockwise = next(path for path in SHIPPED if path.name == "Saltmere")
    track = import_map(clockwise, tmp_path / "Again")
    shipped = read_map(clockwise).centerline
    np.testing.assert_allclose(track.centerline[0, :2], shipped[0, :2], atol=0.2)
    assert (track.centerline[1, :2] - track.centerline[0, :2]) @ (
        shipped[1, :2] - shipped[0, :2]
    ) > 0.0
    elsewhere = shipped[len(shipped) // 3, :2]
    moved = import_map(clockwise, tmp_path / "Moved", seed_point=elsewhere).centerline
    np.testing.assert_allclose(moved[0, :2], elsewhere, atol=0.2)
    assert signed_area(moved[:, :2]) < 0.0
    back = import_map(clockwise, tmp_path / "Back", direction="counterclockwise")
    ahead = back.centerline[1, :2] - back.centerline[0, :2]
    nearest = np.argmin(np.hypot(*(shipped[:, :2] - back.centerline[0, :2]).T))
    assert ahead @ (shipped[(nearest + 1) % len(shipped), :2] - shipped[nearest, :2]) < 0.0


def test_a_bare_map_is_completed_and_nothing_is_written_when_it_fails(tmp_path):
    refused("width is -1", generate_map, tmp_path / "Never", 0, width=-1.0)
    refused(
        "seed point",
        import_map,
        SHIPPED[0],
        tmp_path / "Never",
        seed_point=(1e4, 0.0),
        error=MapError,
    )
    refused("the source itself", import_map, SHIPPED[0], SHIPPED[0], error=MapError)
    turned = write_map(read_map(SHIPPED[0])._replace(folder=tmp_path / "Turned"))
    for kind, message in (("race", "is driven"), ("center", "m wide to the right")):
        content = read_map(turned)
        wrong = content.raceline[::-1] if kind == "race" else content.centerline * -1.0
        write_map(content._replace(**{f"{kind}line": wrong}))
        refused(message, import_map, turned, tmp_path / "Never", error=MapError)
    shutil.rmtree(turned)
    assert list(tmp_path.iterdir()) == []
    source = bare(tmp_path / "Bare Map", SHIPPED[0])
    track = import_map(source, tmp_path / "Full")
    found = read_map(tmp_path / "Full")
    assert found.name == track.name == "Full"
    assert sorted(path.name for path in source.iterdir()) == [
        "Bare Map_map.png",
        "Bare Map_map.yaml",
    ]
    race = resample(found.raceline[:-1, 1:3], 0.02)
    free = wall_clearance(race, found.occupied, found.resolution, np.array(found.origin), 1.0)
    assert free.min() >= 0.305 - 1e-4


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda path: path.name)
def test_shipped_circuits_come_from_their_seeds_and_keep_their_clearance(folder):
    found = read_map(folder)
    settings = ("seed", "style", "direction", "width", "length_range", "resolution")
    circuit = generate_circuit(**{key: found.info[key] for key in settings})
    np.testing.assert_allclose(found.centerline, circuit.centerline, atol=1e-4)
    # Another processor may round a cell of the grid differently.
    assert np.count_nonzero(found.occupied != circuit.occupied) <= 5
    np.testing.assert_allclose(
        found.raceline[:-1, 1:3], raceline_rows(circuit.raceline)[:-1, 1:3], atol=0.05
    )
    race = resample(found.raceline[:-1, 1:3], 0.02)
    free = wall_clearance(race, found.occupied, found.resolution, np.array(found.origin), 1.0)
    assert free.min() >= 0.305 - 1e-4
    assert (folder / f"{found.name}.png").is_file()
