from itertools import product

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, load_track, parse_policy
from pcs_racing_agents.agents import Driver, make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.tournament import fitting as fits
from pcs_racing_agents.tournament.play import game_rules


@pytest.fixture(scope="module")
def short(archive):
    """Games of two moves, so that every plan can be tried."""
    return make_setting(archive, game_rules(CONTEST, moves=2, step_seconds=1.0))


@pytest.fixture(scope="module")
def training(oval, short) -> fits.TrainingRaces:
    return fits.TrainingRaces((oval,), (build("never-switch", short), build("lane-switcher", short)), short, races=8)


def test_the_best_schedule_is_better_than_constant_moves_and_than_its_neighbours(training, short):
    fit = fits.fit_best_schedule(training)
    plans = [[short.moves[i] for i in sequence] for sequence in product(range(5), repeat=2)]
    values = fits.evaluate(training, [build("best-schedule", short, moves=plan) for plan in plans])
    reached = values[plans.index(fit.choice)]
    assert fit.training["reached"] == pytest.approx(reached, abs=1e-4)
    near = [plan[0] == plan[1] or plan[0] == fit.choice[0] or plan[1] == fit.choice[1] for plan in plans]
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


def test_the_best_lead_plan_is_found(training, short):
    """It is at least as good as the best fixed policy, and no change of one of its two policies is better."""
    targets = [0, 4, 8, 11]
    fit, fixed = fits.fit_best_lead_plan(training, targets=targets), fits.fit_best_fixed(training, targets=targets)
    assert fit.training["reached"] >= fixed.training["reached"]
    plans = [{"behind": behind, "ahead": ahead} for behind, ahead in product(targets, repeat=2)]
    values = fits.evaluate(training, [build("best-lead-plan", short, targets=plan) for plan in plans])
    reached = values[plans.index(fit.choice)]
    assert fit.training["reached"] == pytest.approx(reached, abs=1e-4)
    near = [plan["behind"] == fit.choice["behind"] or plan["ahead"] == fit.choice["ahead"] for plan in plans]
    assert reached == values[near].max()
    assert fit.training["candidates"] <= len(plans)
    assert build("best-lead-plan", short, fit=fit).facts["behind"].startswith(f"policy {fit.choice['behind']} ")


def test_a_candidate_scores_its_own_wins(oval, archive):
    """Known answers: in the paper's race pace wins, so the slowest candidate beats a slower car and no faster one."""
    setting = make_setting(archive, game_rules("paper", moves=2, step_seconds=4.0))
    slowest = build("best-fixed", setting, target=0)
    scores = [
        fits.evaluate(
            fits.TrainingRaces((oval,), (Driver("other", (parse_policy(f"lattice:pace={pace}"),)),), setting, races=6),
            [slowest],
        )
        for pace in (0.0, 1.0)
    ]
    assert scores == [[1.0], [0.0]]


def test_psro_is_an_equilibrium_of_the_game_of_choosing_agents(training, oval, short):
    refused("one track", fits.TrainingRaces, (oval,), (), short)
    refused("psro needs", fits.fit_psro, training, [build("never-switch", short)])
    names = ("always-aggressiveness+", "always-restraint+", "never-switch", "random-moves")
    longer = make_setting(short.archive, game_rules(CONTEST, moves=3, step_seconds=8.0))
    members = [build(name, longer) for name in names]
    training = fits.TrainingRaces((load_track("Pipkin"),), (members[0],), longer, races=10)
    meta = fits.fit_psro(training, members)
    assert np.count_nonzero(meta.payoffs) > 0
    assert meta.weights.sum() == pytest.approx(1.0)
    np.testing.assert_array_equal(meta.payoffs, -meta.payoffs.T)
    assert (meta.weights @ meta.payoffs).min() >= -1e-6  # nobody beats the mixture on these races
    again = fits.fit_psro(training, members, known=fits.fit_psro(training, members[:3]))
    np.testing.assert_array_equal(again.payoffs, meta.payoffs)
    refused("4 agents", fits.fit_psro, training, members[:2], known=meta)
