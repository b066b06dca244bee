"""Run the example of every client library in an environment of its own, and print a table of
versions and results.

    python dev/tools/try_clients.py
    python dev/tools/try_clients.py --only rllib_ppo sb3_ppo --out out/clients

Each file of ``examples/clients`` names its libraries in a block of inline metadata (PEP 723). A
virtual environment is made for each file and kept in the folder ``--out``; all together take some
gigabytes and, the first time, half an hour. The table at the end stands in docs/reports/clients.md.
"""

import argparse
import json
import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
CLIENTS = ROOT / "examples" / "clients"
METADATA = re.compile(r"^# /// script\n((?:#.*\n)+?)# ///$", re.MULTILINE)
TORCH = "torch>=2.8,<2.14"
"""For those that need it: the range of pyproject.toml; newer ones would bring gigabytes of CUDA."""

SHARED = ("gymnasium", "pettingzoo", "numpy", "torch")
"""Libraries whose versions have columns of their own."""

HEAD = f"""\
| File | Libraries | {" | ".join(SHARED)} | Works | Seconds |
|---|---|---|---|---|---|---|---|"""

VERSIONS = """
import json
from importlib.metadata import distributions

print(json.dumps({each.name.lower().replace("_", "-"): each.version for each in distributions()}))
"""


def dependencies(script: Path) -> list[str]:
    """Return the libraries that a script names in its inline metadata."""
    found = METADATA.search(script.read_text(encoding="utf-8"))
    if found is None:
        raise ValueError(
            f"{script} has no block of inline metadata (PEP 723); it must begin with '# /// script'"
        )
    text = "".join(
        line[2:] if line.startswith("# ") else line[1:]
        for line in found[1].splitlines(keepends=True)
    )
    libraries: list[str] = tomllib.loads(text)["dependencies"]
    return libraries


def scripts(only: list[str] | None) -> list[Path]:
    """Return the scripts of the clients, all of them or those of the given names."""
    all_of_them = {path.stem: path for path in sorted(CLIENTS.glob("*.py"))}
    unknown = sorted(set(only or ()) - set(all_of_them))
    if unknown:
        raise SystemExit(f"there is no client {unknown[0]!r}; there are: {', '.join(all_of_them)}")
    return [path for name, path in all_of_them.items() if not only or name in only]


def environment(script: Path, folder: Path) -> Path:
    """Make the virtual environment of a script, if it is not there yet; return its Python."""
    python = folder / "bin" / "python"
    wanted = "\n".join([TORCH, *dependencies(script)])
    stamp = folder / "installed.txt"
    # Installing takes minutes: again only if the script asks for other libraries.
    if not stamp.is_file() or stamp.read_text() != wanted:
        subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True)
        limits = folder / "constraints.txt"
        limits.write_text(TORCH)
        pip = [
            python,
            "-m",
            "pip",
            "--disable-pip-version-check",
            "install",
            "--quiet",
            "--constraint",
            limits,
        ]
        subprocess.run([*pip, "--editable", ROOT, *dependencies(script)], check=True)
        stamp.write_text(wanted)
    return python


def row(script: Path, installed: dict[str, str], verdict: str, seconds: float) -> str:
    """Return the line of the table for a script.

    Parameters
    ----------
    installed : dict of str
        Versions of the libraries in its environment, by name.
    seconds : float
        How long the script ran.
    """
    names = [re.split(r"[\[=<>]", each)[0] for each in dependencies(script)]
    own = [
        f"{name} {installed[name.lower().replace('_', '-')]}"
        for name in names
        if name not in SHARED
    ]
    shared = [installed.get(name, "") for name in SHARED]
    return (
        "| "
        + " | ".join([f"`{script.name}`", ", ".join(own), *shared, verdict, f"{seconds:.0f}"])
        + " |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", nargs="+", metavar="NAME", help="names of files of examples/clients without .py"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "out" / "clients",
        help="folder of the environments and logs",
    )
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    failed, table = [], []
    for script in scripts(given.only):
        python = environment(script, given.out / script.stem)
        log, begun = given.out / f"{script.stem}.log", time.monotonic()
        with log.open("w") as output:
            code = subprocess.run(
                [python, script], cwd=ROOT, stdout=output, stderr=subprocess.STDOUT
            ).returncode
        seconds = time.monotonic() - begun
        print(
            f"{script.stem}: {'works' if code == 0 else f'fails, see {log}'}, {seconds:.0f} s",
            flush=True,
        )
        installed = json.loads(
            subprocess.run([python, "-c", VERSIONS], check=True, capture_output=True).stdout
        )
        table.append(row(script, installed, "yes" if code == 0 else "no", seconds))
        failed += [script.stem] * (code != 0)
    print("\n" + "\n".join([HEAD, *table]))
    if failed:
        raise SystemExit(f"{len(failed)} of them do not work: {', '.join(failed)}")


if __name__ == "__main__":
    main()
