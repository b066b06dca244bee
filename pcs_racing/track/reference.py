"""A track that compiled functions hand on as one address.

A call hands over its arguments word by word, and the arrays of a track are 110 words, for each of which the compiler
writes and optimises code on both sides. Behind a reference a function finds the same attributes, and reads those that
it uses. A race is no faster for it, but a tenth of the compilation is spared (``benchmarks/start_time.py --against``).
"""

from typing import Any

from numba import types
from numba.core import cgutils, config
from numba.core.datamodel import models
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic, lower_getattr_generic, register_model

__all__ = ["TrackReference", "refer_to"]


class TrackReference(types.Type):
    """Numba's type of a reference to a named tuple, which stands in a variable of the function that made it."""

    def __init__(self, track: types.NamedTuple) -> None:
        self.track = track
        super().__init__(f"reference({track})")


@register_model(TrackReference)
class _Address(models.OpaqueModel):
    """A reference is a plain pointer."""


@infer_getattr
class _Attributes(AttributeTemplate):
    key = TrackReference

    def generic_resolve(self, reference: TrackReference, name: str) -> Any:  # type: ignore[override]
        fields = reference.track.fields
        return reference.track[fields.index(name)] if name in fields else None


@lower_getattr_generic(TrackReference)
def _read_attribute(context, builder, reference, address, name):  # type: ignore[no-untyped-def]
    track = reference.track
    index = track.fields.index(name)
    there = builder.bitcast(address, context.get_value_type(track).as_pointer())
    value = builder.load(cgutils.gep_inbounds(builder, there, 0, index))
    return impl_ret_borrowed(context, builder, track[index], value)


if getattr(config, "DISABLE_JIT", 0):

    def refer_to(track: Any) -> Any:
        """Return the track itself, which needs no reference in plain Python."""
        return track

else:

    @intrinsic
    def refer_to(typing, track):  # type: ignore[no-untyped-def]
        """Return a reference to a track, for calls as long as the calling function runs."""

        def generate(context, builder, signature, values):  # type: ignore[no-untyped-def]
            return builder.bitcast(cgutils.alloca_once_value(builder, values[0]), cgutils.voidptr_t)

        return TrackReference(track)(track), generate
