"""Headroom of pools whose true payoffs are known, and of a small pool that is raced."""

import csv

import numpy as np
import pytest

from studies.__main__ import main
from studies.headroom import FOLDS, headroom, spanning_policies

RACES = 400


def ladder(policies: int, step: float = 0.02) -> np.ndarray:
    """Payoffs of policies that only differ in strength."""
    strength = step * np.arange(policies)
    return strength[:, None] - strength[None, :]


def wheel(policies: int, size: float) -> np.ndarray:
    """Payoffs of policies on a circle: each beats the policies up to half a turn behind it."""
    angle = 2.0 * np.pi * np.arange(policies) / policies
    return size * np.sin(angle[:, None] - angle[None, :])


def estimates(payoffs: np.ndarray) -> list:
    """Headroom in ten draws of races that are won or lost."""
    names, found = [str(k) for k in range(len(payoffs))], []
    for seed in range(10):
        draws = np.random.default_rng(seed).binomial(
            RACES, 0.5 + payoffs, size=(FOLDS, *payoffs.shape)
        )
        won = np.triu(draws / RACES - 0.5, 1)
        found.append(headroom(won - won.swapaxes(1, 2), names))
    return found


def test_a_pool_whose_strongest_policy_beats_all_has_no_headroom():
    found = estimates(ladder(10))
    assert abs(np.mean([one.value for one in found])) < 0.01
    assert {one.best_fixed for one in found} == {"9"}


@pytest.mark.parametrize("strength", [0.0, 0.02])
def test_headroom_of_a_wheel_is_the_headroom_of_its_true_payoffs(strength):
    truth = wheel(9, 0.15) + ladder(9, strength)
    found = estimates(truth)
    expected = truth.max(axis=0).mean() - truth.mean(axis=1).max()
    error = np.mean([one.error for one in found])
    assert abs(np.mean([one.value for one in found]) - expected) < error
    assert all(one.low <= one.value + 1e-12 for one in found)


def test_a_pool_spans_an_archive():
    assert len(spanning_policies("default", None)) == 16
    assert len(spanning_policies("contest", 3)) == 3


def test_the_command_races_a_pool_and_refuses_other_numbers_of_races(tmp_path, capsys):
    paces = [f"lattice:pace={pace}" for pace in (0.2, 0.5, 1.0)]
    words = ["headroom", "--policies", *paces, "--track", "Tarnfjord", "--duration", "8"]
    assert main([*words, "--races", "16", "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "payoffs.csv").open(newline="") as file:
        payoffs = {(row["policy"], row["opponent"]): float(row["payoff"])
                   for row in csv.DictReader(file)}  # fmt: skip
    assert payoffs[paces[2], paces[0]] == -payoffs[paces[0], paces[2]] > 0.2
    assert paces[2] in capsys.readouterr().out
    assert main([*words, "--races", "20", "--out", str(tmp_path / "none")]) == 2
    assert "races is 20; it must be a multiple of 16" in capsys.readouterr().err
