"""Drive random cars within the bounds of all fields: in a scalar environment, a batch, threads.

    python dev/tools/random_cars.py --cars 20000

Each car drives 5 s at random, without an opponent; walls stop it. The script counts cars with an
observation that is not finite, own states that are refused, and observations that differ.
"""

import argparse
import time
from typing import Any

import numpy as np
from annotated_types import Interval

from pcs_racing import InputError, load_rules
from pcs_racing.envs import DriveEnv
from pcs_racing.envs.draws import PARAMETERS
from pcs_racing.envs.drive import DriveVectorEnv

TOGETHER = 500  # cars with the same fields drawn
STEPS, HELD = 50, 5  # of 0.1 s; steps with one action
ROOM = ("width", "length")  # cars that do not fit on the grid are refused


def draws_of(rng: np.random.Generator) -> dict[str, Any]:
    """Return draws of some fields over their whole ranges."""
    draws: dict[str, Any] = {}
    names = [name for name in PARAMETERS if name not in ROOM]
    for name in rng.choice(names, rng.integers(1, len(names)), replace=False).tolist():
        limits = [note for note in PARAMETERS[name].notes if isinstance(note, Interval)]
        if not limits:
            draws[name] = {"choice": ["linear", "pacejka"]}
            continue
        ends = [limits[0].ge, limits[0].le]
        draws[name] = {"log_uniform": ends} if ends[0] > 0.0 and rng.random() < 0.7 else ends
    return draws


def main() -> None:
    parser = argparse.ArgumentParser(description="random cars within the bounds of all fields")
    parser.add_argument("--cars", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng, begin = np.random.default_rng(arguments.seed), time.perf_counter()
    counts = dict.fromkeys(("cars", "not finite", "refused", "other bits"), 0)
    while counts["cars"] < arguments.cars:
        together = min(TOGETHER, arguments.cars - counts["cars"])
        given: dict[str, Any] = {
            "track": "Tarnfjord",
            "opponent": None,
            "rules": load_rules("paper", contact="stop"),
            "randomize": draws_of(rng),
        }
        envs = [DriveVectorEnv(together, threads=threads, **given) for threads in (1, 2)]
        seed = int(rng.integers(2**31))
        seen = [[env.reset(seed=seed)[0].copy()] for env in envs]
        actions = rng.choice([-1.0, -0.3, 0.0, 0.5, 1.0], (STEPS // HELD, together, 2))
        actions = np.repeat(actions, HELD, 0).astype(np.float32)
        wrong = np.zeros((3, together), bool)
        for action in actions:
            for env, own in zip(envs, seen, strict=True):
                own.append(env.step(action)[0].copy())
        one, two = map(np.array, seen)
        wrong[0] = ~np.isfinite(one).all((0, 2))
        wrong[2] = (one != two).any((0, 2))
        try:
            envs[1].set_state(envs[0].get_state())
        except InputError as error:
            print(error)
            wrong[1] = True
        scalar = DriveEnv(**given)
        for car in range(together):
            own = [scalar.reset(seed=seed + car)[0]]
            for action in actions[:, car]:
                observation, _, ended, late, _ = scalar.step(action)
                own.append(observation)
                if ended or late:
                    break
            wrong[2, car] |= (np.array(own) != one[: len(own), car]).any()
            try:
                scalar.set_state(scalar.get_state())
            except InputError as error:
                print(error)
                wrong[1, car] = True
        counts["cars"] += together
        for name, some in zip(list(counts)[1:], wrong, strict=True):
            counts[name] += int(some.sum())
        print(counts, f"{time.perf_counter() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
