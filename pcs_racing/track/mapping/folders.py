"""From a seed, or from a picture of the walls, to a complete map folder.

``python -m pcs_racing.track.mapping.folders maps`` makes every generated circuit in a folder again, each from its own
``NAME_track.yaml``.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import MapError
from pcs_racing.track.building.centerline import centerline_from_grid
from pcs_racing.track.building.curves import signed_area
from pcs_racing.track.building.raceline import CLEARANCE, minimum_curvature_raceline, raceline_rows
from pcs_racing.track.mapping.circuits import generate_circuit
from pcs_racing.track.mapping.pictures import show_track
from pcs_racing.track.maps import MapFolder, read_map, write_map
from pcs_racing.track.track import Track, build_track

__all__ = ["generate_map", "import_map", "regenerate"]

SETTINGS = ("seed", "style", "direction", "width", "length_range", "resolution")
"""What of ``NAME_track.yaml`` determines a generated circuit: the arguments of ``generate_circuit``."""


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
    picture: bool = True,
) -> Track:
    """Generate a circuit and write its map folder: grid, lines, how it was made, and a picture.

    Parameters
    ----------
    folder : path-like
        The map folder to write.
    seed : int
    style : {"hull", "voronoi", "hairpin"}
    name : str, optional
        Name of the circuit and of its files. Default: the folder's own name.
    description : str
        A line for people.
    direction, width, length_range, resolution
        See ``generate_circuit``.
    picture : bool
        Also draw ``NAME.png`` (needs matplotlib).

    Returns
    -------
    Track

    Raises
    ------
    InputError
        If a parameter is impossible, before anything is written.
    MapError
        If the seed gives no circuit, or the folder can't be written.
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
    return _generate(Path(folder), name, settings, info, picture)


def import_map(
    source: str | Path,
    destination: str | Path,
    *,
    seed_point: Sequence[float] | None = None,
    direction: str | float | None = None,
    name: str | None = None,
    clearance: float = CLEARANCE,
    picture: bool = True,
) -> Track:
    """Complete a map folder: centre line from the grid, race line from the centre line.

    Parameters
    ----------
    source : path-like
        A map folder; its ``NAME_map.yaml`` and the picture named there are enough.
    destination : path-like
        The map folder to write; never the source.
    seed_point : sequence of float, optional
        A point on the track, in m. Default: the first point of the source's own centre line, if it has one.
    direction : {"counterclockwise", "clockwise"} or float, optional
        Driving direction, or the heading in rad at the start. Default: that of the source's own centre line, if it has
        one, else counterclockwise.
    name : str, optional
        Name of the circuit and of its files. Default: the destination's own name.
    clearance : float
        Distance in m that the race line keeps from the walls.
    picture : bool
        Also draw ``NAME.png`` (needs matplotlib).

    Returns
    -------
    Track

    Raises
    ------
    MapError
        If the source can't be read, holds no closed loop, or is too narrow; nothing is written then.
    """
    target = Path(destination)
    if target.resolve() == Path(source).resolve():
        raise MapError(f"destination {target} is the source itself: choose another folder")
    found = read_map(Path(source))
    if found.centerline is not None:
        # The shipped line tells where the circuit begins and which way round it goes.
        line = found.centerline[:, :2]
        seed_point = line[0].tolist() if seed_point is None else seed_point
        direction = ("counterclockwise", "clockwise")[signed_area(line) < 0.0] if direction is None else direction
    center = centerline_from_grid(
        found.occupied, found.resolution, found.origin, seed_point=seed_point, direction=direction
    )
    race = minimum_curvature_raceline(center, found.occupied, found.resolution, found.origin, clearance=clearance)
    made = (found.occupied, found.resolution, found.origin, center, raceline_rows(race), dict(found.info))
    return _save(target, name, made, picture)


def regenerate(folder: str | Path) -> Track:
    """Make a generated circuit again, from the seed and the settings in its ``NAME_track.yaml``.

    What the file holds besides them (such as calibrated speed ranges) is kept.

    Parameters
    ----------
    folder : path-like
        The map folder.

    Raises
    ------
    MapError
        If the folder doesn't say how it was generated.
    """
    found = read_map(Path(folder))
    missing = [key for key in ("seed", "style") if key not in found.info]
    if missing:
        raise MapError(f"{folder} was not generated: its {found.name}_track.yaml has no {' and no '.join(missing)}")
    settings = {key: value for key, value in found.info.items() if key in SETTINGS}
    rest = {key: value for key, value in found.info.items() if key not in SETTINGS}
    return _generate(Path(folder), found.name, settings, rest, True)


def _generate(folder: Path, name: str | None, settings: dict[str, Any], info: dict[str, Any], picture: bool) -> Track:
    circuit = generate_circuit(**settings)
    x, y = circuit.origin.tolist()
    rows = raceline_rows(circuit.raceline)
    made = (circuit.occupied, circuit.resolution, (x, y), circuit.centerline, rows, info | settings)
    return _save(folder, name, made, picture)


def _save(folder: Path, name: str | None, made: tuple[Any, ...], picture: bool) -> Track:
    name = folder.name if name is None else name
    occupied, resolution, origin, center, rows, info = made
    # Nothing is written unless the result can be raced on.
    track = build_track(name, occupied, resolution, origin, center, rows[:-1, 1:3], folder=folder)
    write_map(MapFolder(name, folder, occupied, resolution, origin, center, rows, info))
    if picture:
        show_track(track, folder / f"{name}.png")
    return track


def main(arguments: Sequence[str] | None = None) -> None:
    """Regenerate every generated circuit in the folders named on the command line."""
    for parent in sys.argv[1:] if arguments is None else arguments:
        for folder in sorted(path for path in Path(parent).iterdir() if path.is_dir()):
            track = regenerate(folder)
            print(f"{track.name}: {track.length:.1f} m", flush=True)


if __name__ == "__main__":
    main()
