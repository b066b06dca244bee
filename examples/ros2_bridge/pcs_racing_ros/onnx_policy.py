"""Run a file of ``pcs-racing export`` with numpy and onnxruntime alone.

    python onnx_policy.py lidar-ppo.onnx --hz 100

prints the inputs and the outputs of the file, and the delay of a decision on this computer.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime


def number(file: str, about: dict[str, Any], name: str, low: float, high: float) -> float:
    """Return a number of a file's description, within a range."""
    value = about.get(name)
    if type(value) not in (int, float) or not low <= value <= high:  # NaN, too
        raise ValueError(
            f"{file} has {name} {value!r}; it must be a number from {low:g} to {high:g}"
        )
    return float(value)


class OnnxPolicy:
    """Network of a file, with the state from decision to decision, if the network has one."""

    def __init__(self, file: str) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # a small network gains nothing from threads
        if not Path(file).is_file():
            raise ValueError(f"there is no file {file}")
        try:
            self.session = onnxruntime.InferenceSession(file, options, ["CPUExecutionProvider"])
        except Exception as error:  # the exceptions of onnxruntime have no other base
            raise ValueError(f"{file} is no ONNX file: {' '.join(str(error).split())}") from error
        metadata = self.session.get_modelmeta().custom_metadata_map
        try:
            #: Description: name, period (s), inputs and outputs with their units, state.
            self.about = json.loads(metadata["pcs_racing"])
            #: Inputs that are outputs of the last decision.
            self.kept = dict(self.about.get("state", {}))
            named = {*self.about["inputs"], *self.kept}, {"name", "outputs", "period"}
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise ValueError(f"{file} was not written by pcs-racing export") from error
        self.shapes = {one.name: (1, *one.shape[1:]) for one in self.session.get_inputs()}
        outputs = {one.name for one in self.session.get_outputs()}
        if (
            named[0] != self.shapes.keys()
            or not named[1] <= self.about.keys()
            or not outputs >= {*self.about["outputs"], *self.kept.values()}
            or not all(isinstance(size, int) for shape in self.shapes.values() for size in shape)
        ):
            raise ValueError(
                f"{file} has inputs {', '.join(self.shapes)} and outputs {', '.join(outputs)}; its"
                " description has others: export it again"
            )
        if self.about["period"] is not None:
            number(file, self.about, "period", 0.001, 60.0)
        self.reset()

    def reset(self) -> None:
        """Forget all decisions."""
        self.state = {name: np.zeros(self.shapes[name], np.float32) for name in self.kept}

    def decide(self, **inputs: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs by name for one observation, and keep the state."""
        rows = {k: np.asarray(v, np.float32).reshape(self.shapes[k]) for k, v in inputs.items()}
        names = [one.name for one in self.session.get_outputs()]
        outputs = dict(zip(names, self.session.run(names, {**rows, **self.state}), strict=True))
        self.state = {name: outputs.pop(source) for name, source in self.kept.items()}
        return {name: values[0] for name, values in outputs.items()}


def positive(text: str) -> float:
    """Return a number above 0 and at most 10000."""
    if not 0.0 < float(text) <= 10000.0:  # NaN, too
        raise argparse.ArgumentTypeError(f"{text} is not above 0 and at most 10000")
    return float(text)


def main() -> None:
    parser = argparse.ArgumentParser(description="run a file of pcs-racing export")
    parser.add_argument("file")
    parser.add_argument("--hz", type=positive, default=50.0, help="commands a second")
    parser.add_argument("--seconds", type=positive, default=2.0)
    arguments = parser.parse_args()
    try:
        policy = OnnxPolicy(arguments.file)
    except ValueError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")
    print(json.dumps({key: policy.about[key] for key in ("name", "period", "outputs")}))
    rng, delays, due, begin = np.random.default_rng(0), [], 0.0, time.perf_counter()
    for k in range(max(1, round(arguments.hz * arguments.seconds))):
        time.sleep(max(0.0, begin + k / arguments.hz - time.perf_counter()))
        if k / arguments.hz >= due - 1e-9:  # between decisions the last outputs hold
            measured = {name: rng.random(policy.shapes[name]) for name in policy.about["inputs"]}
            asked = time.perf_counter()  # above: your sensors in place of random numbers
            outputs = policy.decide(**measured)
            delays.append(1e3 * (time.perf_counter() - asked))
            due += policy.about["period"] or 0.0
    print({name: values.tolist() for name, values in outputs.items()})
    median, late = np.percentile(delays, [50, 99])
    print(f"{len(delays)} decisions: {median:.3f} ms (median), {late:.3f} ms (99 %)")


if __name__ == "__main__":
    main()
