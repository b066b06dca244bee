"""``pcs-racing track``: show, import, generate and calibrate tracks."""

from pathlib import Path
from typing import Annotated

import yaml

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import MAX_YAML, write_atomically
from pcs_racing.race.calibrating import calibrate
from pcs_racing.race.config import load_rules
from pcs_racing.track.loading import load_track
from pcs_racing.track.map_files import parse_info
from pcs_racing.track.maps import list_tracks, read_inside
from pcs_racing.track.track import Calibration, Track, calibration_values
from pcs_racing_agents.base.tables import aligned
from pcs_racing_agents.cli.commands import Command, Option, command
from pcs_racing_agents.cli.options import DEFAULT_TRACK, TRACK_HELP, RulesName, output_file
from pcs_racing_agents.watch.frames import write_track_picture

group = Command(
    "track",
    "Show, import, generate and calibrate circuits.",
    ("pcs-racing track show Tarnfjord --out tarnfjord.png",),
)

MapFolder = Annotated[Path, Option("map folder to write", "DIR")]
Name = Annotated[str | None, Option("name of the circuit (default: name of the folder)")]


@command(
    "track show", "pcs-racing track show", "pcs-racing track show Tarnfjord --out tarnfjord.png"
)
def run_show(
    track: Annotated[
        str | None, Option(f"{TRACK_HELP} (default: list the shipped circuits)", "T")
    ] = None,
    *,
    out: Annotated[Path | None, Option("file for the picture (.png)", "FILE")] = None,
) -> None:
    """List the shipped circuits, or print a summary of a circuit and draw it."""
    if track is None:
        if out is not None:
            raise InputError("--out draws a circuit: say which, as in 'pcs-racing track show T'")
        rows = [(name, f"{load_track(name).length:.1f}") for name in list_tracks()]
        print("\n".join(aligned([("circuit", "lap, m"), *rows])))
        return
    target = output_file(out, ".png") if out else None
    circuit = load_track(track)
    print(circuit.summary())
    if target is not None:
        print(f"picture: {write_track_picture(circuit, target)}")


@command(
    "track import",
    "pcs-racing track import downloads/hall --out maps/hall --seed-point 1.5 0.2 --direction"
    " clockwise",
)
def run_import(
    source: Annotated[
        str, Option("map folder to read; a ROS yaml file and its picture are enough")
    ],
    *,
    out: MapFolder,
    name: Name = None,
    seed_point: Annotated[
        tuple[float, float] | None,
        Option("a point on the track in m (default: searched)", ("X", "Y")),
    ] = None,
    direction: Annotated[
        str | None,
        Option(
            "driving direction: counterclockwise (default), clockwise, or the heading at the start"
            " in rad"
        ),
    ] = None,
) -> None:
    """Complete a map folder: build the missing centre line from the picture, and the race line from
    the centre line.
    """
    from pcs_racing.track.mapping.circuits import import_map

    heading = None if direction is None else _direction(direction)
    track = import_map(source, out, seed_point=seed_point, direction=heading, name=name)
    write_track_picture(track, out / f"{track.name}.png")
    print(f"{track.summary()}\nwritten: {out}")


@command(
    "track generate", "pcs-racing track generate --seed 7 --style voronoi --out maps/Sevenhills"
)
def run_generate(
    *,
    seed: Annotated[
        int, Option("seed of the circuit; the same seed and style give the same circuit")
    ],
    style: Annotated[
        str,
        Option("hull (flowing bends), voronoi (many braking zones) or hairpin (long straights)"),
    ] = "hull",
    width: Annotated[float, Option("width of the track in m", "M")] = 2.2,
    name: Name = None,
    out: MapFolder,
) -> None:
    """Generate a new circuit from a seed."""
    from pcs_racing.track.mapping.circuits import generate_map

    track = generate_map(out, seed, style, name=name, width=width)
    write_track_picture(track, out / f"{track.name}.png")
    print(f"{track.summary()}\nwritten: {out}")


@command("track calibrate", "pcs-racing track calibrate maps/Sevenhills --rules contest --write")
def run_calibrate(
    track: Annotated[
        str | None, Option(f"{TRACK_HELP} (default: {DEFAULT_TRACK}, unless --write is given)")
    ] = None,
    *,
    rules: RulesName = "paper",
    seed: Annotated[int, Option("seed of the noise")] = 0,
    write: Annotated[
        bool, Option("store the result in the file NAME_track.yaml of the map folder")
    ] = False,
) -> None:
    """Measure the speed range and the start positions of a circuit by simulation."""
    config = load_rules(rules)
    if write and track is None:
        raise InputError(
            "--write changes a map folder: say which, as in 'pcs-racing track calibrate FOLDER"
            " --write'"
        )
    circuit = load_track(DEFAULT_TRACK if track is None else track)
    report = calibrate(circuit, config, seed=seed)
    print(report.table())
    if write:
        print(f"written: {_write_calibration(circuit, config.name, report.calibration)}")


def _write_calibration(track: Track, rules: str, calibration: Calibration) -> Path:
    """Store a calibration in the file NAME_track.yaml, with its other entries unchanged."""
    if track.folder is None:
        raise InputError(
            f"track {track.name!r} does not come from a folder: there is nowhere to write"
        )
    path = track.folder / f"{track.name}_track.yaml"
    # Entries for other rules and a person's additions remain unchanged.
    info = parse_info(path, read_inside(track.folder, path, MAX_YAML)) if path.is_file() else {}
    info["calibration"] = {**info.get("calibration", {}), rules: calibration_values(calibration)}
    text = yaml.safe_dump(info, sort_keys=False, allow_unicode=True)
    write_atomically(path, text)
    return path


def _direction(text: str) -> str | float:
    """Return a heading if the text is a number, else the text (checked by the mapping tools)."""
    try:
        return float(text)
    except ValueError:
        return text
