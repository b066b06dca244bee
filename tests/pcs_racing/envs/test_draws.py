"""Draws of the cars' parameters: spelling, distributions, refusals."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base.errors import ConfigError
from pcs_racing.car.vehicle import F1TENTH, VehicleParams
from pcs_racing.envs.draws import (
    PARAMETERS,
    Randomization,
    cars_at_ends,
    draw_vehicles,
    load_randomization,
    with_values,
)

SPELLED = {
    "mu": [0.7, 1.1],
    "tyres": {"choice": ["linear", "pacejka"]},
    "each": {"steer_lag": {"normal": [0.1, 0.03]}, "speed_lag": {"log_uniform": [0.05, 0.5]}},
    "car_1": {"steer_delay": [0.0, 0.1], "speed_delay": {"choice": [0.0, 0.04]}},
}


def drawn(spelled, count=2000, cars=1):
    """Values of so many episodes, for each car by name."""
    randomization, generator = load_randomization(spelled), np.random.default_rng(0)
    return [randomization.draw(generator, cars) for _ in range(count)]


def column(name, spelled, count=2000):
    """Values of one field in so many episodes."""
    return np.array([cars[0][name] for cars in drawn({name: spelled}, count)])


def test_cars_share_a_draw_or_have_their_own():
    for first, second in drawn(SPELLED, 20, cars=2):
        assert first["mu"] == second["mu"]
        assert first["tyres"] == second["tyres"]
        assert first["steer_lag"] != second["steer_lag"]
        assert first["speed_lag"] != second["speed_lag"]
        assert set(second) - set(first) == {"steer_delay", "speed_delay"}


def test_a_draw_follows_from_the_order_of_the_fields_not_of_the_spelling():
    backwards = dict(reversed(SPELLED.items()))
    assert drawn(backwards, 5, cars=2) == drawn(SPELLED, 5, cars=2)
    values, generator = (
        drawn({"m": [3.0, 4.5], "mu": [0.6, 1.2]}, 1)[0][0],
        np.random.default_rng(0),
    )
    assert values == {
        "mu": 0.6 + (1.2 - 0.6) * generator.random(),
        "m": 3.0 + 1.5 * generator.random(),
    }


def test_a_range_is_uniform():
    values = column("mu", [0.6, 1.2])
    assert ((values >= 0.6) & (values <= 1.2)).all()
    np.testing.assert_allclose(np.quantile(values, [0.25, 0.5, 0.75]), [0.75, 0.9, 1.05], atol=0.03)
    assert (column("mu", 0.8, 3) == 0.8).all()


def test_a_logarithm_is_uniform():
    values = column("speed_lag", {"log_uniform": [0.05, 5.0]})
    np.testing.assert_allclose(np.median(np.log(values)), np.log(0.5), atol=0.15)
    np.testing.assert_allclose([values.min(), values.max()], [0.05, 5.0], rtol=0.02)


def test_a_normal_draw_is_cut_to_the_range_of_its_field():
    inner = column("mu", {"normal": [1.0, 0.1]})
    np.testing.assert_allclose([inner.mean(), inner.std()], [1.0, 0.1], atol=0.01)
    half = column("steer_lag", {"normal": [0.0, 0.1]})  # no lag is below 0
    assert (half > 0.0).all()
    assert half.mean() == pytest.approx(0.1 * np.sqrt(2.0 / np.pi), rel=0.05)
    wide = column("steer_lag", {"normal": [1.0, 1e6]})  # all but uniform
    np.testing.assert_allclose(np.quantile(wide, [0.25, 0.75]), [0.5, 1.5], atol=0.1)
    assert (column("mu", {"normal": [0.9, 0.0]}, 3) == 0.9).all()
    flat = column("mu", {"normal": [1.0, 1e308]})
    np.testing.assert_allclose(np.quantile(flat, [0.25, 0.75]), [2.5, 7.5], atol=0.5)
    # Delays beyond the cut are multiples, too.
    assert set(column("steer_delay", {"normal": [0.05, 0.001]}, 50)) == {0.04, 0.06}
    assert (column("steer_delay", {"normal": [0.04, 0.0]}, 3) == 0.04).all()


def test_delays_are_drawn_in_multiples():
    steps = [0.0, 0.02, 0.04, 0.06, 0.08, 0.1]
    values, counts = np.unique(column("steer_delay", [0.0, 0.1]), return_counts=True)
    assert values.tolist() == steps
    assert counts.min() > 250
    near = column("speed_delay", {"normal": [0.06, 0.01]})
    assert set(near) <= {0.02, 0.04, 0.06, 0.08, 0.1}
    assert np.mean(near == 0.06) == pytest.approx(0.68, abs=0.04)


def test_listed_values_are_equally_likely():
    values, counts = np.unique(
        column("tyres", {"choice": ["linear", "pacejka"]}), return_counts=True
    )
    assert values.tolist() == ["linear", "pacejka"]
    assert counts.min() > 900
    noises = column("steer_noise", {"choice": [None, 0.1]}, 100)
    assert set(noises) == {None, 0.1}  # None is the noise of the rules


def test_every_field_with_a_range_can_be_drawn():
    """Drawn at one end of its range, it makes a car."""
    assert set(VehicleParams._options) <= set(PARAMETERS)
    for name, option in VehicleParams._options.items():
        ends = [note.le for note in option.notes if hasattr(note, "le")]
        spelled = {name: ends[0] if ends else {"choice": ["pacejka"]}}
        car = draw_vehicles(load_randomization(spelled), (F1TENTH,), np.random.default_rng(0))[0]
        assert getattr(car, name) == (ends[0] if ends else "pacejka")


def test_a_drawn_mass_changes_the_inertia_unless_it_is_drawn():
    heavy = with_values(F1TENTH, {"m": 2.0 * F1TENTH.m})
    assert heavy.inertia == pytest.approx(2.0 * F1TENTH.inertia)
    assert with_values(F1TENTH, {"m": 5.0, "inertia": 0.1}) == VehicleParams(m=5.0, inertia=0.1)


def test_the_max_delays_cover_all_draws():
    most = load_randomization(SPELLED | {"car_0": {"speed_delay": [0.0, 0.065]}}).max_delays
    assert (most.steer_delay, most.speed_delay) == (0.1, 0.06)
    assert load_randomization({"steer_delay": {"normal": [0.0, 0.1]}}).max_delays.steer_delay == 0.5
    assert Randomization().max_delays == F1TENTH


def test_the_ends_of_all_draws_are_cars():
    spelled = {
        "m": [2.0, 8.0],
        "each": {"steer_max": {"normal": [0.4, 0.01]}},
        "car_1": {"mu": 0.9},
    }
    low, high = cars_at_ends(load_randomization(spelled), (F1TENTH, F1TENTH))
    assert [car.steer_max for car in (low[0], high[1])] == pytest.approx([0.35, 0.45])
    assert (low[0].m, high[1].m, low[0].mu, low[1].mu) == (2.0, 8.0, F1TENTH.mu, 0.9)
    only = cars_at_ends(load_randomization(spelled), (F1TENTH,), "mu", "m")[1][0]
    assert (only.m, only.steer_max) == (8.0, F1TENTH.steer_max)


def test_a_spelling_is_read_from_a_file_and_written_again(tmp_path):
    file = tmp_path / "cars.yaml"
    file.write_text("mu: [0.7, 1.1]\neach:\n  steer_lag: {normal: [0.1, 0.03]}\n")
    randomization = load_randomization(file)
    assert randomization.names == ("mu", "steer_lag")
    assert randomization.own == ("steer_lag",)
    plain = load_randomization(SPELLED).plain()
    assert plain == SPELLED
    assert load_randomization(load_randomization(plain)) == load_randomization(SPELLED)
    file.write_text("mu: [1.1, 0.7]\n")
    refused(r"cars.yaml: mu is \[1.1, 0.7\]", load_randomization, file, error=ConfigError)
    refused("none.yaml", load_randomization, tmp_path / "none.yaml", error=ConfigError)


@pytest.mark.parametrize(
    ("spelled", "message"),
    [
        ({"steering_delay": 0.1}, r"'steering_delay'.*did you mean 'steer_delay'"),
        ({"C_Sf": 4.0}, "did you mean 'c_sf'"),
        ({"car_8": {"mu": 1.0}}, "holds 'car_8'"),
        ({"each": {"each": {}}}, "holds 'each'"),
        ({"each": [0.5, 1.0]}, r"each is \[0.5, 1.0\]; it must be a mapping"),
        ({"mu": [1.0, 0.5]}, r"mu is \[1.0, 0.5\]; .* 0.01 <= low <= high <= 10"),
        ({"mu": [0.001, 0.5]}, "mu is .*0.01 <= low"),
        ({"mu": [np.nan, 0.5]}, "mu is .nan"),
        ({"mu": None}, "mu is None"),
        ({"mu": {"gauss": [1.0, 0.1]}}, "mu is {'gauss'.*one of log_uniform, normal and choice"),
        ({"mu": {"normal": [1.0, 0.1], "choice": [1.0]}}, "one of log_uniform"),
        ({"mu": {"normal": [1.0, -0.1]}}, "deviation from 0"),
        ({"mu": {"normal": [1.0, 10**400]}}, "deviation from 0 to 1e308"),
        ({"mu": {"normal": [11.0, 0.1]}}, "a mean from 0.01 to 10"),
        ({"mu": {"choice": []}}, "must be of a list of values"),
        ({"mu": {"choice": [1.0, 11.0]}}, "mu is 11.0; it must be a number from 0.01 to 10"),
        ({"steer_lag": {"choice": [None]}}, "steer_lag is None"),
        ({"steer_lag": {"log_uniform": [0.0, 1.0]}}, "1e-06 <= low <= high <= 2"),
        ({"steer_delay": [0.03, 0.035]}, "no multiple of 0.02"),
        ({"steer_delay": {"choice": [0.03]}}, "multiple of 0.02"),
        ({"tyres": [0, 1]}, r"tyres is \[0, 1\]; it must be choice"),
        ({"tyres": {"choice": ["soft"]}}, "tyres is 'soft'; it must be one of linear, pacejka"),
        ({"mu": 1.0, "each": {"mu": 1.0}}, "mu is drawn for all cars and for each"),
        ({"mu": 1.0, "car_1": {"mu": 1.0}}, "mu is drawn for all cars and for car_1"),
        ({"each": {"mu": 1.0}, "car_1": {"mu": 1.0}}, "mu is drawn for each and for car_1"),
    ],
)
def test_an_impossible_draw_is_one_line(spelled, message):
    refused(message, load_randomization, spelled, error=ConfigError)


def test_draws_of_a_missing_car_are_refused():
    randomization = load_randomization({"car_2": {"mu": 1.0}})
    randomization.check_cars(3)
    refused("for car_2; the cars are car_0, car_1", randomization.check_cars, 2, error=ConfigError)
    refused("the only car is car_0", randomization.check_cars, 1, error=ConfigError)
