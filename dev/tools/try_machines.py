"""Runs the tests as other machines would: other instructions, one thread, no right to write,
another Python.

    python dev/tools/try_machines.py
    python dev/tools/try_machines.py --variants generic blas-haswell --tests tests/pcs_racing_agents/tournament
    python dev/tools/try_machines.py --pythons python3.12 python3.13

Every variant begins with empty caches of compiled code and of circuits. Prints a table and the
tests that failed; the whole of what pytest said is in a file for each variant. A variant that this
machine can't run is named with the reason.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
# groups of instructions that numpy has loops for, beyond AVX2
WIDE = "X86_V4 AVX512_ICL AVX512_SPR"
COPIED = (
    "__pycache__",
    ".venv",
    ".git",
    "out",
    "build",
    "dist",
    ".pytest_cache",
    ".mypy_cache",
    ".ruff_cache",
)


@dataclass(frozen=True)
class Variant:
    """A machine to stand in for."""

    says: str  #: What is different, for the table.
    environment: Mapping[str, str] = field(default_factory=dict)  #: Variables that make it so.
    read_only: bool = False  #: The sources can't be written to, and who runs the tests is not root.


VARIANTS = {
    "here": Variant("this machine as it is"),
    "generic": Variant("kernels for any x86-64: no FMA, no AVX", {"NUMBA_CPU_NAME": "generic"}),
    "blas-haswell": Variant(
        "OpenBLAS as on a processor with AVX2", {"OPENBLAS_CORETYPE": "Haswell"}
    ),
    "blas-prescott": Variant("OpenBLAS as on an old processor", {"OPENBLAS_CORETYPE": "Prescott"}),
    "numpy-avx2": Variant("numpy without AVX-512", {"NPY_DISABLE_CPU_FEATURES": WIDE}),
    "libm": Variant(
        "libm without AVX2 and FMA", {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}
    ),
    "torch-plain": Variant(
        "torch without AVX",
        {"ATEN_CPU_CAPABILITY": "default", "ONEDNN_MAX_CPU_ISA": "SSE41", "MKL_CBWR": "COMPATIBLE"},
    ),
    "one-thread": Variant(
        "one thread everywhere",
        {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    ),
    "all-at-once": Variant(
        "generic, blas-haswell, numpy-avx2 and one-thread together",
        {
            "NUMBA_CPU_NAME": "generic",
            "OPENBLAS_CORETYPE": "Haswell",
            "NPY_DISABLE_CPU_FEATURES": WIDE,
            "NUMBA_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        },
    ),
    "read-only": Variant("sources that can't be written to, and not root", read_only=True),
}


@dataclass(frozen=True)
class Outcome:
    """What a run came to: a reason why there is none, or pytest's last line, its failures and
    processor seconds.
    """

    end: str
    failed: Sequence[str] = ()
    seconds: float = 0.0
    good: bool = False


def environment_of(variant: Variant, scratch: Path, sources: Path) -> dict[str, str]:
    """Variables of a run whose caches are empty, and that imports the sources."""
    # data beside the repository
    real = {"PCS_RACING_MAPS": "maps", "PCS_RACING_REFERENCE": "reference"}
    there = {name: str(REPOSITORY.parent / "shared" / folder) for name, folder in real.items()}
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONHOME", "NUMBA_CACHE_DIR")
    }
    # A home of its own: caches of compiled code in the user's would hide what this variant
    # compiles.
    found = {
        **there,
        **kept,
        "HOME": str(scratch / "home"),
        "PYTHONPATH": str(sources),
        "TMPDIR": str(scratch / "tmp"),
    }
    found |= {"PCS_RACING_CACHE": str(scratch / "tracks"), "CI": "true", **variant.environment}
    if not variant.read_only:  # there numba must find a folder by itself
        found["NUMBA_CACHE_DIR"] = str(scratch / "numba")
    return found


def disabled_here(features: str) -> str:
    """Those of numpy's groups of instructions that this processor has; numpy warns of the others."""
    from numpy._core._multiarray_umath import __cpu_features__ as features_here

    return " ".join(name for name in features.split() if features_here.get(name))


def run(
    name: str, variant: Variant, python: str, workers: str, tests: Sequence[str], out: Path
) -> Outcome:
    """Run the tests under a variant; their output goes to a file."""
    scratch = Path(tempfile.mkdtemp(prefix=f"pcs-racing-{name}-"))
    sources, who = REPOSITORY, {}
    try:
        for folder in ("home", "tmp"):
            (scratch / folder).mkdir()
        if variant.read_only:
            sources = scratch / "sources"
            shutil.copytree(REPOSITORY, sources, ignore=shutil.ignore_patterns(*COPIED))
            # Root may write to what nobody may write to.
            if os.getuid() == 0:
                who = {"user": "nobody", "group": "nogroup", "extra_groups": []}
                for folder in (scratch, scratch / "home", scratch / "tmp"):
                    shutil.chown(folder, "nobody")
            for path in (*sources.rglob("*"), sources):
                path.chmod(path.stat().st_mode & ~0o222)
        environment = environment_of(variant, scratch, sources)
        if "NPY_DISABLE_CPU_FEATURES" in variant.environment:
            environment["NPY_DISABLE_CPU_FEATURES"] = disabled_here(
                variant.environment["NPY_DISABLE_CPU_FEATURES"]
            )
            # Otherwise the variant would be the plain run under another name.
            if not environment["NPY_DISABLE_CPU_FEATURES"] and len(variant.environment) == 1:
                return Outcome("not run: this processor has no AVX-512")
        elsewhere = {"cwd": scratch / "tmp", "env": environment, **who}
        if subprocess.run(
            [python, "-c", ""], check=False, capture_output=True, **elsewhere
        ).returncode:
            return Outcome(f"not run: {who.get('user', 'this user')} may not run {python}")
        parallel = ("-n", workers, "--dist", "worksteal") if workers != "0" else ()
        command = [python, "-m", "pytest", "-p", "no:cacheprovider", *parallel, "-rfE"]
        before = os.times()
        with open(out / f"{name}.log", "w", encoding="utf-8") as log:
            command += [
                "--rootdir",
                str(sources),
                "--basetemp",
                str(scratch / "tmp" / "pytest"),
                *tests,
            ]
            done = subprocess.run(
                command,
                check=False,
                stdout=log,
                stderr=log,
                **{**elsewhere, "cwd": sources},
                timeout=7200,
            )
        after = os.times()
    finally:
        # Folders without the right to write can't be removed.
        for path in scratch.rglob("*"):
            if path.is_dir() and not path.is_symlink():
                path.chmod(0o755)
        shutil.rmtree(scratch, ignore_errors=True)
    lines = (out / f"{name}.log").read_text(encoding="utf-8", errors="replace").splitlines()
    failed = [line for line in lines if re.match(r"(FAILED|ERROR) ", line)]
    seconds = (
        after.children_user + after.children_system - before.children_user - before.children_system
    )
    return Outcome(
        lines[-1] if lines else "nothing was said", failed, seconds, done.returncode == 0
    )


def environment_with(python: str, out: Path) -> str:
    """Make a virtual environment with another Python; return its interpreter."""
    folder = out / Path(python).name
    interpreter = folder / "bin" / "python"
    if not interpreter.exists():
        subprocess.run([python, "-m", "venv", folder], check=True)
    command = [
        interpreter,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--only-binary=:all:",
        "--editable",
        ".[test]",
    ]
    subprocess.run(command, check=True, cwd=REPOSITORY)
    return str(interpreter)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--variants", nargs="*", choices=VARIANTS, default=list(VARIANTS), help="default: all"
    )
    parser.add_argument(
        "--pythons", nargs="*", default=[], help="other interpreters, for instance python3.13"
    )
    parser.add_argument(
        "--tests", nargs="*", default=[], help="files or folders; default: all tests"
    )
    parser.add_argument("--workers", default="2", help="processes of pytest; default: 2")
    parser.add_argument(
        "--out",
        type=Path,
        default=REPOSITORY / "out" / "machines",
        help="folder for what pytest says",
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    runs = [(name, VARIANTS[name], sys.executable) for name in arguments.variants]
    for python in arguments.pythons:
        if shutil.which(python) is None:
            parser.error(f"{python} is not an interpreter on PATH")
        name = Path(python).name if "/" not in python else Path(python).resolve().name
        runs.append((name, Variant(f"{python} instead of {sys.executable}"), python))
    good = True
    for name, variant, python in runs:
        begin = time.monotonic()
        if python != sys.executable:
            python = environment_with(python, arguments.out)
        outcome = run(name, variant, python, arguments.workers, arguments.tests, arguments.out)
        minutes = (time.monotonic() - begin) / 60.0
        print(
            f"| {name} | {variant.says} | {outcome.end} | {outcome.seconds:.0f} | {minutes:.1f} |",
            flush=True,
        )
        for line in outcome.failed:
            print(f"    {line}", flush=True)
        good &= outcome.good or outcome.end.startswith("not run")
    sys.exit(not good)


if __name__ == "__main__":
    main()
