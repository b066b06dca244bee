"""``pcs-racing identify``: find the parameters of a car from its log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pcs_racing.base.errors import InputError, say
from pcs_racing.base.settings import plain_settings
from pcs_racing.car.vehicle import VEHICLES, load_vehicle
from pcs_racing.identification.fitting import identify, write_vehicle, yaw_rate_error
from pcs_racing.identification.reading import read_log
from pcs_racing_agents.base.tables import aligned
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import can_draw, output_file

MAX_ERROR = 0.3  # of the yaw rate, above which a car does not explain its log


@command(
    "identify",
    "pcs-racing identify drive.csv --out my_car.yaml",
    "pcs-racing identify bag/ --vehicle forzaeth-nuc2 --given m=3.5 lf=0.16 lr=0.15 --out"
    " my_car.yaml",
)
def run(
    log: Annotated[Path, Option("log: .csv, .mcap (ROS 2) or its folder, or a replay (.json)")],
    *,
    vehicle: Annotated[
        str, Option(f"start car: {', '.join(VEHICLES)} or a YAML file", "CAR")
    ] = "f1tenth-pacejka",
    given: Annotated[
        Sequence[str], Option("known parameters, such as mass and geometry", "NAME=VALUE")
    ] = (),
    topics: Annotated[
        Sequence[str],
        Option("topics of a bag with several of a type: odom=, drive=, imu=", "NAME=TOPIC"),
    ] = (),
    car: Annotated[int, Option("car of a replay")] = 0,
    check: Annotated[
        Path | None, Option("another log, whose yaw rate the found car must predict", "LOG")
    ] = None,
    out: Annotated[Path, Option("file for the car (.yaml); a picture (.png) goes with it", "FILE")],
) -> None:
    """Find tyres, lags and limits of a car from its log."""
    target = output_file(out, ".yaml")
    start = load_vehicle(vehicle)
    changes = {name: _value(text) for name, text in _pairs("--given", given).items()}
    start = load_vehicle({**plain_settings(start), **changes}) if changes else start
    names = _pairs("--topics", topics)
    logs = [read_log(path, car=car, topics=names) for path in (log, check) if path is not None]
    say(f"{logs[0].duration:.0f} s of driving; the search takes about as long")
    found = identify(logs[0], start)
    print("\n".join(aligned(found.rows())))
    error = found.error("psi_dot")
    print(f"\nyaw rate of the log: {error:.1%} RMS error, noise included")
    if error > MAX_ERROR:
        say("warning: the found car does not explain the log; check its units, mass and geometry")
    if check is not None:
        print(f"yaw rate of {check}: {yaw_rate_error(found.vehicle, logs[1]):.1%} RMS error")
    print(f"car: {write_vehicle(found, target)}")
    if can_draw("the picture of the car"):
        from pcs_racing_agents.base.style import save_picture
        from pcs_racing_agents.watch.identification_picture import identification_picture

        picture = save_picture(identification_picture(found), target.with_suffix(".png"))
        print(f"picture: {picture}")


def _pairs(option: str, words: Sequence[str]) -> dict[str, str]:
    """Return names and values of words like ``m=3.5``."""
    pairs = [word.partition("=") for word in words]
    for word, (name, _, value) in zip(words, pairs, strict=True):
        if not name or not value:
            raise InputError(f"{option} holds {word!r}; it must be like NAME=VALUE")
    return {name: value for name, _, value in pairs}


def _value(text: str) -> Any:
    """Return a number, or the text if it is none."""
    try:
        return float(text)
    except ValueError:
        return text
