"""Runs of a third-party Python file, each with its own globals, modules, random numbers and clock.

A module in the file's folder, or in a folder that the file adds to ``sys.path``, belongs to the
run: two files with a ``utils`` in each of their folders use two modules. A race runs the file
again, so that its globals are fresh. While the file's code runs, ``sys.modules`` has the run's
modules under their plain names, where pickle looks for them, and the global generators of
``random``, numpy and torch are the run's own, seeded by the race. The run's module ``time`` shows
the race time.
"""

import argparse
import builtins
import importlib
import os
import random
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from threading import RLock
from types import CodeType, ModuleType
from typing import Any, NoReturn

import numpy as np
from numba.core.dispatcher import Dispatcher

from pcs_racing.base.checks import check_path
from pcs_racing.base.errors import InputError
from pcs_racing.planners import ros_nodes

EPOCH = 1_700_000_000.0
"""Clock time at the start of a race, s since 1970: programs take 0 for "not yet"."""

_PREFIX = "drivers of "
_SHARED = {*sys.builtin_module_names, "pcs_racing", "pcs_racing_agents"}
_PLAIN = {*_SHARED, *sys.stdlib_module_names, "numpy", "numba"} - {"random"}
"""Packages that draw no random numbers unless the file asks for them."""
_TICK = 1e-5  # s added by each reading of the clock, so that a loop that waits for a time ends

_import = builtins.__import__
_entropy: Any = importlib.import_module("numpy.random.bit_generator")
# Held while a file's code runs: it has the global generators, and may not be thread-safe.
_lock = RLock()
_runs: dict[str, "Run"] = {}
_running: list["Run"] = []  # whose code runs now, the innermost last


class Run:
    """One run of a file: in a race, with a seed and a clock, or once per process, without them."""

    def __init__(self, path: Path, number: int = 0, seed: tuple[int, ...] = (0,)) -> None:
        self.path = Path(check_path("a Python file", path))
        self.template, self.file = _template(path), str(path.resolve())
        self.name = f"{self.template}#{number}" if number else self.template
        self.now = 0.0  #: Race time, s.
        self.driver: Any = None
        self._folders, self._known_path = [str(path.resolve().parent)], list[str]()
        self._owned: dict[str, bool] = {}
        self._shown: dict[str, ModuleType] = {}  # the run's modules by their plain names
        self._hidden: dict[str, ModuleType | None] = {}  # others of these names meanwhile
        self._draws = False
        self._seed = int(np.random.SeedSequence(seed).generate_state(1)[0])
        torch = sys.modules.get("torch")
        self._generators: Any = (
            random.Random(self._seed).getstate(),
            np.random.MT19937(self._seed),
            {"has_gauss": 0},
            None if torch is None else torch.Generator().manual_seed(self._seed).get_state(),
            lambda size: random.getrandbits(size),
        )
        self._outside: Any = None  # the generators of this process while the file's code runs
        self._stand_ins = {
            "argparse": _over(argparse, ArgumentParser=_Parser),
            **ros_nodes.modules(),
        }
        if number:
            self._stand_ins["time"] = self._time()
        # Last: the file imports modules while it is loaded.
        self.module = self._load()

    def _load(self) -> ModuleType:
        spec = spec_from_file_location(
            self.name, self.path, submodule_search_locations=self._folders
        )
        if not self.path.is_file() or spec is None or not isinstance(spec.loader, SourceFileLoader):
            raise InputError(f"there is no Python file {self.path}")
        loader = spec.loader = _Loader(self.name, self.file)
        module = sys.modules[self.name] = module_from_spec(spec)
        _runs[self.name] = self
        try:
            with self.entered(f"{self.path} can't be loaded"):
                self._seed_generators()
                loader.exec_module(module)
        except BaseException:
            _code.cache_clear()
            self.forget()
            raise
        return module

    def forget(self) -> None:
        """Remove the run and its modules from this process."""
        del _runs[self.name]
        for name in [name for name in sys.modules if name.partition(".")[0] == self.name]:
            del sys.modules[name]

    @contextmanager
    def entered(self, what: str) -> Iterator[None]:
        """Let the file's code run within the block.

        An error of any kind becomes one line that begins with ``what``.
        """
        with _lock, one_line(what, ()):
            argv, self._known_path = sys.argv, sys.path[:]
            folder, streams = os.getcwd(), (sys.stdout, sys.stderr)
            _running.append(self)
            for name, module in self._shown.items():
                self.show(name, module)
            sys.argv = [str(self.path)]
            if self._draws:
                self._seed_generators()
            try:
                yield
            finally:
                self._note_folders()
                os.chdir(folder)
                sys.stdout, sys.stderr = streams
                sys.argv, sys.path[:] = argv, self._known_path
                _running.pop()
                self._hide()
                if self._outside is not None:
                    self._generators, self._outside = _swap(self._outside), None

    def show(self, name: str, module: ModuleType) -> None:
        """Show a module of the run under its plain name while the file's code runs."""
        self._shown[name] = module
        if self.runs and name not in self._hidden:
            self._hidden[name] = sys.modules.get(name)
            sys.modules[name] = module

    def _hide(self) -> None:
        for name, module in self._hidden.items():
            sys.modules.pop(name, None)
            if module is not None:
                sys.modules[name] = module
        self._hidden = {}

    @property
    def runs(self) -> bool:
        """True while the file's code runs."""
        return self in _running

    def _note_folders(self) -> None:
        """Add the folders that the file's code added to ``sys.path`` to the run's folders."""
        if sys.path != self._known_path:
            added = [
                one for one in sys.path if one not in self._known_path and one not in self._folders
            ]
            self._folders += added
            self._owned.clear()

    def _seed_generators(self) -> None:
        if self._outside is None:
            self._outside = _swap(self._generators)

    def owns(self, head: str) -> bool:
        """Return whether a module belongs to the run, by its folder."""
        if self.runs:
            self._note_folders()
        if head not in self._owned:
            spec = (
                None
                if head in _SHARED
                else PathFinder.find_spec(f"{self.name}.{head}", self._folders)
            )
            # a folder without __init__.py gives way to a package
            if spec is not None and spec.origin is None:
                other = PathFinder.find_spec(head)
                spec = None if other is not None and other.origin is not None else spec
            self._owned[head] = spec is not None
        return self._owned[head]

    def import_own(
        self,
        name: str,
        names: Any = None,
        local: Any = None,
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> Any:
        """Import as ``__import__`` does, with the run's own modules under the run's name.

        Some other modules have replacements.
        """
        head, dot, _ = name.partition(".")
        if level == 0 and self.owns(head):
            module = _import(f"{self.name}.{name}", names, local, fromlist)
            return module if fromlist else sys.modules[f"{self.name}.{head}"]
        if level == 0 and (stand_in := self._stand_ins.get(name if fromlist else head)) is not None:
            if dot and name not in self._stand_ins:
                _import(name)
            return stand_in
        if level == 0 and head not in _PLAIN:
            self.draw()
        module = _import(name, names, local, fromlist, level)
        if head == "torch" and self._outside is not None and self._outside[3] is None:
            sys.modules["torch"].manual_seed(self._seed)
        # Registrations by the first run stay.
        again = self.name != self.template and head.startswith("pcs_racing")
        return _without_registrations(module) if again else module

    def draw(self) -> None:
        """Give the file's code its own generators from now on: it may draw random numbers."""
        self._draws = True
        if self.runs:
            self._seed_generators()

    def read_clock(self) -> float:
        """Return the time of the race, s since 1970."""
        self.now += _TICK
        return EPOCH + self.now

    def _time(self) -> ModuleType:
        def in_ns() -> int:
            return round(1e9 * self.read_clock())

        def sleep(seconds: float) -> None:
            self.now += seconds

        seconds = ["time", "monotonic", "perf_counter", "process_time", "thread_time"]
        own: dict[str, Any] = dict.fromkeys(seconds, self.read_clock)
        return _over(
            time, sleep=sleep, **own, **dict.fromkeys([f"{name}_ns" for name in seconds], in_ns)
        )


class _Parser(argparse.ArgumentParser):
    """Parser in a file without arguments; a missing argument is an error of the file."""

    def error(self, message: str) -> NoReturn:
        raise SystemExit(
            f"it reads arguments of a command line, and there are none for it: {message}"
        )


def _over(real: ModuleType, **own: Any) -> ModuleType:
    """Return a module with some own values, and all other values from another module."""
    module = ModuleType(real.__name__, real.__doc__)
    module.__dict__.update({"__getattr__": partial(getattr, real), **own})
    return module


def _without_registrations(ours: ModuleType) -> ModuleType:
    """Return a module of our packages whose functions ``register_...`` do nothing."""

    def read(name: str) -> Any:
        if name.startswith("register_"):
            return lambda *given, **named: None
        value = getattr(ours, name)
        inside = isinstance(value, ModuleType) and value.__name__.startswith(f"{ours.__name__}.")
        return _without_registrations(value) if inside else value

    return _over(ours, __getattr__=read)


def _swap(given: Any) -> Any:
    """Set the global generators, and return the previous generators."""
    torch, (state, bits, gauss, torch_state, randbits) = sys.modules.get("torch"), given
    tensor = torch.get_rng_state() if torch is not None else None
    theirs: Any = np.random  # numpy's global generator has no type
    was = (
        random.getstate(),
        theirs.get_bit_generator(),
        theirs.get_state(legacy=False),
        tensor,
        _entropy.randbits,
    )
    random.setstate(state)
    theirs.set_bit_generator(bits)
    if gauss["has_gauss"]:
        theirs.set_state(gauss)
    if torch is not None and torch_state is not None:
        torch.set_rng_state(torch_state)
    _entropy.randbits = randbits  # source of seeds for numpy's unseeded generators
    return was


@contextmanager
def one_line(what: str, passing: type[Exception] | tuple[()] = InputError) -> Iterator[None]:
    """Turn any error, the end of the process included, into one line.

    Ctrl-C passes, and so do the errors ``passing``, by default our errors.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise
    except passing:
        raise
    except BaseException as error:
        try:
            said = f"{type(error).__name__}: {error}"
        except Exception:  # the text of the error raised an error
            said = type(error).__name__
        raise InputError(f"{what}: {said}") from error


@lru_cache(maxsize=1024)
def _code(path: str) -> CodeType | None:
    """Return the bytecode of a file, the same for all runs in this process."""
    return SourceFileLoader("-", path).get_code("-")


class _Loader(SourceFileLoader):
    """Loader of a run's files, with the run's imports."""

    def get_code(self, fullname: str) -> CodeType | None:
        return _code(self.path)

    def exec_module(self, module: ModuleType) -> None:
        owner, _, plain = module.__name__.partition(".")
        run = _runs[owner]
        if plain:
            run.show(plain, module)
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": run.import_own}
        if b"random" in self.get_data(self.path):
            run.draw()
        super().exec_module(module)
        # All runs share numba's compiled code: numba takes globals as constants.
        first = sys.modules.get(module.__name__.replace(run.name, run.template, 1))
        for name, value in vars(first).items() if first is not None else ():
            if isinstance(value, Dispatcher) and isinstance(vars(module).get(name), Dispatcher):
                setattr(module, name, value)


class _PlainLoader(Loader):
    """Loader of a run's module for pickle, under its plain name."""

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        self.module = importlib.import_module(f"{_running[-1].name}.{spec.name}")
        self.own_spec = self.module.__spec__
        return self.module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.own_spec  # the import system has set another


class _Finder(MetaPathFinder):
    """Finder of the modules of runs, also used by pickle for their classes."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(_PREFIX):
            owned = _running and _running[-1].owns(fullname.partition(".")[0])
            return ModuleSpec(fullname, _PlainLoader()) if owned else None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(fullname, spec.loader.path)
        return spec


sys.meta_path.insert(0, _Finder())


def run_file(path: str | Path) -> ModuleType:
    """Run a Python file, once per process, and return it as a module."""
    path = Path(check_path("a Python file", path))
    return (_runs.get(_template(path)) or Run(path)).module


def _template(path: Path) -> str:
    """Return the name of a file's first run, without dots: pickle takes a dot for a package."""
    return f"{_PREFIX}{path.resolve()}".replace(".", ":")


def files_run() -> list[str]:
    """Return the files run in this process.

    Another process needs them to unpickle objects of their classes.
    """
    return [run.file for run in _runs.values() if run.name == run.template]
