"""The environments' inputs as functions of bytes: options, actions, seeds and opponents, drawn from the bytes."""

import struct
from functools import cache
from typing import Any

import numpy as np

from pcs_racing import RaceGame, load_game_config, load_race_config, load_track
from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv
from pcs_racing.envs.drive_options import DriveOptions
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv
from pcs_racing.envs.opponents import parse_opponents
from pcs_racing.game.archive_files import load_archive

__all__ = [
    "drive_envs", "drive_inputs", "drive_options", "duel_envs", "duel_inputs", "game_options", "head_to_head_inputs",
    "opponents", "race_options", "small_game",
]  # fmt: skip


@cache
def small_game() -> RaceGame:
    return RaceGame(
        load_track("Tarnfjord"), load_archive("default"), load_game_config("paper", moves=1, step_seconds=0.5)
    )


class Draw:
    """Values out of bytes; when they are used up it goes on with zeros."""

    ODD: tuple[Any, ...] = (
        None, True, False, 0, 1, -1, 2, 3, 255, 10**9, -(10**9), 2**31, 2**63, 2**64, -(2**63) - 1, 10**30,
        0.0, 0.5, 1.0, -0.0, 1e-300, 1e300, -1e300, float("nan"), float("inf"), -float("inf"), 0.1, 0.02, 2.5,
        "", "a", "paper", "contest", "lattice", "nan", "0", "\x00", "\ud800", "../..", "/", "a" * 300, b"", b"abc",
        [], {}, (), [1, 2], (0.5, 1.0), [[]], {"a": 1}, {1: 2}, [None], np.float32(0.5), np.int64(3), np.array(1.0),
        np.array([1, 2]), np.array([], np.float32), np.array(["x"]), np.array([None], object), 1j, range(3), object,
    )  # fmt: skip

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1] if self.at <= len(self.data) else 0

    def number(self) -> float:
        self.at += 8
        return float(struct.unpack("<d", self.data[self.at - 8 : self.at].ljust(8, b"\0"))[0])

    def choice(self, values: Any) -> Any:
        return values[(self.byte() + 256 * self.byte()) % len(values)]

    def value(self, likely: tuple[Any, ...] = ()) -> Any:
        kind = self.byte() % 8
        if kind < 3 and likely:
            return self.choice(likely)
        if kind == 3:
            return self.number()
        if kind == 4:
            return self.byte() - 128
        if kind == 5:
            return [self.choice(self.ODD) for _ in range(self.byte() % 4)]
        if kind == 6:
            return self.data[self.at : self.at + self.byte() % 20].decode("latin-1")
        return self.choice(self.ODD)

    def keywords(self, likely: dict[str, tuple[Any, ...]]) -> dict[str, Any]:
        """Some of the arguments, and now and then one that does not exist."""
        names = list(likely)
        chosen = {self.choice(names) for _ in range(1 + self.byte() % 4)}
        values = {name: self.value(likely[name]) for name in sorted(chosen)}
        return values | ({"unknown": 1} if self.byte() == 255 else {})


GAME = {
    "race": ("paper", "contest"), "moves": (1, 4, 100, 101), "step_seconds": (0.1, 8.0, 0.15, 600), "epsilon": (0.5, [0.1, 0.5]),
    "stay": (True, False), "utility": ("lead", "win", "lead-at-crash"), "fault_penalty": (0.0, 1.5), "discount": (1, 0.5),
    "characteristics": (["restraint"], ("aggressiveness", "restraint"), "pace"), "mask_duplicates": (True,),
}  # fmt: skip
RACE = {
    "name": ("mine",), "duration": (0.1, 40.0, 3600), "start": ("side-by-side", "staggered", "rolling"),
    "start_gap": (0.8, 1.4), "start_spacing": (0.9, 0.4), "start_speed": (0, 15), "start_lines": (1, 1000),
    "steering_noise": (0.01,), "noise_time": (0.28,), "speed_range": ([0.5, 1.0], (0.1, 3)), "stay_move": (True,),
    "crash_rule": ("nobody", "fault-loses"), "aggressiveness": ("lead", "pace", "speed"), "ittc_horizon": (10.0,),
}  # fmt: skip
DRIVE = {
    "track": ("Pipkin", "pipkin"), "opponent": (None, "lattice", "pure-pursuit", "lattice:pace=0.8", ["lattice", "lattice:pace=0.9"]),
    "race": ("paper", "contest"), "duration": (1.0, 0.1, None), "time_step": (0.1, 0.02, 1.0), "top_speed": (8.0, 20),
    "beams": (0, 1, 108, 100_000, 100_001), "fov": (4.7, 6.28), "max_range": (30.0, 0.1), "lidar_noise": (0.0, 0.1),
    "look_ahead": ((0.0, 1.0), [2.0], ()), "normalize": (True, False), "progress_reward": (1.0,), "rivalry": (0.5,),
    "crash_penalty": (10.0, 0), "start_lines": (1, 100, 1000),
}  # fmt: skip


def game_options(data: bytes) -> object:
    return load_game_config(**{"source": "paper", **Draw(data).keywords(GAME)})


def race_options(data: bytes) -> object:
    return load_race_config("paper", **Draw(data).keywords(RACE))


def drive_options(data: bytes) -> object:
    try:
        return DriveOptions(**Draw(data).keywords(DRIVE))
    except TypeError as error:  # Python's own word for an argument that does not exist
        if "unexpected keyword" not in str(error):
            raise
        return None


def drive_envs(data: bytes) -> object:
    """Environments made of odd arguments, and a first step in them."""
    draw = Draw(data)
    options = {"track": "Pipkin", "opponent": None, "num_envs": draw.value((1, 2, 3))} | draw.keywords(DRIVE)
    if "unknown" not in options:
        DriveOptions(**{key: value for key, value in options.items() if key != "num_envs"})
    env = DriveVectorEnv(**options, threads=draw.value((None, 1, 2)))
    env.reset(seed=1)
    result = env.step(np.zeros((env.num_envs, 2), np.float32))
    env.close()
    return result


@cache
def driven() -> tuple[DriveEnv, DriveVectorEnv]:
    return DriveEnv("Pipkin", "pure-pursuit"), DriveVectorEnv(3, track="Pipkin", opponent=None, threads=1)


def drive_inputs(data: bytes) -> object:
    """Actions, seeds and options of the control level."""
    draw = Draw(data)
    env, envs = driven()
    what = draw.byte() % 8
    if what == 0:
        return env.reset(seed=draw.value((0, 1, None)), options=draw.value((None, {})))
    if what == 1:
        return envs.reset(seed=draw.value((0, [1, 2, 3], [None, 1, 2], None)), options=draw.value((None, {})))
    env.reset(seed=0)
    if what < 4:
        return env.step(draw.value(([0.0, 0.5], np.zeros(2, np.float32), [draw.number(), draw.number()])))
    if what == 7:
        return env.set_state(draw.value((env.get_state(),)))
    envs.reset(seed=0)
    numbers = [[draw.number(), draw.number()] for _ in range(3)]
    with np.errstate(all="ignore"):
        short = np.array(numbers, np.float32)
    return envs.step(draw.value((numbers, np.zeros((3, 2)), short)))


@cache
def dueled() -> tuple[DuelEnv, DuelVectorEnv]:
    settings = {"track": "Pipkin", "moves": 2, "step_seconds": 0.1}
    return DuelEnv(**settings), DuelVectorEnv(2, threads=1, **settings)


def duel_inputs(data: bytes) -> object:
    """Moves and seeds of the strategy level."""
    draw = Draw(data)
    env, envs = dueled()
    what = draw.byte() % 6
    if what == 0:
        return env.reset(seed=draw.value((0, 1, None)), options=draw.value((None, {})))
    if what == 1:
        return envs.reset(seed=draw.value((0, [1, 2], [None, 1], None)), options=draw.value((None, {})))
    env.reset(seed=0)
    if what < 4:
        return env.step(draw.value((0, 3, 4, -1, np.int64(1), np.array(2), np.array([1]), 1.0)))
    envs.reset(seed=0)
    return envs.step(draw.value(([0, 1], np.array([3, 2]), [4, 0], [[1], [1]], [0.0, 1.0])))


def opponents(data: bytes) -> object:
    draw = Draw(data)
    moves = small_game().move_names
    names = ("never-switch", "random-moves", "always-restraint+", "lattice:pace=0.9", "lane-switcher:3")
    return parse_opponents(draw.value((*names, [(1, names[0]), (draw.number(), names[1])], [draw.value(names)])), moves)


DUEL = {
    "track": ("Pipkin",), "archive": ("default", "contest", "nowhere"), "opponent": ("random-moves", "never-switch", "lattice", None),
    "deterministic_opponent": (True, False), "render_mode": ("rgb_array", None), **GAME,
}  # fmt: skip


def duel_envs(data: bytes) -> object:
    """Duels made of odd arguments, and a first move in them."""
    draw = Draw(data)
    options = {"track": "Pipkin", "step_seconds": 0.1, "num_envs": draw.value((1, 2, 3))} | draw.keywords(DUEL)
    env = DuelVectorEnv(**options, threads=draw.value((None, 1, 2)))
    env.reset(seed=1)
    result = env.step(np.zeros(env.num_envs, np.int64))
    env.close()
    return result


@cache
def two_players() -> HeadToHeadEnv:
    return HeadToHeadEnv("Pipkin", moves=2, step_seconds=0.1)


def head_to_head_inputs(data: bytes) -> object:
    """Moves, seeds and options of the environment for two agents."""
    draw = Draw(data)
    env = two_players()
    what = draw.byte() % 6
    if what < 3:
        likely = (
            None,
            {"policies": [0, 1]},
            {"policies": [draw.value((0, 1)), draw.value((2,))]},
            {"start": draw.value()},
        )
        return env.reset(seed=draw.value((0, 1, None)), options=draw.value(likely))
    env.reset(seed=0)
    if what == 5:
        return env.set_state(draw.value((env.get_state(),)))
    moves = [draw.value((0, 3, 4, -1, np.int64(1), np.array(2), np.array([1]), 1.0)) for _ in range(2)]
    return env.step(draw.value((dict(zip(env.possible_agents, moves, strict=True)), {"car_0": 0}, {})))
