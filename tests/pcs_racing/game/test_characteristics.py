import numpy as np
import pytest

from pcs_racing import InputError, UnknownNameError, draw_starts, load_race_config, load_track
from pcs_racing.game.characteristics import (
    Characteristic,
    Segment,
    _registered,
    get_characteristics,
    measure,
    register_characteristic,
)
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race import races as racing
from pcs_racing.race.state import (
    BLOCKING,
    ITTC,
    ITTC_SAMPLES,
    PROFILE,
    PROFILE_BEHIND,
    STEERING,
    SUMS,
    TIME,
    TIME_BEHIND,
)
from pcs_racing.testing import check_characteristic


@pytest.fixture
def piece() -> Segment:
    """Two races of 8 s; the second ended after 2 s."""
    sums = np.zeros((2, 2, len(SUMS)))
    sums[..., TIME] = [[8.0, 8.0], [2.0, 2.0]]
    sums[..., ITTC] = [[80.0, 160.0], [20.0, 0.0]]
    sums[..., ITTC_SAMPLES] = [[160.0, 160.0], [40.0, 0.0]]
    sums[..., STEERING] = [[4.0, 8.0], [1.0, 3.0]]
    sums[..., BLOCKING] = [[2.0, 0.0], [0.0, 1.0]]
    sums[..., PROFILE] = [[7.2, 6.0], [1.0, 2.0]]
    sums[..., TIME_BEHIND] = [[2.0, 6.0], [0.5, 1.5]]
    sums[..., PROFILE_BEHIND] = [[1.8, 4.8], [0.5, 1.2]]
    return Segment(np.array([[40.0, 36.0], [8.0, 10.0]]), sums, np.array([8.0, 2.0]), 8.0)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("aggressiveness", [[4.0, -4.0], [-2.0, 2.0]]),
        ("pace", [[4.0, -4.0], [-8.0, 8.0]]),  # as if the crash had not cut it short
        ("restraint", [[0.5, 1.0], [0.5, 0.0]]),
        ("smoothness", [[-0.5, -1.0], [-0.5, -1.5]]),
        ("blocking", [[0.25, 0.0], [0.0, 0.5]]),
        ("speed", [[0.9, 0.75], [0.5, 1.0]]),
        ("reaction", [[0.0, 0.2], [0.0, 0.0]]),  # for less than a second in front or behind nothing is said
    ],
)
def test_values_by_hand(piece, name, expected):
    np.testing.assert_allclose(measure(piece, get_characteristics([name]))[..., 0], expected)


def test_pieces_of_a_race_add_up():
    """Lead of the whole is the sum over the pieces; restraint is their mean, weighted by samples."""
    config = load_race_config("paper", duration=4.0)
    track = load_track("Pipkin")
    setup = racing.RaceSetup(track, config, (LATTICE, LATTICE))
    state = racing.start_races(setup, draw_starts(track, config, 4, 0), racing.race_seeds(0, 4))
    theta = np.tile(LATTICE.default, (4, 2, 1))
    moments = [state.copy()]
    for _ in range(2):
        racing.advance(setup, state, theta, 200)
        moments.append(state.copy())
    axes = get_characteristics(["aggressiveness", "restraint"])
    first, second, whole = (
        measure(Segment.between(moments[a], moments[b], 2.0 * (b - a)), axes) for a, b in ((0, 1), (1, 2), (0, 2))
    )
    going = ~state.crashed
    assert going.any()
    piece = Segment.between(moments[0], moments[1], 2.0)
    np.testing.assert_allclose(piece.time[going], 2.0)
    np.testing.assert_allclose((first + second)[going, :, 0], whole[going, :, 0], atol=1e-9)
    np.testing.assert_allclose(((first + second) / 2)[going, :, 1], whole[going, :, 1])
    np.testing.assert_allclose(whole[:, 0, 0], -whole[:, 1, 0])


def test_a_pooled_characteristic_is_measured_on_the_race_so_far(piece):
    speed, reaction = get_characteristics(["speed", "reaction"])
    later = Segment(piece.progress, 2.0 * piece.sums, 2.0 * piece.time, 8.0)
    values = measure(piece, [speed, reaction], later)
    np.testing.assert_array_equal(values[..., 0], speed.evaluate(piece))
    np.testing.assert_array_equal(values[..., 1], reaction.evaluate(later))
    assert reaction.evaluate(piece)[1, 0] == 0.0 < values[1, 0, 1]  # it was behind for a second by now


@pytest.mark.parametrize("name", list(_registered))
def test_ours_pass_the_check_for_everybody(name):
    check_characteristic(get_characteristics([name])[0])


@pytest.mark.parametrize(
    ("evaluate", "message"),
    [
        (lambda segment: segment.progress[:, 0], r"returns shape \(5,\)"),
        (lambda segment: segment.progress.astype(int), "type int64"),
        (lambda segment: segment.sums[..., STEERING] / segment.time[:, None], "of 0.0 s"),
        (lambda segment: segment.progress - segment.progress.mean(), "depends on the other races"),
        (lambda segment: segment.progress * [1.0, 2.0], "do not change places"),
        (lambda segment: segment.progress.__imul__(2.0), "writes to the segment"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value encountered")
def test_the_check_finds_what_is_wrong(evaluate, message):
    with pytest.raises(AssertionError, match=f"characteristic 'mine'.*{message}"):
        check_characteristic(Characteristic("mine", "m", "wrong", evaluate))


@pytest.mark.usefixtures("own_registry")
def test_a_characteristic_is_known_by_its_name():
    mine = Characteristic("mine", "m", "half the progress", lambda segment: 0.5 * segment.progress)
    register_characteristic(mine)
    register_characteristic(mine)  # again: nothing happens
    assert get_characteristics(["mine"]) == (mine,)
    with pytest.raises(InputError, match="named 'mine' exists already"):
        register_characteristic(Characteristic("mine", "m", "another", lambda segment: segment.progress))


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([], "name at least one"),
        (["speed", "speed"], "each once"),
        (["charm"], "'charm' is unknown"),
    ],
)
def test_impossible_names_are_one_clear_error(names, message):
    with pytest.raises(InputError, match=message):
        get_characteristics(names)
    assert issubclass(UnknownNameError, InputError)
