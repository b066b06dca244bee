"""The races of a page as packed columns."""

from dataclasses import replace

import numpy as np
import pytest

from pcs_racing.base.packing import unpack
from pcs_racing_agents.results.race_files import read_results
from pcs_racing_agents.view.view_page import packed_races


@pytest.fixture
def races(tournament_folder):
    return read_results(tournament_folder[0] / "results.csv")


def test_packing_loses_nothing_that_is_shown(races):
    packed = packed_races(races)
    assert packed["length"] == len(races) == 18
    values = {name: unpack(column) for name, column in packed["columns"].items()}
    assert values["lead"] == pytest.approx(races.lead, abs=0.00051)
    assert values["start_s"] == pytest.approx(races.start_s, abs=0.005)
    assert packed["seeds"] == ["2"]
    for number, row in enumerate(races):
        for car, (agent, overtakes, variant, moves) in enumerate((
            (row.ego, row.ego_overtakes, row.ego_variant, row.ego_moves),
            (row.opponent, row.opponent_overtakes, row.opponent_variant, row.opponent_moves),
        )):  # fmt: skip
            assert packed["agents"][int(values[("ego", "opponent")[car]][number])] == agent
            assert packed["moves"][int(values[f"moves{car}"][number])] == "; ".join(moves)
            assert values[f"overtakes{car}"][number] == overtakes
            assert values[f"variants{car}"][number] == variant
            assert values[f"switches{car}"][number] == races.switches[number, car]
        assert ("none", "ego", "opponent")[int(values["winner"][number])] == row.winner
        assert ("none", "wall", "car")[int(values["crash"][number])] == row.crash
        assert ("none", "ego", "opponent", "both")[int(values["fault"][number])] == row.fault


def test_of_what_is_not_known_the_page_says_so(races):
    unknown = np.full(len(races), np.nan)
    no_moves = races.moves._replace(codes=races.moves.codes[..., :0])
    packed = packed_races(replace(races, duration=unknown, moves=no_moves))
    assert (unpack(packed["columns"]["duration"]) == -1).all()
    assert packed["moves"] == [""]
