"""ONNX files of networks: a graph in ONNX's own text, its constants, and a description.

A file describes itself in its metadata :data:`METADATA` (JSON): ``name``, ``period`` (time between
decisions, s), ``inputs`` and ``outputs`` (elements in order, with units), and ``state``: inputs
that are the named outputs of the last decision, zeros at first. Angles are positive to the left.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError, require
from pcs_racing.base.files import write_atomically

METADATA = "pcs_racing"
"""Key of the description in the metadata of a file."""

OPSET, IR_VERSION = 17, 8  # versions of ONNX 1.12, for runtimes since 2022
Constants = dict[str, NDArray[Any]]
Step = tuple[Any, ...]
"""Operator with its attributes, and its inputs after the first: arrays of float32."""


@dataclass(frozen=True, eq=False)
class OnnxNetwork:
    """A network, and the answers of its own code to drawn inputs."""

    graph: str  #: Inputs, outputs and nodes in ONNX's text, with a batch axis N first.
    constants: Constants
    about: Mapping[str, Any]  #: Description of the file.
    drawn: Constants = field(default_factory=dict)  #: Drawn inputs.
    answers: Constants = field(default_factory=dict)  #: Outputs of the own code for these inputs.


def chain(x: str, y: str, steps: Iterable[Step]) -> tuple[str, Constants]:
    """Return nodes from value ``x`` to value ``y``, and their constants."""
    nodes: list[str] = []
    constants: Constants = {}
    for k, (operator, *others) in enumerate(steps):
        named = {f"{y}_{k}_{i}": np.asarray(one) for i, one in enumerate(others)}
        constants |= named
        nodes.append(f"{y}_{k} = {operator} ({', '.join([x, *named])})")
        x = f"{y}_{k}"
    return "\n".join([*nodes, f"{y} = Identity ({x})"]), constants


def layer_steps(layers: DenseLayers, hidden: str) -> list[Step]:
    """Return steps of layers with an activation function between them."""
    parts = zip(layers.weights, layers.biases, strict=True)
    return [step for w, b in parts for step in (("Gemm <transB = 1>", w, b), (hidden,))][:-1]


def write_onnx(network: OnnxNetwork, path: Path) -> Path:
    """Write a file, and return its path; a file with other answers than the own code is refused."""
    require("onnx", extra="onnx")
    import onnx.parser
    import onnx.reference

    head = f'<ir_version: {IR_VERSION}, opset_import: ["" : {OPSET}], producer_name: "pcs-racing">'
    model = onnx.parser.parse_model(f"{head}\n{METADATA} {network.graph}")
    model.graph.initializer.extend(
        onnx.numpy_helper.from_array(array, name) for name, array in network.constants.items()
    )
    onnx.helper.set_model_props(model, {METADATA: json.dumps(network.about)})
    onnx.checker.check_model(model, full_check=True)
    names = list(network.answers)
    found = onnx.reference.ReferenceEvaluator(model).run(names, network.drawn) if names else []
    for name, values in zip(names, found, strict=True):
        close = np.isclose(values, network.answers[name], rtol=1e-4, atol=1e-4)
        # A choice between equal values may differ.
        if close.mean() < (0.95 if values.dtype == np.int64 else 1.0):
            raise InputError(
                f"can't write {path}: the file would answer {name} otherwise than"
                f" {network.about['name']} itself in {1.0 - close.mean():.0%} of drawn observations"
            )
    write_atomically(path, model.SerializeToString())
    return path
