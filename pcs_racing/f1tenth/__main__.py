"""Run an F1TENTH gym program unmodified: python -m pcs_racing.f1tenth PROGRAM.py ARGS."""

import os
import runpy
import sys
from pathlib import Path

from pcs_racing.base.errors import InputError


def main(given: list[str]) -> int:
    """Run the program; an input error prints one line and returns status 2."""
    if not given or given[0] in ("-h", "--help") or not os.path.isfile(given[0]):
        print(
            f"{__doc__}"
            if not given or given[0][0] == "-"
            else f"error: there is no program {given[0]}",
            file=sys.stderr,
        )
        return 2
    from pcs_racing.f1tenth.copies import replace_copy
    from pcs_racing.f1tenth.stand_ins import install

    install()
    program = os.path.abspath(given[0])
    sys.argv[:] = [given[0], *given[1:]]
    sys.path.insert(0, os.path.dirname(program))
    try:
        replace_copy(Path(program))
        runpy.run_path(program, run_name="__main__")
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
