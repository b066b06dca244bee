"""Make every generated circuit of a folder again, each from the seed and settings in its
``NAME_track.yaml``.

    python dev/tools/make_circuits.py maps

Their other content (descriptions, calibrated speed ranges) stays.
"""

import sys
from pathlib import Path

from pcs_racing.base.errors import MapError
from pcs_racing.track.map_files import read_map, write_map
from pcs_racing.track.mapping.circuits import generate_map
from pcs_racing.track.track import Track

SETTINGS = ("seed", "style", "direction", "width", "length_range", "resolution")


def make_again(folder: Path) -> Track:
    info = read_map(folder).info
    missing = [key for key in ("seed", "style") if key not in info]
    if missing:
        raise MapError(
            f"{folder} was not generated: its track.yaml has no {' and no '.join(missing)}"
        )
    track = generate_map(folder, **{key: info[key] for key in SETTINGS if key in info})
    # Generating writes a fresh track.yaml; the description and the calibration of the old one are
    # kept.
    write_map(read_map(folder)._replace(info=info))
    return track


def main() -> None:
    for folder in sorted(
        path for parent in sys.argv[1:] for path in Path(parent).iterdir() if path.is_dir()
    ):
        print(f"{folder.name}: {make_again(folder).length:.1f} m", flush=True)


if __name__ == "__main__":
    main()
