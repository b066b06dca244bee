"""Where inputs come from: our own mutations, the generators of hypothesis, and atheris, which sees coverage.

Atheris counts the branches of instrumented Python. Compiled functions can't be instrumented, and neither can libraries
in C: it is guided through our own Python, PyYAML, Pillow's readers of files and the readers of zip files and arrays, and
blind in what numba, numpy, zlib, safetensors and the C parts of ``json`` and ``csv`` do.
"""

import os
import random
import re
import sys
import types
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

__all__ = ["ENGINES", "MOST_BYTES", "fuzz_guided", "generate", "import_instrumented", "mutate"]

ENGINES = ("mutations", "hypothesis", "atheris")
MOST_BYTES = 20_000
EXAMPLES = 500  # of one run of hypothesis
WITHOUT_BYTECODE = re.compile(r"^\s*(from pcs_racing\.compilation import|from numba import|import numba)", re.MULTILINE)


def mutate(
    try_one: Callable[[bytes], bool], seeds: list[bytes], where: str, first: int, kind: str, words: tuple[str, ...]
) -> None:
    """Change valid inputs until ``try_one`` says that it is enough; input number k depends on ``where`` and k alone."""
    from fuzz_mutations import mutations

    number = first
    while try_one(mutations(random.Random(f"{where} {number}"), seeds, kind, words)[:MOST_BYTES]):
        number += 1


class _EnoughError(KeyboardInterrupt):
    """What hypothesis lets through."""


def generate(try_one: Callable[[bytes], bool], seeds: list[bytes], where: str, first: int, kind: str) -> None:
    """Let hypothesis make inputs until ``try_one`` says that it is enough."""
    from fuzz_strategies import strategy
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as with_seed

    def test(data: bytes) -> None:
        if not try_one(data[:MOST_BYTES]):
            raise _EnoughError

    settled = settings(
        max_examples=EXAMPLES, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    turn = 0
    with suppress(_EnoughError):
        while True:
            with_seed(hash_of(f"{where} {first} {turn}"))(settled(given(strategy(tuple(seeds), kind))(test)))()
            turn += 1


def hash_of(text: str) -> int:
    return random.Random(text).getrandbits(31)


def import_instrumented() -> None:
    """Import the targets, and all that they import of us, so that atheris sees which branches run.

    Must be called before anything else imports them.
    """
    import zipfile

    import atheris
    import numpy as np

    package = Path(__file__).parent.parent
    compiled = [
        ".".join(path.relative_to(package).with_suffix("").parts)
        for name in ("pcs_racing", "pcs_racing_agents")
        for path in sorted((package / name).rglob("*.py"))
        if WITHOUT_BYTECODE.search(path.read_text(encoding="utf-8")) or path.stem in ("compilation", "code_cache")
    ]
    told, sys.stderr = sys.stderr, _Silence()  # it names every module
    try:
        with atheris.instrument_imports(
            include=["yaml", "PIL", "pcs_racing", "pcs_racing_agents", "fuzz_targets", "fuzz_environments"],
            exclude=compiled,
        ):
            import fuzz_targets  # noqa: F401
    finally:
        sys.stderr = told
    for module in (zipfile, sys.modules[np.lib.format.read_array.__module__]):
        _instrument(module, atheris.instrument_func)


class _Silence:
    def write(self, text: str) -> int:
        return len(text)

    def flush(self) -> None:
        pass


def _instrument(module: types.ModuleType, instrument: Callable[[Any], Any]) -> None:
    """Instrument the functions and methods of a module that has been imported already."""
    places = [vars(module), *(vars(value) for value in vars(module).values() if isinstance(value, type))]
    for function in {value for place in places for value in place.values() if isinstance(value, types.FunctionType)}:
        if function.__module__ == module.__name__:
            instrument(function)


def fuzz_guided(
    try_one: Callable[[bytes], bool], finish: Callable[[], None], seeds: list[bytes], corpus: Path, where: str
) -> None:
    """Let atheris make inputs out of a corpus until ``try_one`` says that it is enough; never returns.

    Inputs that reach new branches are kept in the corpus. ``finish`` is called at the end; then the process ends.
    """
    import atheris

    corpus.mkdir(parents=True, exist_ok=True)
    for i, data in enumerate(seeds):
        (corpus / f"seed-{i}").write_bytes(data)

    def test(data: bytes) -> None:
        if not try_one(data):
            finish()
            os._exit(0)

    longest = min(max(4000, 2 * max(map(len, seeds), default=0)), 200_000)
    atheris.Setup(
        [
            sys.argv[0], f"-max_len={longest}", "-rss_limit_mb=0", "-timeout=100000", f"-seed={hash_of(where) + 1}",
            "-verbosity=0", "-len_control=0", f"-artifact_prefix={corpus.parent}/", str(corpus),
        ],
        test,
    )  # fmt: skip
    atheris.Fuzz()
