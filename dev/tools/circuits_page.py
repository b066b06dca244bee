"""The page of the circuits: a picture of every shipped one, with its length, width, speeds and
character.

The figures come from the shipped files: race line, track.yaml and calibration. The page is made
whenever the site is built (``docs/site_pages.py``).
"""

from pathlib import Path

from pcs_racing import load_track
from pcs_racing.race.config import KNOWN_RULES
from pcs_racing.track.building.raceline import lap_time
from pcs_racing.track.frenet import SPEED
from pcs_racing.track.map_files import read_map
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

ROOT = Path(__file__).resolve().parents[2]

HEAD = """# Circuits

The {number} circuits that ship with the package were generated for this project and
are free to use under its licence (MIT). `pcs_racing.load_track("Tarnfjord")` loads a circuit by
its name. You can also [import a map of your own](../bring_a_map.md).

## At a glance

- **length** and **lap**: values of the race line at its full speed, which no car in a race reaches
  everywhere;
- **width**: width of the drivable surface;
- **speed**: smallest and largest speed of the race line;
- **pace**: the scales of this speed that the parameter values "pace 0" and "pace 1" mean under the
  rules of each name ([definition](../bring_a_map.md#speed-range-and-start-positions)).
"""


def circuits_page() -> str:
    """Return the whole page."""
    tracks = [(load_track(ROOT / "maps" / name), _info(name)) for name in list_tracks()]
    columns = [
        "circuit",
        "length",
        "width",
        "lap",
        "speed",
        *(f"pace, {rules}" for rules in KNOWN_RULES),
    ]
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    lines += [
        f"| [{track.name}](#{track.name.lower()}) | {' | '.join(figures(track, info))} |"
        for track, info in tracks
    ]
    blocks = [HEAD.format(number=len(tracks)).strip(), "\n".join(lines)]
    blocks += [_section(track, info) for track, info in tracks]
    return "\n\n".join(blocks) + "\n"


def figures(track: Track, info: dict) -> list[str]:
    """Return the figures of a circuit, as the table has them."""
    speed = track.line[:, SPEED]
    lap = lap_time(speed, track.arrays.ds)
    paces = [track.calibration[rules].speed_range for rules in KNOWN_RULES]
    return [
        f"{track.length:.0f} m",
        f"{info['width']:.1f} m",
        f"{lap:.1f} s",
        f"{speed.min():.1f} to {speed.max():.1f} m/s",
        *(f"{low:.2f} to {high:.2f}" for low, high in paces),
    ]


def _section(track: Track, info: dict) -> str:
    length, width, lap, speed, *_ = figures(track, info)
    picture = f"../../maps/{track.name}/{track.name}.png"
    told = f"{info['description']}. {length} long, {width} wide, {lap} a lap at {speed}."
    made = f"Generated with style `{info['style']}`, seed {info['seed']}, {info['direction']}."
    shown = (
        f"Plan of {track.name}, {length}: walls, race line coloured by its speed, start line and"
        " direction"
    )
    return f"## {track.name}\n\n{told} {made}\n\n![{shown}]({picture})"


def _info(name: str) -> dict:
    return read_map(ROOT / "maps" / name).info
