"""ONNX files of networks: a builder of graphs, and the description of a file.

A file describes itself in its metadata :data:`METADATA` (JSON): ``name``, ``period`` (time between
decisions, s), ``inputs`` and ``outputs`` (elements in order, with units), and ``state``: inputs
that are the named outputs of the last decision, zeros at first. Angles are positive to the left.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import require
from pcs_racing.base.files import write_atomically

METADATA = "pcs_racing"
"""Key of the description (JSON) in the metadata of a file."""

OPSET, IR_VERSION = 17, 8  # of ONNX 1.12, for runtimes since 2022


class OnnxGraph:
    """Builder of a graph from inputs to outputs, both with a batch axis.

    A method adds nodes and returns the name of their result. Arrays become float32 constants.
    """

    def __init__(self) -> None:
        require("onnx", extra="onnx")
        import onnx.helper
        import onnx.numpy_helper

        self._onnx: Any = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self._ends: dict[str, list[Any]] = {"inputs": [], "outputs": []}

    def add(self, kind: str, *inputs: str | ArrayLike, name: str = "", **attributes: Any) -> str:
        """Add a node of an operator (``Add``), and return the name of its result."""
        names = [one if isinstance(one, str) else self.constant(one) for one in inputs]
        name = name or f"{kind.lower()}_{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(kind, names, [name], **attributes))
        return name

    def constant(self, values: ArrayLike, kind: type[np.generic] = np.float32) -> str:
        """Add a constant array."""
        name = f"constant_{len(self._constants)}"
        array = np.asarray(values, kind)
        self._constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def end(self, side: str, name: str, *shape: int, kind: type[np.generic] = np.float32) -> str:
        """Declare an input or an output (``side``) with the shape of one row of the batch."""
        element = self._onnx.helper.np_dtype_to_tensor_dtype(np.dtype(kind))
        value = self._onnx.helper.make_tensor_value_info(name, element, ["N", *shape])
        self._ends[side].append(value)
        return name

    def slice(self, x: str, first: int, end: int) -> str:
        """Add the elements from ``first`` to the one before ``end``, along the axis after N."""
        ends = [self.constant([one], np.int64) for one in (first, end, 1)]
        return self.add("Slice", x, *ends)

    def unsqueeze(self, x: str, axis: int) -> str:
        """Add an axis of length 1."""
        return self.add("Unsqueeze", x, self.constant([axis], np.int64))

    def standardize(self, x: str, mean: ArrayLike, spread: ArrayLike, clip: float) -> str:
        """Add ``(x - mean) / spread`` within ``clip``, computed in float64."""
        double, single = self._onnx.TensorProto.DOUBLE, self._onnx.TensorProto.FLOAT
        x = self.add("Sub", self.add("Cast", x, to=double), self.constant(mean, np.float64))
        x = self.add("Div", x, self.constant(spread, np.float64))
        limits = [self.constant(one, np.float64) for one in (-clip, clip)]
        return self.add("Cast", self.add("Clip", x, *limits), to=single)

    def dense(self, x: str, weight: ArrayLike, bias: ArrayLike) -> str:
        """Add a fully connected layer with weights of shape (outputs, inputs)."""
        return self.add("Gemm", x, weight, bias, transB=1)

    def layers(self, x: str, layers: DenseLayers, hidden: str, last: str | None = None) -> str:
        """Add layers with an activation function between them, and one after the last, if any."""
        pairs = list(zip(layers.weights, layers.biases, strict=True))
        for pair in pairs[:-1]:
            x = self.add(hidden, self.dense(x, *pair))
        x = self.dense(x, *pairs[-1])
        return x if last is None else self.add(last, x)

    def choose(self, values: str, name: str) -> None:
        """Add an output: the index of the max value of each row."""
        chosen = self.end("outputs", name, kind=np.int64)
        self.add("ArgMax", values, name=chosen, axis=1, keepdims=0)

    def write(self, path: Path, about: Mapping[str, Any]) -> Path:
        """Write the file, with a description, and return its path."""
        helper = self._onnx.helper
        graph = helper.make_graph(
            self._nodes,
            METADATA,
            *(self._ends[side] for side in ("inputs", "outputs")),
            initializer=self._constants,
        )
        opset = helper.make_opsetid("", OPSET)
        model = helper.make_model(graph, opset_imports=[opset], producer_name="pcs-racing")
        model.ir_version = IR_VERSION
        helper.set_model_props(model, {METADATA: json.dumps(about)})
        self._onnx.checker.check_model(model, full_check=True)
        write_atomically(path, model.SerializeToString())
        return path


Exported = tuple[OnnxGraph, dict[str, Any]]
"""Graph of a file, and its description."""


def described(
    name: str, period: float | None, inputs: Any, outputs: Any, **more: Any
) -> dict[str, Any]:
    """Return the description of a file."""
    return {"name": name, "period": period, "inputs": inputs, "outputs": outputs, **more}
