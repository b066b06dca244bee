"""One race explained: the facts, the words and the pictures."""

import re
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused
from same_move import Model
from zoo_games import untrained

from pcs_racing import draw_starts, make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.moves import move_names, move_table
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.explain.explain import Unit, explain_game, value_unit
from pcs_racing_agents.explain.pcs_picture import archive_picture, in_units
from pcs_racing_agents.explain.pictures import explanation_picture
from pcs_racing_agents.explain.words import lead_words, opponent_words, story, why
from pcs_racing_agents.pictures.style import CARS, picture_bytes, save_picture


@pytest.fixture(scope="module")
def contest(oval, archive):
    return make_game(oval, archive, "contest", step_seconds=0.8)


@pytest.fixture(scope="module")
def setting(contest):
    return make_setting(contest.archive, contest.config)


def network_of(setting, target="advantage", **training):
    return replace(untrained(setting, target), training=training)


def explained(contest, ego, rival, **options):
    """A race that is not over before the moves are made."""
    start = draw_starts(contest.track, contest.setup.config, 8, 3).take([0])
    return explain_game(contest, ego, rival, policies=[4, 6], start=start, seed=int(race_seeds(5, 8)[0]), **options)


@pytest.fixture(scope="module")
def race(contest, setting):
    """An agent with a network, of which two moves are alike, against one that draws."""
    ego = build("cfr-argmax", setting, network=network_of(setting, worth="win"))
    return explained(contest, ego, build("random-moves", setting))


def test_the_facts_are_those_of_the_game_and_moves_are_events_of_the_replay(contest, setting, race):
    """The game is played again, move by move."""
    start = draw_starts(contest.track, contest.setup.config, 8, 3).take([0])
    state = contest.reset(race_seeds(5, 8)[:1], policies=[[4, 6]], starts=start)
    for k, step in enumerate(race.steps):
        assert step.time == pytest.approx(0.8 * (k + 1))
        assert step.policy == state.policy[0, 0]
        assert step.own == pytest.approx(np.clip(contest.archive.normalised[step.policy], -1, 2), abs=1e-6)
        assert step.opponent == pytest.approx(state.estimates[0, 1, k], abs=1e-6)  # measured in the step before
        assert step.lead == pytest.approx(race.lead[round(step.time / race.replay.frame_dt)], abs=1e-3)
        assert step.move == np.argmax(step.values)
        assert step.probabilities[step.move] == 1.0
        assert step.next_policy == setting.table[step.policy, step.move]
        state = contest.step(state, np.array([[step.move, step.opponent_move]]))
    assert contest.done(state).all()
    assert race.played.lead == state.race.lead
    events = [(event.time, event.text) for event in race.replay.events if event.kind == "move" and event.car == 0]
    assert events == [(pytest.approx(step.time), race.moves[step.move]) for step in race.steps]


def test_the_other_car_sees_the_other_side(contest, setting):
    ego, rival = build("random-moves", setting, seed=3), build("random-moves", setting, seed=4)
    first, second = (explained(contest, ego, rival, car=car) for car in (0, 1))
    for own, rival_step in zip(first.steps, second.steps, strict=True):
        assert own.lead == pytest.approx(-rival_step.lead, abs=1e-5)
        assert (own.move, own.opponent_move) == (rival_step.opponent_move, rival_step.move)
    assert np.array_equal(first.lead, -second.lead)
    assert story(second).startswith("random-moves (car 1) against random-moves (car 0)")


def test_the_story_tells_every_step_and_a_race_that_ends_at_once(race):
    text = story(race)
    assert text.startswith("cfr-argmax (car 0) against random-moves on oval, contest rules: ")
    assert text.count("saw:") == text.count("did:") == text.count("then:") == text.count("why:") == len(race.steps) > 0
    assert all(f"did: {race.moves[step.move]}, " in text for step in race.steps)
    after = race.lead[round(race.ends[1] / race.replay.frame_dt)]
    for change, words in [(1.3, "gained 1.3 m"), (-1.3, "lost 1.3 m"), (0.04, "no change")]:
        moved = race.steps[0]._replace(lead=after - change)
        assert story(replace(race, steps=(moved,))).split("then: ")[1].startswith(words)
    empty = replace(race, steps=())
    assert story(empty).endswith("over before the first move.")
    assert picture_bytes(explanation_picture(empty)).startswith(b"<?xml")


def test_the_opponent_is_described_in_relation_to_the_archive_and_leads_in_words(race):
    middle = race.middle
    step = race.steps[0]._replace(opponent=middle + np.array([-0.2, 0.05]))
    told = "opponent restrained (aggressiveness 0.20 below the middle, restraint 0.05 above the middle)"
    assert opponent_words(race, step) == told
    step = step._replace(opponent=middle + np.array([0.31, -0.4]))
    assert opponent_words(race, step).startswith("opponent aggressive and daring (aggressiveness 0.31 above")
    assert opponent_words(race, step._replace(opponent=middle)).startswith("opponent in the middle of the archive")
    for lead, words in [(3.14, "ahead by 3.1 m"), (-3.14, "behind by 3.1 m"), (0.1, "level")]:
        assert lead_words(lead) == words


def test_a_move_is_compared_with_staying_and_counted_in_what_values_mean(race, setting):
    step = race.steps[0]._replace(move=0, values=np.array([0.3, 0.1, 0.22, -0.1, 0.2]))
    assert why(race, step) == "worth 0.100 of a win more than staying, 0.080 of a win more than restraint +"
    assert why(race, step._replace(move=4)) == "worth 0.100 of a win less than aggressiveness +"
    drawn = step._replace(move=2, values=np.array([0.3, 0.1, 0.22]))
    assert why(race, drawn) == "worth 0.080 of a win less than aggressiveness +"
    assert why(race, drawn._replace(move=4)) == "its network has no value for stay"
    kept = why(race, step._replace(next_policy=step.policy))
    assert kept == "it keeps the policy, so its value is that of staying"
    assert why(race, step._replace(values=None)) == ""
    assert value_unit(network_of(setting, worth="win"), "lead") == Unit(1.0, "of a win")
    assert value_unit(network_of(setting), "win") == Unit(0.5, "of a win")
    assert value_unit(network_of(setting), "lead") == Unit(1.0, "m of lead")
    assert value_unit(network_of(setting, "regret"), "win") == Unit(1.0, "")


def test_an_agent_with_a_default_strategy_says_why_it_left_or_kept_it(contest, setting):
    network = network_of(setting, worth="win")
    rival = build("never-switch", setting)
    options = {"network": network, "open_loop": "never-switch"}
    drivers = (build("adaptive", setting, **options, margin=margin) for margin in (0.0, 1000.0))
    bold, shy = (explained(contest, driver, rival) for driver in drivers)
    assert shy.default.name == "never-switch"
    assert "did: stay, kept policy" in story(shy)
    for step in shy.steps:
        assert step.move == step.default_move == shy.moves.index("stay")
        if np.argmax(step.values) != step.default_move:
            assert why(shy, step).startswith("keeps to never-switch: the best move, ")
            assert "not above the margin of 1000.000 of a win" in why(shy, step)
    left = [step for step in bold.steps if step.move != step.default_move]
    assert left
    for step in left:
        gain = step.values[step.move] - step.values[step.default_move]
        assert f"worth {gain:.3f} of a win more than stay, what never-switch would do" in why(bold, step)


def test_open_loop_agents_drivers_and_whoever_answers_predict(contest, setting):
    race = explained(contest, build("always-aggressiveness+", setting), build("lane-switcher", setting))
    assert "makes open-loop moves" in story(race)
    assert "why:" not in story(race)
    race = explained(contest, build("lane-switcher", setting), build("random-moves", setting), car=1)
    assert re.search(r"drawn with a chance of 2[05]%", story(race))
    cars = build("never-switch", setting), build("lane-switcher", setting)
    refused("'lane-switcher' in car 1 makes no moves.*; try the other car", explained, contest, *cars, car=1)
    refused("car is 2", explained, contest, build("never-switch", setting), build("never-switch", setting), car=2)
    race = explained(contest, Model(), build("never-switch", setting))
    assert all(step.values is None and step.probabilities is None for step in race.steps)
    assert story(race).startswith("Model (car 0)")
    assert picture_bytes(explanation_picture(race)).startswith(b"<?xml")


def test_the_pictures_show_what_was_seen_and_done(race):
    from matplotlib.colors import to_rgba as rgba

    figure = explanation_picture(race)
    space, track, *panels, lead = figure.axes
    marks = [text for text in space.texts if text.get_text().isdigit()]
    seen = {text.get_text(): text.xy for text in marks if text.get_bbox_patch().get_facecolor() == rgba(CARS[1])}
    for k, step in enumerate(race.steps):
        assert seen[str(k + 1)] == pytest.approx(tuple(in_units(race.archive, step.opponent)[[1, 0]]))
    far = [race.steps[0]._replace(opponent=race.middle - distance) for distance in (3.0, 0.0)]
    limits = explanation_picture(replace(race, steps=far)).axes[0].get_xlim()
    assert limits[0] < in_units(race.archive, far[0].opponent)[1] < limits[1]
    panels = [axes for axes in panels if axes.get_visible()]
    for axes, step in zip(panels, race.steps, strict=True):
        assert [patch.get_width() for patch in axes.patches] == pytest.approx(step.values.tolist())
        own = [patch.get_facecolor() == rgba(CARS[race.car]) for patch in axes.patches]
        assert own == [move == step.move for move in range(len(race.moves))]
        assert not axes.texts
        assert axes.get_title("left").endswith(f": {step.time:g} s")
        assert [set(line.get_xdata()) for line in axes.lines] == [{0.0}]
    upright = {line.get_xdata()[0] for line in lead.lines if len({*line.get_xdata()}) == 1}
    assert upright == {step.time for step in race.steps}
    assert {race.moves[step.move] for step in race.steps} <= {text.get_text() for text in lead.texts}
    assert len(track.lines) >= 2


def test_a_move_that_the_network_does_not_know_is_marked_and_chances_stand_in_for_values(race, contest, setting):
    steps = [step._replace(values=step.values[: step.move]) for step in race.steps]
    panels = explanation_picture(replace(race, steps=steps)).axes[2:-1]
    assert [[text.get_text() for text in axes.texts] for axes in panels[: len(steps)]] == [["made"]] * len(steps)
    race = explained(contest, build("random-moves", setting), build("never-switch", setting))
    panels = [axes for axes in explanation_picture(race).axes[2:-1] if axes.get_visible()]
    assert sum(patch.get_width() for patch in panels[0].patches) == pytest.approx(1.0)


def test_the_archive_shows_where_moves_lead(archive, tmp_path):
    figure = archive_picture(archive, epsilon=0.5, policy=3)
    texts = " ".join(text.get_text() for text in figure.axes[0].texts)
    names, leads_to = move_names(archive, 0.5), move_table(archive, 0.5)[3]
    assert all(name in texts for name in names)
    arrows = [text for text in figure.axes[0].texts if text.get_text() == "" and text.arrow_patch is not None]
    assert len(arrows) == len(set(leads_to.tolist()) - {3})
    assert save_picture(figure, tmp_path / "archive.png").read_bytes().startswith(b"\x89PNG")
    refused("policy is 12", archive_picture, archive, policy=12)
