"""The archives that come with the package agree with their configurations and manifests."""

import numpy as np
import pytest

from pcs_racing import load_archive, load_track
from pcs_racing.game.moves import duplicate_share, no_op_share
from pcs_racing.testing import check_archive
from pcs_racing_agents.policies import load_archive_config
from pcs_racing_agents.policies.archive_report import stated_settings
from pcs_racing_agents.policies.archive_run import stage_scenarios
from pcs_racing_agents.policies.evaluate import race_policies, summarise


@pytest.mark.parametrize("name", ["default", "contest"])
def test_it_was_made_with_the_settings_and_circuits_that_ship(name):
    archive, config = load_archive(name), load_archive_config(name)
    for key, value in stated_settings(config).items():
        # Archives written before the rules had this name state them as the preset.
        stated = archive.settings.get(key, archive.settings.get("preset"))
        assert stated == value, key
    assert len(config.tracks) >= 3
    stated_hashes = archive.settings["track_hashes"].split(", ")
    # The archive contest was also raced on other circuits.
    for track, stated in zip(config.tracks, stated_hashes, strict=False):
        assert stated == f"{track} {load_track(track).content_hash[:16]}"


def test_the_default_archive_lies_along_the_front():
    archive = load_archive("default")
    check_archive(archive)
    assert len(archive) >= 40
    points = archive.normalised
    away = np.linalg.norm(points[:, None] - points[None], axis=-1)[~np.eye(len(points), dtype=bool)]
    assert away.min() > 0.0
    # Seen from either axis there is a policy within a quarter of the range of any place.
    for axis in range(2):
        assert np.diff(np.sort(points[:, axis])).max() < 0.25
    assert np.corrcoef(points.T)[0, 1] < -0.9  # more of one is less of the other
    assert duplicate_share(archive) < 0.15


def test_the_policies_of_the_contest_crash_seldom_and_react_to_the_lead_by_moves_alone():
    archive, config = load_archive("contest"), load_archive_config("contest")
    check_archive(archive)
    assert 8 <= len(archive) <= config.max_policies
    assert (archive.parameters[:, archive.parameter_names.index("pace_behind")] == 0.0).all()
    assert archive.own_crash.max() <= config.crash_limit
    assert no_op_share(archive) <= 0.15
    # The axes nearly lie on one line: the strong policies of the planner differ in pace alone.
    assert np.corrcoef(archive.normalised.T)[0, 1] < -0.9


def test_the_contest_is_measured_again_with_crashes_as_rare_as_they_should_be():
    """Two of its policies drive those races again; other processors may round otherwise."""
    archive = load_archive("contest")
    champion = archive.settings["champion_1"]
    _, _, final = stage_scenarios(load_archive_config("contest"), champion)
    chosen = [0, len(archive) - 1]
    found = summarise(race_policies((final, archive.complete(archive.parameters[chosen]))))
    assert (np.abs(found.coordinates - archive.coordinates[chosen]) <= archive.spread[chosen]).all()
    np.testing.assert_allclose(found.own_crash, archive.own_crash[chosen], atol=0.05)
    assert load_archive("default").own_crash.max() < 0.15
