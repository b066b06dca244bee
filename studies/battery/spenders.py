"""The population of opponents: fixed ways of spending, for each type of energy."""

import numpy as np

from studies.battery.model import Model, effective, public_equilibrium
from studies.battery.rules import BOOST, CHARGE, GAPS, HOLD, MIDDLES, Floats, Rules

SPENDERS = ("early", "late", "spread", "behind", "ahead", "equilibrium")
CHARGES_FROM = 5.0  # m of lead, from which on a spender charges
SLIP = 0.02  # probability of another move, in the beliefs about spenders


def spend(rules: Rules, full: int, name: str) -> Floats:
    """Return the table of moves of a spender other than "equilibrium"."""
    step = np.arange(rules.steps)[:, None, None]
    gap, left = MIDDLES[:, None], np.arange(full + 1)
    wanted = {
        "early": step >= 0,
        "late": step >= rules.steps - full // rules.cost,
        "spread": left * rules.steps >= (rules.steps - step) * full,
        "behind": gap < 0.0,
        "ahead": gap > 0.0,
    }[name]
    boosts = np.broadcast_to(wanted, (rules.steps, GAPS, full + 1)) & rules.works(full)
    charges = ~boosts & (gap > CHARGES_FROM) & (left < full) & (rules.moves > CHARGE)
    chosen = np.where(boosts, BOOST, np.where(charges, CHARGE, HOLD))
    return np.moveaxis(np.eye(rules.moves)[chosen], 3, 1)


def population(model: Model) -> list[list[Floats]]:
    """Return the tables of all spenders of each type of energy."""
    rules, public = model.rules, public_equilibrium(model)
    return [
        [
            effective(rules, public[..., : full + 1])
            if name == "equilibrium"
            else spend(rules, full, name)
            for name in SPENDERS
        ]
        for full in rules.full
    ]
