"""Races driven again for the page: small, whole, and only if they are still the same."""

import json
import re
from dataclasses import replace
from itertools import product, zip_longest
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from replay_pages import unpack

from pcs_racing.race.replay import page_values
from pcs_racing_agents.study.study import open_results
from pcs_racing_agents.tournament.race_files import race_table, read_results
from pcs_racing_agents.tournament.races import Categorical, RaceRow
from pcs_racing_agents.watch.race_choice import OUTCOMES, choose_races, outcomes
from pcs_racing_agents.watch.race_replays import RaceRepeater, packed_races, space_values, view_page
from pcs_racing_agents.watch.results_folder import ResultsFolder


@pytest.fixture(scope="module")
def repeater(tournament_folder):
    return RaceRepeater(open_results(tournament_folder[0]))


def test_a_race_is_a_replay_with_less_in_it(repeater, tournament_folder):
    _, tournament = tournament_folder
    race = repeater.drive(1)
    recording = tournament.record(tournament.races[1], candidates=False)
    whole = page_values(recording.replay)
    assert whole.keys() - race.keys() == {"walls", "line", "ittc"}
    assert repeater.circuits["Pipkin"] == {part: whole[part] for part in ("walls", "line")}
    for part in ("cars", "progress", "line_speed", "outcome", "frame_dt"):
        assert race[part] == whole[part]
    np.testing.assert_array_equal(unpack(race["paths"]), unpack(whole["paths"])[::2])
    assert race["plan_dt"] == pytest.approx(2 * whole["plan_dt"])
    assert [event for event in race["events"] if event[2] == "move"]
    assert race["space"]["policies"] == recording.played.path[0].tolist()
    assert race["space"]["made"] == recording.played.moves.codes[0].tolist()


def test_places_are_where_the_archive_and_the_other_car_saw_them(
    repeater, tournament_folder, archive
):
    """As shares of the picture, which holds the archive and most explored policies."""
    _, tournament = tournament_folder
    points, explored = archive.coordinates[:, [1, 0]], archive.explored_coordinates[:, [1, 0]]
    low, high = points.min(axis=0), points.max(axis=0)
    tails, reach = np.quantile(explored, [0.02, 0.98], axis=0), high - low
    least = np.maximum(np.minimum(low, tails[0]), low - 0.5 * reach) - 0.08 * reach
    largest = np.minimum(np.maximum(high, tails[1]), high + 0.5 * reach) + 0.08 * reach
    axes = [("restraint", "s", *ends) for ends in zip(least[:1], largest[:1], strict=True)]
    axes += [("aggressiveness", "m", *ends) for ends in zip(least[1:], largest[1:], strict=True)]
    space = space_values(replace(archive, own_crash=np.linspace(0.0, 0.1234, 12)), ("a", "b"))
    assert (space["archive"], space["moves"]) == ("toy", ["a", "b"])
    assert [tuple(axis.values()) for axis in space["axes"]] == [
        (*axis[:2], *map(pytest.approx, axis[2:])) for axis in axes
    ]
    assert np.array(space["points"]) == pytest.approx(
        (points - least) / (largest - least), abs=1e-4
    )
    inside = ((explored >= least) & (explored <= largest)).all(axis=1)
    expected = (explored[inside] - least) / (largest - least)
    assert unpack(space["explored"]) == pytest.approx(expected, abs=2e-4)
    assert (min(space["crash"]), max(space["crash"])) == (0.0, 12.3)
    assert space_values(archive, ())["crash"] is None
    # A step of a car's observations: two own coordinates, two of the other, the lead, and the end.
    for number in (1, 9):
        race, row = repeater.drive(number), tournament.races[number]
        blocks = (
            tournament.record(row, candidates=False)
            .played.observations[0, :, :-2]
            .reshape(2, -1, 6)
        )
        units = archive.nadir + blocks[..., 2:4].astype(float) * (archive.ideal - archive.nadir)
        places = np.round((units[..., ::-1] - least) / (largest - least), 4)
        over = blocks[..., 5] == 1.0
        expected = [
            [place.tolist() if there else None for place, there in zip(*rows, strict=True)]
            for rows in zip(places, over, strict=True)
        ]
        assert race["space"]["seen"] == expected
    assert race["space"]["ends"] == (1.0, 2.0, 3.0, 4.0, 5.0)


def test_a_race_is_small_and_races_of_a_pair_come_together(repeater):
    values = repeater.drive(0)
    seconds = values["cars"]["shape"][0] * values["frame_dt"]
    assert len(json.dumps(values)) < 3000 + 1300 * seconds  # 40 s in at most 55 kB
    told = []
    order = list(repeater.drive_all([13, 0, 7, 1, 12], lambda *words: told.append(words)))
    assert told == [(done, 5, "Pipkin") for done in range(1, 6)]
    assert sorted(order) == [0, 1, 7, 12, 13]
    assert abs(order.index(0) - order.index(1)) == 1
    assert abs(order.index(12) - order.index(13)) == 1


def test_packing_loses_nothing_that_is_shown_and_tells_what_is_not_known(tournament_folder):
    races = read_results(tournament_folder[0] / "results.csv")
    packed = packed_races(races)
    assert packed["length"] == len(races) == 18
    values = {name: unpack(column) for name, column in packed["columns"].items()}
    assert values["lead"] == pytest.approx(races.lead, abs=0.00051)
    assert values["start_s"] == pytest.approx(races.start_s, abs=0.005)
    assert packed["seeds"] == ["2"]
    for car, name in enumerate(("ego", "opponent")):
        for key in ("overtakes", "variants", "switches"):
            np.testing.assert_array_equal(values[f"{key}{car}"], getattr(races, key)[:, car])
        agents = [packed["agents"][int(code)] for code in values[name]]
        moves = [packed["moves"][int(code)] for code in values[f"moves{car}"]]
        assert agents == [getattr(row, name) for row in races]
        assert moves == ["; ".join(getattr(row, f"{name}_moves")) for row in races]
    for name, words in (
        ("winner", ("none", "ego", "opponent")),
        ("crash", ("none", "wall", "car")),
        ("fault", ("none", "ego", "opponent", "both")),
    ):
        assert [words[int(code)] for code in values[name]] == [getattr(row, name) for row in races]
    assert values["duration"] == pytest.approx(races.duration, abs=0.005)
    for name in ("race", "side"):
        np.testing.assert_array_equal(values[name], getattr(races, name))
    unknown = np.full(len(races), np.nan)
    no_moves = races.moves._replace(codes=races.moves.codes[..., :0])
    packed = packed_races(replace(races, duration=unknown, moves=no_moves))
    assert (unpack(packed["columns"]["duration"]) == -1).all()
    assert packed["moves"] == [""]


def test_the_page_says_what_it_holds(tournament_folder):
    races = read_results(tournament_folder[0] / "results.csv")
    results = ResultsFolder(Path("my folder"), Path(), races, "front", None)
    first = races.take([0])
    cases = [
        (results, {"c": 3}),
        (replace(results, races=first, start="side-by-side"), None),
        (replace(results, races=replace(first, rules=Categorical.constant("", 1))), {"c": 3}),
    ]
    pages = []
    for one, space in cases:
        repeater = RaceRepeater(one)
        repeater.circuits["Pipkin"], repeater.space = {"b": 2}, space
        pages.append(view_page(repeater, {2: "why"}, {2: {"a": 1}}))
    data = [json.loads(re.search(r'id="races">(.*?)</script>', page)[1]) for page in pages]
    command = "pcs-racing view 'my folder' --index {race}"
    keys = ("title", "about", "sides", "replays", "circuits", "space", "command")
    several, one = "18 races, 3 agents, 1 circuit, contest rules", "1 race, 3 agents, 1 circuit"
    same = [[2, "why"]], [["Pipkin", {"b": 2}]]
    assert [[one[key] for key in keys] for one in data] == [
        ["my folder", several, ["front", "rear"], *same, {"c": 3}, command],
        ["my folder", f"{one}, contest rules", ["left", "right"], *same, None, command],
        ["my folder", one, ["front", "rear"], *same, {"c": 3}, command],
    ]
    assert all(
        '<script type="application/json" id="race-2">{"a":1}</script>' in page for page in pages
    )


def columns_of(races):
    """A table of races given as (ego, opponent, track, lead, winner, crash, fault, policies of the
    ego).
    """
    return race_table(
        RaceRow(
            ego=ego,
            opponent=opponent,
            track=track,
            lead=float(lead),
            winner=winner,
            crash=crash,
            fault=fault,
            ego_path=tuple(map(int, path.split("; "))),
            race=number,
        )
        for number, (ego, opponent, track, lead, winner, crash, fault, path) in enumerate(races)
    )


def test_outcomes_are_told_by_agent():
    columns = columns_of(
        [
            ("a", "b", "t", 3, "ego", "none", "none", "1; 2"),
            ("a", "b", "t", 3, "ego", "none", "none", "1; 1"),
            ("a", "b", "t", -3, "opponent", "wall", "ego", "1; 1"),
            ("a", "b", "t", 1, "none", "car", "both", "1; 1"),
            ("a", "b", "t", 0, "none", "none", "none", "1; 1"),
            ("a", "b", "t", 1, "none", "car", "none", "1; 1"),
        ]
    )
    of_a = [
        "a win with switches",
        "a win without switching",
        "a crash of its own",
        "a crash of its own",
        "a tie",
        "a tie",
    ]
    of_b = ["a loss", "a loss", "a crash of the other's", "a crash of its own", "a tie", "a tie"]
    for car, expected in enumerate((of_a, of_b)):
        assert [OUTCOMES[i].split(",")[0] for i in outcomes(columns, car)] == expected


def test_a_win_by_switching_is_one_that_staying_loses():
    """Of the four races that "a" wins with a switch, "never-switch" loses the first one, from the
    same policy.
    """
    rows = [
        RaceRow(
            ego=ego,
            opponent="b",
            track="t",
            race=race,
            winner=winner,
            ego_variant=variant,
            ego_path=path,
        )
        for ego, race, winner, variant, path in [
            *(("a", race, "ego", 1, (1, 2)) for race in range(4)),
            ("never-switch", 0, "opponent", 1, (1, 1)),
            ("never-switch", 1, "ego", 1, (1, 1)),
            ("never-switch", 2, "opponent", 3, (3, 3)),
        ]
    ]
    found = [OUTCOMES[i] for i in outcomes(race_table(rows), 0)]
    assert found[:4] == ["a win by switching", *["a win with switches"] * 3]
    assert found[4:] == ["a loss", "a win without switching", "a loss"]
    won, lost = rows[0], rows[4]
    for change in ({}, {"opponent": "c"}, {"track": "u"}, {"seed": 1}, {"rules": "paper"}):
        pair = [won, lost._replace(**change)]
        assert OUTCOMES[outcomes(race_table(pair), 0)[0]] == found[1 if change else 0]
        turned = [
            row._replace(
                ego=row.opponent,
                opponent=row.ego,
                winner={"ego": "opponent", "opponent": "ego"}[row.winner],
                ego_variant=0,
                opponent_variant=row.ego_variant,
                ego_path=(),
                opponent_path=row.ego_path,
            )
            for row in pair
        ]
        assert OUTCOMES[outcomes(race_table(turned), 1)[0]] == found[1 if change else 0]


words = st.sampled_from(["a", "b", "c"])
races = st.tuples(
    words,
    words,
    st.sampled_from(["s", "t"]),
    st.floats(-50, 50),
    st.sampled_from(["none", "ego", "opponent"]),
    st.sampled_from(["none", "wall", "car"]),
    st.sampled_from(["none", "ego", "opponent", "both"]),
    st.sampled_from(["1; 1", "1; 2"]),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(races, min_size=1, max_size=40), st.integers(0, 50))
def test_agents_and_outcomes_take_turns_and_the_closest_comes_first(given_races, count):
    columns = columns_of(given_races)
    picks = choose_races(columns, count)
    assert len(picks) == min(count, len(columns))
    assert list(picks.items()) == list(by_definition(columns, count).items())


def by_definition(races, count):
    """Piles of each outcome and agent, who take turns; in a pile opponents and circuits do, from
    another one on.
    """
    names, by_car = list(races.agents.words), [outcomes(races, car) for car in (0, 1)]
    piles = {}
    for outcome, agent in product(range(len(OUTCOMES)), range(len(names))):
        groups = {}
        for car, number in product((0, 1), range(len(races))):
            if by_car[car][number] == outcome and races.agents.codes[number, car] == agent:
                rival = (int(races.agents.codes[number, 1 - car]) - agent) % len(names)
                place = rival, int(races.track.codes[number])
                groups.setdefault(place, []).append((abs(races.lead[number]), car, number))
        order = [[number for *_, number in sorted(groups[place])] for place in sorted(groups)]
        piles[agent, outcome] = [
            number for turn in zip_longest(*order) for number in turn if number is not None
        ]
    picks = {}
    for turn in zip_longest(*piles.values()):
        for (agent, outcome), number in zip(piles, turn, strict=True):
            if number is not None and len(picks) < count:
                picks.setdefault(number, f"{names[agent]}: {OUTCOMES[outcome]}")
    return picks
