"""The hidden battery and the series with faults: rules, replies in a made-up model, a cell."""

import numpy as np
import pytest

from pcs_racing import load_track
from studies.battery.command import GOAL, VARIANTS, gain, make_row
from studies.battery.faults import FAULTS, chances, series, series_gain
from studies.battery.model import (
    ENDS,
    GRID,
    Model,
    fixed_reply,
    model_score,
    reply_values,
    start_score,
    visits,
)
from studies.battery.play import ARMS, Cell, plan_support, run_cell
from studies.battery.rules import BOOST, CHARGE, GAPS, HOLD, Rules, gap_bins
from studies.battery.spenders import SPENDERS, population

SMALL = Rules(energy=(8.0, 16.0), step=8.0, charge=0.5)


def made_up_model(rules: Rules) -> Model:
    """Return a model in which a car gains a bin by each move that is faster than the opponent's."""
    pace = {HOLD: 0, BOOST: 1, CHARGE: -1}
    found = np.zeros((3, GAPS, rules.moves, rules.moves, GAPS + 2))
    for gap, a, b in np.ndindex(found.shape[1:4]):
        found[:, gap, a, b, min(max(gap + pace[a] - pace[b], 0), GAPS - 1)] = 1.0
    return Model(rules, found)


@pytest.fixture(scope="module")
def model() -> Model:
    return made_up_model(SMALL)


@pytest.fixture(scope="module")
def plans(model):
    return population(model)


def test_units_of_energy():
    rules = VARIANTS["base"]
    assert (rules.steps, rules.cost, rules.full) == (20, 2, (2, 6, 12))
    assert rules.after(2).tolist() == [[0, 1, 2], [0, 0, 0], [1, 2, 2]]
    assert VARIANTS["no-charge"].after(1).tolist() == [[0, 1], [0, 0]]
    far, near = gap_bins(np.array([-9.0, 7.9]))
    assert rules.works(2)[far].tolist() == [False] * 3
    assert rules.works(2)[near].tolist() == [False, False, True]
    assert VARIANTS["no-distance"].works(2)[far].tolist() == [False, False, True]


def test_a_boost_that_does_not_work_is_holding():
    moves, gaps, left = np.array([BOOST, BOOST, CHARGE]), np.array([7, 7, 7]), np.array([2, 1, 0])
    assert SMALL.effective(moves, gaps, left).tolist() == [BOOST, HOLD, CHARGE]


def test_ways_of_spending(plans):
    for full, own in zip(SMALL.full, plans, strict=True):
        tables = dict(zip(SPENDERS, own, strict=True))
        for table in own:
            np.testing.assert_allclose(table.sum(axis=1), 1.0)
            assert not table[:, BOOST][:, ~SMALL.works(full)].any()
        assert tables["early"][0, BOOST, 7, full] == 1.0
        assert tables["late"][:, BOOST, 7, full].tolist() == [0.0] * (5 - full // 2) + [1.0] * (
            full // 2
        )
        assert tables["behind"][2, BOOST, :, full].tolist()[6:8] == [1.0, 0.0]


def test_forward_and_backward_give_one_score(model, plans):
    """Against an opponent without chance the best moves earn their value."""
    full = SMALL.full[1]
    opponent = (SMALL.full[0], plans[0][0])
    values = reply_values(model, full, opponent)
    spread = visits(model, full, plans[1][0], opponent)
    np.testing.assert_allclose(spread.sum(axis=(1, 2, 3)), 1.0)
    best = start_score(values)
    known = fixed_reply(model, full, [opponent], plans[1], gap=True)
    assert model_score(model, full, known, opponent) == pytest.approx(best)
    assert all(model_score(model, full, plan, opponent) <= best + 1e-9 for plan in plans[1])


def test_more_knowledge_is_never_worse(model, plans):
    opponents = [(full, one) for full, own in zip(SMALL.full, plans, strict=True) for one in own]
    full = SMALL.full[0]
    told = np.mean([start_score(reply_values(model, full, one)) for one in opponents])
    score = {}
    for gap in (False, True):
        table = fixed_reply(model, full, opponents, plans[0], gap)
        score[gap] = np.mean([model_score(model, full, table, one) for one in opponents])
    plain = max(
        np.mean([model_score(model, full, plan, one) for one in opponents]) for plan in plans[0]
    )
    assert plain <= score[True] + 1e-3
    assert score[False] <= score[True] + 1e-3
    assert score[True] <= told + 1e-9


def test_the_support_of_a_game_with_a_dominant_plan_is_one(model, plans):
    never = [
        [np.eye(3)[[HOLD] * 5][:, :, None, None] * np.ones((GAPS, full + 1))] for full in (2, 4)
    ]
    some = [own[1:2] + idle for own, idle in zip(plans, never, strict=True)]
    assert plan_support(model, some).tolist() == [1, 1]
    assert ENDS[GRID].tolist() == [1.0, 0.0]


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell(load_track("Pipkin"), "lattice", SMALL, 2, 2, 2, seed=3, arms=("gap", "shown"))


def test_a_cell(cell):
    found = run_cell(cell)
    scores = found["scores"]
    assert scores.shape == (len(ARMS), 2, 2, 2, 12, 3)
    assert np.isin(scores[1:3], (0.0, 0.5, 1.0)).all()
    assert np.isnan(scores[::3]).all()
    assert (found["ceiling"] >= 0.0).all()
    row = make_row("base", "lattice", "Pipkin", found)
    assert row.told is None
    assert not row.passes or row.shown.mean >= GOAL


def test_a_low_ceiling_saves_the_races(cell):
    found = run_cell(Cell(cell.track, "lattice", SMALL, 2, 2, 2, seed=3, least=1.0))
    assert np.isnan(found["scores"]).all()
    assert "not raced" in make_row("energy", "lattice", "Pipkin", found).texts()


def test_a_gain_counts_some_races():
    scores = np.zeros((len(ARMS), 4, 2, 1, 1, 3))
    scores[ARMS.index("shown"), ..., 0] = 1.0
    scores[ARMS.index("shown"), ::2, ..., 2] = 1.0
    assert gain(scores, "shown", "gap", slice(1, None)).mean == 0.25
    assert gain(scores, "told", "shown", slice(1)).mean == -1.0


def test_a_series_is_won_by_two_races_or_by_faults():
    outcomes = np.array([[[[0, 0, 0]] * 2], [[[1, 0, FAULTS]] * 2], [[[0, 1, 0]] * 2]])
    given = chances(outcomes.astype(int))
    assert [series(given, {}, policy) for policy in range(3)] == [1.0, 1.0, 1.0]
    even = np.zeros((1, 3, FAULTS + 1, FAULTS + 1))
    even[0, :2, 0, 0] = 0.5
    assert series(even, {}) == pytest.approx(0.5)


def test_risk_that_depends_on_the_score_of_the_series_can_pay():
    """A fast policy wins with a fault in two of three races, a safe one every second race."""
    fast = [[0, 2, 0]] * 4 + [[1, 2, 0]] * 2
    safe = [[0, 0, 0]] * 3 + [[1, 0, 0]] * 3
    races = np.array([fast, safe]).reshape(1, 2, 3, 2, 3)
    found = series_gain(races, np.repeat(races, 2, axis=2), groups=2)
    assert found.mean > 0.0
    same = series_gain(races[:, :1], races[:, :1], groups=3)
    assert same.mean == 0.0
