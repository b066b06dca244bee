"""Third-party Python files, each imported once and apart from all other code of the process.

While the code of a file runs (its import, and the calls of its drivers), the search for modules
begins in its folder, and ``sys.modules`` has the modules of this folder under their plain names.
Then the process has its own modules again: two files with a ``utils`` in each of their folders use
two modules. In the modules of a file, ``time`` shows the time of the race, and ``rclpy`` is
replaced (:mod:`pcs_racing.planners.ros_nodes`). Each driver draws from generators of its own.
"""

import os
import random
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from threading import RLock
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError, check_path, one_line
from pcs_racing.planners import ros_nodes

EPOCH = 1_700_000_000.0
"""Clock time at the start of a race, s since 1970: programs take 0 for "not yet"."""

_PREFIX = "drivers of "
_TICK = 1e-5  # s added by each reading of the clock, so that a loop that waits for a time ends
_CLOCKS = ("time", "monotonic", "perf_counter", "process_time", "thread_time")
_OURS = {"pcs_racing", "pcs_racing_agents"}
_ENDS = (".py", os.sep)  # a module, or a package in a folder

_files: dict[Path, "_OwnFile"] = {}
_lock = RLock()  # held while a file's code runs: it has the modules and generators of the process


class _OwnFile:
    """A Python file with the modules of its folder, and of folders that it adds to ``sys.path``."""

    def __init__(self, path: Path) -> None:
        self.path, self.now = path, 0.0
        # Without dots: pickle takes a dot for a package.
        self.name = f"{_PREFIX}{path}".replace(".", ":")
        self._folders: list[str] = []
        self._hides: set[str] = set()  # importable from the folders
        self._modules = dict(ros_nodes.modules())
        self._add_folder(str(path.parent))
        spec = spec_from_file_location(self.name, path, submodule_search_locations=self._folders)
        if not path.is_file() or spec is None or spec.loader is None:
            raise InputError(f"there is no Python file {path}")
        self.module = sys.modules[self.name] = module_from_spec(spec)
        try:
            with self.running(f"{path} can't be loaded"), drawing(seeded(0)):
                spec.loader.exec_module(self.module)
        except InputError:
            del sys.modules[self.name]
            raise
        self._replace_clock(self.module)

    @contextmanager
    def running(self, what: str, now: float = 0.0) -> Iterator[None]:
        """Let the file's code run within the block, at a race time (s).

        An error of any kind becomes one line that begins with ``what``.
        """
        with _lock, one_line(what, ()):
            self.now, path, argv = now, sys.path[:], sys.argv
            names = sys.modules.keys() & (self._hides | self._modules.keys())
            hidden = {name: sys.modules.pop(name) for name in names}
            sys.modules.update(self._modules)
            sys.path[:0], sys.argv = self._folders, [str(self.path)]
            count = len(sys.modules)
            try:
                yield
            finally:
                for folder in [one for one in sys.path if one not in (*path, *self._folders)]:
                    self._add_folder(folder)
                if len(sys.modules) != count:
                    self._keep_modules()
                for name in self._modules:
                    sys.modules.pop(name, None)
                sys.modules.update(hidden)
                sys.path[:], sys.argv = path, argv

    def _add_folder(self, folder: str) -> None:
        self._folders.append(os.path.abspath(folder))
        for entry in Path(folder).iterdir() if Path(folder).is_dir() else ():
            if entry.suffix == ".py" or (entry / "__init__.py").is_file():
                self._hides.add(entry.stem)
        self._hides -= _OURS

    def _keep_modules(self) -> None:
        """Keep the new modules of the folders, under names that other processes find, too."""
        for plain, module in list(sys.modules.items()):
            if plain.startswith(_PREFIX) or plain in self._modules or not self._owns(plain, module):
                continue
            self._modules[plain] = sys.modules[f"{self.name}.{plain}"] = module
            for value in vars(module).values():
                if isinstance(value, type | FunctionType) and value.__module__ == plain:
                    value.__module__ = f"{self.name}.{plain}"
            self._replace_clock(module)

    def _owns(self, name: str, module: ModuleType) -> bool:
        head = name.partition(".")[0]
        starts = tuple(f"{one}{os.sep}{head}{end}" for one in self._folders for end in _ENDS)
        own = getattr(module, "__dict__", {})  # without a __getattr__ of the module
        places = [own.get("__file__") or "", *own.get("__path__", ())]
        return head not in _OURS and any(
            f"{os.path.abspath(place)}{os.sep}".startswith(starts) for place in places
        )

    def _replace_clock(self, module: ModuleType) -> None:
        """Let a module read the time of the race."""
        own: dict[str, Callable[..., Any]] = dict.fromkeys(_CLOCKS, self._read_clock)
        own |= {f"{name}_ns": lambda: round(1e9 * self._read_clock()) for name in _CLOCKS}
        own["sleep"] = self._sleep
        replaced: dict[int, Any] = {id(getattr(time, name)): one for name, one in own.items()}
        replaced[id(time)] = SimpleNamespace(**{**vars(time), **own})
        found = {name: replaced.get(id(value)) for name, value in vars(module).items()}
        vars(module).update((name, one) for name, one in found.items() if one is not None)

    def _read_clock(self) -> float:
        self._sleep(_TICK)
        return EPOCH + self.now

    def _sleep(self, seconds: float) -> None:
        self.now += seconds


def seeded(*seed: int) -> list[Any]:
    """Return states of the global generators of ``random``, numpy and torch for a seed."""
    number = int(np.random.SeedSequence(seed).generate_state(1)[0])
    torch = sys.modules.get("torch")
    return [
        random.Random(number).getstate(),
        np.random.MT19937(number),
        torch and torch.Generator().manual_seed(number).get_state(),
    ]


@contextmanager
def drawing(states: list[Any]) -> Iterator[None]:
    """Let the code within the block draw from generators with these states, which it changes."""
    outside = _exchanged(states)
    try:
        yield
    finally:
        states[:] = _exchanged(outside)


def _exchanged(states: list[Any]) -> list[Any]:
    """Set the states of the global generators, and return their former states."""
    torch = sys.modules.get("torch")
    numpy: Any = np.random
    former = [random.getstate(), numpy.get_bit_generator(), torch and torch.get_rng_state()]
    random.setstate(states[0])
    numpy.set_bit_generator(states[1])  # a copy of its state would take 60 us
    if torch is not None and states[2] is not None:
        torch.set_rng_state(states[2])
    return former


def own_file(path: str | Path) -> _OwnFile:
    """Return a Python file, imported at its first use in this process."""
    place = Path(check_path("a Python file", path)).resolve()
    with _lock:
        if place not in _files:
            _files[place] = _OwnFile(place)
        return _files[place]


def files_run() -> list[str]:
    """Return the files imported in this process.

    Another process needs them to unpickle objects of their classes.
    """
    return list(map(str, _files))
