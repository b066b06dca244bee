"""Drive random cars within the bounds of all fields: in a scalar environment, a batch, threads.

    python dev/tools/random_cars.py 20000

Each car drives 5 s at random, without an opponent; walls stop it. Of each 500 cars, the script
prints how many have an observation that is not finite, and how many have other observations in one
of the environments. A refused own state ends the script with its error.
"""

import sys

import numpy as np
from annotated_types import Interval

from pcs_racing import load_rules
from pcs_racing.envs import DriveEnv, DriveVectorEnv
from pcs_racing.envs.draws import PARAMETERS

TOGETHER, HELD, STEPS = 500, 5, 50  # cars with the same fields drawn; steps of 0.1 s
RULES = load_rules("paper", contact="stop")
DRAWS = {
    name: next(
        (
            {"log_uniform": [note.ge, note.le]} if note.ge > 0.0 else [note.ge, note.le]
            for note in field.notes
            if isinstance(note, Interval)
        ),
        {"choice": ["linear", "pacejka"]},
    )
    for name, field in PARAMETERS.items()
    if name not in ("width", "length")  # such cars do not fit on the grid
}


def drive(env, seed, actions):  # type: ignore[no-untyped-def]
    """Return all observations of a drive, and restore the own state at its end."""
    seen = [env.reset(seed=seed)[0].copy(), *(env.step(action)[0].copy() for action in actions)]
    env.set_state(env.get_state())
    return np.array(seen)


for rng in map(np.random.default_rng, range(int(sys.argv[1]) // TOGETHER)):
    names = rng.choice(list(DRAWS), rng.integers(1, len(DRAWS)), replace=False)
    given = {"opponent": None, "rules": RULES, "randomize": {name: DRAWS[name] for name in names}}
    actions = rng.choice([-1.0, -0.3, 0.0, 0.5, 1.0], (STEPS // HELD, TOGETHER, 2))
    actions = np.repeat(actions, HELD, 0).astype(np.float32)
    one, two = (drive(DriveVectorEnv(TOGETHER, threads=k, **given), 0, actions) for k in (1, 2))
    scalar = DriveEnv(**given)
    alone = np.stack([drive(scalar, car, actions[:, car]) for car in range(TOGETHER)], axis=1)
    wrong = ~np.isfinite(one).all((0, 2)), ((one != two) | (one != alone)).any((0, 2))
    print(f"not finite: {wrong[0].sum()}; other bits: {wrong[1].sum()}", flush=True)
