import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError, load_rules, load_track
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game import characteristics as measures
from pcs_racing.planners.lattice import LATTICE, REFERENCE
from pcs_racing.race import races as racing, state as kept
from pcs_racing.race.races import draw_starts
from pcs_racing.race.start_grid import Starts
from pcs_racing.testing import check_characteristic


@pytest.fixture
def piece() -> measures.Segment:
    """Four races of 8 s; the others than the first ended after 2 s, 0.25 s and 3 s."""
    sums = np.zeros((4, 2, len(kept.SUMS)))
    sums[..., kept.TIME] = [[8.0, 8.0], [2.0, 2.0], [0.25, 0.25], [3.0, 3.0]]
    sums[..., kept.ITTC] = [[80.0, 160.0], [20.0, 0.0], [3.0, 0.0], [0.0, 0.0]]
    sums[..., kept.ITTC_SAMPLES] = [[160.0, 160.0], [40.0, 0.0], [0.0, 0.0], [60.0, 60.0]]
    sums[..., kept.STEERING] = [[4.0, 8.0], [1.0, 3.0], [1.0, 0.0], [0.0, 3.0]]
    sums[..., kept.BLOCKING] = [[2.0, 0.0], [0.0, 1.0], [0.25, 0.0], [3.0, 0.0]]
    sums[..., kept.PROFILE] = [[7.2, 6.0], [1.0, 2.0], [0.25, 0.0], [2.1, 1.8]]
    sums[..., kept.TIME_BEHIND] = [[2.0, 6.0], [0.5, 1.5], [0.0, 0.25], [1.0, 2.0]]
    sums[..., kept.PROFILE_BEHIND] = [[1.8, 4.8], [0.5, 1.2], [0.0, 0.0], [0.9, 1.6]]
    sums[..., kept.LATERAL] = [[32.0, 72.0], [8.0, 0.0], [2.0, 0.0], [0.0, 3.0]]
    progress = np.array([[40.0, 36.0], [8.0, 10.0], [1.0, 2.0], [6.0, 6.0]])
    return measures.Segment(progress, sums, np.array([8.0, 2.0, 0.25, 3.0]), 8.0)


def test_values_by_hand_and_the_check_for_everybody(piece):
    for name, expected in [
        ("aggressiveness", [[4.0, -4.0], [-2.0, 2.0], [-1.0, 1.0], [0.0, 0.0]]),
        # As if the crash had not cut it short; less than half a second counts as half of one, here
        # and below.
        ("pace", [[4.0, -4.0], [-8.0, 8.0], [-16.0, 16.0], [0.0, 0.0]]),
        ("restraint", [[0.5, 1.0], [0.5, 0.0], [3.0, 0.0], [0.0, 0.0]]),
        ("smoothness", [[-0.5, -1.0], [-0.5, -1.5], [-2.0, 0.0], [0.0, -1.0]]),
        ("blocking", [[0.25, 0.0], [0.0, 0.5], [0.5, 0.0], [1.0, 0.0]]),
        ("speed", [[0.9, 0.75], [0.5, 1.0], [0.5, 0.0], [0.7, 0.6]]),
        ("cornering", [[2.0, 3.0], [2.0, 0.0], [2.0, 0.0], [0.0, 1.0]]),
        # For less than a second in front or behind nothing is said.
        ("reaction", [[0.0, 0.2], [0.0, 0.0], [0.0, 0.0], [0.3, 0.6]]),
    ]:
        np.testing.assert_allclose(
            measures.measure(piece, measures.get_characteristics([name]))[..., 0], expected
        )
    for name in list(measures._registered):
        check_characteristic(measures.get_characteristics([name])[0])


def test_pieces_of_a_race_add_up():
    """The lead is the sum over the pieces; restraint is their mean, weighted by samples."""
    config = load_rules("paper", duration=4.0)
    track = load_track("Pipkin")
    setup = racing.RaceSetup(track, config, (REFERENCE, REFERENCE))
    state = racing.start_races(setup, draw_starts(track, config, 4, 0), race_seeds(0, 4))
    theta = np.tile(LATTICE.default, (4, 2, 1))
    moments = [state.copy()]
    for _ in range(2):
        racing.advance(setup, state, theta, 200)
        moments.append(state.copy())
    axes = measures.get_characteristics(["aggressiveness", "restraint"])
    first, second, whole = (
        measures.measure(measures.Segment.between(moments[a], moments[b], 2.0 * (b - a)), axes)
        for a, b in ((0, 1), (1, 2), (0, 2))
    )
    going = ~state.crashed
    assert going.any()
    piece = measures.Segment.between(moments[0], moments[1], 2.0)
    np.testing.assert_allclose(piece.time[going], 2.0)
    np.testing.assert_allclose((first + second)[going, :, 0], whole[going, :, 0], atol=1e-9)
    np.testing.assert_allclose(((first + second) / 2)[going, :, 1], whole[going, :, 1])
    np.testing.assert_allclose(whole[:, 0, 0], -whole[:, 1, 0])


def test_a_pooled_characteristic_is_measured_on_the_race_so_far(piece):
    speed, reaction = measures.get_characteristics(["speed", "reaction"])
    later = measures.Segment(piece.progress, 2.0 * piece.sums, 2.0 * piece.time, 8.0)
    values = measures.measure(piece, [speed, reaction], later)
    np.testing.assert_array_equal(values[..., 0], speed.evaluate(piece))
    np.testing.assert_array_equal(values[..., 1], reaction.evaluate(later))
    # it was behind for a second by now
    assert reaction.evaluate(piece)[1, 0] == 0.0 < values[1, 0, 1]


@pytest.mark.parametrize(
    ("evaluate", "message"),
    [
        (lambda segment: segment.progress[:, 0], r"returns shape \(5,\)"),
        (lambda segment: segment.progress.astype(int), "type int64"),
        (lambda segment: segment.sums[..., kept.STEERING] / segment.time[:, None], "of 0.0 s"),
        (lambda segment: segment.progress - segment.progress.mean(), "depends on the other races"),
        (lambda segment: segment.progress * [1.0, 2.0], "do not change places"),
        (lambda segment: segment.progress.__imul__(2.0), "writes to the segment"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value encountered")
def test_the_check_finds_what_is_wrong(evaluate, message):
    with pytest.raises(AssertionError, match=f"characteristic 'mine'.*{message}"):
        check_characteristic(measures.Characteristic("mine", "m", "wrong", evaluate))


@pytest.mark.usefixtures("own_registry")
def test_a_characteristic_is_known_by_its_name_and_impossible_names_are_refused():
    mine = measures.Characteristic(
        "mine", "m", "half the progress", lambda segment: 0.5 * segment.progress
    )
    measures.register_characteristic(mine)
    measures.register_characteristic(mine)  # again: nothing happens
    assert measures.get_characteristics(["mine"]) == (mine,)
    with pytest.raises(InputError, match="named 'mine' exists already"):
        measures.register_characteristic(
            measures.Characteristic("mine", "m", "another", lambda segment: segment.progress)
        )
    for names, message in [
        ([], "name at least one"),
        (["speed", "speed"], "each once"),
        (["charm"], "'charm' is unknown"),
    ]:
        refused(message, measures.get_characteristics, names)
    assert issubclass(UnknownNameError, InputError)


PACES = (0.0, 0.5, 1.0)
TOLERANCE = 0.04  # between the slowest and the fastest of the circuits, for one policy


def pieces(name, paces, rules="paper", seconds=12.0, skip=4.0):
    """Speed and lead gained, m, of both cars in races of two paces each: shape (B, 2, 2)."""
    track = load_track(name)
    config = load_rules(
        rules, duration=seconds, start="rolling", start_gap=min(0.5 * track.length, 50.0)
    )
    setup = racing.RaceSetup(track, config, (REFERENCE, REFERENCE))
    starts = Starts(np.zeros(len(paces)), np.zeros(len(paces), np.int64))
    state = racing.start_races(setup, starts, race_seeds(0, len(paces)))
    theta = np.array(
        [[REFERENCE.policy({"pace": pace}).parameters for pace in pair] for pair in paces]
    )
    racing.advance(setup, state, theta, round(100 * skip))
    before = state.copy()
    racing.advance(setup, state, theta, round(100 * (seconds - skip)))
    assert not state.crashed.any()
    axes = measures.get_characteristics(["speed", "aggressiveness"])
    return measures.measure(measures.Segment.between(before, state, seconds - skip), axes)


@pytest.fixture(scope="module")
def alone():
    """Speed of each of PACES on three circuits, half a lap from the other car: shape (3, 3)."""
    names = ("Brackwater", "Kestrelheim", "Pipkin")
    return np.array([pieces(name, [(pace, pace) for pace in PACES])[:, 0, 0] for name in names])


def test_pace_is_the_same_speed_on_every_circuit_whatever_a_far_opponent_does(alone):
    assert np.ptp(alone, axis=0).max() < TOLERANCE
    assert np.diff(alone, axis=1).min() > 2.0 * TOLERANCE
    assert (np.diff(alone, axis=1) > 0.0).all()
    # A car brakes for a bend a little earlier than the profile.
    np.testing.assert_allclose(alone[:, -1], 0.975, atol=0.025)
    slow, fast = pieces("Larkmoor", [(0.5, 0.0), (0.5, 1.0)])[:, 0, 0]
    assert slow == pytest.approx(fast, abs=1e-9)
