import xml.etree.ElementTree as ET

import numpy as np
import pytest
from refusal import refused
from toy_races import toy_races

from pcs_racing_agents.pictures.curves import Curve, curves_picture
from pcs_racing_agents.pictures.style import picture_bytes
from pcs_racing_agents.study import figures
from pcs_racing_agents.study.report_inputs import ScoreAndLoss
from pcs_racing_agents.study.table import make_table
from pcs_racing_agents.tournament.ratings import rate
from pcs_racing_agents.tournament.table import payoffs_picture, ratings_picture


@pytest.fixture(scope="module")
def table():
    cells = toy_races(egos=5, variants=4, opponents=("never-switch", "somebody"))
    return make_table(cells, best="our-best", open_loop="best-fixed", seen={"Tarnfjord"})


def curves(seed=0):
    rng, x = np.random.default_rng(seed), np.arange(12.0)
    validation = np.where(x % 3 == 0, np.exp(-x / 5.0), np.nan)  # measured now and then
    return [Curve(x, np.exp(-x / 4.0) + 0.01 * rng.random(12), "training"), Curve(x, validation, "validation")]


def ratings():
    return rate(["a", "b", "a", "c"] * 20, ["b", "c", "c", "a"] * 20, [1, 1, 1, -1] * 10 + [0, -1, 1, 1] * 10)


POINTS = [
    ScoreAndLoss("one", 0.5, 0.2, 0.1, 0.3),
    ScoreAndLoss("two", 0.5, 0.2, 0.15, 0.25),
    ScoreAndLoss("three", 0.4, 0.4, 0.3, 0.5),
]
PAYOFFS = np.array([[np.nan, 0.9], [0.1, np.nan]])

DRAWINGS = {
    "scores": lambda table: figures.scores_picture(table),
    "differences": lambda table: figures.differences_picture(table),
    "adaptivity": lambda table: figures.adaptivity_picture(table),
    "curves": lambda table: curves_picture({str(n): curves(n) for n in range(5)}),
    "rewards": lambda table: curves_picture({"ppo": curves()}, x_label="steps", y_label="reward", log=False),
    "exploitability": lambda table: figures.exploitability_picture(POINTS),
    "payoffs": lambda table: payoffs_picture(["one", "two"], PAYOFFS),
    "ratings": lambda table: ratings_picture(ratings()),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_picture_has_the_same_bytes_every_time(name, table):
    first, second = (picture_bytes(DRAWINGS[name](table)) for _ in range(2))
    assert first == second
    root = ET.fromstring(first)
    assert root.tag.endswith("svg")
    assert len(first) < 400_000


def test_scores_stand_where_the_table_says_and_differences_that_may_be_nothing_are_hollow(table):
    panels = [axes for axes in figures.scores_picture(table).axes if axes.get_visible()]
    assert len(panels) == len(table.rows)
    assert [label.get_text() for label in panels[0].get_yticklabels()] == list(table.arms)
    for row, axes in zip(table.rows, panels, strict=True):
        marks = [tuple(line.get_xydata()[0]) for line in axes.lines if len(line.get_xdata()) == 1]
        for arm in row.arms:
            assert (arm.score, -table.arms.index(arm.arm)) in marks
        if row.paper is not None:
            assert (row.paper.non_gt, 0) in marks
            assert (row.paper.gt, -2) in marks
    for row, axes in zip(table.rows, figures.differences_picture(table).axes, strict=True):
        marks = {tuple(line.get_xydata()[0]): line for line in axes.lines if line.get_marker() == "o"}
        for i, one in enumerate(row.differences):
            mark = marks[one.result.difference, -i]
            assert (mark.get_markerfacecolor() == "white") == (one.p_holm >= 0.05)


def test_what_can_not_be_drawn_is_named():
    for draw, value in [
        (lambda: figures.adaptivity_picture(make_table(toy_races(egos=3, variants=3))), "adaptivity gains"),
        (lambda: curves_picture({}), "curves"),
        (lambda: curves_picture({"regret": []}), "curves"),
        (lambda: figures.exploitability_picture([]), "score"),
        (lambda: payoffs_picture(["a", "b", "c"], PAYOFFS), r"\(2, 2\)"),
    ]:
        refused(value, draw)
