"""A network that chooses among the candidates of the lattice."""

import numpy as np
import pytest
from refusal import refused
from safetensors.numpy import load, save

from pcs_racing import load_track, racer, run_races
from pcs_racing.base.compilation import compiled
from pcs_racing.planners import candidates, line_ppo
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SPEEDS
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.learned import folder_kind, load_planner
from pcs_racing.planners.line_ppo import (
    CONTEXT,
    FEATURES,
    LATTICE_SIZE,
    LAYERS,
    MEMORY,
    MOVE,
    PAIR,
    PARAMETERS,
    SHARPNESS,
    SIDE_MARGINS,
    SPEED,
    STYLE,
    TOTAL,
    flat_weights,
    load_line_planner,
    plan_by_theta,
    read_line_planner,
    save_line_planner,
)
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.trained import PLANNER_FORMAT
from pcs_racing.planners.view import PATH_COLUMNS, PATH_POINTS

WHOLE = LATTICE.default
DEFAULT = np.array([one.default for one in PARAMETERS])


def tensors(size: float, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    shapes = {f"{name}.weight": shape for name, shape in LAYERS.items()}
    shapes |= {f"{name}.bias": shape[:1] for name, shape in LAYERS.items()}
    return {k: (size * rng.normal(size=shape)).astype(np.float32) for k, shape in shapes.items()}


def path_of(plan, track, theta, view, memory) -> np.ndarray:
    path = np.zeros((PATH_POINTS, PATH_COLUMNS))
    plan(track.arrays, theta, view, memory, np.empty(TOTAL), path)
    return path


@pytest.mark.parametrize("gap", [-5.0, 2.0, 5.0, 20.0])
def test_a_network_of_zeros_drives_as_the_lattice(oval, view_at, gap):
    _, assertiveness, pace, pace_behind = DEFAULT
    wide, narrow = SIDE_MARGINS
    same = {"pace": pace, "pace_behind": pace_behind}
    same["side_margin"] = wide + (narrow - wide) * assertiveness
    whole = LATTICE.policy(same).parameters
    theta = np.concatenate([DEFAULT, WHOLE, flat_weights(tensors(0.0))])
    memories = np.zeros((2, MEMORY))
    for s in (5.0, 5.4, 5.8):
        view = view_at(oval, s, 0.1, speed=4.0, gap=gap, opp_speed=3.0)
        own = path_of(plan_by_theta, oval, theta, view, memories[0])
        np.testing.assert_array_equal(own, path_of(LATTICE.plan, oval, whole, view, memories[1]))
        np.testing.assert_array_equal(*memories[:, : candidates.MEMORY])


@compiled
def _describe_and_choose(track, theta, view, memory, scratch):
    style, numbers = theta[:STYLE], theta[STYLE:]
    line_ppo.describe(track, numbers[:LATTICE_SIZE], style, view, memory, scratch)
    return line_ppo.choose(numbers[LATTICE_SIZE:], scratch)


def test_the_choice_is_the_candidate_with_the_max_score(oval, view_at):
    own = tensors(0.3)
    theta, scratch = np.concatenate([DEFAULT, WHOLE, flat_weights(own)]), np.empty(TOTAL)
    chosen = set()
    for s in np.arange(0.0, oval.length, 2.0):
        view = view_at(oval, s, 0.2, speed=4.0, gap=2.0, opp_speed=3.0)
        found = _describe_and_choose(oval.arrays, theta, view, np.zeros(MEMORY), scratch)
        chosen.add(found)
        ends = np.cumsum([CONTEXT, MOVE * GOALS, SPEED * SPEEDS, PAIR * CANDIDATES])
        features = scratch[line_ppo.FIRST : line_ppo.FIRST + ends[-1]]
        context, moves, speeds, pairs = np.split(features, ends[:-1])
        each = np.concatenate(
            [
                np.tile(moves.reshape(MOVE, GOALS), SPEEDS),
                np.repeat(speeds.reshape(SPEED, SPEEDS), GOALS, axis=1),
                pairs.reshape(PAIR, CANDIDATES),
            ]
        )
        assert each.shape == (FEATURES, CANDIDATES)

        def dense(name: str, x: np.ndarray) -> np.ndarray:
            bias = own[f"{name}.bias"].reshape(-1, *[1] * (x.ndim - 1))
            return own[f"{name}.weight"].astype(np.float64) @ x + bias

        inner = np.tanh(dense("context", context))
        hidden = dense("situation", inner)[:, None] + dense("candidate", each)
        score = dense("score", np.maximum(hidden, 0.0))[0] + dense("weights", inner) @ each
        score -= SHARPNESS * each[-1]
        assert found == np.where(each[-1] < 0.0, -np.inf, score).argmax()
    assert len(chosen) > 3


def test_what_is_saved_is_read(tmp_path, oval, view_at):
    own = tensors(0.3)
    folder = save_line_planner(tmp_path / "mine", own, name="mine", training={"choices": 7})
    fields, numbers = read_line_planner(folder)
    np.testing.assert_array_equal(numbers, np.concatenate([WHOLE, flat_weights(own)]))
    assert (fields["name"], fields["training"]) == ("mine", {"choices": 7})
    planner, view = load_line_planner(folder), view_at(oval, 5.0, gap=3.0)
    np.testing.assert_array_equal(
        path_of(planner.plan, oval, planner.default, view, np.zeros(MEMORY)),
        path_of(plan_by_theta, oval, np.append(DEFAULT, numbers), view, np.zeros(MEMORY)),
    )


def test_the_memory_holds_the_opponents_speed_while_it_is_in_sight(oval, view_at):
    theta, memory = np.concatenate([DEFAULT, WHOLE, flat_weights(tensors(0.0))]), np.zeros(MEMORY)
    path_of(plan_by_theta, oval, theta, view_at(oval, 5.0, gap=3.0, opp_speed=2.5), memory)
    speed, _, usual = memory[candidates.MEMORY :]
    assert speed == 2.5
    assert usual < 0.0  # slower than the profile
    path_of(plan_by_theta, oval, theta, view_at(oval, 5.0, gap=-13.0, opp_speed=2.5), memory)
    np.testing.assert_array_equal(memory[candidates.MEMORY :], 0.0)


def test_a_style_out_of_bounds_is_refused():
    refused("'risk' is 2; it must lie", racer, "line-ppo:risk=2")
    refused("no parameter 'boldness'", racer, "line-ppo:boldness=1")


def test_a_higher_pace_drives_faster():
    track, slow = load_track("Pipkin"), racer("pure-pursuit:pace=0")
    results = [
        run_races(track, [racer(f"line-ppo:{style}")] * 24, slow, "contest", seed=3)
        for style in ("pace=0.2", "pace=1.4")
    ]
    slower, faster = (result.state.progress[:, 0].mean() for result in results)
    assert faster > 1.15 * slower


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"score.bias": np.zeros(2, np.float32)}, r"score.bias has shape \(2,\); .* has \(1,\)"),
        ({"other": np.zeros(2, np.float32)}, r"other has shape \(2,\); .* has None"),
        ({"score.bias": np.zeros(1)}, "score.bias is of type float64; it must be float32"),
        ({"score.bias": np.full(1, np.nan, np.float32)}, "within 100"),
    ],
)
def test_weights_of_another_form_are_refused(tmp_path, changes, message):
    content = save(tensors(0.1) | changes)
    assert load(content)
    refused(message, line_ppo._read_tensors, tmp_path, content)


def test_a_parameter_out_of_bounds_is_refused(tmp_path):
    refused(
        "'pace' is 2; it must lie",
        save_line_planner,
        tmp_path / "mine",
        tensors(0.1),
        lattice={"pace": 2.0},
        training={},
    )


@pytest.mark.parametrize("name", ["line-ppo", "lidar-ppo"])
def test_each_kind_is_loaded_from_its_folder(name):
    folder = PLANNER_FORMAT.find(name)
    planner, shipped = load_planner(folder), get_planner(name)
    assert planner.name == str(folder)
    assert (planner.plan, planner.parameters) == (shipped.plan, shipped.parameters)


def test_a_folder_of_another_kind_is_refused(tmp_path):
    (tmp_path / "manifest.yaml").write_text("format: pcs-racing archive\n")
    assert folder_kind(tmp_path) == "archive"
    refused("is a folder of 'archive'; it must be of lidar", load_planner, tmp_path)
