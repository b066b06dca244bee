"""Values that are made when they are first asked for, of which the last ones used are kept."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class RecentlyUsed(Generic[Key, Value]):
    """The ``most`` values (at least 1) that were used last, by key.

    Unlike :func:`functools.lru_cache` it can be copied and pickled together with what the values refer to.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Key, Value] = OrderedDict()

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """Return the value of a key; ``make`` makes it if it is not there. If that fails, nothing is kept."""
        if key not in self._kept:
            self._kept[key] = make()
            if len(self._kept) > self._most:
                self._kept.popitem(last=False)
        # The order is that of use: the first one goes next.
        self._kept.move_to_end(key)
        return self._kept[key]
