"""Lidar planners with a network, convolutional [1]_ or recurrent [2]_, and their folders.

A third network (:mod:`pcs_racing.planners.field.residual`) corrects a planner without a map; these
two imitate a planner with a map. The inputs of a network, ten times a second, are the ranges of its
beams and the own car's speed, yaw rate, steering angle and speed scale (from the pace). The outputs
are the slope and the bend of the path ahead, relative to the car's heading, and the speeds nearby
and farther on. The network was trained to imitate the predictive spliner, which has a map and knows
the opponent's state, in the same places (``dev/training/imitate_from_lidar.py``).

Differences: networks are smaller, for 135 beams, and have more inputs about the own car; their
output is a path ten times a second, which is followed fifty times a second, instead of steering
angles; training also covers the places where the networks drive, not only the places where the
teacher drives.

References
----------
.. [1] M. M. Zarrar, Q. Weng, B. Yerjan, A. Soyyigit and H. Yun, "TinyLidarNet: 2D LiDAR-based
   end-to-end deep learning model for F1TENTH autonomous racing", 2024, arXiv:2410.07447.
.. [2] Z. Qiao, H. Li, Z. Cao and H. X. Liu, "End2Race: Efficient end-to-end imitation learning for
   real-time F1Tenth racing", 2025, arXiv:2509.16894.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat
from pcs_racing.base.compilation import compiled, kernel
from pcs_racing.base.dense import dense_forward, flat_layers
from pcs_racing.base.elementary import hyperbolic_tangent, sine_cosine
from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar import Beams
from pcs_racing.planners import view as _view
from pcs_racing.planners.field import lidar_ppo as _ppo
from pcs_racing.planners.field import residual as _residual
from pcs_racing.planners.line_following import lane_step, speed_scale
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.scanning import FIELD_OF_VIEW, MAX_RANGE, WORK, scan_beams, sine_tables
from pcs_racing.planners.trained import PLANNER_FORMAT
from pcs_racing.planners.view import PATH_POINTS

# Dense layers on parts of the input; both kernels take a layer's numbers in the order of
# `DenseLayers.flat`.


@kernel
def convolve(flat, sizes, step, x, y):
    """Pass windows of ``x`` through a dense layer and a ReLU, one after the other into ``y``.

    Parameters
    ----------
    flat : ndarray
        Numbers of the layer.
    sizes : ndarray, shape (2,)
        Inputs of a window (positions times channels), and its outputs (channels).
    step : int
        Numbers from one window to the next.
    x : ndarray
        Inputs, position after position, with all channels of a position next to each other.
    y : ndarray
        Outputs, one position for each window.
    """
    width = sizes[1]
    for k in range(y.shape[0] // width):
        out = y[k * width : (k + 1) * width]
        dense_forward(flat, sizes, x[k * step :], out, False)
        for j in range(width):
            out[j] = max(out[j], 0.0)


@kernel
def recur(flat, inputs, units, x, state, work):
    """Advance the state of gated recurrent units (``units``,) by the inputs ``x``.

    ``flat`` holds the layer from the inputs to the reset, update and new gates, then the layer from
    the state to the gates; ``work`` holds 6 times as many numbers as there are units.
    """
    gates = 3 * units
    from_inputs, from_state = work[:gates], work[gates : 2 * gates]
    dense_forward(flat, (inputs, gates), x, from_inputs, False)
    dense_forward(flat[(inputs + 1) * gates :], (units, gates), state, from_state, False)
    for k in range(units):
        reset = 0.5 + 0.5 * hyperbolic_tangent(0.5 * (from_inputs[k] + from_state[k]))
        keep = 0.5 + 0.5 * hyperbolic_tangent(
            0.5 * (from_inputs[units + k] + from_state[units + k])
        )
        new = hyperbolic_tangent(from_inputs[2 * units + k] + reset * from_state[2 * units + k])
        state[k] = new + keep * (state[k] - new)


BEAMS = 135
SEEN = BEAMS + 4  # inputs: beams from right to left; speed, yaw rate, steering, speed scale
OUTPUTS = 4  # slope and bend of the path, speeds nearby and farther on
NEAR, FAR = 3, 7  # path points with these speeds
SLOWEST = 0.5  # m/s
KINDS, MAX_WEIGHT = ("weight", "bias"), 100.0
_STEP = FIELD_OF_VIEW / (BEAMS - 1)
_ANGLES = np.linspace(-0.5 * FIELD_OF_VIEW, 0.5 * FIELD_OF_VIEW, BEAMS)
_SIN, _COS = sine_tables(_ANGLES)

UNITS = 48  # units of the recurrent network
LAYERS = {
    # Three convolutions (positions times channels, channels), a hidden layer, the outputs.
    "cnn": ((7, 8), (5 * 8, 12), (4 * 12, 16), (9 * 16 + 4, 32), (32, OUTPUTS)),
    # Layers from the inputs and from the state to the gates, the outputs.
    "gru": ((SEEN, 3 * UNITS), (UNITS, 3 * UNITS), (UNITS, OUTPUTS)),
    "residual": _residual.LAYERS,
    "ppo": _ppo.LAYERS,
}
"""Numbers of inputs and outputs of the layers of each network."""
COMMANDING = {"residual": _residual, "ppo": _ppo}
"""Networks that put out a command, with the modules of their planners."""
MEMORY = {"cnn": 0, "gru": UNITS, "residual": 0, "ppo": _ppo.MEMORY}
SCANNED = {"cnn": BEAMS, "gru": BEAMS, "residual": _residual.BEAMS, "ppo": _ppo.BEAMS}
SCRATCH = 800  # numbers of working memory of a network

PARAMETERS = (
    Parameter(
        "pace",
        0.0,
        1.0,
        0.0,
        "speed scale between the slowest (0) and fastest (1) of the race's speed range",
    ),
    Parameter("speed_share", 0.6, 1.1, 0.85, "factor of the speed that the network puts out"),
)
VARIANTS = {"calm": {"speed_share": 0.8}, "fast": {"speed_share": 0.95}}

LIDAR_FORMAT = ArtifactFormat(
    "lidar driver",
    ("name", "network", "beams", "training", "weights_sha256"),
    "save_lidar_planner",
    data_file=PLANNER_FORMAT.data_file,
    digest_key="weights_sha256",
    max_bytes=PLANNER_FORMAT.max_bytes,
    shipped=PLANNER_FORMAT.shipped,
)


@compiled
def observe(track, view, pace, work, seen):
    """Write the inputs of the network, all of order one, into ``seen``, shape (SEEN,)."""
    beams = Beams(_ANGLES[0], _STEP, MAX_RANGE, _COS, _SIN)
    scan_beams(track, beams, view, view[_view.OWN_PSI], work, seen[:BEAMS])
    for k in range(BEAMS):
        # The root resolves near ranges without losing far ones.
        seen[k] = 2.0 * np.sqrt(seen[k] / MAX_RANGE) - 1.0
    seen[BEAMS] = view[_view.OWN_V] / 8.0
    seen[BEAMS + 1] = view[_view.OWN_PSI_DOT] / 4.0
    seen[BEAMS + 2] = view[_view.OWN_DELTA] / view[_view.STEER_MAX]
    seen[BEAMS + 3] = 4.0 * (speed_scale(view, pace) - 1.0)


@compiled
def answer_cnn(flat, seen, state, work):
    """Evaluate the convolutional network; the outputs are at the beginning of ``work``."""
    features, first, second = work[:148], work[148:492], work[492:732]
    convolve(flat, (7, 8), 3, seen, first)
    convolve(flat[64:], (40, 12), 16, first, second)
    convolve(flat[556:], (48, 16), 24, second, features[:144])
    for k in range(SEEN - BEAMS):
        features[144 + k] = seen[BEAMS + k]
    dense_forward(flat[1340:], (148, 32, OUTPUTS), features, first, False)


@compiled
def answer_gru(flat, seen, state, work):
    """Advance the recurrent network; the outputs are at the beginning of ``work``."""
    recur(flat, SEEN, UNITS, seen, state, work)
    last = 3 * UNITS * (SEEN + UNITS + 2)
    dense_forward(flat[last:], (UNITS, OUTPUTS), state, work, False)


ANSWERS = {"cnn": answer_cnn, "gru": answer_gru}


@compiled
def lay_path(view, outputs, share, path):
    """Write the path and the speeds of the network's outputs."""
    sine, cosine = sine_cosine(view[_view.OWN_PSI])
    slope, bend = 0.1 * outputs[0], 0.1 * outputs[1]
    near, far = 6.0 + 2.0 * outputs[2], 6.0 + 2.0 * outputs[3]
    for j in range(PATH_POINTS):
        x = j * lane_step(view)
        y = (slope + bend * x) * x
        path[j, _view.PATH_X] = view[_view.OWN_X] + x * cosine - y * sine
        path[j, _view.PATH_Y] = view[_view.OWN_Y] + x * sine + y * cosine
        path[j, _view.PATH_SPEED] = max(
            share * (near + (far - near) * (j - NEAR) / (FAR - NEAR)), SLOWEST
        )
        steep = 1.0 + (slope + 2.0 * bend * x) ** 2
        path[j, _view.PATH_KAPPA] = 2.0 * bend / (steep * np.sqrt(steep))


@cache
def _plan(network: str, frozen: bytes) -> Any:
    """Compile a network with its weights as constants of the code."""
    answer, constant = ANSWERS[network], np.frombuffer(frozen, np.float64)

    @compiled
    def plan(track, theta, view, memory, scratch, path):
        seen, work = scratch[WORK : WORK + SEEN], scratch[WORK + SEEN :]
        observe(track, view, theta[0], scratch[:WORK], seen)
        answer(constant, seen, memory, work)
        lay_path(view, work, theta[1], path)

    return plan


def save_lidar_planner(
    folder: str | Path,
    network: str,
    layers: Sequence[Any],
    *,
    name: str,
    training: Mapping[str, Any],
) -> Path:
    """Save a lidar planner in a folder, created if missing.

    ``network`` is one of :data:`LAYERS`, ``layers`` are weight (out, in) and bias (out,) of each of
    its layers, and ``training`` describes the training: texts and numbers by name.
    """
    pairs = enumerate(layers)
    tensors = {
        f"layers.{i}.{kind}": a for i, pair in pairs for kind, a in zip(KINDS, pair, strict=True)
    }
    content = save_tensors(
        {key: np.ascontiguousarray(value, np.float32) for key, value in tensors.items()}
    )
    _flat(Path(folder), network, content)
    fields = {
        "name": name,
        "network": network,
        "beams": SCANNED[network],
        "training": dict(training),
    }
    return LIDAR_FORMAT.save(folder, fields, content)


def flat_weights(layers: Iterable[Any]) -> NDArray[np.float64]:
    """Return all numbers of layers (weight, bias) as one vector for the compiled networks."""
    return flat_layers(layers).astype(np.float64)


def _flat(folder: Path, network: Any, content: bytes) -> NDArray[np.float64]:
    if not isinstance(network, str) or network not in LAYERS:
        raise InputError(f"{folder}: network is {network!r}; it must be one of {', '.join(LAYERS)}")
    try:
        tensors = load_tensors(content)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder}: the weights are no safetensors file of numbers: {error}"
        ) from None
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (below, above) in enumerate(LAYERS[network]):
        shapes |= {f"layers.{i}.weight": (above, below), f"layers.{i}.bias": (above,)}
    found = {key: tensor.shape for key, tensor in tensors.items()}
    if found != shapes or not all(
        t.dtype == np.float32 and (np.abs(t) <= MAX_WEIGHT).all() for t in tensors.values()
    ):
        raise InputError(
            f"{folder}: a network {network!r} has float32 weights within {MAX_WEIGHT:g} of the"
            f" shapes {shapes}"
        )
    return flat_weights(
        [
            (tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"])
            for i in range(len(shapes) // 2)
        ]
    )


def read_lidar_planner(source: str | Path) -> tuple[str, str, NDArray[np.float64]]:
    """Return name, network and weights of a lidar planner, from its shipped name or its folder."""
    folder = LIDAR_FORMAT.find(source)
    fields, content = LIDAR_FORMAT.load(folder)
    flat, beams = _flat(folder, fields["network"], content), SCANNED[fields["network"]]
    if (
        not isinstance(fields["name"], str)
        or fields["beams"] != beams
        or not isinstance(fields["training"], dict)
    ):
        raise InputError(
            f"{folder / MANIFEST}: name must be a text, beams {beams} and training a mapping"
        )
    return fields["name"], fields["network"], flat


def load_lidar_planner(source: str | Path) -> Planner:
    """Return a lidar planner; source and errors as for :func:`read_lidar_planner`."""
    name, network, flat = read_lidar_planner(source)
    if network in COMMANDING:
        own: Any = COMMANDING[network]
        plan, parameters, variants = own.frozen_plan(flat.tobytes()), own.PARAMETERS, own.VARIANTS
        scratch = own.SCRATCH
    else:
        plan, parameters, variants = _plan(network, flat.tobytes()), PARAMETERS, VARIANTS
        scratch = WORK + SEEN + SCRATCH
    return Planner(
        name=name,
        parameters=parameters,
        plan=plan,
        memory_size=MEMORY[network],
        scratch_size=scratch,
        variants=variants,
    )


def __getattr__(name: str) -> Any:
    """Return ``LIDAR_CNN``, ``LIDAR_GRU``, ``LIDAR_PPO`` or ``RESIDUAL``, loaded at first use."""
    if name not in ("LIDAR_CNN", "LIDAR_GRU", "LIDAR_PPO", "RESIDUAL"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = load_lidar_planner(name.lower().replace("_", "-"))
    return globals()[name]
