from dataclasses import replace

import numpy as np
import pytest
from toy_races import toy_races

from pcs_racing import InputError
from pcs_racing_agents.study.report_inputs import (
    ReplyLoss,
    mean_scores,
    read_curves,
    read_losses,
    scores_and_losses,
    total_losses,
)
from pcs_racing_agents.study.table import make_table


def test_losses_to_best_replies_are_read_and_stand_beside_the_score(tmp_path):
    path = tmp_path / "best_replies.csv"
    head = ",".join(("agent", "track", *ReplyLoss._fields[2:])) + "\n"
    lines = ("a,Oval,0.1,0,0.2,400,0.6,0.4,0.05", "a,Hut,0.3,0.2,0.4,400,0.8,0.2,0", "a,all,0.2,0.1,0.3,800,0.7,0.3,0")
    path.write_text(head + "\n".join(lines) + "\nb,Oval,-0.1,-0.2,0,40,0.4,0.6,0\n")
    losses = read_losses(path)
    assert losses[0] == ReplyLoss("a", "Oval", 0.1, 0.0, 0.2, 400, 0.6, 0.4, 0.05)
    totals = total_losses(losses)
    assert {name: (total.track, total.loss) for name, total in totals.items()} == {
        "a": ("all", 0.2),
        "b": ("Oval", -0.1),
    }
    table = make_table(toy_races(strengths={"a": 0.0, "c": 0.1}, egos=3, variants=3))
    (place,) = scores_and_losses(table, losses)
    assert (place.name, place.loss, place.low, place.high) == ("a", 0.2, 0.1, 0.3)
    assert place.score == pytest.approx(np.mean([row.arms[0].score for row in table.rows]))
    assert scores_and_losses(None, losses) == []
    assert mean_scores(table)["c"] == pytest.approx(np.mean([row.arms[1].score for row in table.rows]))
    assert mean_scores(
        replace(table, rows=(*table.rows, replace(table.rows[0], arms=table.rows[0].arms[:1])))
    ).keys() == {"a"}


@pytest.mark.parametrize(("wrong", "value"), [("much", "'much'"), ("", "'a'"), ("inf", "'inf'")])
def test_files_without_losses_are_refused(tmp_path, wrong, value):
    path = tmp_path / "best_replies.csv"
    head = ",".join(("agent", "track", *ReplyLoss._fields[2:])) + "\n"
    path.write_text(head.replace("agent,", "name,", 1))
    with pytest.raises(InputError, match="'agent'"):
        read_losses(path)
    path.write_text(f"{head}a,Oval,{wrong},0,0.2,400,0.6,0.4,0.05\n")
    with pytest.raises(InputError, match=value):
        read_losses(path)


def test_curves_come_from_the_files_beside_networks(tmp_path):
    path = tmp_path / "learning_curves.csv"
    path.write_text("epoch,training_loss,validation_loss\n1,0.5,\n2,0.25,0.3\n")
    training, validation = read_curves(path)
    assert (training.label, training.y.tolist(), training.x.tolist()) == ("training", [0.5, 0.25], [1.0, 2.0])
    assert np.isnan(validation.y[0])
    with pytest.raises(InputError, match="can't read"):
        read_curves(tmp_path / "nothing.csv")
