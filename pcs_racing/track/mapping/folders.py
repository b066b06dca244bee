"""Complete map folders, generated from a seed or completed from a picture of the walls."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import MapError
from pcs_racing.track.building.centerline import centerline_from_grid
from pcs_racing.track.building.curves import signed_area
from pcs_racing.track.building.raceline import minimum_curvature_raceline, raceline_rows
from pcs_racing.track.mapping.circuits import generate_circuit
from pcs_racing.track.maps import MapFolder, read_map, write_map
from pcs_racing.track.track import Track, build_track


def generate_map(
    folder: str | Path,
    seed: int,
    style: str = "hull",
    *,
    name: str | None = None,
    description: str = "",
    direction: str = "counterclockwise",
    width: float = 2.2,
    length_range: tuple[float, float] = (60.0, 180.0),
    resolution: float = 0.05,
) -> Track:
    """Generate a circuit and write its map folder: grid, lines, and how it was made.

    The name is that of the folder unless another one is given; see ``generate_circuit`` for the rest.
    """
    settings: dict[str, Any] = {
        "seed": seed,
        "style": style,
        "direction": direction,
        "width": width,
        "length_range": list(length_range),
        "resolution": resolution,
    }
    info = {"description": description or f"Generated circuit of style {style}", "license": "MIT"}
    circuit = generate_circuit(**settings)
    x, y = circuit.origin.tolist()
    rows = raceline_rows(circuit.raceline)
    values = (circuit.occupied, circuit.resolution, (x, y), circuit.centerline, rows, info | settings)
    return _save(Path(folder), name, values)


def import_map(
    source: str | Path,
    destination: str | Path,
    *,
    seed_point: Sequence[float] | None = None,
    direction: str | float | None = None,
    name: str | None = None,
) -> Track:
    """Complete a map folder: centre line from the grid, race line from the centre line.

    Of the source, ``NAME_map.yaml`` and the picture named there are enough; the destination, another folder, gives the
    default of ``name``. ``seed_point`` and ``direction`` are as for ``centerline_from_grid``; by default those of the
    source's own centre line, if it has one.
    """
    target = Path(destination)
    if target.resolve() == Path(source).resolve():
        raise MapError(f"destination {target} is the source itself: choose another folder")
    content = read_map(Path(source))
    if content.centerline is not None:
        # The given centre line decides the start and the driving direction.
        line = content.centerline[:, :2]
        seed_point = line[0].tolist() if seed_point is None else seed_point
        direction = ("counterclockwise", "clockwise")[signed_area(line) < 0.0] if direction is None else direction
    center = centerline_from_grid(
        content.occupied, content.resolution, content.origin, seed_point=seed_point, direction=direction
    )
    race = minimum_curvature_raceline(center, content.occupied, content.resolution, content.origin)
    values = (content.occupied, content.resolution, content.origin, center, raceline_rows(race), dict(content.info))
    return _save(target, name, values)


def _save(folder: Path, name: str | None, values: tuple[Any, ...]) -> Track:
    name = folder.name if name is None else name
    occupied, resolution, origin, center, rows, info = values
    # Nothing is written unless the result can be raced on.
    track = build_track(name, occupied, resolution, origin, center, rows[:-1, 1:3], folder=folder)
    write_map(MapFolder(name, folder, occupied, resolution, origin, center, rows, info))
    return track
