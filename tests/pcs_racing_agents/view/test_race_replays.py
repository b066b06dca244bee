"""Races driven again for the page: small, whole, and only if they are still the same."""

import json
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base.packing import unpack
from pcs_racing.race.replay import read_replay
from pcs_racing_agents.results.race_files import race_table, read_results
from pcs_racing_agents.tournament.play import record_row
from pcs_racing_agents.view.race_replays import PLACES, RaceRepeater, circuit_values, race_values
from pcs_racing_agents.view.results_folder import open_results
from pcs_racing_agents.view.view_page import packed_races


@pytest.fixture(scope="module")
def driver(tournament_folder):
    return RaceRepeater(open_results(tournament_folder[0]))


def test_a_race_is_a_replay_with_less_in_it(driver, tournament_folder, tmp_path):
    _, tournament = tournament_folder
    race = driver.drive(1)
    recording = record_row(tournament, tournament.races[1], candidates=False)
    values = {**driver.circuits[race.circuit], **race.values}
    space = values.pop("space")
    path = tmp_path / "race.json"
    path.write_text(json.dumps(values))
    read, whole = read_replay(path), recording.replay
    assert read.cars[..., :5] == pytest.approx(whole.cars[..., :5], abs=0.0006)
    assert not read.cars[..., 5:].any()
    assert read.progress == pytest.approx(whole.progress, abs=0.006)
    assert read.line == pytest.approx(whole.line, abs=0.0006)
    assert read.paths[..., :2] == pytest.approx(whole.paths[::2, ..., :2], abs=0.006, nan_ok=True)
    assert read.plan_dt == pytest.approx(2 * whole.plan_dt)
    assert read.outcome == whole.outcome
    assert [event for event in read.events if event.kind == "move"]
    assert space["policies"] == recording.played.path[0].tolist()
    assert space["made"] == recording.played.moves.codes[0].tolist()


def test_places_are_where_the_archive_and_the_other_car_saw_them(driver, tournament_folder, archive):
    _, tournament = tournament_folder
    race = driver.drive(1)
    space, played = driver.space, record_row(tournament, tournament.races[1], candidates=False).played
    up, across = space["axes"][1], space["axes"][0]
    points = np.array(space["points"]) / PLACES
    back = np.array([axis["low"] for axis in (across, up)]) + points * [a["high"] - a["low"] for a in (across, up)]
    assert back[:, 1] == pytest.approx(archive.coordinates[:, 0], abs=(up["high"] - up["low"]) / PLACES)
    assert back[:, 0] == pytest.approx(archive.coordinates[:, 1], abs=(across["high"] - across["low"]) / PLACES)
    # The first block of what car 0 saw: two own coordinates, two of the other, the lead, and that it was over.
    other = played.observations[0, 0, 2:4].astype(float)
    units = archive.nadir + other * (archive.ideal - archive.nadir)
    place = race.values["space"]["seen"][0][0]
    assert up["low"] + place[1] / PLACES * (up["high"] - up["low"]) == pytest.approx(units[0], abs=0.01)
    assert across["low"] + place[0] / PLACES * (across["high"] - across["low"]) == pytest.approx(units[1], abs=0.01)
    for steps in race.values["space"]["seen"]:
        over = [step is not None for step in steps]
        assert over == sorted(over, reverse=True)  # after a crash nothing is seen any more


def test_a_race_is_small_and_what_is_left_out_optional(driver, tournament_folder):
    values = driver.drive(0).values
    seconds = values["cars"]["shape"][0] * values["frame_dt"]
    assert len(json.dumps(values)) < 3000 + 1300 * seconds  # 40 s in at most 55 kB
    order = [race.race for race in driver.drive_all([13, 0, 7, 1, 12])]
    assert sorted(order) == [0, 1, 7, 12, 13]
    assert abs(order.index(0) - order.index(1)) == 1
    assert abs(order.index(12) - order.index(13)) == 1
    _, tournament = tournament_folder
    replay = record_row(tournament, tournament.races[0], candidates=False).replay
    bare = replace(replay, paths=None, line_speed=None)
    assert "paths" not in race_values(bare)
    assert "line_speed" not in circuit_values(bare)


def test_a_race_that_is_another_one_is_refused(tournament_folder):
    for change, value in [
        ({"lead": 12.0}, r"race 3 .*12\.0000 m"),
        ({"start_s": 12.0}, "race 3 is not"),
        ({"race": 40}, "number 40 "),
    ]:
        results = open_results(tournament_folder[0])
        rows = list(results.races)
        rows[3] = rows[3]._replace(**change)
        refused(value, RaceRepeater(replace(results, races=race_table(rows))).drive, 3)
        refused("race 18", RaceRepeater(results).drive, 18)


def test_packing_loses_nothing_that_is_shown_and_tells_what_is_not_known(tournament_folder):
    races = read_results(tournament_folder[0] / "results.csv")
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
    unknown = np.full(len(races), np.nan)
    no_moves = races.moves._replace(codes=races.moves.codes[..., :0])
    packed = packed_races(replace(races, duration=unknown, moves=no_moves))
    assert (unpack(packed["columns"]["duration"]) == -1).all()
    assert packed["moves"] == [""]
