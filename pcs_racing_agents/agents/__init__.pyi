from . import observing as observing
from .agent import Agent as Agent, Strategy as Strategy
from .blind import save_fit as save_fit
from .from_torch import TorchPolicy as TorchPolicy
from .on_car import PolicyOnCar as PolicyOnCar
from .onnx_export import export_onnx as export_onnx
from .sb3_files import save_model as save_model
from .zoo import Entry as Entry, make as make, names as names, register_agent as register_agent

__all__ = [
    "Agent",
    "Entry",
    "PolicyOnCar",
    "Strategy",
    "TorchPolicy",
    "export_onnx",
    "make",
    "names",
    "observing",
    "register_agent",
    "save_fit",
    "save_model",
]
