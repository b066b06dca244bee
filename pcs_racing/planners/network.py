"""A small neural network as a planner: its weights are the policy's parameter vector.

The network sees a handful of numbers of order one (:data:`INPUTS`) and puts out the steering angle and the speed,
fifty times a second. Every layer is ``tanh(W x + b)``, the output layer included: outputs -1 and 1 stand for the
largest steering angle right and left, and for standing still and :data:`TOP_SPEED`. Nothing else is needed to evolve,
imitate or distil a network: its weights are as good a ``theta`` as the lattice planner's.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import hyperbolic_tangent
from pcs_racing.base.errors import InputError
from pcs_racing.planners import planner as _view
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.pure_pursuit import gap_ahead, line_index
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.frenet import angle_between

__all__ = [
    "INPUTS",
    "SIGHT",
    "TOP_SPEED",
    "WEIGHT_LIMIT",
    "network_inputs",
    "network_planner",
    "tanh_layer",
    "weight_count",
]

INPUTS: dict[str, str] = {
    "speed": "own speed, in 8 m/s",
    "steering": "own steering angle, in its largest",
    "yaw_rate": "own yaw rate, in 5 rad/s",
    "distance": "own distance from the race line, m",
    "course": "direction of motion relative to the race line, rad",
    "curvature_here": "curvature of the race line here, 1/m",
    "curvature_near": "and 0.15 s + 0.5 m ahead",
    "curvature_far": "and 0.45 s + 1.5 m ahead",
    "profile_near": "speed of the profile at the race's fastest scale 0.1 s ahead, in 8 m/s",
    "profile_far": "and 0.45 s + 1.5 m ahead",
    "right": "free width to the right of the car, in 2 m",
    "left": "free width to its left, in 2 m",
    "opponent_near": "nearness of the opponent along the track: 1 beside, 0 from 8 m on",
    "opponent_ahead": "that nearness times the gap in 4 m, positive ahead",
    "opponent_side": "that nearness times how far it is to the left, m",
    "opponent_speed": "that nearness times its speed minus own, in 4 m/s",
}
"""What the network sees, in order, with its unit; all of order one."""

OUTPUTS = 2
TOP_SPEED = 8.0  # m/s
SIGHT = 8.0  # m
WEIGHT_LIMIT = 10.0
MOST_WEIGHTS = 100_000


@compiled
def network_inputs(track, view, out):  # type: ignore[no-untyped-def]
    """Write the network's inputs (:data:`INPUTS`) for a driver's view into ``out``, shape (16,)."""
    v = view[_view.OWN_V]
    s = view[_view.OWN_S]
    here = track.line[line_index(track, s)]
    near = track.line[line_index(track, s + 0.5 + 0.15 * v)]
    far = track.line[line_index(track, s + 1.5 + 0.45 * v)]
    profile = track.line[line_index(track, s + 0.1 * v), _frenet.SPEED]
    gap = gap_ahead(track, view)
    nearness = max(1.0 - abs(gap) / SIGHT, 0.0)
    out[0] = v / 8.0
    out[1] = view[_view.OWN_DELTA] / view[_view.STEER_MAX]
    out[2] = view[_view.OWN_PSI_DOT] / 5.0
    out[3] = view[_view.OWN_D]
    out[4] = angle_between(view[_view.OWN_PSI] + view[_view.OWN_BETA], here[_frenet.PSI])
    out[5] = here[_frenet.KAPPA]
    out[6] = near[_frenet.KAPPA]
    out[7] = far[_frenet.KAPPA]
    out[8] = view[_view.SPEED_HIGH] * profile / 8.0
    out[9] = view[_view.SPEED_HIGH] * far[_frenet.SPEED] / 8.0
    out[10] = 0.5 * (here[_frenet.RIGHT] + view[_view.OWN_D])
    out[11] = 0.5 * (here[_frenet.LEFT] - view[_view.OWN_D])
    out[12] = nearness
    out[13] = nearness * gap / 4.0
    out[14] = nearness * (view[_view.OPP_D] - view[_view.OWN_D])
    out[15] = nearness * (view[_view.OPP_V] - v) / 4.0


@compiled
def tanh_layer(theta, at, x, size, y, width):  # type: ignore[no-untyped-def]
    """Compute ``y = tanh(W x + b)``, a neuron's b after its row of W; returns where the next layer's weights begin."""
    for i in range(width):
        total = theta[at + size]
        for j in range(size):
            total += theta[at + j] * x[j]
        y[i] = hyperbolic_tangent(total)
        at += size + 1
    return at


@cache
def _driver(hidden: tuple[int, ...]) -> Any:
    """Compile the ``control`` of one architecture; the widths are constants of its code."""
    inputs = len(INPUTS)
    layers = (*hidden, OUTPUTS)
    widest = max(inputs, *layers)

    @compiled
    def control(track, theta, view, memory, scratch, path, command):  # type: ignore[no-untyped-def]
        x = scratch[:widest]
        y = scratch[widest : 2 * widest]
        network_inputs(track, view, x)
        size = inputs
        at = 0
        for width in layers:
            at = tanh_layer(theta, at, x, size, y, width)
            x, y = y, x
            size = width
        command[0] = view[_view.STEER_MAX] * x[0]
        command[1] = 0.5 * TOP_SPEED * (1.0 + x[1])

    return control


def weight_count(hidden: Sequence[int]) -> int:
    """Return how many weights a network with these hidden layers has."""
    sizes = [len(INPUTS), *hidden, OUTPUTS]
    return sum((below + 1) * above for below, above in pairwise(sizes))


def network_planner(name: str, hidden: Sequence[int] = (16,), weights: ArrayLike | None = None) -> Planner:
    """Make a planner whose parameters are the weights of a network.

    Parameters
    ----------
    name : str
        Name of the planner.
    hidden : sequence of int
        Widths of the hidden layers, each at least 1; may be empty.
    weights : array_like, shape (weight_count(hidden),), optional
        The default policy's weights, layer by layer, neuron by neuron: its weights for each input, then its bias. All 0
        by default, which drives straight on at 4 m/s.

    Returns
    -------
    Planner
        Its parameters lie in [-10, 10].

    Raises
    ------
    InputError
        If a width is no whole number from 1 on, or the weights have the wrong shape, are not finite or too large.

    Examples
    --------
    >>> network_planner("tiny", hidden=(4,)).parameter_names[:2]
    ('layer0_neuron0_speed', 'layer0_neuron0_steering')
    """
    for width in hidden:
        if isinstance(width, bool) or not isinstance(width, int | np.integer) or width < 1:
            raise InputError(
                f"network {name!r} has a hidden layer of width {width!r}; it must be a whole number from 1 on"
            )
    widths = tuple(int(width) for width in hidden)
    count = weight_count(widths)
    if count > MOST_WEIGHTS:
        raise InputError(f"network {name!r} would have {count} weights; {MOST_WEIGHTS} is the limit")
    values = _checked_weights(name, np.zeros(count) if weights is None else weights, count)
    names = _weight_names(widths)
    parameters = tuple(
        Parameter(label, -WEIGHT_LIMIT, WEIGHT_LIMIT, float(value), "weight")
        for label, value in zip(names, values, strict=True)
    )
    widest = max(len(INPUTS), OUTPUTS, *widths)
    return Planner(name=name, parameters=parameters, control=_driver(widths), scratch_size=2 * widest)


def _checked_weights(name: str, weights: ArrayLike, count: int) -> NDArray[np.float64]:
    values = np.asarray(weights, dtype=np.float64)
    if values.shape != (count,):
        raise InputError(f"network {name!r} has weights of shape {values.shape}; its layers take ({count},)")
    if not np.isfinite(values).all():
        raise InputError(
            f"network {name!r} has a weight that is {values[~np.isfinite(values)][0]}; weights must be finite"
        )
    if np.abs(values).max() > WEIGHT_LIMIT:
        worst = values[np.abs(values).argmax()]
        raise InputError(
            f"network {name!r} has a weight of {worst:g}; it must lie in [{-WEIGHT_LIMIT:g}, {WEIGHT_LIMIT:g}]"
        )
    return values


def _weight_names(hidden: tuple[int, ...]) -> list[str]:
    below = list(INPUTS)
    names = []
    for layer, width in enumerate((*hidden, OUTPUTS)):
        names += [f"layer{layer}_neuron{i}_{source}" for i in range(width) for source in (*below, "bias")]
        below = [f"neuron{i}" for i in range(width)]
    return names
