"""ONNX files of `pcs-racing export` as racers: models of steering and speed, and agents."""

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, require
from pcs_racing.base.files import read_limited
from pcs_racing.envs.models import model_policy
from pcs_racing.envs.origins import check_origin
from pcs_racing.game.players import model_agent
from pcs_racing.planners.racers import Racer, Reader, Request
from pcs_racing_agents.agents.sb3_files import MAX_BYTES
from pcs_racing_agents.base.onnx_file import METADATA


@dataclass(frozen=True, eq=False)
class OnnxModel:
    """A model of a file: commands of a car in rad and m/s, or moves."""

    name: str
    content: bytes  #: Bytes of the file.
    output: str  #: Name of the output: "command" or "move".

    @property
    def content_hash(self) -> str:
        """SHA-256 of the file."""
        return hashlib.sha256(self.content).hexdigest()

    @cached_property
    def _evaluator(self) -> Any:
        import onnx
        import onnx.reference

        return onnx.reference.ReferenceEvaluator(onnx.load_from_string(self.content))

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], None]:
        """Return the output for each observation; ignore the other arguments."""
        rows = np.asarray(observation, np.float32)
        return self._evaluator.run([self.output], {"observation": rows})[0], None


def read_onnx(request: Request) -> Racer | None:
    """Return the racer of an ONNX file."""
    text = request.text
    if not text.endswith(".onnx"):
        return None
    content = read_limited(Path(text), MAX_BYTES, "an ONNX file", InputError)
    require("onnx", extra="onnx")
    import onnx

    try:
        model = onnx.load_from_string(content)
        about = json.loads({one.key: one.value for one in model.metadata_props}[METADATA])
        origin = about["origin"]
    except Exception:  # damaged files raise many types of errors
        raise InputError(
            f"{text} is no ONNX file of a model of Drive or Duel, as 'pcs-racing export' writes it;"
            " the file of a planner needs its own program: race the planner by its name"
        ) from None
    values = check_origin(origin, text)
    if values["environment"] == "duel":
        game = values.get("game")
        return model_agent(OnnxModel(text, content, "move"), text, game, request.asked_game)
    command = OnnxModel(text, content, "command")
    return model_policy(command, name=text, **{**values, "normalized": False})


ONNX = Reader(read_onnx)
