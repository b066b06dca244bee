import hashlib
import pickle
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from refusal import refused

from pcs_racing import InputError, load_archive
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import save_archive
from pcs_racing.game.moves import (
    check_epsilon,
    duplicate_moves,
    duplicate_share,
    move,
    move_names,
    move_table,
    no_op_share,
)
from pcs_racing.planners import registry
from pcs_racing.planners.planner import Parameter, Planner

AXES = ("aggressiveness", "restraint")
COORDINATES = np.array([[0.0, 4.0], [2.0, 3.0], [6.0, 2.0], [8.0, 0.0], [10.0, -1.0]])


def archive(coordinates=COORDINATES, axes=AXES, **changes) -> PolicyArchive:
    values = {
        "name": "toy",
        "planner": "toy-planner",
        "parameter_names": ("a", "b"),
        "parameters": np.column_stack(
            [np.linspace(0.0, 1.0, len(coordinates)), np.zeros(len(coordinates))]
        ),
        "characteristics": axes,
        "coordinates": coordinates,
    }
    return PolicyArchive(**{**values, **changes})


@pytest.fixture
def toy_planner(monkeypatch):
    planner = Planner(
        "toy-planner",
        (Parameter("a", 0.0, 1.0, 0.5, "one"), Parameter("b", -1.0, 1.0, 0.0, "other")),
    )
    monkeypatch.setattr(registry, "_planners", {**registry._planners, planner.name: planner})
    return planner


def test_ideal_nadir_and_the_policies_that_stand_out():
    toy = archive()
    np.testing.assert_array_equal(toy.ideal, [10.0, 4.0])
    np.testing.assert_array_equal(toy.nadir, [0.0, -1.0])
    np.testing.assert_array_equal(toy.normalise([toy.ideal, toy.nadir]), [[1.0, 1.0], [0.0, 0.0]])
    np.testing.assert_allclose(toy.normalised[1], [0.2, 0.8])
    assert toy.select("aggressiveness") == 4
    assert toy.select("restraint") == 0
    assert toy.select() == 2
    refused("has no characteristic 'speed'", toy.select, "speed", error=UnknownNameError)


def test_a_move_goes_to_the_nearest_policy_and_the_table_lists_all_moves():
    toy = archive()
    # From (0.2, 0.8): 0.35 more aggressiveness asks for (0.55, 0.8); policy 2 at (0.6, 0.6) is
    # nearest.
    assert move(toy, 1, 0, 1, 0.35) == 2
    assert move(toy, 1, 0, -1, 0.35) == 0
    # off the end of the front: stays there
    np.testing.assert_array_equal(move(toy, [0, 4], 0, [-1, 1], 0.35), [0, 4])
    table = move_table(toy, (0.35, 0.7))
    names = move_names(toy, (0.35, 0.7))
    assert names == (
        "aggressiveness + 0.35",
        "aggressiveness - 0.35",
        "restraint + 0.35",
        "restraint - 0.35",
        "aggressiveness + 0.7",
        "aggressiveness - 0.7",
        "restraint + 0.7",
        "restraint - 0.7",
        "stay",
    )
    assert table.shape == (5, 9)
    for policy in range(5):
        for column, (step, axis, sign) in enumerate(
            (e, a, s) for e in (0.35, 0.7) for a in (0, 1) for s in (1, -1)
        ):
            assert table[policy, column] == move(toy, policy, axis, sign, step)
    np.testing.assert_array_equal(table[:, -1], np.arange(5))
    switches = ("aggressiveness +", "aggressiveness -", "restraint +", "restraint -")
    assert move_names(toy) == (*switches, "stay")


points = hnp.arrays(
    np.float64, st.tuples(st.integers(2, 12), st.just(3)), elements=st.integers(-5, 5).map(float)
)


def three(coordinates) -> PolicyArchive:
    return archive(
        coordinates, (*AXES, "smoothness"), ideal=np.full(3, 6.0), nadir=np.full(3, -6.0)
    )


@given(points, hnp.arrays(np.float64, (7, 3), elements=st.floats(-2.0, 3.0)))
def test_nearest_agrees_with_brute_force(coordinates, asked):
    toy = three(coordinates)
    for point, found in zip(asked, toy.nearest(asked), strict=True):
        distances = [float(np.sum((point - mine) ** 2)) for mine in toy.normalised]
        assert found == distances.index(min(distances))  # index() finds the first of equals


@given(points, st.floats(0.001, 3.0))
def test_more_of_a_characteristic_never_means_less_of_it(coordinates, epsilon):
    """The policy itself is nearer to its target than anything on the other side of it."""
    toy = three(coordinates)
    for axis in range(3):
        there = toy.normalised[move(toy, np.arange(len(toy)), axis, 1, epsilon), axis]
        assert (there >= toy.normalised[:, axis] - 1e-12).all()


def test_shares_of_useless_moves():
    toy = archive(np.array([[0.0, 1.0], [1.0, 0.0]]))
    # From (0, 1): aggressiveness + 0.6 asks for (0.6, 1) and stays, as do all the others; so it is
    # from (1, 0).
    assert no_op_share(toy, 0.6) == 1.0
    assert duplicate_share(toy, 0.6) == 6 / 8
    # A step of 3 asks for (3, 1), nearest to (1, 0), and for (0, -2), nearest to it too.
    np.testing.assert_array_equal(move_table(toy, 3.0)[0], [1, 0, 0, 1, 0])
    assert no_op_share(toy, 3.0) == 0.5
    assert duplicate_share(toy, 3.0) == 0.5
    table = np.random.default_rng(0).integers(0, 4, (30, 6))
    earlier = [[there in row[:k] for k, there in enumerate(row)] for row in table.tolist()]
    np.testing.assert_array_equal(duplicate_moves(table), earlier)
    # more than are compared at once
    points = np.random.default_rng(1).uniform(-0.5, 1.5, (2, 5000, 2))
    far = np.linalg.norm(points[..., None, :] - toy.normalised, axis=-1)
    np.testing.assert_array_equal(toy.nearest(points), far.argmin(axis=-1))


def test_policies_come_from_the_planner_unless_it_has_changed(toy_planner):
    policy = archive().policy(4)
    assert policy.planner is toy_planner
    assert policy.name == "toy[4]"
    np.testing.assert_array_equal(policy.parameters, [1.0, 0.0])
    explored = archive(
        explored_parameters=[[0.25, 1.0]], explored_coordinates=[[1.0, 1.0]]
    ).explored_policy(0)
    np.testing.assert_array_equal(explored.parameters, [0.25, 1.0])
    assert archive().family() is toy_planner
    refused("holds parameters a, c", archive(parameter_names=("a", "c")).family)
    with pytest.raises(InputError, match=r"policy 'toy\[1\]': parameter 'a' is 7"):
        archive(parameters=[[0.0, 0.0], [7.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]).family()


def test_parameters_that_an_archive_does_not_hold_have_the_planners_defaults(toy_planner):
    rows = np.linspace(0.0, 1.0, len(COORDINATES))[:, None]
    explored = {"explored_parameters": [[-1.0]], "explored_coordinates": [[1.0, 1.0]]}
    toy = archive(parameter_names=("b",), parameters=rows, **explored)
    assert toy.family() is toy_planner
    np.testing.assert_array_equal(toy.policy(4).parameters, [0.5, 1.0])
    np.testing.assert_array_equal(toy.explored_policy(0).parameters, [0.5, -1.0])
    np.testing.assert_array_equal(toy.complete(toy.parameters[:1]), [[0.5, 0.0]])
    refused("parameter_names are b, b", archive, parameter_names=("b", "b"))


def test_the_axes_can_be_chosen_and_tell_how_they_go_together():
    toy = archive()
    assert toy.correlations == {AXES: pytest.approx(np.corrcoef(COORDINATES.T)[0, 1])}
    axes = "aggressiveness, restraint (correlation -0.98)"
    assert repr(toy) == f"<PolicyArchive 'toy': 5 toy-planner policies, {axes}, rules 'paper'>"
    third = np.array([1.0, -1.0, 1.0, -1.0, 0.0])
    three = archive(np.column_stack([COORDINATES, third]), (*AXES, "speed"))
    expected = np.corrcoef(three.coordinates.T)
    assert list(three.correlations) == [AXES, (AXES[0], "speed"), (AXES[1], "speed")]
    np.testing.assert_allclose(list(three.correlations.values()), expected[np.triu_indices(3, 1)])
    one = toy.project(("restraint",))
    assert one.correlations == {}
    assert "policies, restraint, rules" in repr(one)
    constant = archive(
        [[0.0, 1.0], [2.0, 1.0]], parameters=[[0.0, 0.0], [1.0, 0.0]], ideal=[2, 2], nadir=[0, 0]
    )
    assert np.isnan(constant.correlations[AXES])
    toy = archive().project(("restraint",))
    np.testing.assert_array_equal(toy.coordinates, COORDINATES[:, 1:])
    np.testing.assert_array_equal(toy.ideal, [4.0])
    assert move_names(toy) == ("restraint +", "restraint -", "stay")
    spread = np.arange(10.0).reshape(5, 2)
    np.testing.assert_array_equal(
        archive(spread=spread).project(("restraint",)).spread, spread[:, 1:]
    )


@pytest.mark.parametrize(
    "keep",
    [
        lambda toy, folder: load_archive(save_archive(toy, folder)),
        lambda toy, _: pickle.loads(pickle.dumps(toy)),
    ],
)
def test_an_archive_reads_back_exactly(tmp_path, keep, toy_planner):
    explored = {"explored_parameters": [[0.1, 0.2]], "explored_coordinates": [[1.0, 2.0]]}
    toy = archive(**explored, settings={"seed": 3, "by": "hand"})
    measured = archive(
        spread=np.ones((5, 2)), own_crash=np.linspace(0.0, 1.0, 5), explored_own_crash=np.zeros(0)
    )
    for kept in (toy, measured):
        read = keep(kept, tmp_path / "new" / "folder")
        for key in kept.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(read, key), getattr(kept, key))
        assert not read.coordinates.flags.writeable


def test_the_content_hash_says_whether_two_archives_play_the_same_game(tmp_path, toy_planner):
    toy = archive()
    assert archive(name="other", settings={"seed": 3}).content_hash == toy.content_hash
    assert load_archive(save_archive(toy, tmp_path)).content_hash == toy.content_hash
    moved = COORDINATES + 1e-9 * COORDINATES**2
    others = [archive(moved), archive(ideal=[11.0, 4.0]), archive(parameters=np.ones((5, 2)))]
    others += [archive(planner="another"), toy.project(("restraint",)), toy.project(AXES[::-1])]
    assert len({other.content_hash for other in [toy, *others]}) == 7


def test_impossible_archives_questions_and_epsilons_are_one_clear_error():
    for changes, message in [
        (
            {"coordinates": np.zeros((4, 2)), "parameters": np.zeros((5, 2))},
            r"coordinates has shape \(4, 2\)",
        ),
        ({"coordinates": np.zeros((5, 2))}, r"aggressiveness .* 0 .nadir. to 0"),
        ({"coordinates": COORDINATES * np.nan}, r"coordinates holds nan at \(0, 0\)"),
        ({"parameters": np.zeros((5, 3))}, r"parameters has shape \(5, 3\)"),
        ({"parameters": np.zeros((0, 2))}, "holds no policy"),
        ({"parameters": [["x", "y"]] * 5}, "parameters is"),
        ({"characteristics": ("aggressiveness", "aggressiveness")}, "each once"),
        ({"characteristics": ("aggressiveness", "charm")}, "characteristic 'charm' is unknown"),
        ({"characteristics": "speed"}, "characteristics is 'speed'"),
        ({"name": ""}, "name is ''"),
        ({"ideal": [1.0, -2.0], "nadir": [0.0, 0.0]}, r"restraint .* 0 .nadir. to -2"),
        ({"settings": {"a": [1]}}, "settings holds 'a'"),
        ({"parameters": np.full((5, 2), 1j)}, "parameters is .*numbers"),
        *[({key: [1e300, 1.0]}, f"{key} holds 1e.300.*1000000000") for key in ("ideal", "nadir")],
        ({"coordinates": COORDINATES * 1e300}, "coordinates holds"),
        ({"own_crash": np.zeros(4)}, r"own_crash has shape \(4,\)"),
        ({"own_crash": np.full(5, -0.1)}, "own_crash holds -0.1"),
        (
            {"spread": np.where(np.arange(10).reshape(5, 2) == 6, np.nan, 1.0)},
            r"spread holds nan at \(3, 0\)",
        ),
    ]:
        refused(message, archive, **changes)
    for call, message in [
        (lambda toy: toy.nearest([[1.0, 2.0, 3.0]]), r"needs \(..., 2\)"),
        (lambda toy: toy.nearest([np.inf, 0.0]), "NaN or infinity"),
        (lambda toy: toy.policy(-1), "policy index is -1"),
        (lambda toy: toy.project(("speed",)), "no characteristic 'speed'"),
    ]:
        refused(message, call, archive())
    pairs = [(0.1, 0.1), (0.1, "x"), (0.3, True), (0.3, "0.2"), (0.3, -0.1)]
    for epsilon in [0.0, -1.0, 11.0, np.nan, "0.3", (), True, None, *pairs]:
        refused(r"epsilon is .*", check_epsilon, epsilon)
    for epsilon, steps in (
        (10, (10.0,)),
        ([0.2, 0.6], (0.2, 0.6)),
        (np.array([0.6, 0.2]), (0.6, 0.2)),
    ):
        assert check_epsilon(epsilon) == steps


def test_files_that_are_no_archive_and_damaged_ones_are_one_clear_error(tmp_path, toy_planner):
    refused(
        r"unknown archive 'nonsense'.*default", load_archive, "nonsense", error=UnknownNameError
    )
    refused("name or a folder", load_archive, 3)
    refused(r"can't read .*manifest.yaml", load_archive, tmp_path)
    for harm, message in [
        (lambda folder: (folder / "manifest.yaml").write_text("a: [1"), "not valid YAML"),
        (lambda folder: (folder / "manifest.yaml").write_text("- 1"), "no manifest of an archive"),
        (lambda folder: (folder / "archive.npz").write_bytes(b"half"), "digest differs"),
        (lambda folder: (folder / "archive.npz").unlink(), r"can't read .*archive.npz"),
        (damage(lambda m: m.update(version=9)), "version 9"),
        (damage(lambda m: m.update(surprise=1)), "unknown or missing surprise"),
        (damage(lambda m: m.pop("planner")), "unknown or missing planner"),
        (damage(lambda m: m.update(settings=[1])), "settings is"),
        (damage(lambda m: m.update(planner=2**63)), "planner 9223372036854775808 is unknown"),
        (damage(lambda m: m.update(parameter_names=["a"])), r"parameters has shape \(5, 2\)"),
        (swap_arrays, r"archive.npz (is no archive|holds)"),
    ]:
        save_archive(archive(), tmp_path)
        harm(tmp_path)
        refused(message, load_archive, tmp_path)


def damage(change):
    """An archive whose manifest was edited by hand."""

    def apply(folder):
        file = folder / "manifest.yaml"
        manifest = yaml.safe_load(file.read_text())
        change(manifest)
        file.write_text(yaml.safe_dump(manifest))

    return apply


def swap_arrays(folder):
    # a pickle: never read
    np.savez(folder / "archive.npz", parameters=np.array([{"a": 1}], dtype=object))
    damage(
        lambda m: m.update(
            arrays_sha256=hashlib.sha256((folder / "archive.npz").read_bytes()).hexdigest()
        )
    )(folder)


def test_missing_parameters_have_the_values_of_the_start():
    default = load_archive("default")
    assert default.settings["start"] == "lattice:early"
    names = ("parameters", "explored_parameters")
    fewer = {name: getattr(default, name)[:, :-1] for name in names}
    early = replace(default, parameter_names=default.parameter_names[:-1], **fewer)
    assert set(early.complete(early.parameters)[:, -1]) == {0.15}
    other = replace(early, settings={"start": "gap-follower"})
    refused("start is 'gap-follower'; it must be a policy", other.complete, early.parameters)
