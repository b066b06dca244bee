import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusal import refused

from pcs_racing import InputError
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners import view as views
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.pursuit import COMMAND_SLOTS, follow_path, pursuit_steering, steady_course

PACE = Parameter("pace", 0.0, 1.0, 0.5, "how fast")
AIR = Parameter("air", 0.05, 0.35, 0.15, "how far away, m")
PLANNER = Planner("example", (PACE, AIR), variants={"brave": (0.9, 0.1)})


def test_parameters_and_planners_check_themselves():
    for low, high, default in [
        (1.0, 0.0, 0.5),
        (0.0, 0.0, 0.0),
        (0.0, np.inf, 1.0),
        (np.nan, 1.0, 0.5),
    ]:
        refused("parameter 'x' has bounds", Parameter, "x", low, high, default, "")
    for default in [-0.1, 1.1, np.nan]:
        refused("parameter 'x' has default", Parameter, "x", 0.0, 1.0, default, "")
    refused("planner 'p' names a parameter twice: pace, pace", Planner, "p", (PACE, PACE))
    refused("planner 'p' has memory_size -1", Planner, "p", (), memory_size=-1)
    refused("planner 'p' has sight nan", Planner, "p", (), sight=float("nan"))
    assert PLANNER.memory_total == 0
    assert (
        Planner("p", (), drive=lambda *_: (0.0, 0.0), memory_size=3).memory_total
        == 3 + COMMAND_SLOTS
    )
    assert len(views.VIEW) == views.VIEW_SIZE
    assert all(meaning for meaning in views.VIEW.values())


def test_a_policy_keeps_a_vector_of_its_own():
    assert PLANNER.parameter_names == ("pace", "air")
    np.testing.assert_array_equal(PLANNER.bounds, [[0.0, 1.0], [0.05, 0.35]])
    np.testing.assert_array_equal(PLANNER.policy().parameters, [0.5, 0.15])
    np.testing.assert_array_equal(PLANNER.policy({"air": 0.2}).parameters, [0.5, 0.2])
    np.testing.assert_array_equal(PLANNER.policy("brave").parameters, [0.9, 0.1])
    np.testing.assert_array_equal(PLANNER.policy([0.1, 0.2]).parameters, [0.1, 0.2])
    assert PLANNER.policy("brave").name == "example:brave"
    assert PLANNER.policy({"air": 0.2}, name="wide").name == "wide"
    vector = np.array([0.1, 0.2])
    policy = PLANNER.policy(vector)
    vector[0] = 0.9
    assert policy.parameters[0] == 0.1
    refused("read-only", policy.parameters.fill, 0.9, error=ValueError)
    refused("policy 'p' has parameters of shape", Policy, PLANNER, np.zeros(3), "p")
    assert (PLANNER.policy().name, PLANNER.policy(name="mine").name) == ("example", "mine")


@given(st.integers(0, 2**32 - 1))
def test_samples_are_policies(seed):
    theta = PLANNER.sample(np.random.default_rng(seed))
    assert PLANNER.policy(theta).parameters.tolist() == theta.tolist()
    np.testing.assert_array_equal(PLANNER.sample(np.random.default_rng(seed)), theta)


def test_fixed_parameters_keep_their_defaults_and_vectors_are_completed():
    one, other = np.random.default_rng(3), np.random.default_rng(3)
    theta = PLANNER.sample(one, fixed=("pace",))
    np.testing.assert_array_equal(theta, [PACE.default, other.uniform(AIR.low, AIR.high)])
    assert one.random() == other.random()
    assert PLANNER.without(("pace",)) == ("air",)
    refused("no parameter 'speed'", PLANNER.sample, one, fixed=("speed",), error=UnknownNameError)
    np.testing.assert_array_equal(
        PLANNER.complete(("air",), [[0.2], [0.3]]), [[0.5, 0.2], [0.5, 0.3]]
    )
    np.testing.assert_array_equal(PLANNER.complete(("air", "pace"), [[0.2, 0.9]]), [[0.9, 0.2]])
    np.testing.assert_array_equal(PLANNER.complete(("air",), [[0.2]], [0.7, 0.1]), [[0.7, 0.2]])
    refused("no parameter 'speed'", PLANNER.complete, ("speed",), [[0.2]], error=UnknownNameError)


def test_bad_parameters_are_refused():
    for parameters, error, message in [
        ([0.5], InputError, r"shape \(1,\); planner 'example'"),
        ([[0.5, 0.1]], InputError, r"shape \(1, 2\)"),
        ([np.nan, 0.1], InputError, "parameter 'pace' is nan"),
        ([np.inf, 0.1], InputError, "parameter 'pace' is inf"),
        ([0.5, 0.5], InputError, r"parameter 'air' is 0.5"),
        ({"speed": 1.0}, UnknownNameError, "no parameter 'speed'"),
        ({"pace": "high"}, InputError, "parameter 'pace' of planner 'example' is 'high'"),
        (["high", 0.1], InputError, "they must be numbers"),
        ("timid", UnknownNameError, "no variant 'timid'"),
    ]:
        refused(message, PLANNER.policy, parameters, error=error)


@pytest.fixture
def view() -> np.ndarray:
    """A car in the origin that drives along x at 4 m/s."""
    view = np.zeros(views.VIEW_SIZE)
    view[views.OWN_V], view[views.WHEELBASE], view[views.STEER_MAX] = 4.0, 0.33, 0.4
    return view


def test_pure_pursuit_drives_the_arc_along_the_course_of_a_steady_bend(view):
    def steering(x, y, kappa=0.0):
        return pursuit_steering(view, steady_course(view, kappa), x, y, kappa, 0.0)

    radius = 3.0
    x, y = radius * np.sin(0.3), radius * (1.0 - np.cos(0.3))  # on the circle that the car touches
    assert steering(x, y) == pytest.approx(np.arctan(0.33 / radius))
    assert steering(x, -y) == pytest.approx(-np.arctan(0.33 / radius))
    assert steering(x, 0.0) == 0.0
    assert steering(0.1, 5.0) <= 0.4  # the limit of the car
    # Heading and slip of the bend that cancel leave the steering as it was; the slip of the moment
    # says nothing.
    view[views.REAR_AXLE], view[views.REAR_SLIP] = 0.17, 0.02
    usual = steering(1.0, 0.2)
    view[views.OWN_PSI] = -0.5 * (0.17 - 0.02 * 4.0**2)
    assert steady_course(view, 0.5) == pytest.approx(0.0, abs=1e-12)
    assert steering(1.0, 0.2, 0.5) == pytest.approx(usual)
    view[views.OWN_BETA] = 0.1
    assert steering(1.0, 0.2, 0.5) == pytest.approx(usual)


def followed(path, view):
    """The command of the default control; it needs neither a track nor parameters, memory or
    scratch.
    """
    command, nothing = np.zeros(2), np.zeros(0)
    getattr(follow_path, "py_func", follow_path)(
        None, nothing, view, nothing, nothing, path, command
    )
    return command


def at_distance(values, away, wanted):
    """Value where a path is first so far from the car, between the points around that distance."""
    after = next((k for k in range(1, len(away)) if away[k] >= wanted), None)
    if after is None:
        return values[-1]
    share = np.clip((wanted - away[after - 1]) / max(away[after] - away[after - 1], 1e-9), 0.0, 1.0)
    return values[after - 1] + share * (values[after] - values[after - 1])


@pytest.mark.parametrize("seed", range(12))
def test_the_default_control_drives_through_a_point_ahead_at_the_speed_that_the_path_has_there(
    view, seed
):
    """Paths that bend, begin behind the car or end before the point; the car slides, and its tyres
    yield.
    """
    rng = np.random.default_rng(seed)
    v = view[views.OWN_V] = rng.uniform(0.5, 7.0)
    pose = [views.OWN_X, views.OWN_Y, views.OWN_PSI, views.OWN_BETA]
    view[pose] = rng.uniform(-2.0, 2.0, 4) * [1.0, 1.0, 1.0, 0.1]
    view[views.SPEED_LAG] = 0.1
    tyres = [views.UNDERSTEER, views.UNDERSTEER_GAIN, views.REAR_SLIP, views.REAR_AXLE]
    view[tyres] = 0.0028, -0.0004, 0.01, 0.17
    course = view[views.OWN_PSI] + view[views.OWN_BETA]
    t = np.linspace(-0.15, rng.uniform(0.2, 0.6), views.PATH_POINTS) * v
    bend = rng.uniform(-0.3, 0.3)
    x, y = t, 0.5 * bend * t**2 + rng.uniform(-0.05, 0.05)
    points = np.column_stack(
        [np.cos(course) * x - np.sin(course) * y, np.sin(course) * x + np.cos(course) * y]
    )
    speeds, bends = (
        v + rng.uniform(-1.0, 1.5, views.PATH_POINTS),
        bend + 0.1 * np.arange(views.PATH_POINTS),
    )
    path = np.column_stack([points + view[pose[:2]], speeds, bends])
    away = np.hypot(*(path[:, :2] - view[pose[:2]]).T)
    nearest = int(np.argmin(away))
    rest, away = path[nearest:], away[nearest:]

    # braking at 5.5 m/s^2 at most
    speed = max(at_distance(rest[:, views.PATH_SPEED], away, 0.1 * v), v - 0.55)
    reach = 0.3 + 0.1 * v
    goal = np.array([at_distance(rest[:, k], away, reach) for k in range(2)])
    past = next((k for k in range(1, len(away)) if away[k] >= reach), None)
    kappa = rest[-1 if past is None else past - 1, views.PATH_KAPPA]
    # The circle that touches the course and leads through the goal has the curvature 2 sin(angle) /
    # distance. In a steady bend the rear axle moves along the heading, but for the slip of its
    # tyres.
    course = view[views.OWN_PSI] + kappa * (0.17 - 0.01 * v**2)
    way = goal - view[pose[:2]]
    arc = 2.0 * np.sin(np.arctan2(way[1], way[0]) - course) / np.hypot(*way)
    yielding = 0.0028 - 0.0004 * min(10.0 * (speed - v), 9.5)
    steer = np.clip(np.arctan(0.33 * arc) + yielding * v**2 * kappa, -0.4, 0.4)
    np.testing.assert_allclose(followed(path, view), [steer, speed], atol=1e-9)
