"""Races driven again for the page: small, whole, and only if they are still the same."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pcs_racing.base.errors import InputError
from pcs_racing.race.replay_files import read_replay
from pcs_racing_agents.results.race_files import race_table
from pcs_racing_agents.tournament.play import record_row
from pcs_racing_agents.view.race_replays import PLACES, RaceRepeater, circuit_values, race_values
from pcs_racing_agents.view.results_folder import open_results


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


def test_a_race_is_small(driver):
    values = driver.drive(0).values
    seconds = values["cars"]["shape"][0] * values["frame_dt"]
    assert len(json.dumps(values)) < 3000 + 1300 * seconds  # 40 s in at most 55 kB


def test_pairs_are_driven_together(driver):
    order = [race.race for race in driver.drive_all([13, 0, 7, 1, 12])]
    assert sorted(order) == [0, 1, 7, 12, 13]
    assert abs(order.index(0) - order.index(1)) == 1
    assert abs(order.index(12) - order.index(13)) == 1


def test_what_is_left_out_is_optional(driver, tournament_folder):
    _, tournament = tournament_folder
    replay = record_row(tournament, tournament.races[0], candidates=False).replay
    bare = replace(replay, paths=None, line_speed=None)
    assert "paths" not in race_values(bare)
    assert "line_speed" not in circuit_values(bare)


def changed(results, number, **values):
    rows = list(results.races)
    rows[number] = rows[number]._replace(**values)
    return RaceRepeater(replace(results, races=race_table(rows)))


def test_a_race_that_is_another_one_is_refused(tournament_folder):
    results = open_results(tournament_folder[0])
    with pytest.raises(InputError, match=r"race 3 .*12\.0000 m"):
        changed(results, 3, lead=12.0).drive(3)
    with pytest.raises(InputError, match="race 3 is not"):
        changed(results, 3, start_s=12.0).drive(3)
    with pytest.raises(InputError, match="race 3 is number 40 "):
        changed(results, 3, race=40).drive(3)
    with pytest.raises(InputError, match="race 18"):
        RaceRepeater(results).drive(18)
