"""Write the JSON schema of each kind of configuration, from which editors complete and check YAML
files.

python dev/tools/write_schemas.py
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pcs_racing_agents
from pcs_racing.base.settings import DIFFERENT, Settings, options_of
from pcs_racing.race.config import PRESETS, RaceConfig
from pcs_racing_agents.learning.ppo.settings import DuelSettings
from pcs_racing_agents.learning.psro import PSROSettings
from pcs_racing_agents.learning.responses.learner import ResponseSettings
from pcs_racing_agents.learning.self_play import SelfPlaySettings
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.policies.config import SELECTIONS
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.tournament.protocol import ProtocolConfig

FOLDER = Path(pcs_racing_agents.__file__).parent / "data" / "schemas"
KINDS: dict[str, type[Settings]] = {
    "ppo": DuelSettings,
    "protocol": ProtocolConfig,
    "psro": PSROSettings,
    "race": RaceConfig,
    "response": ResponseSettings,
    "self-play": SelfPlaySettings,
    "study": StudyConfig,
    "train": TrainSettings,
}


def schema_of(cls: type[Settings], **more: Any) -> dict[str, Any]:
    """Return the schema of a file of settings; ``more`` are keys beside the options."""
    properties = {}
    for name, option in options_of(cls).items():
        kind = option.kind
        nested = isinstance(kind, type) and issubclass(kind, Settings)
        schema = schema_of(kind) if nested else option.adapter.json_schema()
        # editors would refuse 0.3, which is no multiple of 0.1 in floating point
        schema.pop("multipleOf", None)
        if DIFFERENT in option.notes:
            schema["uniqueItems"] = True
        if kind is RaceConfig:
            schema = {"anyOf": [{"type": "string"}, schema]}
        if option.default is None:
            schema = {"anyOf": [schema, {"type": "null"}]}
        properties[name] = {**schema, "description": option.meaning}
        if not nested or option.default is None:
            is_mapping = isinstance(option.default, Mapping)
            properties[name]["default"] = dict(option.default) if is_mapping else option.default
    return {"type": "object", "additionalProperties": False, "properties": {**properties, **more}}


def schemas() -> dict[str, str]:
    """Return the text of each schema by its kind."""
    made = {kind: schema_of(cls) for kind, cls in KINDS.items()}
    preset = {
        "enum": list(PRESETS),
        "description": "Rules that give the defaults.",
        "default": "paper",
    }
    made["race"]["properties"]["preset"] = preset
    front, spread = (schema_of(type(config)) for config in SELECTIONS.values())
    made["archive"] = {"anyOf": [front, {**spread, "required": ["selection"]}]}
    first = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return {
        kind: json.dumps({**first, "title": kind, **schema}, indent=1) + "\n"
        for kind, schema in made.items()
    }


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for kind, text in schemas().items():
        (FOLDER / f"{kind}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
