"""Refusals of environments: one error that names the value, and nothing has changed."""

import re

import numpy as np
import pytest
from faces import ALL, PAIRS, SINGLE, VARIED, act, begun, flat, make, make_many
from refusal import refused

from pcs_racing import InputError
from pcs_racing.base.errors import UnknownArgumentError
from pcs_racing.car.vehicle import STEER_DELAY
from pcs_racing.envs.batch import check_within
from pcs_racing.envs.drive import (
    DriveEnv,
    DriveHeadToHeadEnv,
    DriveHeadToHeadVectorEnv,
    DriveVectorEnv,
)
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv, SelfPlayVectorEnv

GAMES = (DuelEnv, HeadToHeadEnv)
STEERING = (DriveEnv, DriveHeadToHeadEnv)
VECTORS = (DriveVectorEnv, DuelVectorEnv)
SELF_PLAY = (SelfPlayVectorEnv, DriveHeadToHeadVectorEnv)
EVERYWHERE = (*ALL, *VECTORS, *SELF_PLAY)
NAN = float("nan")
PLAIN = [
    (EVERYWHERE, {"track": ([],), "rules": (5,), "render_mode": ("ansi",), "view": ("moon",)}),
    (
        VECTORS,
        {
            "num_envs": (0, 2.5),
            "threads": (0, True),
            "autoreset_mode": ("Now",),
            "max_episode_steps": (0,),
        },
    ),
    (SELF_PLAY, {"num_envs": (3,), "opponent": ("lattice",)}),
    ((DuelEnv, DuelVectorEnv), {"opponent": (None,)}),
    (PAIRS, {"max_cycles": (0,)}),
    (GAMES, {"epsilon": (NAN, -1.0)}),
    (
        STEERING,
        {
            "time_step": (0.015, NAN),
            "beams": (-1, 2.5),
            "top_speed": (0.0,),
            "see_opponent": ("sometimes",),
        },
    ),
    (STEERING, {"crash_penalty": (-1.0,), "win_reward": (-1.0,), "normalize": ("yes",)}),
]
"""Values whose error only names the argument and the value."""


@pytest.mark.parametrize(
    ("kinds", "arguments", "message"),
    [
        *(
            (kinds, {name: value}, f"{name} is {value!r}")
            for kinds, names in PLAIN
            for name, values in names.items()
            for value in values
        ),
        (EVERYWHERE, {"trak": "Pipkin"}, "'trak'; did you mean 'track'?"),
        (EVERYWHERE, {"track": "Nowhere"}, "Nowhere"),
        (ALL, {"track": [3]}, "track is [3]"),
        (ALL, {"track": ["Pipkin", "Nowhere"]}, "Nowhere"),
        (ALL, {"opponent": 3}, "3 can't race"),
        (ALL, {"opponent": "nobody"}, "nobody"),
        (ALL, {"opponent": []}, "opponent is an empty list"),
        (ALL, {"opponent": ["lattice", 7]}, "7 can't race"),
        (GAMES, {"opponent": ["lane-switcher:3", "pure-pursuit"]}, "must share a planner"),
        (GAMES, {"opponent": "always-left"}, "'left' is no move"),
        (GAMES, {"opponent": [(1, 2, "random-moves")]}, "opponent 0"),
        (GAMES, {"opponent": [(-1.0, "random-moves")]}, "weight of opponent 0 is -1.0"),
        (GAMES, {"archive": "nothing"}, "unknown archive 'nothing'"),
        (GAMES, {"rules": "rally"}, "rules 'rally' are unknown"),
        (GAMES, {"characteristics": ("charm",)}, "has no characteristic 'charm'"),
        (STEERING, {"look_ahead": (0.0,) * 101}, "look_ahead"),
        (
            STEERING,
            {"look_ahead": (), "own_state": False, "see_opponent": "never", "beams": 0},
            "nothing is observed",
        ),
        (STEERING, {"duration": 0.05}, "duration"),
        ((DriveVectorEnv,), {"num_envs": 100_000, "beams": 10_000}, "100000 environments"),
        (ALL, {"vehicle": {"weight": 3.0}}, "weight"),
        (ALL, {"vehicle": {"mu": -1.0}}, "mu is -1.0"),
        (ALL, {"vehicle": [{}, {}, {}]}, "lists 3 cars"),
        (ALL, {"vehicle": 3.0}, "vehicle"),
        (ALL, {"vehicle": {"steer_delay": 0.03}}, "multiple of 0.02"),
        (ALL, {"randomize": {"mu": [1.0, 0.5]}}, "mu is [1.0, 0.5]"),
        (ALL, {"randomize": {"grip": [0.5, 1.0]}}, "grip"),
        (ALL, {"randomize": {"car_2": {"mu": 1.0}}}, "for car_2; the cars are car_0, car_1"),
        ((DriveEnv,), {"randomize": {"car_1": {"mu": 1.0}}, "opponent": None}, "the only car is"),
        (ALL, {"randomize": 0.5}, "randomization"),
        (ALL, {"obstacles": {"count": [3, 1]}}, "count of obstacles is [3, 1]"),
        (ALL, {"obstacles": 200}, "count of obstacles is 200"),
        (ALL, {"obstacles": {"size": 5.0}}, "size of obstacles is 5.0"),
        (ALL, {"obstacles": {"speed": 5.0}}, "speed"),
        (ALL, {"obstacles": {"shape": "star"}}, "shape is 'star'"),
        (ALL, {"obstacles": {"moving": 3, "count": 2}}, "moving is [3, 3], and count is [2, 2]"),
    ],
    ids=lambda value: str(value)[:60] if isinstance(value, dict) else "",
)
def test_an_impossible_argument_is_one_error_that_names_it(kinds, arguments, message):
    for kind in kinds:
        with pytest.raises(InputError, match=re.escape(message)) as caught:
            kind(**arguments)
        if isinstance(caught.value, UnknownArgumentError):
            assert isinstance(caught.value, TypeError)  # as Python's own
            assert f"{kind.__name__}()" in str(caught.value)


@pytest.mark.parametrize("kind", [*ALL, *VECTORS])
def test_an_argument_is_read_and_never_set(kind):
    env = kind()
    for name in ("opponent", "rules", "obstacles"):
        assert getattr(env, name) == getattr(env.options, name)
        refused(f"{name} is an argument .* make another one", setattr, env, name, "lattice")
    refused(r"set_opponent_weights\(\[...\]\) chooses", setattr, env, "opponent", "nonsense")
    env.reset(seed=0)
    env.reward = lambda step: step.reward
    refused(
        "reward is an argument", env.step, act(env) if kind in ALL else env.action_space.sample()
    )


@pytest.mark.parametrize(
    ("kinds", "wrong", "message"),
    [
        (STEERING, [np.nan, 0.0], "nan"),
        (STEERING, [0.0, np.inf], "inf"),
        (STEERING, [0.0], "shape"),
        (STEERING, "left", "numbers"),
        (STEERING, None, "shape|finite"),
        (GAMES, 99, "move 99 is not one of the moves"),
        (GAMES, -1, "move -1"),
        (GAMES, 0.5, "type float64"),
        (GAMES, np.nan, "type float64"),
        (GAMES, True, "moves are"),
        (GAMES, [0, 1], "whole number"),
        (GAMES, None, "type object"),
        (GAMES, "left", "whole number"),
    ],
)
def test_an_impossible_action_is_one_error_and_changes_nothing(kinds, wrong, message):
    for kind in kinds:
        env = begun(make(kind), seed=0)
        before = flat(env.get_state().batch)
        action = act(env)
        refused(
            message, env.step, {**action, "car_1": wrong} if isinstance(action, dict) else wrong
        )
        if isinstance(action, dict):
            for missing in ({"car_0": action["car_0"]}, list(action.values())):
                refused("car_0, car_1", env.step, missing)
        assert flat(env.get_state().batch) == before
        env.step(act(env))


@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (DriveEnv, [[0.0, 0.0], [0.0, 0.0], [0.0, np.nan]], "environment 2"),
        (DriveEnv, np.zeros((2, 2)), r"\(3, 2\)"),
        (DriveEnv, np.full((3, 2), 0.1 + 0.2j), "must be numbers"),
        (DuelEnv, [0, 9, 0], "environment 1: move 9"),
        (DuelEnv, [0, 1], r"of shape \(2,\) and type int64"),
    ],
)
def test_an_impossible_action_of_many_names_the_environment(kind, wrong, message):
    envs = make_many(kind, 3)
    envs.reset(seed=0)
    refused(message, envs.step, np.array(wrong))
    envs.close()
    refused("were closed", envs.step, np.stack([act(make(kind))] * 3))


@pytest.mark.parametrize(
    ("kinds", "arguments", "message"),
    [
        (ALL, {"seed": -1}, "seed is -1"),
        (ALL, {"seed": 0.5}, "seed is 0.5"),
        (ALL, {"options": [1]}, "options are [1]"),
        (
            ALL,
            {"options": {"stat": (3.0, 0)}},
            "reset option 'stat' is unknown; did you mean 'sta",
        ),
        (ALL, {"options": {"state": "yesterday"}}, "state is a str"),
        (ALL, {"options": {"start": (np.nan, 0)}}, "option 'start' is"),
        (ALL, {"options": {"start": (20.0, 2)}}, "option 'start' is"),
        (ALL, {"options": {"start": "here"}}, "option 'start' is"),
        ((*STEERING, DuelEnv), {"options": {"start": (1e9, 0)}}, "1000000000.0"),
        (ALL, {"options": {"obstacles": "boxes"}}, "option 'obstacles' is"),
        (ALL, {"options": {"obstacles": [[0.0, 0.0]]}}, "option 'obstacles' is"),
        (ALL, {"options": {"obstacles": [[0.0, 0.0, 0.0, 0.3, np.nan]]}}, "option 'obstacles' is"),
        (ALL, {"options": {"obstacles": [[0.0, -4.0, 0.0, 50.0, 0.3]]}}, "obstacle"),
        (STEERING, {"options": {"poses": [[0.0, 0.0]]}}, "option 'poses' is"),
        (STEERING, {"options": {"poses": [[1e3, 0.0, 0.0], [0.0, 1e3, 0.0]]}}, "overlaps a wall"),
        (STEERING, {"options": {"poses": np.zeros((2, 4)) - 1.0}}, "reset option"),
        (
            STEERING,
            {"options": {"start": (5.0, 0), "poses": np.zeros((2, 3))}},
            "give one of the two",
        ),
        (STEERING, {"options": {"policies": (0, 1)}}, "policies"),
        (GAMES, {"options": {"policies": [1]}}, "policies has shape"),
        (GAMES, {"options": {"policies": [0, 99]}}, "game 0, car 1: policy 99"),
    ],
    ids=lambda value: str(value)[:60] if isinstance(value, dict) else "",
)
def test_an_impossible_reset_is_one_error_and_changes_nothing(kinds, arguments, message):
    for kind in kinds:
        env = begun(make(kind), seed=0)
        before = env.batch.both_views().tolist()
        refused(re.escape(message), env.reset, **arguments)
        assert env.batch.both_views().tolist() == before
        env.step(act(env))


@pytest.mark.parametrize(
    ("seed", "message"),
    [([0, -1, 2], "seed of environment 1"), ([0, 1], "2 seeds for 3"), (1.5, "seed is 1.5")],
)
def test_an_impossible_seed_of_many_is_refused(seed, message):
    refused(message, make_many(DriveEnv, 3).reset, seed=seed)


def changed(index, value):
    """A state with another value in one part of the batch's."""

    def change(state):
        parts = list(state.batch)
        parts[index] = value(parts[index])
        return state._replace(batch=tuple(parts))

    return change


def late(vehicles):
    """Vehicles of a state, whose steering commands come a control period later."""
    vehicles = vehicles.copy()
    vehicles[..., STEER_DELAY] += 1.0
    return vehicles


def begin(kind, **arguments):
    return begun(make(kind, **arguments), seed=0).get_state()


@pytest.mark.parametrize(
    ("kinds", "harm", "message"),
    [
        (ALL, lambda state: "yesterday", "state is a str; it must be a state of get_state"),
        (
            ALL,
            lambda state: state._replace(generator={"bit_generator": "dice"}),
            "random generator",
        ),
        (
            GAMES,
            changed(0, lambda part: "yesterday"),
            "the state of 1 games is str; it must be GameState",
        ),
        (
            (DuelEnv,),
            lambda state: begin(DuelEnv, steps=(8.0,) * 4),
            (
                r"own is float64 of shape \(1, 2, 4, 2\); it must be finite float64 of shape \(1,"
                r" 2, 3, 2\)"
            ),
        ),
        (
            (DuelEnv,),
            changed(0, lambda game: game._replace(policy=np.array([[0, 99]]))),
            r"games.policy holds 99; it must be from -1 to",
        ),
        (
            (DriveEnv,),
            changed(1, lambda drawn: np.array([2])),
            "opponents holds 2; it must be from 0 to 0",
        ),
        (
            (DriveEnv,),
            lambda state: begin(DriveEnv, opponent=None),
            r"cars is float64 of shape \(1, 1, 7\)",
        ),
        (
            (DriveEnv,),
            changed(4, lambda drawn: (drawn[0], np.zeros(3), *drawn[2:])),
            r"randomization.1 is float64 of shape \(3,\)",
        ),
        (
            ALL,
            changed(4, lambda drawn: (drawn[0], late(drawn[1]), *drawn[2:])),
            "steering delays holds 1.0; it must be from 0 to 0",
        ),
        (
            (DriveEnv,),
            changed(4, lambda drawn: ((np.array([9]), *drawn[0][1:]), *drawn[1:])),
            "circuits holds 9; it must be from 0 to 0",
        ),
        (
            (DuelEnv,),
            changed(
                0, lambda games: games._replace(race=games.race._replace(tick=np.array([801])))
            ),
            "tick holds 801; a game stops at an even number",
        ),
        ((DuelEnv,), changed(0, lambda games: None), "the state has steps but no race"),
    ],
)
def test_an_impossible_state_is_one_error_and_changes_nothing(kinds, harm, message):
    for kind in kinds:
        env, twin = begun(make(kind), seed=3), make(kind)
        before = env.get_state()
        refused(message, env.set_state, harm(before))
        twin.set_state(before)
        assert np.array_equal(twin.batch.both_views(), env.batch.both_views())
        assert flat(env.step(act(env))) == flat(twin.step(act(twin)))


def test_a_number_out_of_range_is_named_with_the_end_of_its_own_circuit():
    lengths = np.array([[40.0], [20.0]])
    check_within("s", np.array([[0.0, 40.0], [0.0, 20.0]]), 0.0, lengths)
    for wrong in (20.5, -0.5):
        refused(
            f"s holds {wrong}; it must be from 0 to 20",
            check_within,
            "s",
            np.array([[5.0], [wrong]]),
            0.0,
            lengths,
        )


def leaves(part, path=()):
    """Every leaf of a state, and the way to it."""
    if isinstance(part, dict | list | tuple):
        for key in part if isinstance(part, dict) else range(len(part)):
            yield from leaves(part[key], (*path, key))
    else:
        yield path, part


def replaced(part, path, value):
    """A state with another leaf."""
    if not path:
        return value
    parts = part if isinstance(part, dict) else dict(enumerate(part))
    changed = {**parts, path[0]: replaced(parts[path[0]], path[1:], value)}
    if isinstance(part, dict):
        return changed
    return part._make(changed.values()) if hasattr(part, "_make") else type(part)(changed.values())


def broken(leaf):
    """Values that are never right in place of a leaf."""
    yield from ("yesterday", 1j, NAN, 10**40, np.zeros((2, 7, 1)), object())
    if isinstance(leaf, np.ndarray):
        yield from (None, leaf.tolist(), leaf.astype(complex), leaf[..., None], leaf[None])
        if leaf.dtype.kind == "f" and leaf.size:
            yield from (np.full_like(leaf, value) for value in (NAN, np.inf))
        if leaf.dtype.kind == "i" and leaf.dtype != np.int8:
            yield from (np.full_like(leaf, end) for end in (np.iinfo(leaf.dtype).max, -2))


@pytest.mark.parametrize(
    ("kind", "arguments", "many"),
    [
        *((kind, VARIED, False) for kind in ALL),
        *((kind, VARIED, True) for kind in SINGLE),
        (DriveEnv, {"opponent": "random-moves"}, True),
    ],
)
def test_a_state_with_one_wrong_leaf_is_refused_and_changes_nothing(kind, arguments, many):
    env = make_many(kind, 2, **arguments) if many else make(kind, **arguments)
    env.reset(seed=3)
    env.step(act(env))
    other = env.get_state()
    env.step(act(env))
    before = flat(env.get_state())
    remembered = ((3, 2), (3,))  # memories of opponents can be anything
    for path, leaf in leaves(other):
        if (
            path[0] == 0
            and leaf is None
            and any(path[1 : 1 + len(way)] == way for way in remembered)
        ):
            continue
        for value in broken(leaf):
            refused("the state", env.set_state, replaced(other, path, value))
        assert flat(env.get_state()) == before, path
    env.set_state(other)


@pytest.mark.parametrize("kind", SINGLE)
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"vehicle": {"mu": 0.8}}, "the state's cars have mu 0.8, this environment's 1.0489"),
        (
            {"vehicle": [{}, {"lf": 0.2}]},
            "the state's cars have lf 0.2, this environment's 0.15875",
        ),
        ({"track": "Brackwater"}, "the state's circuits have other content hashes"),
    ],
    ids=["friction", "second", "circuit"],
)
def test_a_state_of_other_cars_or_circuits_is_refused(kind, change, said):
    drawn = {"track": "Pipkin", "randomize": {"m": [3.0, 4.0]}}
    state = begun(kind(**drawn | change)).get_state()
    refused(said, kind(**drawn).set_state, state)
    kind(**drawn | change).set_state(state)


def test_unknown_agents_and_states_of_another_number_are_refused():
    refused(
        "agent 'car_2' is unknown; the agents are car_0, car_1",
        make(HeadToHeadEnv).action_space,
        "car_2",
    )
    for kind in SINGLE:
        envs, more = make_many(kind, 2), make_many(kind, 3)
        more.reset(seed=0)
        for wrong in (more.get_state(), "yesterday"):
            refused(
                "use a state of get_state|it must be a state of get_state",
                envs.set_state,
                wrong,
            )


@pytest.mark.parametrize(
    ("place", "value"), [("speed", 1e7), ("speed", 1e308), ("delay", 1e9), ("delay", -1e3)]
)
def test_a_state_that_would_end_the_process_is_refused(place, value):
    """A car beyond the grid within a step, and a command from outside of those kept."""
    env = DriveEnv(track="Pipkin", opponent=None)
    env.reset(seed=1)
    state = env.get_state()
    if place == "speed":
        state.batch[0].cars[0, 0, 3] = value
    else:
        state.batch[4][1][..., 16] = value
    before = flat(env.get_state())
    refused("must be from", env.set_state, state)
    assert flat(env.get_state()) == before
