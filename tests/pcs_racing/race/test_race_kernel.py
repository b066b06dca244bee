"""Counts and faults of a race, against a second account of it in a few lines of numpy.

All of it also runs as plain Python (``NUMBA_DISABLE_JIT=1``) in little time: ``nox -s coverage``
runs it that way.
"""

import numpy as np
import pytest
from placed_cars import BETA, DELTA, PSI, PSI_DOT, V, X, Y, placed, view_of

from pcs_racing import load_rules
from pcs_racing.base.compilation import compiled
from pcs_racing.base.seeds import normal_noise
from pcs_racing.car.collision import Rectangle
from pcs_racing.car.ittc import Motion, minimum_ittc
from pcs_racing.car.vehicle import F1TENTH, VehicleParams, load_vehicle, simulate
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.view import VIEW
from pcs_racing.race.driving import advance
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.positions import move_along
from pcs_racing.race.races import RaceSetup, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import CAR_CRASH, NO_CRASH, SUMS, WALL_CRASH, empty_state
from pcs_racing.race.steering import delayed
from pcs_racing.track.frenet import SPEED

COLUMN = {name: k for k, name in enumerate(SUMS)}
PERIOD = 0.02  # s, between two commands

# Two cars without a common number, so that none can replace the other's.
SHORT = VehicleParams(mu=1.0, c_sf=4.5, c_sr=5.3, lf=0.15, lr=0.17, h=0.07, width=0.30, length=0.50)
LONG = VehicleParams(
    mu=1.05, c_sf=4.7, c_sr=5.5, lf=0.16, lr=0.18, h=0.08, width=0.36, length=0.70, steer_max=0.4
)
CARS = (SHORT, LONG)


def change_lanes(track, theta, view, memory):
    """Along the race line at a speed that swells and falls; out of the other one's way while it is
    near.
    """
    seen = dict(zip(VIEW, view, strict=True))
    sample = track.line[int(seen["S"] / track.arrays.ds) % len(track.line)]
    lane = theta[2] if abs(seen["GAP"]) < 1.8 else 0.0
    turn = np.mod(sample[4] - seen["PSI"] + np.pi, 2.0 * np.pi) - np.pi
    return 1.2 * turn - 0.8 * (seen["D"] - lane) + 0.33 * sample[5], theta[0] + theta[1] * np.sin(
        seen["TIME"]
    )


LANES = (
    ("speed", 0.0, 9.0, 4.0, "m/s"),
    ("swell", -3.0, 3.0, 0.0, "m/s"),
    ("lane", -1.0, 1.0, 0.0, "m"),
)
DRIVER = Planner("lanes", tuple(Parameter(*one) for one in LANES), drive=change_lanes)
START = {"start": "staggered", "start_gap": 2.4, "start_spacing": 0.0}
RULES = load_rules("paper", **START, steering_noise=0.02, noise_time=0.5, duration=9.0)


class Account:
    """Compute the course of a race once more from the places of the cars."""

    def __init__(self, setup, state):
        self.setup, self.state = setup, state
        self.sums, self.overtakes, self.leader = np.zeros((2, len(SUMS))), [0, 0], None
        self.disturbance, self.progress = np.zeros(2), state.progress[0].copy()

    def drive(self, theta):
        """Drive for a control period, by the kernel and here."""
        setup, state, rules = self.setup, self.state, self.setup.rules
        tick, cars, s = int(state.tick[0]), state.cars[0].copy(), state.frenet[0, :, 0].copy()
        views = [view_of(setup, state, 0, car) for car in range(2)]
        advance(setup, state, theta, 2)

        asked = np.array(
            [change_lanes(setup.track, theta[0, car], views[car], None) for car in range(2)]
        )
        keep = np.exp(-PERIOD / rules.noise_time)
        draws = np.array([normal_noise(state.seed[0], car, tick) for car in range(2)])
        self.disturbance = (
            keep * self.disturbance + rules.steering_noise * np.sqrt(1.0 - keep**2) * draws
        )
        np.testing.assert_allclose(state.disturbance[0], self.disturbance, atol=1e-12)
        np.testing.assert_allclose(
            state.command[0], asked + np.outer(self.disturbance, [1, 0]), atol=1e-12
        )

        given = zip(cars, state.command[0], setup.vehicles, strict=True)
        ways = [
            simulate(car, np.tile(command, (2, 1)), params=vehicle)
            for car, command, vehicle in given
        ]
        np.testing.assert_allclose(state.cars[0], [way[2] for way in ways], atol=1e-9)
        at = setup.track.to_frenet(state.cars[0][:, :2])
        np.testing.assert_allclose(state.frenet[0], at, atol=1e-6)
        length = setup.track.length
        led = self.progress[::-1] > self.progress
        self.progress += np.mod(at[:, 0] - s + 0.5 * length, length) - 0.5 * length
        np.testing.assert_allclose(state.progress[0], self.progress, atol=1e-5)

        lead = self.progress[0] - self.progress[1]
        if abs(lead) > setup.vehicles[0].length:
            ahead = 0 if lead > 0.0 else 1
            self.overtakes[ahead] += self.leader == 1 - ahead
            self.leader = ahead
        in_the_way = abs(at[0, 1] - at[1, 1]) < 0.5 * (
            setup.vehicles[0].width + setup.vehicles[1].width
        )
        for car, (before, _, after) in enumerate(ways):
            own_lead = lead if car == 0 else -lead
            self.sums[car, COLUMN["BLOCKING"]] += PERIOD * (in_the_way and 0.0 < own_lead < 3.0)
            self.sums[car, COLUMN["STEERING"]] += abs(after[DELTA] - before[DELTA])
            self.sums[car, COLUMN["LATERAL"]] += (after[V] * after[PSI_DOT]) ** 2 * PERIOD
            self.sums[car, COLUMN["TIME"]] += PERIOD
            driven = np.mod(at[car, 0] - s[car] + 0.5 * length, length) - 0.5 * length
            profile = setup.track.line[
                int(at[car, 0] / setup.track.arrays.ds) % len(setup.track.line), SPEED
            ]
            self.sums[car, COLUMN["PROFILE"]] += driven / (setup.speed_range[1] * profile)
            self.sums[car, COLUMN["TIME_BEHIND"]] += PERIOD * led[car]
            self.sums[car, COLUMN["PROFILE_BEHIND"]] += (
                driven / (setup.speed_range[1] * profile) * led[car]
            )
        for k in (1, 2):
            if (tick + k) % 5 == 0:
                for car in range(2):
                    self.sums[car, COLUMN["ITTC"]] += time_to_collision(
                        setup, car, ways[car][k], ways[1 - car][k]
                    )
                    self.sums[car, COLUMN["ITTC_SAMPLES"]] += 1
        return at


def velocity(car):
    return car[V] * np.cos(car[PSI] + car[BETA]), car[V] * np.sin(car[PSI] + car[BETA])


def time_to_collision(setup, car, own, other):
    s = float(setup.track.to_frenet(own[:2])[0])
    half = 0.5 * setup.vehicles[1 - car].length, 0.5 * setup.vehicles[1 - car].width
    horizon = setup.rules.ittc_horizon
    lidar = Motion(own[X], own[Y], *velocity(own))
    body = Rectangle(other[X], other[Y], other[PSI], *half)
    return minimum_ittc(setup.track.arrays, lidar, s, body, *velocity(other), True, horizon)


def test_a_race_counts_what_a_second_account_of_it_counts(coarse_oval):
    """Two cars that pass each other, block each other and change lanes, over the start line."""
    setup = RaceSetup(coarse_oval, RULES, (DRIVER, DRIVER), CARS)
    starts = Starts(np.array([coarse_oval.length - 5.0]), np.array([1]))  # car 1 in front
    state = start_races(setup, starts, np.array([5], np.uint64))
    theta = np.array([[[3.6, 1.6, 0.35], [3.5, -1.6, -0.35]]])
    account, moments = Account(setup, state), []
    for _ in range(RULES.ticks // 2):
        moments.append(account.drive(theta))
        assert not state.crashed.any()
        np.testing.assert_allclose(state.sums[0], account.sums, rtol=1e-6, atol=1e-9)
        assert state.overtakes[0].tolist() == account.overtakes
        assert state.leader[0] == (-1 if account.leader is None else account.leader)
    # The race had all that is counted.
    assert min(account.overtakes) >= 1
    assert (account.sums[:, COLUMN["BLOCKING"]] > 0.5).all()
    assert (account.sums[:, COLUMN["BLOCKING"]] < 8.0).all()
    assert np.ptp(moments, axis=0)[:, 0].min() > 0.9 * coarse_oval.length  # over the start line
    np.testing.assert_allclose(account.sums[:, COLUMN["TIME"]], 9.0)
    assert (account.sums[:, COLUMN["PROFILE"]] > 3.0).all()
    np.testing.assert_array_equal(account.sums[:, COLUMN["ITTC_SAMPLES"]], 9.0 * 20)


def test_a_view_says_where_both_cars_are_and_what_they_are(coarse_oval):
    setup = RaceSetup(coarse_oval, RULES, (DRIVER, DRIVER), CARS)
    state = start_races(setup, Starts(np.array([10.0]), np.array([0])), np.array([5], np.uint64))
    theta = np.array([[[3.6, 1.6, 0.35], [3.5, -1.6, -0.35]]])
    advance(setup, state, theta, 150)
    for car in range(2):
        own, other = state.cars[0, car], state.cars[0, 1 - car]
        (s, d), (other_s, other_d) = (
            coarse_oval.to_frenet(own[:2]),
            coarse_oval.to_frenet(other[:2]),
        )
        body, rival = CARS[car], CARS[1 - car]
        # The growth rate of its distance from the line: by moving it a little along its
        # course.
        later = coarse_oval.to_frenet(other[:2] + 1e-4 * np.array(velocity(other)))[1]
        stiffness = body.mu * 9.81
        expected = {
            "TIME": 1.5,
            "X": own[X],
            "Y": own[Y],
            "DELTA": own[DELTA],
            "V": own[V],
            "PSI": own[PSI],
            "PSI_DOT": own[PSI_DOT],
            "BETA": own[BETA],
            "S": s,
            "D": d,
            "OPP_X": other[X],
            "OPP_Y": other[Y],
            "OPP_V": other[V],
            "OPP_PSI": other[PSI],
            "OPP_BETA": other[BETA],
            "OPP_S": other_s,
            "OPP_D": other_d,
            "GAP": state.progress[0, 1 - car] - state.progress[0, car],
            "LENGTH": body.length,
            "WIDTH": body.width,
            "WHEELBASE": body.wheelbase,
            "STEER_MAX": body.steer_max,
            "UNDERSTEER": (1.0 / body.c_sf - 1.0 / body.c_sr) / stiffness,
            "UNDERSTEER_GAIN": (
                body.h
                * (1.0 / (body.c_sf * body.lr) + 1.0 / (body.c_sr * body.lf))
                / stiffness
                / 9.81
            ),
            "REAR_SLIP": 1.0 / (stiffness * body.c_sr),
            "REAR_AXLE": body.lr,
            "GRIP_USE": 0.0,
            "SPEED_LAG": 0.1,
            "OPP_LENGTH": rival.length,
            "OPP_WIDTH": rival.width,
            "SPEED_LOW": 0.8,
            "SPEED_HIGH": 1.0,
            "LIDAR_FOV": 2.0 * np.pi,
        }
        of_poses = [name for name in VIEW if name.startswith("TRUE_")]
        expected |= {name: expected[name.removeprefix("TRUE_")] for name in of_poses}
        seen = dict(zip(VIEW, view_of(setup, state, 0, car), strict=True))
        assert seen.pop("OPP_D_DOT") == pytest.approx((later - other_d) / 1e-4, abs=0.15)
        perfect = dict.fromkeys(
            set(seen) - set(expected), 0.0
        )  # the lidar, no handicap, a prompt steering
        assert len(perfect) == 11
        assert seen == pytest.approx(expected | perfect, abs=1e-6)


def test_a_view_has_the_stiffness_and_the_grip_of_pacejka_tyres(coarse_oval):
    car = load_vehicle("f1tenth-pacejka")
    setup, state, _ = placed(coarse_oval, [(10.0, 0.0), (12.0, 0.0)], vehicles=(car, SHORT))
    fast = setup.settings._replace(speed_low=0.9, speed_high=1.2)
    views = [np.zeros(len(VIEW)) for _ in range(2)]
    rows = np.stack([car.as_row(), SHORT.as_row()])
    for i, view in enumerate(views):
        fill_view(coarse_oval.arrays, state, 0, i, rows, fast, view)
    sliding, linear = (dict(zip(VIEW, view, strict=True)) for view in views)
    front, rear = car.b_f * car.c_f * car.d_f, car.b_r * car.c_r * car.d_r
    assert sliding["REAR_SLIP"] == pytest.approx(1.0 / (car.mu * 9.81 * rear))
    assert sliding["UNDERSTEER"] == pytest.approx((1.0 / front - 1.0 / rear) / (car.mu * 9.81))
    # The rear axle slides first, when the car brakes by 5.5 m/s^2; 0.65 of that may be used.
    usable = 0.65 * car.mu * car.d_r * (9.81 - 5.5 * car.h / car.lf)
    assert sliding["GRIP_USE"] == pytest.approx(1.0 / usable)
    assert sliding["SPEED_HIGH"] == pytest.approx(np.sqrt(usable / 5.0))  # of the race line
    assert sliding["SPEED_LOW"] == pytest.approx(0.75 * sliding["SPEED_HIGH"])
    assert (linear["GRIP_USE"], linear["SPEED_LOW"], linear["SPEED_HIGH"]) == (0.0, 0.9, 1.2)


def test_noise_is_the_sum_of_four_parts_and_a_command_is_due_after_its_delay():
    """With whole numbers of Python's, which do not overflow."""

    def scrambled(key):
        key = (key ^ (key >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        key = (key ^ (key >> 27)) * 0x94D049BB133111EB % 2**64
        return key ^ (key >> 31)

    for seed, car, tick in ((0, 0, 0), (7, 1, 0), (2**63 + 5, 0, 398), (12345, 1, 7998)):
        key = scrambled((seed + 0x9E3779B97F4A7C15 * (2 * tick + car + 1)) % 2**64)
        key = scrambled((key + 0xD1B54A32D192ED03) % 2**64)
        parts = [(key >> shift) % 65536 / 65535 for shift in (0, 16, 32, 48)]
        # four uniform numbers have the variance 4 / 12
        expected = (sum(parts) - 2.0) * np.sqrt(3.0)
        assert normal_noise(np.uint64(seed), car, tick) == pytest.approx(expected, abs=1e-12)
    # The queue is at the end of the driver's memory; the rest belongs to the driver.
    memory, queue = np.array([9.0, 9.0, 0.0, 0.0, 0.0]), getattr(delayed, "py_func", delayed)
    assert [queue(memory, 3.0, 2 * k, k + 1.0, 0.0) for k in range(8)] == [
        0.0,
        0.0,
        0.0,
        1.0,
        2.0,
        3.0,
        4.0,
        5.0,
    ]
    assert memory[:2].tolist() == [9.0, 9.0]


def crash_and_fault(state):
    return state.crash[0].tolist(), state.fault[0].tolist()


def test_a_wall_is_the_fault_of_the_car_that_stands_in_it(coarse_oval):
    for places, crash, fault in [
        ([(2.0, 0.0), (6.0, 0.0)], [NO_CRASH, NO_CRASH], [0, 0]),
        ([(2.0, 1.15), (6.0, 0.0)], [WALL_CRASH, NO_CRASH], [1, 0]),
        ([(2.0, 0.0), (6.0, 1.15)], [NO_CRASH, WALL_CRASH], [0, 1]),
        ([(2.0, -1.15), (6.0, 1.15)], [WALL_CRASH, WALL_CRASH], [1, 1]),
        ([(6.0, 1.15), (6.3, 1.0)], [WALL_CRASH, NO_CRASH], [1, 0]),  # and in each other
        ([(6.0, 0.0), (6.5, 0.0)], [CAR_CRASH, CAR_CRASH], [1, 1]),  # both stand
    ]:
        setup, state, theta = placed(coarse_oval, places)
        state.crash[:] = NO_CRASH
        advance(setup, state, theta, 2)
        assert crash_and_fault(state) == (crash, fault)


@pytest.mark.parametrize("order", [1, -1])
def test_a_car_that_runs_into_a_wall_is_blamed_alone(coarse_oval, order):
    """It steers to the side on the straight while the other one is in the middle."""
    setup, state, theta = placed(
        coarse_oval, [(3.0, 0.0, 0.6), (9.0, 0.0)][::order], [4.0, 0.0][::order]
    )
    advance(setup, state, theta, 200)
    blamed = [1, 0][::order]
    assert crash_and_fault(state) == ([WALL_CRASH * own for own in blamed], blamed)
    assert 0 < state.tick[0] < 200
    after = state.copy()
    advance(setup, state, theta, 100)  # nothing moves any more
    for one, other in zip(state, after, strict=True):
        np.testing.assert_array_equal(one, other)


def test_each_car_is_as_long_and_as_wide_as_its_own_parameters_say(coarse_oval):
    """A long and a short car in one place after the other, until they touch or reach a wall."""
    for vehicles in ((SHORT, LONG), (LONG, SHORT)):
        lengths = 0.5 * (vehicles[0].length + vehicles[1].length)
        widths = 0.5 * (vehicles[0].width + vehicles[1].width)
        for apart, touch in ((-0.01, True), (0.01, False)):
            _, state, _ = placed(
                coarse_oval, [(5.0, 0.0), (5.0 + lengths + apart, 0.0)], vehicles=vehicles
            )
            assert state.crashed[0] == touch
            _, state, _ = placed(
                coarse_oval, [(5.0, 0.0), (5.0, widths + apart)], vehicles=vehicles
            )
            assert state.crashed[0] == touch
        for car, vehicle in enumerate(vehicles):
            for side in (-1.0, 1.0):
                clear = [
                    wall_at(coarse_oval, 6.0, side) - 0.5 * vehicle.width - into
                    for into in (0.02, -0.02)
                ]
                for d, hit in zip(clear, (False, True), strict=True):
                    places = [(11.0, 0.0), (11.0, 0.0)]
                    places[car] = (6.0, side * d)
                    _, state, _ = placed(coarse_oval, places, vehicles=vehicles)
                    assert state.crash[0].tolist() == [
                        WALL_CRASH * int(hit and k == car) for k in range(2)
                    ]


def wall_at(track, s, side):
    """Distance from the race line to the nearest wall, from the wall segments."""
    x, y, psi = track.to_cartesian([s, 0.0])
    ax, ay, bx, by = (track.arrays.walls - [x, y, x, y]).T
    across = side * np.array([-np.sin(psi), np.cos(psi)])
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (ax * by - ay * bx) / (across[0] * (by - ay) - across[1] * (bx - ax))
        along = (ax * across[1] - ay * across[0]) / (across[0] * (by - ay) - across[1] * (bx - ax))
    return way[(way > 0.0) & (along >= 0.0) & (along <= 1.0)].min()


def lead_by(track, leads, vehicles=(F1TENTH, F1TENTH)):
    """Overtakes and the leader after car 0 led by so much, moment after moment."""
    setup, state, theta = placed(track, [(4.0, -0.4), (4.0, 0.4)], vehicles=vehicles)
    for lead in leads:
        state.progress[0] = 4.0 + lead, 4.0
        advance(setup, state, theta, 2)
        assert not state.crashed.any()
    return state.overtakes[0].tolist(), int(state.leader[0])


def test_a_pass_counts_once_the_car_leads_by_more_than_its_length(coarse_oval):
    own = F1TENTH.length
    assert lead_by(coarse_oval, [0.0, 0.5]) == ([0, 0], -1)  # no car has led yet
    # side by side, and a bit ahead: not yet
    assert lead_by(coarse_oval, [-1.0, own - 0.01]) == ([0, 0], 1)
    assert lead_by(coarse_oval, [-1.0, own + 0.01]) == ([1, 0], 0)
    assert lead_by(coarse_oval, [1.0, 0.1, -0.1, 0.1, -own - 0.01]) == ([0, 1], 1)
    # it never lost the lead by a length
    assert lead_by(coarse_oval, [1.0, -0.5, 1.0]) == ([0, 0], 0)
    assert lead_by(coarse_oval, [1.0, -1.0, 1.0, 2.0, -1.0]) == ([1, 2], 1)
    assert lead_by(coarse_oval, [-1.0, 0.6], vehicles=(SHORT, F1TENTH)) == ([1, 0], 0)
    assert lead_by(coarse_oval, [-1.0, 0.6], vehicles=(LONG, F1TENTH)) == ([0, 0], 1)


@pytest.mark.parametrize(
    ("ahead", "beside", "blocking"),
    [
        (1.0, 0.0, True),
        (2.95, 0.0, True),
        (3.05, 0.0, False),  # its reach is 3 m
        (3.95, 0.0, False),
        (1.0, 0.30, True),
        (1.0, 0.36, False),  # not in its way: half of the two widths is 0.33
        (1.0, -0.30, True),
        (1.0, -0.36, False),
    ],
)
@pytest.mark.parametrize("order", [1, -1])
def test_blocking_is_credited_to_the_car_ahead(coarse_oval, order, ahead, beside, blocking):
    poses = [(3.0 + ahead, 0.15 + beside), (3.0, 0.15)][::order]
    setup, state, theta = placed(coarse_oval, poses, vehicles=CARS)
    advance(setup, state, theta, 20)
    np.testing.assert_allclose(state.sums[0, :, COLUMN["BLOCKING"]], [0.2 * blocking, 0.0][::order])


def test_a_lap_ends_at_the_line_within_a_control_period_and_who_rolls_back_drives_none():
    """The first crossing is half way through 0.02 s, the second 20/21 of the way."""
    state, length = empty_state(1, 0, laps=3), 100.0
    moved = state.frenet, state.progress, state.laps
    # a metre before the end of the first lap
    state.frenet[0, 1, 0] = state.progress[0, 1] = -1.0 % length
    for tick, s in (
        (3000, 1.0),
        (3010, 99.5),
        (3020, 0.5),
        (6000, 40.0),
        (6500, 80.0),
        (7002, 1.0),
        (7004, 99.0),
    ):
        move_along(length, *moved, tick, 0, 1, s, 0.0)
    assert state.lap_count.tolist() == [[0, 2]]
    assert state.progress[0, 1] == pytest.approx(199.0)
    first, second = 29.99, 70.02 - 0.02 / 21.0
    assert state.lap_time[0, 1] == pytest.approx(second - first)
    assert state.best_lap[0, 1] == pytest.approx(first)
    expected = [[np.nan] * 3, [first, second - first, np.nan]]
    np.testing.assert_allclose(state.lap_times[0], expected)


def test_planners_are_asked_ten_and_fifty_times_a_second_before_the_cars_move(coarse_oval):
    setup = RaceSetup(
        coarse_oval, load_rules("paper", duration=1.0, start_speed=0.0), (COUNTER, COUNTER)
    )
    state = start_races(setup, Starts(np.array([2.0]), np.array([0])), np.array([0], np.uint64))
    for ticks in (2, 10, 22, 66, 40):
        advance(setup, state, np.zeros((1, 2, 1)), ticks)
        done = min(int(state.tick[0]), 100)
        expected = [np.ceil(done / 10), np.ceil(done / 2)]
        np.testing.assert_array_equal(
            state.memory[0], [[*expected, 0.01 * (np.ceil(done / 2) * 2 - 2)]] * 2
        )
        # The second call of each car sees the path that its own plan has written.
        np.testing.assert_array_equal(state.path[0, :, 0, 0], expected[0])
    assert state.tick[0] == 100


@compiled
def count_plans(track, theta, view, memory, scratch, path):
    memory[0] += 1.0
    path[0, 0] = memory[0]


@compiled
def count_commands(track, theta, view, memory, scratch, path, command):
    memory[1] += 1.0
    memory[2] = view[0]
    command[0] = 0.0
    command[1] = 0.0


COUNTER = Planner("counter", (), count_plans, count_commands, memory_size=3)
