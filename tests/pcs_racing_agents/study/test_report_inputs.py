from dataclasses import replace

import numpy as np
import pytest
from toy_races import toy_races

from pcs_racing import InputError
from pcs_racing_agents.study.report_inputs import (
    TreeLoss,
    mean_losses,
    mean_scores,
    read_curves,
    read_losses,
    scores_and_losses,
)
from pcs_racing_agents.study.table import make_table


def test_losses_are_means_over_trees(tmp_path):
    path = tmp_path / "exploitability.csv"
    head = "track,agent,tree,lost_to_best_response,lost_to_equilibrium,off_in_self_play,against_random\n"
    path.write_text(head + "Oval,a,0,1.0,0.5,0,2\nOval,a,1,3.0,0.5,0,4\nOval,b,0,1,1,1,1\n")
    first, second = read_losses(path)
    assert first == TreeLoss("Oval", "a", 2, ((2.0, 1.0), (0.5, 0.0), (3.0, 1.0)))
    assert np.isnan(second.columns[0][1])
    table = make_table(toy_races(strengths={"a": 0.0, "c": 0.1}, egos=3, variants=3))
    (place,) = scores_and_losses(table, [first, second])
    assert (place.name, place.loss, place.loss_error) == ("a", 2.0, 1.0)
    assert place.score == pytest.approx(np.mean([row.arms[0].score for row in table.rows]))
    assert scores_and_losses(None, [first]) == []
    assert mean_scores(table)["c"] == pytest.approx(np.mean([row.arms[1].score for row in table.rows]))
    assert mean_scores(
        replace(table, rows=(*table.rows, replace(table.rows[0], arms=table.rows[0].arms[:1])))
    ).keys() == {"a"}
    both = mean_losses(
        [first, second, first._replace(track="Elsewhere", columns=((4.0, 0.0), (np.nan, np.nan), (3.0, 1.0)))]
    )
    assert both["a"].columns[0] == (3.0, 0.5)
    assert np.isnan(both["a"].columns[1][0])
    assert (both["a"].trees, both["a"].track) == (4, "Oval, Elsewhere")
    path.write_text(head.replace("agent", "name"))
    with pytest.raises(InputError, match="no column 'agent'"):
        read_losses(path)
    path.write_text(head + "Oval,a,0,much,0,0,0\n")
    with pytest.raises(InputError, match="'much' where a number should be"):
        read_losses(path)


def test_curves_come_from_the_files_beside_networks(tmp_path):
    path = tmp_path / "learning_curves.csv"
    path.write_text("epoch,training_loss,validation_loss\n1,0.5,\n2,0.25,0.3\n")
    training, validation = read_curves(path)
    assert (training.label, training.y.tolist(), training.x.tolist()) == ("training", [0.5, 0.25], [1.0, 2.0])
    assert np.isnan(validation.y[0])
    with pytest.raises(InputError, match="can't read"):
        read_curves(tmp_path / "nothing.csv")
