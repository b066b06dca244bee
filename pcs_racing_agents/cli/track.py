"""``pcs-racing track``: list, show, import, generate and calibrate circuits."""

import argparse
from pathlib import Path

import yaml

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.race.calibration import calibrate
from pcs_racing.race.config import load_race_config
from pcs_racing.track.loading import load_track
from pcs_racing.track.map_files import parse_info
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Calibration, Track, calibration_values
from pcs_racing_agents.cli.options import (
    DEFAULT_TRACK,
    TRACK_HELP,
    Commands,
    add_command,
    add_race,
    can_draw,
    output_file,
)


def add(commands: Commands) -> None:
    """Add the group ``track`` and its commands."""
    group = add_command(
        commands,
        "track",
        "list, show, import, generate and calibrate circuits",
        "pcs-racing track show Tarnfjord --out tarnfjord.png",
    )
    tracks: Commands = group.add_subparsers(title="commands", metavar="COMMAND", required=True)
    parser = add_command(tracks, "list", "list the circuits that ship with the package", "pcs-racing track list")
    parser.set_defaults(run=run_list)
    _add_show(tracks)
    _add_import(tracks)
    _add_generate(tracks)
    _add_calibrate(tracks)


def _add_show(tracks: Commands) -> None:
    parser = add_command(
        tracks,
        "show",
        "print a summary of a circuit, and draw it",
        "pcs-racing track show Tarnfjord --out tarnfjord.png",
    )
    parser.add_argument("track", nargs="?", default=DEFAULT_TRACK, help=f"{TRACK_HELP} (default: {DEFAULT_TRACK})")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="file for the picture (.png, .svg or .pdf; needs matplotlib)"
    )
    parser.set_defaults(run=run_show)


def _add_import(tracks: Commands) -> None:
    parser = add_command(
        tracks,
        "import",
        "complete a map folder: build the missing centre line from the picture, and the race line from the centre line",
        "pcs-racing track import downloads/hall --out maps/hall --seed-point 1.5 0.2 --direction clockwise",
    )
    parser.add_argument("source", help="map folder to read; a ROS yaml file and its picture are enough")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="map folder to write")
    parser.add_argument("--name", help="name of the circuit (default: that of the folder)")
    parser.add_argument(
        "--seed-point", type=float, nargs=2, metavar=("X", "Y"), help="a point on the track in m (default: searched)"
    )
    parser.add_argument(
        "--direction",
        type=_direction,
        help="driving direction: counterclockwise (default), clockwise, or the heading at the start in rad",
    )
    parser.set_defaults(run=run_import)


def _add_generate(tracks: Commands) -> None:
    parser = add_command(
        tracks,
        "generate",
        "generate a new circuit from a seed",
        "pcs-racing track generate --seed 7 --style voronoi --out maps/Sevenhills",
    )
    parser.add_argument(
        "--seed",
        type=int,
        required=True,
        metavar="N",
        help="seed of the circuit; the same seed and style give the same circuit",
    )
    parser.add_argument(
        "--style",
        default="hull",
        help="hull (flowing bends), voronoi (many braking zones) or hairpin (long straights) (default: hull)",
    )
    parser.add_argument("--width", type=float, default=2.2, metavar="M", help="width of the track in m (default: 2.2)")
    parser.add_argument("--name", help="name of the circuit (default: that of the folder)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="map folder to write")
    parser.set_defaults(run=run_generate)


def _add_calibrate(tracks: Commands) -> None:
    parser = add_command(
        tracks,
        "calibrate",
        "measure the speed range and the start positions of a circuit by simulation",
        "pcs-racing track calibrate maps/Sevenhills --race contest --write",
    )
    parser.add_argument("track", nargs="?", help=f"{TRACK_HELP} (default: {DEFAULT_TRACK}, unless --write is given)")
    add_race(parser)
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the noise (default: 0)")
    parser.add_argument(
        "--write", action="store_true", help="store the result in the file NAME_track.yaml of the map folder"
    )
    parser.set_defaults(run=run_calibrate)


def run_list(arguments: argparse.Namespace) -> None:
    """Print one line for each shipped circuit."""
    for name in list_tracks():
        print(f"{name:14} {load_track(name).length:6.1f} m")


def run_show(arguments: argparse.Namespace) -> None:
    """Print a summary of a track, and draw it."""
    target = output_file(arguments.out, ".png", ".svg", ".pdf") if arguments.out else None
    track = load_track(arguments.track)
    print(track.summary())
    if target is not None:
        from pcs_racing.track.mapping.pictures import show_track

        show_track(track, target)
        print(f"picture: {target}")


def run_import(arguments: argparse.Namespace) -> None:
    """Build the missing lines of a map and write its folder."""
    from pcs_racing.track.mapping.folders import import_map

    track = import_map(
        arguments.source,
        arguments.out,
        seed_point=arguments.seed_point,
        direction=arguments.direction,
        name=arguments.name,
        picture=can_draw("the picture of the circuit"),
    )
    _print_written(track, arguments.out)


def run_generate(arguments: argparse.Namespace) -> None:
    """Generate a circuit and write its folder."""
    from pcs_racing.track.mapping.folders import generate_map

    track = generate_map(
        arguments.out,
        arguments.seed,
        arguments.style,
        name=arguments.name,
        width=arguments.width,
        picture=can_draw("the picture of the circuit"),
    )
    _print_written(track, arguments.out)


def run_calibrate(arguments: argparse.Namespace) -> None:
    """Measure the crash rate over the speed and the start positions; print and store the calibration."""
    config = load_race_config(arguments.race)
    if arguments.write and arguments.track is None:
        raise InputError("--write changes a map folder: say which, as in 'pcs-racing track calibrate FOLDER --write'")
    track = load_track(DEFAULT_TRACK if arguments.track is None else arguments.track)
    report = calibrate(track, config, seed=arguments.seed)
    print(report.table())
    if arguments.write:
        print(f"written: {_write_calibration(track, config.name, report.calibration)}")


def _write_calibration(track: Track, preset: str, calibration: Calibration) -> Path:
    """Store a calibration in the file NAME_track.yaml, and keep the other entries of the file."""
    if track.folder is None:
        raise InputError(f"track {track.name!r} does not come from a folder: there is nowhere to write")
    path = track.folder / f"{track.name}_track.yaml"
    info = parse_info(path, path.read_bytes()) if path.is_file() else {}
    info["calibration"] = {**info.get("calibration", {}), preset: calibration_values(calibration)}
    text = yaml.safe_dump(info, sort_keys=False, allow_unicode=True)
    write_atomically(path, lambda file: file.write(text.encode()))
    return path


def _direction(text: str) -> str | float:
    """Return a heading if the text is a number, else the text itself, which the mapping tools check."""
    try:
        return float(text)
    except ValueError:
        return text


def _print_written(track: Track, folder: Path) -> None:
    print(f"{track.summary()}\nwritten: {folder}")
