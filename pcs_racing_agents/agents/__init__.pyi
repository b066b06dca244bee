from . import observing as observing
from .agent import Agent as Agent
from .agent import Competitor as Competitor
from .agent import Driver as Driver
from .agent import Strategy as Strategy
from .agent import as_agent as as_agent
from .fits import save_fit as save_fit
from .from_torch import TorchPolicy as TorchPolicy
from .game_spec import GameSpec as GameSpec
from .game_spec import make_game_spec as make_game_spec
from .hub import load_from_hub as load_from_hub
from .hub import write_model_card as write_model_card
from .onnx_export import export_onnx as export_onnx
from .sb3_files import load_model as load_model
from .sb3_files import save_model as save_model
from .zoo import Entry as Entry
from .zoo import make as make
from .zoo import names as names
from .zoo import parse_agent as parse_agent
from .zoo import register_agent as register_agent

__all__ = [
    "Agent",
    "Competitor",
    "Driver",
    "Entry",
    "GameSpec",
    "Strategy",
    "TorchPolicy",
    "as_agent",
    "export_onnx",
    "load_from_hub",
    "load_model",
    "make",
    "make_game_spec",
    "names",
    "observing",
    "parse_agent",
    "register_agent",
    "save_fit",
    "save_model",
    "write_model_card",
]
