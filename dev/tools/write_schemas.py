"""Write the JSON schema of each kind of configuration, by which editors complete and check YAML
files.

python dev/tools/write_schemas.py
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Interval, Len, MinLen

import pcs_racing_agents
from pcs_racing.base.settings import DIFFERENT, OneOf, Settings, options_of, split
from pcs_racing.race.config import KNOWN_RULES, Rules
from pcs_racing_agents.learning.ppo import PPOSettings
from pcs_racing_agents.learning.responses import PSROSettings, ResponseSettings
from pcs_racing_agents.learning.self_play import SelfPlaySettings
from pcs_racing_agents.networks.training import TrainSettings
from pcs_racing_agents.policies.config import SELECTIONS
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.tournament.protocol import ProtocolConfig

TYPES = {bool: "boolean", float: "number", int: "integer", str: "string"}
FOLDER = Path(pcs_racing_agents.__file__).parent / "data" / "schemas"
KINDS: dict[str, type[Settings]] = {
    "ppo": PPOSettings,
    "protocol": ProtocolConfig,
    "psro": PSROSettings,
    "response": ResponseSettings,
    "rules": Rules,
    "self-play": SelfPlaySettings,
    "study": StudyConfig,
    "train": TrainSettings,
}

BASE = {
    "enum": list(KNOWN_RULES),
    "description": "Rules that give the defaults.",
    "default": "paper",
}
"""Schema of the key ``rules`` of rules."""


def schema_of_kind(kind: Any, notes: Iterable[Any]) -> dict[str, Any]:
    """Return the schema of the values of a type with notes."""
    origin, inner = get_origin(kind), get_args(kind)
    schema: dict[str, Any] = {"type": TYPES[kind]} if kind in TYPES else {}
    if origin is Literal:
        schema = {"type": "string", "enum": list(inner)}
    elif origin in (Union, UnionType):
        schema = {
            "anyOf": [
                schema_of_kind(*split(one)) for one in inner if one in TYPES or get_origin(one)
            ]
        }
    elif origin is Mapping:
        schema = {"type": "object", "additionalProperties": schema_of_kind(*split(inner[1]))}
    elif origin is tuple:
        schema = {"type": "array", "items": schema_of_kind(*split(inner[0]))}
        if inner[-1] is not Ellipsis:
            schema |= {"minItems": len(inner), "maxItems": len(inner)}
    for note in notes:
        # multiples are left out: editors would refuse 0.3, no multiple of 0.1 in floating point
        if isinstance(note, OneOf):
            schema["enum"] = list(note.names)
        elif isinstance(note, Interval):
            schema |= {"minimum": note.ge, "maximum": note.le}
        elif isinstance(note, MinLen | Len):
            noun = {"string": "Length", "array": "Items", "object": "Properties"}[schema["type"]]
            schema[f"min{noun}"] = note.min_length
            if getattr(note, "max_length", None) is not None:
                schema[f"max{noun}"] = note.max_length
        elif note is DIFFERENT:
            schema["uniqueItems"] = True
    return schema


def schema_of(cls: type[Settings], **more: Any) -> dict[str, Any]:
    """Return the schema of a file of settings; ``more`` are further keys."""
    properties = {}
    for name, option in options_of(cls).items():
        kind = option.kind
        nested = isinstance(kind, type) and issubclass(kind, Settings)
        schema = schema_of(kind) if nested else schema_of_kind(kind, option.notes)
        if kind is Rules:
            schema = {"anyOf": [{"type": "string"}, schema_of(kind, rules=BASE)]}
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
    made["rules"]["properties"]["rules"] = BASE
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
