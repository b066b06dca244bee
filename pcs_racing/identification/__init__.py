"""The parameters of a car from its log: tyres, lags and limits."""

from pcs_racing.car.vehicle import load_vehicle
from pcs_racing.identification.fitting import (
    Identification,
    identify,
    write_vehicle,
    yaw_rate_error,
)
from pcs_racing.identification.logs import DrivingLog, write_log
from pcs_racing.identification.reading import read_log
from pcs_racing.identification.recording import SensorNoise, record_test_drive

__all__ = [
    "DrivingLog",
    "Identification",
    "SensorNoise",
    "identify",
    "load_vehicle",
    "read_log",
    "record_test_drive",
    "write_log",
    "write_vehicle",
    "yaw_rate_error",
]
