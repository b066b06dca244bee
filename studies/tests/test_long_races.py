"""Plans by the size of the lead: moves, fits and gains."""

import numpy as np

from pcs_racing.game.make import make_game
from pcs_racing_agents.agents.blind import best_fixed, best_lead_plan
from studies.__main__ import main
from studies.long_races.command import RULES, Outcome, gain_rows
from studies.long_races.plans import Plan, climb, plan_agent


def observed(spec, leads, policy=0):
    """Observations after one step that ended with these leads, in m."""
    names = list(spec.identity.elements)
    rows = np.zeros((len(leads), len(names)), np.float32)
    axes = len(spec.archive.characteristics)
    rows[:, :axes] = spec.archive.normalised[policy]
    rows[:, 2 * axes] = np.array(leads) / 20.0
    rows[:, 2 * axes + 1] = 1.0
    return rows


def test_a_plan_goes_to_the_policy_of_its_lead():
    spec = make_game(None, "contest", RULES[300])
    seen = observed(spec, [-30.0, -20.0, 0.0, 19.9, 20.0, 40.0])
    size = plan_agent(spec, Plan((-20.0, 20.0), (1, 2, 3)), "size").act(seen)
    walks = [best_fixed(spec, target=target).act(seen) for target in (1, 2, 3)]
    assert size.tolist() == [walks[k][row] for row, k in enumerate((0, 1, 1, 1, 2, 2))]
    sign = plan_agent(spec, Plan((0.0,), (1, 2)), "sign").act(seen)
    assert (sign == best_lead_plan(spec, targets={"behind": 1, "ahead": 2}).act(seen)).all()


def test_the_long_rules_last_300_s():
    assert (RULES[40].ends[-1], RULES[300].ends[-1]) == (40.0, 300.0)
    assert str(Plan((-5.0, 5.0), (1, 2, 3))) == "policy 1, from -5 m: policy 2, from 5 m: policy 3"


def test_the_search_changes_one_target_after_another():
    asked = []

    def raced(plans):
        asked.append(len(plans))
        return max(
            plans,
            key=lambda plan: -sum(abs(t - w) for t, w in zip(plan.targets, (2, 0), strict=True)),
        )

    assert climb(Plan((0.0,), (1, 1)), [0, 1, 2], raced) == Plan((0.0,), (2, 0))
    assert len(asked) == 3


def outcome(archive, arm, score):
    return Outcome(archive, 300, arm, Plan((), (0,)), 0.5, score, 0.1)


def test_gains_are_over_the_best_fixed_policy_of_the_same_archive():
    scores = {"best-fixed": (0.5, 0.7), "best-lead-plan": (0.52, 0.76)}
    rows = gain_rows(
        [outcome(f"a{k}", arm, score) for arm, two in scores.items() for k, score in enumerate(two)]
    )
    assert rows[1][:4] == ("300", "best-fixed", "0.600", "0.100")
    # Student's t with 1 degree of freedom: 12.7 standard errors of 0.02.
    assert rows[2][-1] == "+0.040 [-0.214, +0.294]"


def test_one_archive_has_no_interval(tmp_path, capsys):
    assert main(["long-races", "--archives", "contest", "--out", str(tmp_path / "out")]) == 2
    assert "give at least two different archives" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
