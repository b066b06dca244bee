"""Small neural network as a planner; its weights are the policy's parameters, or constants.

The network's inputs are a few numbers of order one (:data:`INPUTS`). Its outputs are the steering
angle and the speed, fifty times a second. Every layer is ``tanh(W x + b)``, the output layer
included: outputs -1 and 1 mean the max steering angle right and left, and standstill and
:data:`TOP_SPEED`. No other code is needed to evolve, imitate or distil a network: its weights are a
``theta`` like the lattice planner's.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.checks import is_whole
from pcs_racing.base.compilation import compiled, identified
from pcs_racing.base.dense import dense_forward, weight_count
from pcs_racing.base.errors import InputError
from pcs_racing.planners import view as _view
from pcs_racing.planners.field.pure_pursuit import gap_ahead, line_index
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.pursuit import COMMAND_SLOTS
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.frenet import angle_between

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
"""Inputs of the network in order, with units; all of order one."""

OUTPUTS = 2
CALL_STEPS = 2  # simulation steps of 0.01 s from one call of a planner's ``control`` to the next
TOP_SPEED = 8.0  # m/s
SIGHT = 8.0  # m
WEIGHT_LIMIT = 10.0
MAX_WEIGHTS = 100_000


@compiled
def network_inputs(track, view, out):
    """Write the network's inputs (:data:`INPUTS`) for a view into ``out``, shape (16,)."""
    v = view[_view.OWN_V]
    s = view[_view.OWN_S]
    own_place = track.line[line_index(track, s)]
    near = track.line[line_index(track, s + 0.5 + 0.15 * v)]
    far = track.line[line_index(track, s + 1.5 + 0.45 * v)]
    profile = track.line[line_index(track, s + 0.1 * v), _frenet.SPEED]
    gap = gap_ahead(track, view)
    nearness = max(1.0 - abs(gap) / SIGHT, 0.0)
    out[0] = v / 8.0
    out[1] = view[_view.OWN_DELTA] / view[_view.STEER_MAX]
    out[2] = view[_view.OWN_PSI_DOT] / 5.0
    out[3] = view[_view.OWN_D]
    out[4] = angle_between(view[_view.OWN_PSI] + view[_view.OWN_BETA], own_place[_frenet.PSI])
    out[5] = own_place[_frenet.KAPPA]
    out[6] = near[_frenet.KAPPA]
    out[7] = far[_frenet.KAPPA]
    out[8] = view[_view.SPEED_HIGH] * profile / 8.0
    out[9] = view[_view.SPEED_HIGH] * far[_frenet.SPEED] / 8.0
    out[10] = 0.5 * (own_place[_frenet.RIGHT] + view[_view.OWN_D])
    out[11] = 0.5 * (own_place[_frenet.LEFT] - view[_view.OWN_D])
    out[12] = nearness
    out[13] = nearness * gap / 4.0
    out[14] = nearness * (view[_view.OPP_D] - view[_view.OWN_D])
    out[15] = nearness * (view[_view.OPP_V] - v) / 4.0


@cache
def _control(hidden: tuple[int, ...], hold: int, frozen: bytes | None) -> Any:
    """Compile a network that decides every ``hold`` steps of 0.01 s.

    The weights are frozen, or come from ``theta``. Sizes and frozen weights are constants of the
    code. With the sizes as a tuple, each number of layers would compile its own forward pass.
    """
    sizes = np.array((len(INPUTS), *hidden, OUTPUTS))
    widest = int(sizes.max())
    odd = len(sizes) % 2 == 0
    constant = np.frombuffer(frozen or b"", np.float64)
    from_theta = frozen is None
    every_call = hold == CALL_STEPS

    @compiled
    def control(track, theta, view, memory, scratch, path, command):
        if every_call or int(view[_view.TIME] * 100.0 + 0.5) % hold == 0:
            x = scratch[:widest]
            y = scratch[widest : 2 * widest]
            network_inputs(track, view, x)
            if from_theta:
                dense_forward(theta, sizes, x, y, True)
            else:
                dense_forward(constant, sizes, x, y, True)
            outputs = y if odd else x
            command[0] = view[_view.STEER_MAX] * outputs[0]
            command[1] = 0.5 * TOP_SPEED * (1.0 + outputs[1])
            if not every_call:
                memory[0] = command[0]
                memory[1] = command[1]
        else:
            command[0] = memory[0]
            command[1] = memory[1]

    return control if frozen is None else identified(control, frozen)


def make_network_planner(
    name: str,
    hidden: tuple[int, ...],
    hold: int,
    parameters: tuple[Parameter, ...],
    frozen: bytes | None = None,
) -> Planner:
    """Return a planner with weights as parameters, or with frozen weights (float64, as bytes)."""
    return Planner(
        name=name,
        parameters=parameters,
        control=_control(hidden, hold, frozen),
        memory_size=0 if hold == CALL_STEPS else COMMAND_SLOTS,
        scratch_size=2 * max(len(INPUTS), OUTPUTS, *hidden),
        sight=SIGHT,
    )


def network_weight_count(hidden: Sequence[int]) -> int:
    """Return the number of weights of a network with these hidden layers."""
    return weight_count((len(INPUTS), *hidden, OUTPUTS))


def network_planner(
    name: str,
    hidden: Sequence[int] = (16,),
    weights: ArrayLike | None = None,
    hold: int = CALL_STEPS,
) -> Planner:
    """Make a planner whose parameters are the weights of a network.

    Parameters
    ----------
    hidden : sequence of int
        Widths of the hidden layers, each at least 1; may be empty.
    weights : array_like, shape (network_weight_count(hidden),), optional
        Weights of the default policy (:meth:`pcs_racing.base.dense.DenseLayers.flat`): for each
        layer its biases, then for each input the weights to all neurons. By default all are 0,
        which drives straight on at 4 m/s.
    hold : int
        Duration of a decision in simulation steps of 0.01 s, an even number: 2 for fifty decisions
        a second.

    Returns
    -------
    Planner
        Its parameters lie in [-10, 10].

    Examples
    --------
    >>> network_planner("tiny", hidden=(4,)).parameter_names[3:5]
    ('layer0_bias_neuron3', 'layer0_speed_neuron0')
    """
    for width in hidden:
        if not is_whole(width) or width < 1:
            raise InputError(
                f"network {name!r} has a hidden layer of width {width!r}; it must be a whole number"
                " from 1 on"
            )
    widths = tuple(int(width) for width in hidden)
    count = network_weight_count(widths)
    if weights is None and count <= MAX_WEIGHTS:
        weights = np.zeros(count)
    check_network_planner(name, (len(INPUTS), *widths, OUTPUTS), weights, hold)
    parameters = tuple(
        Parameter(label, -WEIGHT_LIMIT, WEIGHT_LIMIT, float(value), "weight")
        for label, value in zip(_weight_names(widths), np.asarray(weights, np.float64), strict=True)
    )
    return make_network_planner(name, widths, hold, parameters)


def check_network_planner(
    name: str, sizes: Sequence[int], weights: ArrayLike | None, hold: int
) -> None:
    """Check that a network can drive; its name is for messages.

    ``sizes`` and ``weights`` are ``sizes`` and ``flat()`` of
    :class:`pcs_racing.base.dense.DenseLayers`. A decision holds for ``hold`` simulation steps.
    """
    if (sizes[0], sizes[-1]) != (len(INPUTS), OUTPUTS):
        raise InputError(
            f"network {name!r} has {sizes[0]} inputs and {sizes[-1]} outputs; a driver has"
            f" {len(INPUTS)} and {OUTPUTS}, steering and speed"
        )
    count = weight_count(sizes)
    if count > MAX_WEIGHTS:
        raise InputError(f"network {name!r} would have {count} weights; {MAX_WEIGHTS} is the limit")
    values = np.asarray(weights, np.float64)
    if values.shape != (count,):
        raise InputError(
            f"network {name!r} has weights of shape {values.shape}; its layers take ({count},)"
        )
    wrong = values[~(np.abs(values) <= WEIGHT_LIMIT)]  # NaN, too
    if len(wrong):
        raise InputError(
            f"network {name!r} has a weight of {wrong[0]:g}; it must lie in [{-WEIGHT_LIMIT:g},"
            f" {WEIGHT_LIMIT:g}]"
        )
    if not is_whole(hold) or not 2 <= hold <= 100 or hold % 2:
        raise InputError(
            f"network {name!r} holds its decisions for {hold!r} steps; it must be an even number, 2"
            " to 100"
        )


def _weight_names(hidden: tuple[int, ...]) -> list[str]:
    below = list(INPUTS)
    names = []
    for layer, width in enumerate((*hidden, OUTPUTS)):
        names += [
            f"layer{layer}_{source}_neuron{i}" for source in ("bias", *below) for i in range(width)
        ]
        below = [f"neuron{i}" for i in range(width)]
    return names
