"""Steps per second of the environments: batches against scalar environments, with and without a
lidar, on one core.

    python dev/benchmarks/environment_speed.py [--track NAME_OR_FOLDER] [--envs 256] [--seconds 1.0]
    # the variants whose names hold one of these; README's table
    python dev/benchmarks/environment_speed.py --only duel "two agents"
    python dev/benchmarks/environment_speed.py --only defaults
    # steps of an agent with 1, 4 and 8 cars, and with 2
    python dev/benchmarks/environment_speed.py --only cars
    # scalar environments here and in another checkout
    python dev/benchmarks/environment_speed.py --against PATH

Everything is measured in one run, all variants in each of several rounds, and the best round of
each counts. Times are the thread's own, so other work on the machine disturbs little. All on one
thread. Control level ("drive", "two agents") steps last 0.02 s, the period of planners' commands;
the cars roll straight on at 1 m/s, and start again after a crash. In "two agents" both cars are
steered, and steps are counted for each car. SuperSuit's path is measured where
it is installed.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from race_speed import side_by_side

from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadVectorEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv

# Steps of one scalar environment for each line that it reads, by names of other checkouts.
SCALAR = """
import sys, time
import numpy as np
import pcs_racing
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.duel import DuelEnv
name, track = sys.argv[1:]
drive = name == "drive"
own = {"opponent": "pure-pursuit", "time_step": 0.02}
env = DriveEnv(track=track, **own) if drive else DuelEnv(track=track)
steps, hold = 1000 if drive else 60, np.array([0.0, -0.75], np.float32)
def run():
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    start = time.process_time()
    for _ in range(steps):
        if env.step(hold if drive else int(rng.integers(4)))[2]:
            env.reset()
    return 1e6 * (time.process_time() - start) / steps
run()
print(pcs_racing.__file__, flush=True)
for _ in sys.stdin:
    print(run(), flush=True)
"""

ROUNDS = 5
STRAIGHT = np.array([0.0, -0.75], np.float32)  # steering and speed: straight on at 1 m/s

Work = tuple[Callable[[], None], int]  # something to repeat, and the steps in it


def batch(envs: Any, steps: int) -> Work:
    """Steps of a batch: straight on, or random moves."""
    space, rng = envs.single_action_space, np.random.default_rng(0)
    straight = np.tile(STRAIGHT, (envs.num_envs, 1)) if isinstance(space, Box) else None
    envs.reset(seed=0)

    def work() -> None:
        if straight is not None:
            envs.reset()  # after two seconds of driving, before most cars reach a wall
        for _ in range(steps):
            envs.step(rng.integers(space.n, size=envs.num_envs) if straight is None else straight)

    return work, steps * envs.num_envs


def scalar(env: Any, steps: int) -> Work:
    """Steps of one environment, with a reset at the end of an episode."""
    space, rng = env.action_space, np.random.default_rng(0)
    straight = isinstance(space, Box)
    env.reset(seed=0)

    def work() -> None:
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(
                STRAIGHT if straight else int(rng.integers(space.n))
            )
            if terminated or truncated:
                env.reset()

    return work, steps


def supersuit_games(track: str) -> Work:
    """Moves of both players by way of PettingZoo and SuperSuit, counted per game."""
    import supersuit

    from pcs_racing.envs.duel import parallel_env

    environments = supersuit.pettingzoo_env_to_vec_env_v1(parallel_env(track=track))
    work, steps = batch(supersuit.concat_vec_envs_v1(environments, 8, base_class="gymnasium"), 5)
    return work, steps // 2


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--track", default="Tarnfjord")
    parser.add_argument("--envs", type=int, default=256, help="environments in a batch")
    parser.add_argument("--seconds", type=float, default=1.0, help="for each variant in each round")
    parser.add_argument(
        "--against", type=Path, metavar="PATH", help="only compare with the checkout in this folder"
    )
    parser.add_argument(
        "--only",
        nargs="+",
        metavar="TEXT",
        default=[""],
        help="variants whose names hold one of these",
    )
    given = parser.parse_args()
    if given.against is not None:
        for name in ("drive", "duel"):
            new, old = side_by_side(SCALAR, [name, given.track], given.against)
            print(
                f"{name}, scalar: {new:.1f} us a step here, {old:.1f} there: {old / new:.2f} times"
                " as fast"
            )
        return
    track = {"track": given.track}
    step, pursuit = {"time_step": 0.02}, {"opponent": "pure-pursuit"}
    many = {"num_envs": given.envs, "threads": 1, **track}
    few, most = {"beams": 108}, {"beams": 1080}
    makers: dict[str, Callable[[], Work]] = {
        **{
            f"{name}, defaults": lambda name=name, steps=steps: batch(
                gym.make_vec(f"pcs_racing/{name}", num_envs=given.envs, threads=1), steps
            )
            for name, steps in {"Line-v0": 20, "Drive-v1": 20, "Duel-v1": 2}.items()
        },
        "drive, batch, pure pursuit": lambda: batch(DriveVectorEnv(**many, **step, **pursuit), 100),
        "drive, batch, lattice": lambda: batch(
            DriveVectorEnv(**many, **step, opponent="lattice"), 100
        ),
        "drive, batch, alone": lambda: batch(DriveVectorEnv(**many, **step, opponent=None), 100),
        "drive, batch, pure pursuit, 108 beams": lambda: batch(
            DriveVectorEnv(**many, **step, **pursuit, **few), 100
        ),
        "drive, batch, pure pursuit, 1080 beams": lambda: batch(
            DriveVectorEnv(**many, **step, **pursuit, **most), 100
        ),
        "two agents, batch": lambda: batch(DriveHeadToHeadVectorEnv(**many, **step), 100),
        "two agents, batch, 108 beams": lambda: batch(
            DriveHeadToHeadVectorEnv(**many, **step, **few), 100
        ),
        "two agents, batch, 1080 beams": lambda: batch(
            DriveHeadToHeadVectorEnv(**many, **step, **most), 100
        ),
        **{
            f"{cars} cars{', 1080 beams' if beams else ''}": lambda cars=cars, beams=beams: batch(
                DriveHeadToHeadVectorEnv(
                    (given.envs // cars) * cars,
                    threads=1,
                    **track,
                    **step,
                    cars=cars,
                    rules="contest",
                    beams=beams,
                ),
                100,
            )
            for beams in (0, 1080)
            for cars in (1, 2, 4, 8)
        },
        "drive, scalar, pure pursuit": lambda: scalar(DriveEnv(**track, **step, **pursuit), 100),
        "drive, scalar, 1080 beams": lambda: scalar(
            DriveEnv(**track, **step, **pursuit, **most), 100
        ),
        "duel, batch": lambda: batch(DuelVectorEnv(**many), 2),
        "duel, scalar": lambda: scalar(DuelEnv(**track), 100),
        "duel, SuperSuit (games)": lambda: supersuit_games(given.track),
    }
    variants = {}
    for name, make in makers.items():
        if any(text in name for text in given.only):
            try:
                variants[name] = make()
            except ImportError:
                print("SuperSuit is not installed: its path is left out")
    best = dict.fromkeys(variants, 0.0)
    for work, _ in variants.values():
        work()  # compiles
    # All variants in each round: a slow moment of the machine then costs none of them its best.
    for _ in range(ROUNDS):
        for name, (work, steps) in variants.items():
            done, start = 0, time.thread_time()
            while time.thread_time() - start < given.seconds:
                work()
                done += steps
            best[name] = max(best[name], done / (time.thread_time() - start))
    print(f"{given.track}, {given.envs} environments in a batch, one thread")
    print(f"{'':42} {'steps/s':>10} {'us/step':>9} {'ratio':>7}")
    for name, rate in best.items():
        level = name.partition(",")[0]
        level = f"2 cars{', 1080 beams' if 'beams' in name else ''}" if " cars" in level else level
        single = best.get(level) or best.get(
            "duel, scalar" if level == "duel" else "drive, scalar, pure pursuit"
        )
        print(
            f"{name:42} {rate:10.0f} {1e6 / rate:9.2f}"
            + (f" {rate / single:7.2f}" if single else "")
        )


if __name__ == "__main__":
    main()
