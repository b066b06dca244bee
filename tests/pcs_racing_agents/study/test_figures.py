import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from toy_races import toy_races, toy_table

from pcs_racing_agents.base.curves import Curve, curves_picture
from pcs_racing_agents.base.style import COLOURS, picture_bytes
from pcs_racing_agents.study import figures
from pcs_racing_agents.study.table import make_table
from pcs_racing_agents.tournament.ratings import rate
from pcs_racing_agents.tournament.table import payoffs_picture, ratings_picture


@pytest.fixture(scope="module")
def table():
    cells = toy_races(egos=5, variants=4, opponents=("never-switch", "somebody"))
    return make_table(cells, best="our-best", open_loop="best-fixed", train={"Tarnfjord"})


def curves(seed=0):
    rng, x = np.random.default_rng(seed), np.arange(12.0)
    validation = np.where(x % 3 == 0, np.exp(-x / 5.0), np.nan)  # measured now and then
    return [
        Curve(x, np.exp(-x / 4.0) + 0.01 * rng.random(12), "training"),
        Curve(x, validation, "validation"),
    ]


def ratings():
    return rate(
        ["a", "b", "a", "c"] * 20,
        ["b", "c", "c", "a"] * 20,
        [1, 1, 1, -1] * 10 + [0, -1, 1, 1] * 10,
    )


PAYOFFS = np.array([[np.nan, 0.9], [0.1, np.nan]])

DRAWINGS = {
    "differences": lambda table: figures.differences_picture(table),
    "curves": lambda table: curves_picture({str(n): curves(n) for n in range(5)}),
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


def drawn(axes) -> list[tuple]:
    """Lines and marks of a panel: kind, x and y, whether a mark is hollow."""
    return [
        (
            line.get_marker(),
            *(list(values) for values in line.get_data()),
            line.get_marker() != "None" and line.get_markerfacecolor() in ("none", "white"),
        )
        for line in axes.lines
    ]


def bar(low, high, value, height, mark="o", hollow=False) -> list[tuple]:
    """An interval with its mark."""
    return [("None", [low, high], [height, height], False), (mark, [value], [height], hollow)]


def labels(axes) -> dict[float, str]:
    return {
        place: label.get_text()
        for place, label in zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)
    }


def test_pictures_of_a_table_hold_its_numbers_each_in_the_place_of_its_agent():
    """Agents below each other, a gap where one did not race; hollow at p >= 0.05; the paper's
    figures are diamonds.
    """
    toy = toy_table()
    first, hidden, other, second = figures.differences_picture(toy).axes
    visible = [axes.get_visible() for axes in (first, hidden, other, second)]
    assert visible == [True, False, False, True]
    assert drawn(first)[1:] == [
        *bar(0.125, 0.375, 0.25, 0),
        *bar(-0.125, 0.375, 0.125, -1, hollow=True),
        *bar(-0.125, 0.375, 0.125, -2, hollow=True),
        ("D", [0.054], [-1], True),
    ]
    assert drawn(second)[1:] == bar(-0.3125, -0.1875, -0.25, 0)
    # the best agent, another one, and the gain
    assert [line.get_color() for line in first.lines[1:7:2]] == [
        COLOURS[1],
        COLOURS[0],
        COLOURS[1],
    ]
    assert labels(first) == {0: "ours", -1: "cfr-argmax", -2: "adaptivity gain"}
    titles = (first.get_title(loc="left"), second.get_title(loc="left"))
    assert titles == ("Tarnfjord, never-switch", "Hut (test), somebody")
    bare = replace(toy, rows=tuple(replace(row, paper=None, gain=None) for row in toy.rows))
    assert labels(figures.differences_picture(bare).axes[0]) == {0: "ours", -1: "cfr-argmax"}
    assert [
        "diamonds: the paper's" in figures.differences_picture(one).get_supxlabel()
        for one in (toy, bare)
    ] == [True, False]
