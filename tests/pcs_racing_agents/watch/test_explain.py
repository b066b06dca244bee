"""One race explained: the facts, the words and the pictures."""

import re
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused
from same_move import Model
from zoo_games import untrained

from pcs_racing import load_rules, make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.moves import move_names, move_table
from pcs_racing.game.players import competitor
from pcs_racing.race.races import draw_starts
from pcs_racing.race.replay import ReplayEvent
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.style import save_picture
from pcs_racing_agents.policies.picture import archive_picture
from pcs_racing_agents.tournament import Pairing
from pcs_racing_agents.watch.explain import explain_race, value_unit
from pcs_racing_agents.watch.words import lead_words, story, why


@pytest.fixture(scope="module")
def contest(oval, archive):
    return make_game(oval, archive, load_rules("contest", front_pace=(1.0, 1.0)), steps=(0.8,) * 5)


@pytest.fixture(scope="module")
def spec(contest):
    return make_game(None, contest.archive, contest.rules)


def network_of(spec, target="advantage", **training):
    return replace(untrained(spec, target), training=training)


def explained(contest, ego, rival, **options):
    """A race that is not over before the moves are made."""
    start = draw_starts(contest.track, contest.setup.rules, 8, 3).take([0])
    pairing = Pairing(contest, ego, rival, np.array([[4, 6]]), start, race_seeds(5, 8)[:1])
    return explain_race(pairing, 0, **options)


@pytest.fixture(scope="module")
def race(contest, spec):
    """An agent with a network that values two moves alike, against an agent that draws."""
    ego = build("cfr-argmax", spec, network=network_of(spec, worth="win"))
    return explained(contest, ego, build("random-moves", spec))


def test_the_facts_are_those_of_the_game_and_moves_are_events_of_the_replay(contest, spec, race):
    """The game is played again, move by move."""
    start = draw_starts(contest.track, contest.setup.rules, 8, 3).take([0])
    state = contest.reset(race_seeds(5, 8)[:1], policies=[[4, 6]], starts=start)
    for k, step in enumerate(race.steps):
        assert step.time == pytest.approx(0.8 * (k + 1))
        assert step.policy == state.policy[0, 0]
        # measured in the step before
        assert step.opponent == pytest.approx(state.estimates[0, 1, k], abs=1e-6)
        assert step.lead == pytest.approx(
            race.lead[round(step.time / race.replay.frame_dt)], abs=1e-3
        )
        assert step.move == np.argmax(step.values)
        assert step.probabilities[step.move] == 1.0
        assert step.next_policy == spec.table[step.policy, step.move]
        state = contest.step(state, race.played.moves.codes[:, :, k])
    assert contest.done(state).all()
    assert race.played.lead == state.race.lead
    events = [
        (event.time, event.car, event.text) for event in race.replay.events if event.kind == "move"
    ]
    made = [
        (0.8 * (k + 1), car, contest.moves[race.played.moves.codes[0, car, k]])
        for k in range(len(race.steps))
        for car in (0, 1)
    ]
    assert sorted(events) == [(pytest.approx(time), *rest) for time, *rest in sorted(made)]


def test_the_other_car_sees_the_other_side(contest, spec):
    ego, rival = build("random-moves", spec, seed=3), build("random-moves", spec, seed=4)
    first, second = (explained(contest, ego, rival, car=car) for car in (0, 1))
    for own, rival_step in zip(first.steps, second.steps, strict=True):
        assert own.lead == pytest.approx(-rival_step.lead, abs=1e-5)
        assert own.time == rival_step.time
    assert np.array_equal(first.lead, -second.lead)
    assert story(second).startswith("random-moves (car 1) against random-moves (car 0)")


@pytest.fixture(scope="module")
def told(race):
    """Two decisions of car 0 in a race of five, whose lead is made up, and which a crash ends at 2
    s.
    """
    time = np.linspace(0.0, 2.0, 41)
    lead = np.interp(time, [0.0, 0.8, 1.6, 2.0], [0.0, 1.0, 2.3, -0.25])
    cars = np.stack(
        [np.stack([time, car + 0.1 * time, *[time] * 5], axis=1) for car in (0.0, 1.0)], axis=1
    )
    moments = [
        (0.8, 1, "overtake", "no longer"),
        (1.2, 0, "overtake", "passed"),
        (1.6, 1, "brake", "braked"),
    ]
    events = [
        ReplayEvent(*moment)
        for moment in [*moments, (1.7, 0, "move", "stay"), (2.4, 1, "crash", "hit a wall")]
    ]
    replay = replace(
        race.replay,
        cars=cars,
        progress=np.stack([lead, 0.0 * lead], axis=1),
        ittc=None,
        paths=None,
        events=events,
        frame_dt=0.05,
        outcome="car 1 crashed",
    )
    first, second = race.steps[:2]
    values, chances = np.array([0.3, 0.1, 0.22, -0.1, 0.2]), np.array([0.6, 0.0, 0.4, 0.0, 0.0])
    steps = (
        first._replace(
            time=0.8,
            lead=1.0,
            opponent=race.middle + np.array([0.12, -0.3]),
            move=0,
            policy=3,
            next_policy=5,
            values=values,
            probabilities=chances,
        ),
        second._replace(
            time=1.6,
            lead=2.26,
            opponent=race.middle + np.array([-0.31, 0.05]),
            move=2,
            policy=5,
            next_policy=5,
            values=values,
            probabilities=np.eye(5)[2],
        ),
    )
    return replace(race, steps=steps, replay=replay)


def test_the_story_tells_every_step_and_a_race_that_ends_at_once(told):
    before, after = told.game.archive.normalised[[3, 5]]
    by, to = ("aggressiveness", "restraint")
    assert story(told).splitlines() == [
        "cfr-argmax (car 0) against random-moves on oval, contest rules: car 1 crashed",
        (
            "  0.8 s  saw: opponent aggressive and daring (aggressiveness 0.12 above the middle,"
            " restraint 0.30 below the middle); ahead by 1.0 m."
        ),
        (
            "         did: aggressiveness + (drawn with a chance of 60%), from policy 3 to 5 "
            f"({by} {before[0]:.2f} to {after[0]:.2f}, {to} {before[1]:.2f} to {after[1]:.2f})."
        ),
        (
            "         why: worth 0.100 of a win more than staying, 0.080 of a win more than"
            " restraint +."
        ),
        (
            "         then: gained 1.3 m, ahead by 2.3 m; it passed at 1.2 s; the opponent braked"
            " at 1.6 s."
        ),
        (
            "  1.6 s  saw: opponent restrained (aggressiveness 0.31 below the middle, restraint"
            " 0.05 above the middle); ahead by 2.3 m."
        ),
        "         did: restraint +, no policy lies that way: kept policy 5.",
        "         why: it keeps the policy, so its value is the value of staying.",
        "         then: lost 2.5 m, level; the opponent hit a wall at 2.4 s.",
    ]
    still = told.steps[0]._replace(
        lead=2.26, move=4, next_policy=3, opponent=told.middle, probabilities=None
    )
    lines = story(replace(told, steps=(still,))).splitlines()
    assert lines[1].startswith(
        "  0.8 s  saw: opponent in the middle of the archive (aggressiveness 0.00 below"
    )
    assert lines[2] == "         did: stay, kept policy 3."
    assert lines[4].startswith("         then: no change, ahead by 2.3 m; it passed")
    empty = replace(told, steps=())
    assert story(empty).splitlines()[1:] == ["The race was over before the first move."]
    assert [lead_words(lead) for lead in (-0.4, 0.29)] == ["behind by 0.4 m", "level"]


VALUES = np.array([0.3, 0.1, 0.22, -0.1, 0.2])
WIN, METRES = "of a win", "m of lead"


@pytest.mark.parametrize(
    ("move", "values", "unit", "words"),
    [
        (0, VALUES, WIN, "worth 0.100 {} more than staying, 0.080 {} more than restraint +"),
        (4, VALUES, WIN, "worth 0.100 {} less than aggressiveness +"),
        (2, VALUES[:3], WIN, "worth 0.080 {} less than aggressiveness +"),
        (4, VALUES[:3], WIN, "its network has no value for stay"),
        (0, None, WIN, ""),
        (0, VALUES[:1], WIN, "there is no other move"),
        (0, VALUES, METRES, "worth 0.10 {} more than staying, 0.08 {} more than restraint +"),
        (
            2,
            VALUES,
            "",
            "worth 0.02 more than staying, 0.08 less than aggressiveness + (relative values)",
        ),
    ],
)
def test_a_move_is_compared_with_staying_in_the_unit_of_values(race, move, values, unit, words):
    step = race.steps[0]._replace(move=move, values=values)
    assert why(replace(race, unit=unit), step) == words.replace("{}", unit)


def test_the_training_of_a_network_decides_the_unit_of_its_values(spec):
    assert value_unit(network_of(spec, worth="win"), "lead") == (1.0, WIN)
    assert value_unit(network_of(spec), "win") == (0.5, WIN)
    assert value_unit(network_of(spec, "advantage"), "lead") == (1.0, METRES)
    assert value_unit(network_of(spec, "regret"), "win") == (1.0, "")


def test_open_loop_agents_fixed_policies_and_whoever_answers_predict(contest, spec):
    race = explained(
        contest, build("always-aggressiveness+", spec), build("lane-switcher:any", spec)
    )
    assert "makes open-loop moves" in story(race)
    assert "why:" not in story(race)
    race = explained(contest, build("lane-switcher:any", spec), build("random-moves", spec), car=1)
    assert re.search(r"drawn with a chance of 2[05]%", story(race))
    cars = build("never-switch", spec), build("lane-switcher:any", spec)
    refused(
        "'lane-switcher:any' in car 1 makes no moves.*; try the other car",
        explained,
        contest,
        *cars,
        car=1,
    )
    refused(
        "car 0 makes no moves.*; nor does the other car's", explained, contest, *cars[1:], *cars[1:]
    )
    race = explained(contest, competitor(Model(), spec), build("never-switch", spec))
    assert all(step.values is None and step.probabilities is None for step in race.steps)
    assert story(race).startswith("Model (car 0)")


def test_the_archive_shows_where_moves_lead(archive, tmp_path):
    crashes = np.linspace(0.0, 0.3, 12)
    known = replace(archive, own_crash=crashes)
    figure = archive_picture(known, epsilon=0.5)
    axes, _ = figure.axes
    start = archive.select("middle")
    leads_to = move_table(archive, 0.5)[start, :-1]
    title = "Archive toy, rules paper: 12 policies, grey: 30 explored"
    assert (axes.get_title("left"), axes.get_xlabel()) == (title, "restraint, s")
    points, explored = archive.coordinates[:, [1, 0]], archive.explored_coordinates[:, [1, 0]]
    dots = axes.collections[0]
    drawn = [dots.get_offsets(), dots.get_array(), *(line.get_xydata() for line in axes.lines[:2])]
    for found, expected in zip(
        drawn, [points, 100.0 * crashes, explored, points[start : start + 1]], strict=True
    ):
        np.testing.assert_array_equal(found, expected)
    first, *named = [text.get_text() for text in axes.get_legend().get_texts()]
    assert first == f"policy {start}"
    shown = ", ".join(name for name in named if not name.endswith(": no effect"))
    moves = zip(move_names(archive, 0.5)[:-1], leads_to, strict=True)
    assert set(shown.split(", ")) == {name for name, end in moves if end != start}
    arrows = {
        (*text.xy, *text.xyann)
        for text in axes.texts
        if text.get_text() == "" and text.arrow_patch is not None
    }
    assert arrows == {(*points[end], *points[start]) for end in leads_to if end != start}
    assert len(archive_picture(replace(archive, own_crash=None)).axes) == 1  # no colour bar
    assert save_picture(figure, tmp_path / "archive.png").read_bytes().startswith(b"\x89PNG")
