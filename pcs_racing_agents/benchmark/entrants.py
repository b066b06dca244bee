"""Agents that are brought to the benchmark: a zoo name, a function, a file of Stable-Baselines3, a driver's folder."""

import importlib
import sys
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import is_model
from pcs_racing.planners.trained import load_driver
from pcs_racing_agents.agents.agent import Competitor, as_competitor
from pcs_racing_agents.agents.sb3_files import load_sb3_policy
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.agents.zoo import parse_agent


def load_entrant(
    text: str, setting: Setting, *, drive: bool = False, weights: Path | None = None, name: str | None = None
) -> Competitor:
    """Return the competitor that a text names.

    Parameters
    ----------
    text : str
        One of these: a name of the zoo, with options if it has any; ``module:function``, a function of the setting (and
        of the path of the weights, if there is one) that returns a competitor; the path of a ``.zip`` file of
        Stable-Baselines3, of which only numbers are read; with ``drive``, the folder of a driver at control level. A
        module is looked for in the working directory as well.
    drive : bool
        Whether the text is the name or the folder of a driver (:func:`pcs_racing.planners.trained.load_driver`).
    weights : path, optional
        File that is handed to the function.
    name : str, optional
        Name on the card, in place of its own.
    """
    module, separator, function = text.partition(":")
    if drive:
        planner = load_driver(Path(text) if Path(text).is_dir() else text)
        return as_competitor(planner.policy({}), name or planner.name)
    # One that drives has the arguments of its environment beside it, and is read below.
    if is_model(text) and not Path(text).with_suffix(".yaml").is_file():
        return as_competitor(load_sb3_policy(Path(text)), name or Path(text).stem)
    here = str(Path.cwd())
    if here not in sys.path:
        # As with "python -m", but at the end, so that a file here hides no installed package.
        sys.path.append(here)
    # "name:option=value" is an agent of the zoo; a module is only what can be found.
    if weights is not None or (separator and "=" not in function and _is_module(module)):
        return as_competitor(_call(module, function, setting, weights), name or function)
    return as_competitor(parse_agent(text, setting), name)


def _is_module(name: str) -> bool:
    try:
        return name.replace(".", "").isidentifier() and importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False


def _call(module: str, function: str, setting: Setting, weights: Path | None) -> Any:
    """Return what the function of a module makes."""
    if weights is not None and not weights.is_file():
        raise InputError(f"there is no file of weights {weights}")
    try:
        build = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"can't find {module}:{function} ({error}); give module:function, where the module can be imported"
        ) from None
    return build(setting) if weights is None else build(setting, weights)
