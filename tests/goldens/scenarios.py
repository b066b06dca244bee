"""Races and episodes whose results belong to a version: saved by `dev/tools/make_goldens.py`.

Inputs other than code are made here (policies, actions, seeds) or named by a hash (the circuit).
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import gymnasium
import numpy as np
import pettingzoo

import pcs_racing
from pcs_racing import load_rules, load_track, racer
from pcs_racing.base.seeds import race_seeds
from pcs_racing.envs import GYMNASIUM_IDS, PETTINGZOO_IDS
from pcs_racing.envs.drive import parallel_env as drive_head_to_head_env
from pcs_racing.envs.line import parallel_env as line_head_to_head_env
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.lattice import REFERENCE
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, draw_starts, start_races

TRACK = "Pipkin"
RACES_ID = "pcs_racing/Races-v1"
"""The races below the environments, which have no id of their own; its number goes up with theirs.
"""

KNOWN_RULES = ("paper", "contest")
RIVALS = {
    "lattice:pace=0.7": "lattice:early,pace=0.7",
    **{text: text for text in ("lane-switcher:3", "pure-pursuit", "gap-follower")},
}
"""Rivals by their names in the kept files; the lattice had other defaults when they were made."""
SHORT_TICKS, SHORT_SECONDS, LONG_SECONDS, LONG_RACES = 20, 2.0, 40.0, 8

Values = dict[str, np.ndarray]


def track_hash() -> str:
    return load_track(TRACK).content_hash


def archive() -> PolicyArchive:
    """Six policies from slow to fast, with coordinates that were made up."""
    pace = np.linspace(0.3, 0.9, 6)
    lattice = REFERENCE
    parameters = np.array([lattice.policy({"pace": value}).parameters for value in pace])
    coordinates = np.column_stack([20.0 * pace - 10.0, [4.0, 3.0, 3.5, 2.0, 2.5, 1.0]])
    return PolicyArchive(
        "golden",
        "lattice",
        lattice.parameter_names,
        parameters,
        ("aggressiveness", "restraint"),
        coordinates,
    )


SHORT_GAME = {"archive": archive(), "steps": (0.6,) * 5}


def races() -> Values:
    """A short race of each planner under each rules, and the ends of long ones."""
    track, ego = load_track(TRACK), racer("lattice:early")
    out: Values = {}
    for rules in KNOWN_RULES:
        for text, policy in RIVALS.items():
            rival = racer(policy)
            setup = RaceSetup(
                track,
                load_rules(rules, duration=SHORT_SECONDS, start_lines=2),
                (ego.planner, rival.planner),
            )
            state = start_races(setup, draw_starts(track, setup.rules, 2, 0), race_seeds(0, 2))
            theta = np.broadcast_to(
                pad_parameters([ego, rival], setup.theta_size), (2, 2, setup.theta_size)
            ).copy()
            seen = []
            for _ in range(round(SHORT_SECONDS * 100) // SHORT_TICKS):
                advance(setup, state, theta, SHORT_TICKS, threads=1)
                seen.append(np.concatenate([state.cars.reshape(2, -1), state.progress], axis=1))
            out[f"values {rules} {text}"] = np.array(seen)
            out[f"values {rules} {text} sums"] = state.sums.copy()
        config = load_rules(rules, duration=LONG_SECONDS, start_lines=4)
        starts = draw_starts(track, config, LONG_RACES, 1)
        for text, policy in list(RIVALS.items())[:2]:
            ended = pcs_racing.run_races(
                track, ego, racer(policy), config, seed=1, starts=starts, threads=1
            )
            out[f"ends {rules} {text}"] = np.column_stack(
                [ended.lead, ended.time, ended.winner, ended.crashed]
            )
    return out


def actions(count: int, width: int) -> np.ndarray:
    """Smooth steering and speeds, the same on every machine."""
    time = np.arange(count)[:, None]
    number = np.arange(width)[None]
    steering = np.round(0.3 * np.sin(0.3 * time + number), 3)
    speed = np.round(-0.2 + 0.3 * np.cos(0.17 * time + 2.0 * number), 3)
    return np.stack([steering, speed], axis=-1).astype(np.float32)


def vector_episode(
    name: str, seed: int, actions: Iterable[np.ndarray], **options: Any
) -> tuple[Values, Any]:
    """Observations, rewards and ends of three environments at once; and the open environment."""
    env = gymnasium.make_vec(
        name, num_envs=3, track=TRACK, threads=1, autoreset_mode="SAME_STEP", **options
    )
    first, _ = env.reset(seed=seed)
    seen, rewards, over = [first], [], []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        seen.append(observation)
        rewards.append(reward)
        over.append((terminated, truncated))
    return {
        "observations": np.array(seen),
        "rewards": np.array(rewards),
        "ends": np.array(over),
    }, env


def pair_episode(
    name: str, seed: int, actions: Iterable[np.ndarray], maker: Any, **options: Any
) -> tuple[Values, Any]:
    """Observations and rewards of both agents of an environment; and the environment."""
    made = getattr(pettingzoo, "make", None)
    env = (
        made("parallel", name, track=TRACK, **options)
        if made is not None
        else maker(track=TRACK, **options)
    )
    first, _ = env.reset(seed=seed)
    seen, rewards = [[first[agent] for agent in env.possible_agents]], []
    for action in actions:
        observation, reward, _, _, _ = env.step(dict(zip(env.possible_agents, action, strict=True)))
        if not observation:
            break
        seen.append([observation[agent] for agent in env.possible_agents])
        rewards.append([reward[agent] for agent in env.possible_agents])
        if not env.agents:
            break
    return {"observations": np.array(seen), "rewards": np.array(rewards)}, env


def named(what: str, episode: Values) -> Values:
    return {f"values {what} {name}": value for name, value in episode.items()}


def drive(name: str) -> Values:
    """Two seconds in three races at once, with and without a lidar."""
    out: Values = {}
    for what, options in {
        "paper": {"opponent": "lattice:early"},
        "contest": {"rules": "contest", "opponent": "lane-switcher:3", "beams": 16},
        "alone": {"opponent": None, "normalize": True},
    }.items():
        episode, env = vector_episode(name, 5, actions(20, 3), **options)
        out |= named(
            what,
            {**episode, "elements": np.array([element.name for element in env.unwrapped.elements])},
        )
        env.close()
    return out


def avoidance(name: str) -> Values:
    """Two seconds on three tracks with obstacles that stand and move."""
    episode, env = vector_episode(name, 5, actions(20, 3), beams=16)
    boxes = np.concatenate(env.unwrapped.batch.randomization.boxes)
    env.close()
    return named("boxes", {**episode, "boxes": boxes})


def duel(name: str) -> Values:
    """Three games at once, of short steps to their ends."""
    out: Values = {}
    for race in KNOWN_RULES:
        moves = ((np.arange(3) + step) % 4 for step in range(6))
        episode, env = vector_episode(
            name, 7, moves, rules=race, opponent="random-moves", **SHORT_GAME
        )
        game = env.unwrapped.game
        names = {
            "elements": np.array([element.name for element in game.observation_elements]),
            "moves": np.array(game.moves[: game.offered]),
        }
        out |= named(race, {**episode, "ends": episode["ends"][:, 0], **names})
        env.close()
    return out


def head_to_head(name: str) -> Values:
    """One game of two agents, of short steps to its end."""
    out: Values = {}
    for race in KNOWN_RULES:
        moves = ((step + np.arange(2)) % 4 for step in range(4))
        out |= named(
            race, pair_episode(name, 3, moves, pcs_racing.parallel_env, rules=race, **SHORT_GAME)[0]
        )
    return out


def drive_head_to_head(name: str) -> Values:
    """Two seconds of a race of two agents, with and without a lidar."""
    out: Values = {}
    for what, options in {
        "paper": {},
        "contest": {
            "rules": "contest",
            "beams": 16,
            "see_opponent": "in sight",
            "win_reward": 1.0,
            "time_left": True,
        },
    }.items():
        episode, env = pair_episode(name, 5, actions(100, 2), drive_head_to_head_env, **options)
        names = {"elements": np.array([element.name for element in env.unwrapped.elements])}
        out |= named(what, {**episode, "state": env.state(), **names})
    return out


STYLE = {"assertiveness": 0.9, "pace": 1.4}
"""Style of the cars of `line`; ``line-ppo`` had other defaults when the results were made."""


def line(name: str) -> Values:
    """A second of three races, with some rejected choices."""
    choices = ((7 * step + np.arange(3)) % 64 for step in range(10))
    return vector_episode(name, 5, choices, style={**STYLE, "risk": (0.0, 1.0)})[0]


def line_head_to_head(name: str) -> Values:
    """A second of a race of two agents."""
    choices = ((7 * step + np.arange(2)) % 64 for step in range(10))
    return pair_episode(name, 5, choices, line_head_to_head_env, style=STYLE)[0]


_BY_NAME: dict[str, Callable[[str], Values]] = {
    "Drive": drive,
    "Avoidance": avoidance,
    "Duel": duel,
    "head_to_head": head_to_head,
    "drive_head_to_head": drive_head_to_head,
    "Line": line,
    "line_head_to_head": line_head_to_head,
}


def _scenario(name: str) -> Callable[[], Values]:
    return lambda: _BY_NAME[name.partition("/")[2].rpartition("-v")[0]](name)


SCENARIOS: dict[str, Callable[[], Values]] = {
    RACES_ID: races,
    **{name: _scenario(name) for name in (*GYMNASIUM_IDS, *PETTINGZOO_IDS)},
}
"""Recorded results of every id; a new environment needs a scenario here."""


def file_name(name: str) -> str:
    return f"{name.partition('/')[2]}.npz"


# Results count as the same: short races to nine decimals, the ends of long ones roughly.
VALUE = 1e-9
"""Of 64-bit numbers of short races: another processor may round a last bit differently."""
FLOAT32 = 2e-6
"""Of observations, which are 32-bit numbers, relative: a last bit or two."""
LEAD = 0.05
"""Of the ends of long races, m and s: over 40 s rounding errors grow, and a planner's choice may
fall another way.
"""
STRAY = 1
"""Long races of each kind that may end altogether differently for that reason."""


def differences(found: Mapping[str, Any], kept: Mapping[str, Any]) -> list[str]:
    """Return the differences between two sets of results, in a line each."""
    lines = [f"{name} is in one of the two only" for name in sorted(set(found) ^ set(kept))]
    for name in sorted(set(found) & set(kept)):
        new, old = np.asarray(found[name]), np.asarray(kept[name])
        if new.shape != old.shape or new.dtype.kind != old.dtype.kind:
            lines.append(
                f"{name} has shape {new.shape} and type {new.dtype}; it had {old.shape} and"
                f" {old.dtype}"
            )
        elif new.dtype.kind != "f":
            if (new != old).any():
                lines.append(
                    f"{name} is {new[new != old].flat[0]!r} where it was"
                    f" {old[new != old].flat[0]!r}"
                )
        elif name.startswith("ends "):
            strayed = (np.abs(new - old) > LEAD).any(axis=1).sum()
            if strayed > STRAY:
                lines.append(f"{name}: {strayed} of {len(new)} races end otherwise")
        else:
            allowed = VALUE + (FLOAT32 if new.dtype == np.float32 else VALUE) * np.maximum(
                np.abs(old), 1.0
            )
            worst = np.nanmax(np.abs(new.astype(np.float64) - old) / allowed)
            if worst > 1.0 or (np.isnan(new) != np.isnan(old)).any():
                at = np.unravel_index(np.argmax(np.abs(new - old)), new.shape)
                lines.append(f"{name} is {new[at]:.12g} where it was {old[at]:.12g}")
    return lines
