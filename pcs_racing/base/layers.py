"""Convolutions over a row of numbers, and gated recurrent units: dense layers on parts of what went in.

Both take their numbers as :meth:`pcs_racing.base.dense.DenseLayers.flat` orders those of a layer.
"""

from pcs_racing.base.compilation import kernel
from pcs_racing.base.dense import dense_forward
from pcs_racing.base.elementary import hyperbolic_tangent


@kernel
def convolve(flat, sizes, step, x, y):  # type: ignore[no-untyped-def]
    """Pass windows of ``x`` through a dense layer and a ReLU, one after the other into ``y``.

    Parameters
    ----------
    flat : ndarray
        The layer's numbers.
    sizes : ndarray, shape (2,)
        Numbers of a window, and that come out of it: positions times channels, and channels.
    step : int
        Numbers from one window to the next.
    x : ndarray
        Position after position, with all channels of one beside each other.
    y : ndarray
        As many positions as there are windows.
    """
    width = sizes[1]
    for k in range(y.shape[0] // width):
        out = y[k * width : (k + 1) * width]
        dense_forward(flat, sizes, x[k * step :], out, False)
        for j in range(width):
            out[j] = max(out[j], 0.0)


@kernel
def recur(flat, inputs, units, x, state, work):  # type: ignore[no-untyped-def]
    """Move the state of gated recurrent units (``units``,) on by the inputs ``x``.

    ``flat`` holds the layer from the inputs to the reset, update and new gates, and that from the state to them;
    ``work`` 6 times as many numbers as there are units.
    """
    gates = 3 * units
    from_inputs, from_state = work[:gates], work[gates : 2 * gates]
    dense_forward(flat, (inputs, gates), x, from_inputs, False)
    dense_forward(flat[(inputs + 1) * gates :], (units, gates), state, from_state, False)
    for k in range(units):
        reset = 0.5 + 0.5 * hyperbolic_tangent(0.5 * (from_inputs[k] + from_state[k]))
        keep = 0.5 + 0.5 * hyperbolic_tangent(0.5 * (from_inputs[units + k] + from_state[units + k]))
        new = hyperbolic_tangent(from_inputs[2 * units + k] + reset * from_state[2 * units + k])
        state[k] = new + keep * (state[k] - new)
