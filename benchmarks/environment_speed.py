"""Steps per second of the environments: batches against scalar environments, with and without a lidar, on one core.

    python benchmarks/environment_speed.py [--track NAME_OR_FOLDER] [--envs 256] [--seconds 1.0]
    python benchmarks/environment_speed.py --only duel "two agents"    # the variants whose names hold one of these
    python benchmarks/environment_speed.py --against PATH    # scalar environments beside those of another checkout

Everything is measured in one run, the variants in turn for several rounds, and the best round of each counts. Times
are the thread's own, so other work on the machine disturbs little. All on one thread. A step of a match is a whole
race. "Control level" steps last 0.02 s, the period at which planners steer; the cars roll straight on at 1 m/s, and
begin anew when they crash. In "two agents" both cars are steered, and steps are counted for each car: what a learner
gets. SuperSuit's path is measured where it is installed.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from race_speed import side_by_side

from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadVectorEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv
from pcs_racing.envs.match import MatchEnv, MatchVectorEnv

# Steps of one scalar environment for each line that it reads, by what other checkouts have, too.
SCALAR = """
import sys, time
import numpy as np
import pcs_racing
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.duel import DuelEnv
name, track = sys.argv[1:]
drive = name == "drive"
env = DriveEnv(track, opponent="pure-pursuit", time_step=0.02) if drive else DuelEnv(track)
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
STEPS = 100  # between two looks at the clock

Work = tuple[Callable[[], None], int]  # something to repeat, and the steps in it


def drive_batch(track: str, envs: int, **arguments) -> Work:
    """Steps of a batch; it begins anew every two seconds of driving, before most cars reach a wall."""
    env = DriveVectorEnv(envs, track=track, time_step=0.02, threads=1, **arguments)
    env.reset(seed=0)
    actions = np.tile(np.array([0.0, -0.75], np.float32), (envs, 1))

    def work() -> None:
        env.reset()
        for _ in range(STEPS):
            env.step(actions)

    return work, STEPS * envs


def pair_batch(track: str, envs: int, **arguments) -> Work:
    """Steps of a batch whose cars are all steered by agents, counted for each car."""
    env = DriveHeadToHeadVectorEnv(envs, track=track, time_step=0.02, threads=1, **arguments)
    env.reset(seed=0)
    actions = np.tile(np.array([0.0, -0.75], np.float32), (envs, 1))

    def work() -> None:
        env.reset()
        for _ in range(STEPS):
            env.step(actions)

    return work, STEPS * envs


def drive_scalar(track: str, inner: bool = False, **arguments) -> Work:
    """Steps of the scalar environment; ``inner`` leaves out all but the compiled call."""
    env = DriveEnv(track, time_step=0.02, **arguments)
    action = np.array([0.0, -0.75], np.float32)
    env.reset(seed=0)
    env.step(action)
    batch = env.batch
    command = np.array([[[0.0, -0.75]]])
    results = (np.zeros((1, 2)), np.empty(1), np.empty(1, np.bool_), np.empty(1, np.bool_))
    results += (np.empty((1, len(env.elements)), np.float32),)

    def work() -> None:
        env.reset()
        for _ in range(STEPS):
            if inner:
                batch._step_part(command, 2, 0, 1, 0, results)
            elif env.step(action)[2]:
                env.reset()

    return work, STEPS


def duel_batch(track: str, envs: int) -> Work:
    """Moves of a batch of games against random moves, with all that begins anew."""
    env = DuelVectorEnv(envs, track=track, threads=1)
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def work() -> None:
        for _ in range(2):
            env.step(rng.integers(0, 4, envs))

    return work, 2 * envs


def duel_scalar(track: str) -> Work:
    """Moves of one game after the other against random moves."""
    env = DuelEnv(track)
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def work() -> None:
        for _ in range(100):
            if env.step(int(rng.integers(4)))[2]:
                env.reset()

    return work, 100


def match_batch(track: str, envs: int) -> Work:
    """Races of a batch of matches against policies of the archive, with all that begins anew."""
    env = MatchVectorEnv(envs, track=track, threads=1)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    policies = len(env.game.archive)

    def work() -> None:
        env.step(rng.integers(0, policies, envs))

    return work, envs


def match_scalar(track: str) -> Work:
    """Races of one match after the other."""
    env = MatchEnv(track)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    policies = len(env.game.archive)

    def work() -> None:
        for _ in range(20):
            if env.step(int(rng.integers(policies)))[2]:
                env.reset()

    return work, 20


def supersuit_games(track: str) -> Work:
    """Moves of both players by way of PettingZoo and SuperSuit, counted per game."""
    import supersuit

    from pcs_racing.envs.duel import parallel_env

    env = supersuit.concat_vec_envs_v1(
        supersuit.pettingzoo_env_to_vec_env_v1(parallel_env(track=track)), 8, base_class="gymnasium"
    )
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def work() -> None:
        for _ in range(5):
            env.step(rng.integers(0, 4, 16))

    return work, 40


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--track", default="Tarnfjord")
    parser.add_argument("--envs", type=int, default=256, help="environments in a batch")
    parser.add_argument("--seconds", type=float, default=1.0, help="for each variant in each round")
    parser.add_argument("--against", type=Path, metavar="PATH", help="only compare with the checkout in this folder")
    parser.add_argument(
        "--only", nargs="+", metavar="TEXT", default=[""], help="variants whose names hold one of these"
    )
    given = parser.parse_args()
    if given.against is not None:
        for name in ("drive", "duel"):
            new, old = side_by_side(SCALAR, [name, given.track], given.against)
            print(f"{name}, scalar: {new:.1f} us a step here, {old:.1f} there: {old / new:.2f} times as fast")
        return
    track, envs = given.track, given.envs
    pure = {"opponent": "pure-pursuit"}
    makers: dict[str, Callable[[], Work]] = {
        "drive, batch, pure pursuit": lambda: drive_batch(track, envs, **pure),
        "drive, batch, lattice": lambda: drive_batch(track, envs),
        "drive, batch, alone": lambda: drive_batch(track, envs, opponent=None),
        "drive, batch, pure pursuit, 108 beams": lambda: drive_batch(track, envs, **pure, beams=108),
        "drive, batch, pure pursuit, 1080 beams": lambda: drive_batch(track, envs, **pure, beams=1080),
        "two agents, batch": lambda: pair_batch(track, envs),
        "two agents, batch, 108 beams": lambda: pair_batch(track, envs, beams=108),
        "two agents, batch, 1080 beams": lambda: pair_batch(track, envs, beams=1080),
        "drive, scalar, pure pursuit": lambda: drive_scalar(track, **pure),
        "drive, scalar, compiled call alone": lambda: drive_scalar(track, inner=True, **pure),
        "drive, scalar, 1080 beams": lambda: drive_scalar(track, **pure, beams=1080),
        "duel, batch": lambda: duel_batch(track, envs),
        "duel, scalar": lambda: duel_scalar(track),
        "match, batch": lambda: match_batch(track, envs),
        "match, scalar": lambda: match_scalar(track),
        "duel, SuperSuit (games)": lambda: supersuit_games(track),
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
    for _ in range(ROUNDS):
        for name, (work, steps) in variants.items():
            done, start = 0, time.thread_time()
            while time.thread_time() - start < given.seconds:
                work()
                done += steps
            best[name] = max(best[name], done / (time.thread_time() - start))
    print(f"{track}, {envs} environments in a batch, one thread")
    print(f"{'':42} {'steps/s':>10} {'us/step':>9} {'ratio':>7}")
    for name, rate in best.items():
        level = name.partition(",")[0]
        scalar = best.get({"duel": "duel, scalar", "match": "match, scalar"}.get(level, "drive, scalar, pure pursuit"))
        print(f"{name:42} {rate:10.0f} {1e6 / rate:9.2f}" + (f" {rate / scalar:7.2f}" if scalar else ""))
    step, call = best.get("drive, scalar, pure pursuit"), best.get("drive, scalar, compiled call alone")
    if step and call:
        added = 1e6 / step - 1e6 / call
        print(f"what Gymnasium's interface adds to the compiled call: {added:.1f} us a step")


if __name__ == "__main__":
    main()
