"""Small pieces of code that only long races compile: `nox -s coverage` runs them once more without
compilation.

A compiled function leaves no trace of its lines. With ``NUMBA_DISABLE_JIT=1`` these tests run as
plain Python, many times slower, so the circuit is coarse and the races are short. Other tests that
are quick enough run that way, too.
"""

import numpy as np
import pytest

from pcs_racing import CONTEST, PAPER, load_rules, racer, run_races
from pcs_racing.game.players import draw
from pcs_racing.race.races import draw_starts
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.curves import first_crossing, resample
from pcs_racing.track.mapping.circuits import generate_circuit


@pytest.mark.parametrize(
    "rival",
    ["lattice:pace=0.6", "lane-switcher:3", "lane-switcher:11", "pure-pursuit", "gap-follower"],
)
def test_a_second_of_racing(coarse_oval, rival):
    config = load_rules(CONTEST if "lane" in rival else PAPER, duration=1.0, start_lines=1)
    starts = draw_starts(coarse_oval, config, 1, 0)
    ended = run_races(
        coarse_oval,
        racer("lattice"),
        racer(rival),
        config,
        starts=starts,
        seed=0,
        threads=1,
    )
    assert np.isfinite(ended.lead).all()
    assert ended.time[0] > 0.3


def test_what_is_drawn_depends_on_what_was_seen_and_the_seed_alone():
    seen = np.random.default_rng(2).normal(size=(300, 4)).astype(np.float32)
    chances = np.tile([0.25, 0.0, 0.75], (300, 1))
    drawn = draw(chances, seen, 5)
    np.testing.assert_array_equal(draw(chances[7:9], seen[7:9], 5), drawn[7:9])
    assert (draw(chances, seen, 6) != drawn).any()
    assert abs(np.mean(drawn == 0) - 0.25) < 0.1


def test_a_generated_circuit_is_as_wide_as_it_says_and_its_race_line_keeps_clear():
    circuit = generate_circuit(1, width=3.0, length_range=(60.0, 70.0), resolution=0.2)
    assert 60.0 <= circuit.length <= 70.0
    assert first_crossing(circuit.raceline) == (-1, -1)
    middle, race = (resample(line[:, :2], 0.5) for line in (circuit.centerline, circuit.raceline))
    air = wall_clearance(middle, circuit.occupied, 0.2, circuit.origin, 3.0)
    np.testing.assert_allclose(air, 1.5, atol=0.3)
    assert wall_clearance(race, circuit.occupied, 0.2, circuit.origin, 1.0).min() >= 0.3
