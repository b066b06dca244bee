"""How tests say that something is refused."""

from collections.abc import Callable

import pytest

from pcs_racing import InputError


def refused(
    message: str,
    call: Callable[..., object],
    /,
    *arguments: object,
    error: type = InputError,
    **options: object,
) -> None:
    """Call a function, which must raise this error, of a single line that matches the message."""
    with pytest.raises(error, match=message) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
