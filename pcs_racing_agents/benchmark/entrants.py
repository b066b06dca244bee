"""Agents that are brought to the benchmark: a zoo name, a function, a file of Stable-Baselines3, a driver's folder."""

from pathlib import Path

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import is_model
from pcs_racing.planners.trained import load_driver
from pcs_racing_agents.agents.agent import Competitor, as_competitor
from pcs_racing_agents.agents.own_code import own_code
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
        One of these: what :func:`pcs_racing_agents.agents.parse_agent` takes; the path of a ``.zip`` file of
        Stable-Baselines3, of which only numbers are read; with ``weights``, ``module:function``, a function of the
        setting and of their path that returns a competitor; with ``drive``, the folder of a driver at control level.
    drive : bool
        Whether the text is the name or the folder of a driver (:func:`pcs_racing.planners.trained.load_driver`).
    weights : path, optional
        File that is handed to the function.
    name : str, optional
        Name on the card, in place of its own.
    """
    if drive:
        planner = load_driver(Path(text) if Path(text).is_dir() else text)
        return as_competitor(planner.policy({}), name or planner.name)
    # One that drives has the arguments of its environment beside it, and is read below.
    if is_model(text) and not Path(text).with_suffix(".yaml").is_file():
        return as_competitor(load_sb3_policy(Path(text)), name or Path(text).stem)
    if weights is None:
        return as_competitor(parse_agent(text, setting), name)
    if not weights.is_file():
        raise InputError(f"there is no file of weights {weights}")
    made = own_code(text, setting, weights)
    if made is None:
        raise InputError(f"can't find {text}; give module:function, where the module can be imported")
    return as_competitor(made, name or text.partition(":")[2])
