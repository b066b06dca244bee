"""The command ``pcs-racing identify``."""

import pytest
from PIL import Image

from pcs_racing.car.vehicle import F1TENTH, load_vehicle
from pcs_racing.identification import SensorNoise, record_test_drive, write_log
from pcs_racing_agents.cli.main import main


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    log = record_test_drive(F1TENTH, 6.0, effort=0.2, noise=SensorNoise(), seed=1)
    return write_log(log, tmp_path_factory.mktemp("logs") / "drive.csv")


def test_a_car_and_a_picture_are_written(drive, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    out = tmp_path / "my_car.yaml"
    words = ["--given", "tyres=linear", "m=4", "c_sf=8", "--check", str(drive), "--out", str(out)]
    assert main(["identify", str(drive), *words]) == 0
    printed = capsys.readouterr().out
    car = load_vehicle(out)
    assert (car.m, car.tyres) == (4.0, "linear")
    assert car.c_sf == pytest.approx(F1TENTH.c_sf, rel=0.15)
    assert "a_max" in printed
    assert f"yaw rate of {drive}: " in printed
    with Image.open(tmp_path / "my_car.png") as picture:
        assert picture.size == (1200, 750)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--given", "m"], "--given holds 'm'; it must be like NAME=VALUE"),
        (["--given", "mass=3"], "unknown vehicle setting 'mass'"),
        (["--given", "m=-3"], "m is -3.0; it must be a number from 0.001"),
        (["--vehicle", "f1tenh"], "did you mean 'f1tenth'"),
        (["--topics", "/odom"], "--topics holds '/odom'"),
    ],
)
def test_mistakes_are_one_line_before_the_search(drive, tmp_path, capsys, words, message):
    out = tmp_path / "my_car.yaml"
    assert main(["identify", str(drive), *words, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()
