from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, load_track
from pcs_racing.game.make import make_game
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.tournament import fitting as fits
from pcs_racing_agents.tournament.pairings import draw_schedule


@pytest.fixture(scope="module")
def short(archive):
    """Games of two moves, so that every plan can be tried."""
    return make_game(None, archive, CONTEST, steps=(1.0,) * 3)


@pytest.fixture(scope="module")
def training(oval, short) -> fits.TrainingRaces:
    return fits.TrainingRaces(
        (oval,), (build("never-switch", short), build("lane-switcher:any", short)), short, races=8
    )


def test_the_best_schedule_is_better_than_constant_moves_and_than_its_neighbours(training, short):
    fit = fits.fit_best_schedule(training)
    plans = [[short.moves[i] for i in sequence] for sequence in product(range(5), repeat=2)]
    values = fits.evaluate(training, [build("best-schedule", short, moves=plan) for plan in plans])
    reached = values[plans.index(fit.choice)]
    assert fit.training["reached"] == pytest.approx(reached, abs=1e-4)
    near = [
        plan[0] == plan[1] or plan[0] == fit.choice[0] or plan[1] == fit.choice[1] for plan in plans
    ]
    assert reached == values[near].max()
    assert 5 + 4 <= fit.training["candidates"] <= 25


def test_the_best_target_is_found_and_fits_repeat(training, short, tmp_path):
    fit = fits.fit_best_fixed(training)
    walkers = [build("best-fixed", short, target=target) for target in range(12)]
    values = fits.evaluate(training, walkers)
    assert values[fit.choice] == values.max()
    assert fits.fit_best_fixed(training, targets=[3, 5]).choice in (3, 5)
    assert build("best-fixed", short, fit=fit).facts["target"].startswith(f"policy {fit.choice} ")
    first = fits.fit_best_fixed(training)
    for _ in range(2):
        with open_job(tmp_path / "fit", "fit", {}) as job:
            assert vars(fits.fit_best_fixed(training, job=job)) == vars(first)


def test_the_best_lead_plan_is_at_least_as_good_as_the_best_fixed_policy(training, short):
    targets = [0, 4, 8, 11]
    fit = fits.fit_best_lead_plan(training, targets=targets)
    fixed = fits.fit_best_fixed(training, targets=targets)
    assert fit.training["reached"] >= fixed.training["reached"]
    (reached,) = fits.evaluate(training, [build("best-lead-plan", short, fit=fit)])
    assert fit.training["reached"] == pytest.approx(reached, abs=1e-4)
    assert set(fit.choice.values()) <= set(targets)


def test_candidates_are_compared_in_the_same_races(training, short, oval, monkeypatch):
    """Of each opponent on each track, with other start policies for each opponent; scores are means
    over all.
    """
    given = []
    two = replace(training, tracks=(oval, load_track("Pipkin")), seed=7)

    def play(pairings, **named):
        given.append(pairings)
        return [SimpleNamespace(score=np.array([k, k + 0.5])) for k in range(len(pairings))]

    monkeypatch.setattr(fits, "play_pairings", play)
    monkeypatch.setattr(fits, "series_of", lambda races, rules: races)
    agents = [build("best-fixed", short, target=target) for target in range(3)]
    assert fits.evaluate(two, agents).tolist() == [1.75, 5.75, 9.75]
    (pairings,) = given
    met = list(product(agents, two.tracks, enumerate(two.opponents)))
    for pairing, (agent, track, (k, opponent)) in zip(pairings, met, strict=True):
        schedule = draw_schedule(track, short.rules.for_game, 8, 7)
        counts = [len(getattr(car, "policies", range(12))) for car in (agent, opponent)]
        assert (pairing.game.track, pairing.ego, pairing.opponent, pairing.seed) == (
            track,
            agent,
            opponent,
            7,
        )
        np.testing.assert_array_equal(
            pairing.variants, np.roll(schedule.draws, 2 * k, axis=0) % np.array(counts, "u8")
        )
        np.testing.assert_array_equal(pairing.starts.s, schedule.starts.s)
        np.testing.assert_array_equal(pairing.noise, schedule.seeds)
    assert two.facts(0.123456, 3) == {
        "tracks": "oval, Pipkin",
        "opponents": "never-switch, lane-switcher:any",
        "races": 8 * 2 * 2,
        "candidates": 3,
        "seed": 7,
        "reached": 0.1235,
    }


@pytest.mark.parametrize("seed", range(5))
def test_a_search_climbs_to_the_best_neighbour_and_takes_the_first_of_equals(seed):
    """Against a search that looks at all scores; each choice is raced once, with the number of
    earlier ones.
    """
    options, places = (1, 3, 4), 3
    every = list(product(options, repeat=places))
    score = dict(
        zip(every, np.random.default_rng(seed).integers(0, 4, len(every)).tolist(), strict=True)
    )
    asked: list[tuple[int, ...]] = []

    def raced(choices, before):
        assert before == len(asked)
        asked.extend(choices)
        return np.array([score[choice] for choice in choices], float)

    best, scores = fits._search(raced, options, places)
    assert scores == {choice: score[choice] for choice in asked}
    assert len(set(asked)) == len(asked)
    current, near = None, {(option,) * places for option in options}
    known = set(near)
    while current != (top := min(known, key=lambda choice: (-score[choice], choice))):
        current = top
        known |= {
            choice
            for choice in every
            if sum(a != b for a, b in zip(choice, current, strict=True)) == 1
        }
    assert (best, set(asked)) == (current, known)


def test_psro_is_an_equilibrium_of_the_game_of_choosing_agents(training, oval, short):
    refused("one track", fits.TrainingRaces, (oval,), (), short)
    names = ("always-aggressiveness+", "always-restraint+", "never-switch", "random-moves")
    longer = make_game(None, short.archive, CONTEST, steps=(8.0,) * 4)
    members = [build(name, longer) for name in names]
    training = fits.TrainingRaces((load_track("Pipkin"),), (members[0],), longer, races=10)
    meta = fits.fit_psro(training, members)
    assert np.count_nonzero(meta.payoffs) > 0
    assert meta.weights.sum() == pytest.approx(1.0)
    np.testing.assert_array_equal(meta.payoffs, -meta.payoffs.T)
    assert (meta.weights @ meta.payoffs).min() >= -1e-6  # no gain over the mixture on these races
    again = fits.fit_psro(training, members, known=fits.fit_psro(training, members[:3]))
    np.testing.assert_array_equal(again.payoffs, meta.payoffs)
