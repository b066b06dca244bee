"""Which races are shown: by rule, the same every time, spread over agents, outcomes, opponents and
circuits.
"""

from itertools import product, zip_longest

from hypothesis import given, settings
from hypothesis import strategies as st

from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow
from pcs_racing_agents.watch.race_choice import OUTCOMES, choose_races, outcomes


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
    for change in ({}, {"opponent": "c"}, {"track": "u"}, {"seed": 1}, {"preset": "paper"}):
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
