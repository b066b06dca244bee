"""Keep the results that belong to the present versions of the environments, as `docs/versions.md`
says.

    python dev/tools/make_goldens.py

Results of a version that are there already are compared, never replaced: if they differ, the
environment needs the next number behind its ``-v``.
"""

import io
import sys
from pathlib import Path

import numpy as np

GOLDENS = Path(__file__).resolve().parents[2] / "tests" / "goldens"
sys.path.insert(0, str(GOLDENS))

from scenarios import SCENARIOS, differences, file_name, track_hash  # noqa: E402


def main() -> None:
    wrong = []
    for name, scenario in SCENARIOS.items():
        found = {**scenario(), "track": np.array(track_hash())}
        file = GOLDENS / file_name(name)
        if not file.is_file():
            buffer = io.BytesIO()
            np.savez_compressed(buffer, **found)
            file.write_bytes(buffer.getvalue())
            print(f"{name}: kept, {file.stat().st_size / 1000:.0f} kB")
            continue
        with np.load(file) as stored:
            lines = differences(found, dict(stored))
        print(f"{name}: {'as it was' if not lines else 'DIFFERENT'}")
        wrong += [f"{name}: {line}" for line in lines]
    if wrong:
        sys.exit(
            "\n".join(
                [
                    *wrong,
                    (
                        "nothing was replaced: give these environments the next number"
                        " (docs/versions.md)"
                    ),
                ]
            )
        )


if __name__ == "__main__":
    main()
