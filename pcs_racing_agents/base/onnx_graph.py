"""ONNX files of networks: a builder of graphs from arithmetic, with a description of the file.

A file describes itself in its metadata :data:`METADATA` (JSON): ``name``, ``period`` (time between
decisions, s), ``inputs`` and ``outputs`` (elements in order, with units), and ``state``: inputs
that are the named outputs of the last decision, zeros at first. Angles are positive to the left.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import require
from pcs_racing.base.files import write_atomically

METADATA = "pcs_racing"
"""Key of the description in the metadata of a file."""

OPSET, IR_VERSION = 17, 8  # of ONNX 1.12, for runtimes since 2022


@dataclass(frozen=True)
class Value:
    """Result of a node; arithmetic with it adds nodes, and constants of float32."""

    graph: "OnnxGraph"
    name: str

    def __add__(self, other: "Operand") -> "Value":
        return self.graph.add("Add", self, other)

    def __sub__(self, other: "Operand") -> "Value":
        return self.graph.add("Sub", self, other)

    def __mul__(self, other: "Operand") -> "Value":
        return self.graph.add("Mul", self, other)

    def __truediv__(self, other: "Operand") -> "Value":
        return self.graph.add("Div", self, other)

    def __getitem__(self, part: slice) -> "Value":
        """Return a part of each row: elements along the axis after N."""
        ends = (self.graph.constant([one], np.int64) for one in (part.start, part.stop, 1))
        return self.graph.add("Slice", self, *ends)

    def clip(self, low: "Operand", high: "Operand") -> "Value":
        """Return the value within limits, numbers or arrays."""
        return self.graph.add("Min", self.graph.add("Max", self, low), high)

    def unsqueeze(self, axis: int) -> "Value":
        """Return the value with another axis of length 1."""
        return self.graph.add("Unsqueeze", self, self.graph.constant([axis], np.int64))


Operand = Value | ArrayLike
"""Input of a node: a value, or the numbers of a constant."""


class OnnxGraph:
    """Graph from inputs to outputs, both with a batch axis N first, and its description."""

    def __init__(self, name: str, period: float | None) -> None:
        require("onnx", extra="onnx")
        import onnx.helper
        import onnx.numpy_helper

        self._onnx: Any = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self._ends: dict[str, list[Any]] = {"inputs": [], "outputs": []}
        #: Description of the file.
        self.about: dict[str, Any] = {"name": name, "period": period, "inputs": {}, "outputs": {}}

    def add(self, kind: str, *inputs: Operand, name: str = "", **attributes: Any) -> Value:
        """Add a node of an operator (``Add``), and return its result."""
        names = [(one if isinstance(one, Value) else self.constant(one)).name for one in inputs]
        name = name or f"{kind.lower()}_{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(kind, names, [name], **attributes))
        return Value(self, name)

    def constant(self, values: ArrayLike, kind: type[np.generic] = np.float32) -> Value:
        """Add a constant array."""
        name, array = f"constant_{len(self._constants)}", np.asarray(values, kind)
        self._constants.append(self._onnx.numpy_helper.from_array(array, name))
        return Value(self, name)

    def _end(self, side: str, name: str, shape: tuple[int, ...], kind: type[np.generic]) -> None:
        element = self._onnx.helper.np_dtype_to_tensor_dtype(np.dtype(kind))
        ends = self._onnx.helper.make_tensor_value_info(name, element, ["N", *shape])
        self._ends[side].append(ends)

    def input(self, name: str, *shape: int, about: Any = None) -> Value:
        """Add an input with the shape of a row; an input without description is a state."""
        self._end("inputs", name, shape, np.float32)
        if about is not None:
            self.about["inputs"][name] = about
        return Value(self, name)

    def output(self, name: str, value: Value, *shape: int, about: Any = None) -> None:
        """Add an output with the shape of a row."""
        self._end("outputs", name, shape, np.float32)
        self.add("Identity", value, name=name)
        if about is not None:
            self.about["outputs"][name] = about

    def choose(self, name: str, values: Value) -> None:
        """Add an output: the index of the max value of each row."""
        self._end("outputs", name, (), np.int64)
        self.add("ArgMax", values, name=name, axis=1, keepdims=0)
        self.about["outputs"][name] = "index of the max value"

    def standardize(self, x: Value, mean: ArrayLike, spread: ArrayLike, clip: float) -> Value:
        """Return ``(x - mean) / spread`` within ``clip``, computed in float64."""
        kinds = self._onnx.TensorProto
        ends = (self.constant(one, np.float64) for one in (mean, spread, -clip, clip))
        middle, unit, low, high = ends
        x = (self.add("Cast", x, to=kinds.DOUBLE) - middle) / unit
        return self.add("Cast", x.clip(low, high), to=kinds.FLOAT)

    def dense(self, x: Value, weight: ArrayLike, bias: ArrayLike) -> Value:
        """Return the outputs of a fully connected layer with weights of shape (outputs, inputs)."""
        return self.add("Gemm", x, weight, bias, transB=1)

    def layers(self, x: Value, layers: DenseLayers, hidden: str, last: str = "Identity") -> Value:
        """Return the outputs of layers with an activation function after each."""
        kinds = [hidden] * len(layers.hidden) + [last]
        for kind, weight, bias in zip(kinds, layers.weights, layers.biases, strict=True):
            x = self.add(kind, self.dense(x, weight, bias))
        return x

    def write(self, path: Path) -> Path:
        """Write the file, and return its path."""
        helper = self._onnx.helper
        ends = self._ends["inputs"], self._ends["outputs"]
        graph = helper.make_graph(self._nodes, METADATA, *ends, initializer=self._constants)
        opset = helper.make_opsetid("", OPSET)
        model = helper.make_model(graph, opset_imports=[opset], producer_name="pcs-racing")
        model.ir_version = IR_VERSION
        helper.set_model_props(model, {METADATA: json.dumps(self.about)})
        self._onnx.checker.check_model(model, full_check=True)
        write_atomically(path, model.SerializeToString())
        return path
