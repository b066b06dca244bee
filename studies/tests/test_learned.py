"""Learned characteristics: their values by hand, their files, and archives on their axes."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from refusal import refused

from pcs_racing import PolicyArchive, get_planner, load_archive, save_archive
from pcs_racing.game import characteristics
from pcs_racing.game.characteristics import Segment, get_characteristics, measure
from pcs_racing.race.state import SUMS
from pcs_racing.testing import check_archive, check_characteristic
from studies.axes import learned

INPUTS = (learned.LearnedInput("aggressiveness", 0.0, 2.0), learned.LearnedInput("restraint", 1.0, 0.5))
RATING = learned.LearnedAxis(
    "toy_rating", "a rating", 0.5, (("aggressiveness", 2.0), ("aggressiveness * restraint", -1.0))
)
CYCLE = learned.LearnedAxis("toy_cycle", "a cycle", 0.0, (("restraint", 1.0),))
TOY = learned.LearnedCharacteristics("toy", INPUTS, (RATING, CYCLE), {"seed": 3})


pytestmark = pytest.mark.usefixtures("own_registry")


def archive(**changes) -> PolicyArchive:
    lattice = get_planner("lattice")
    policies = [lattice.policy({"pace": pace}).parameters for pace in (0.2, 0.5, 0.8)]
    values = {
        "name": "toy",
        "planner": "lattice",
        "parameter_names": lattice.parameter_names,
        "parameters": np.array(policies),
        "characteristics": ("toy_rating", "toy_cycle"),
        "coordinates": np.array([[0.0, 1.0], [1.0, 0.0], [2.0, -1.0]]),
    }
    return PolicyArchive(**{**values, **changes})


def piece(lead: float) -> Segment:
    """One race of 8 s with no sample of time to collision: a restraint of 0, so -2 on the scale of the input."""
    return Segment(np.array([[40.0 + lead, 40.0]]), np.zeros((1, 2, len(SUMS))), np.array([8.0]), 8.0)


def test_the_axes_are_ordinary_characteristics_that_sum_weighted_and_limited_terms():
    # A lead of 4 m is 2 sd: 0.5 + 2 * 2 - 2 * (-2) for car 0; a deficit is -2: 0.5 - 4 - 4 for car 1.
    values = measure(piece(4.0), TOY.characteristics)
    np.testing.assert_allclose(values[0], [[8.5, -2.0], [-7.5, -2.0]])
    far, limit = (measure(piece(lead), TOY.characteristics) for lead in (1000.0, 2.0 * learned.BOUND))
    np.testing.assert_array_equal(far, limit)
    inputs = measure(piece(3.0), get_characteristics(["aggressiveness", "restraint"]))
    np.testing.assert_array_equal(TOY.estimate(inputs), measure(piece(3.0), TOY.characteristics))
    learned.register_learned(TOY)
    learned.register_learned(
        learned.LearnedCharacteristics.from_plain(TOY.to_plain())
    )  # an equal set again: nothing happens
    for characteristic in get_characteristics(TOY.names):
        check_characteristic(characteristic)
    refused("toy_rating", learned.register_learned, replace(TOY, axes=(replace(RATING, intercept=0.0), CYCLE)))


def test_a_file_brings_them_back(tmp_path):
    file = learned.save_learned(TOY, tmp_path / "toy.yaml")
    read = learned.load_learned(file)
    assert read == TOY
    assert read.training == {"seed": 3}
    assert get_characteristics(["toy_rating"])


def test_damaged_files_are_refused(tmp_path):
    for change, value in [
        (lambda plain: plain["axes"][0]["weights"].update(aggressiveness=2.5), "sha256"),
        (lambda plain: plain["axes"][0]["weights"].update(charm=1.0), "charm"),
        (lambda plain: plain["axes"][0].update(intercept=float("nan")), "nan"),
        (lambda plain: plain["axes"][0].update(weights=[1.0]), "weights"),
        (lambda plain: plain["axes"][0].update(name="pace"), "pace"),
        (lambda plain: plain["inputs"][0].update(scale=0.0), "scale"),
        (lambda plain: plain["inputs"][0].update(name="charm"), "charm"),
        (lambda plain: plain.update(inputs=3), "inputs"),
        (lambda plain: plain.update(name="../toy"), "../toy"),
        (lambda plain: plain.update(training=[]), "training"),
        (lambda plain: plain.pop("sha256"), "sha256"),
    ]:
        file = learned.save_learned(TOY, tmp_path / "toy.yaml")
        plain = yaml.safe_load(file.read_text())
        change(plain)
        file.write_text(yaml.safe_dump(plain))
        refused(value.replace(".", r"\."), learned.load_learned, file)
        assert "toy_rating" not in characteristics._registered


def test_an_archive_on_them_is_read_once_they_are_known(tmp_path, monkeypatch):
    file, without = learned.save_learned(TOY, tmp_path / "toy.yaml"), dict(characteristics._registered)
    learned.register_learned(TOY)
    made = archive()
    check_archive(made)
    folder = save_archive(made, tmp_path / "toy")
    monkeypatch.setattr(characteristics, "_registered", without)  # as in another process
    refused("toy_rating", load_archive, folder)
    learned.load_learned(file)
    assert load_archive(folder).content_hash == made.content_hash
