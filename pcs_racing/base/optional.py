"""Check of optional libraries: one clear error if a library is missing."""

from importlib.util import find_spec


def require(*modules: str, extra: str = "mapping") -> None:
    """Raise an error that names the extra of this distribution to install if a module is missing; import nothing."""
    for name in modules:
        if find_spec(name) is None:
            raise ModuleNotFoundError(f'{name} is needed for this: pip install "pcs-racing[{extra}]"', name=name)
