"""Drawing circuits as plain Python: what measures walls, finds crossings and bounds the race line."""

import numpy as np
import pytest

from pcs_racing import MapError
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.curves import first_crossing, resample
from pcs_racing.track.mapping.circuits import generate_circuit
from pcs_racing.track.track import build_track


def test_a_generated_circuit_is_as_wide_as_it_says_and_its_race_line_keeps_clear():
    circuit = generate_circuit(1, width=3.0, length_range=(60.0, 70.0), resolution=0.2)
    assert 60.0 <= circuit.length <= 70.0
    assert first_crossing(circuit.raceline) == (-1, -1)
    middle, race = (resample(line[:, :2], 0.5) for line in (circuit.centerline, circuit.raceline))
    air = wall_clearance(middle, circuit.occupied, 0.2, circuit.origin, 3.0)
    np.testing.assert_allclose(air, 1.5, atol=0.3)
    assert wall_clearance(race, circuit.occupied, 0.2, circuit.origin, 1.0).min() >= 0.3


def test_a_circuit_must_not_cross_itself():
    t = np.linspace(0.0, 2.0 * np.pi, 101)[:-1]
    eight = 8.0 * np.column_stack([np.sin(t), np.sin(2.0 * t)])
    line = np.column_stack([eight, np.full((100, 2), 0.5)])
    with pytest.raises(MapError, match="crosses itself"):
        build_track("eight", np.zeros((100, 100), np.bool_), 0.2, (-10.0, -10.0), line, eight)
