import numpy as np
import pytest

from pcs_racing import InputError, PolicyArchive, load_race_config, load_track
from pcs_racing.testing import check_archive
from pcs_racing_agents.planners.lattice import LATTICE
from pcs_racing_agents.synthesis import evaluate, front_layers, random_archive
from pcs_racing_agents.synthesis.random_search import main

SHORT = load_race_config("paper", duration=4.0)


@pytest.fixture(scope="module")
def tracks():
    return [load_track("Pipkin"), load_track("Tarnfjord")]


def small(tracks, **changes):
    settings = {
        "policies": 20,
        "opponents": 2,
        "races": 2,
        "held_out_races": 4,
        "segment_seconds": 2.0,
        "crash_limit": 0.5,
    }
    return random_archive(tracks, SHORT, **{**settings, **changes})


def test_layers_of_a_front_by_hand():
    points = np.array([[0.0, 3.0], [3.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 0.0], [2.0, 2.0]])
    np.testing.assert_array_equal(front_layers(points), [0, 0, 1, 0, 2, 0])


def test_the_policies_kept_are_those_that_none_beats(tracks):
    archive = small(tracks, fewest=1)
    assert archive.settings["front_layers_kept"] == 1
    assert archive.settings["policies_below_crash_limit"] == 20  # else some of the 20 had no say
    explored = archive.explored_coordinates
    for theta in archive.parameters:
        mine = explored[(archive.explored_parameters == theta).all(axis=1)]
        assert not ((explored >= mine).all(axis=1) & (explored > mine).any(axis=1)).any()
    check_archive(archive, tracks[0])


def test_a_thin_front_is_thickened_by_whole_layers(tracks):
    thin, thick = small(tracks, fewest=1), small(tracks, fewest=10)
    assert len(thin) < 10 <= len(thick)
    assert thick.settings["front_layers_kept"] > 1
    assert {theta.tobytes() for theta in thin.parameters} < {theta.tobytes() for theta in thick.parameters}


def test_the_stored_coordinates_come_from_other_races_than_the_choice(tracks):
    archive = small(tracks)
    for theta, found in zip(archive.parameters, archive.coordinates, strict=True):
        first = archive.explored_coordinates[(archive.explored_parameters == theta).all(axis=1)]
        assert not np.isclose(first, found).any()


def test_the_same_seed_gives_the_same_archive_to_the_last_bit(tracks, tmp_path):
    paths = [small(tracks).save(tmp_path / name) for name in ("one", "two")]
    assert (paths[0] / "archive.npz").read_bytes() == (paths[1] / "archive.npz").read_bytes()
    assert not np.array_equal(small(tracks, seed=1).explored_parameters, small(tracks).explored_parameters)


def test_every_policy_is_raced_alike(tracks):
    """What a policy evaluates to does not depend on the others."""
    rng = np.random.default_rng(0)
    thetas, rivals = (np.stack([LATTICE.sample(rng) for _ in range(n)]) for n in (3, 2))
    options = {"segment_seconds": 2.0, "races": 4, "seed": 3}
    axes = ("aggressiveness", "restraint", "smoothness")
    together = evaluate(tracks, LATTICE, thetas, rivals, SHORT, axes, **options)
    alone = evaluate(tracks, LATTICE, thetas[1:2], rivals, SHORT, axes, **options)
    np.testing.assert_allclose(alone.coordinates[0], together.coordinates[1], rtol=1e-12)
    assert together.coordinates.shape == (3, 3)
    assert ((together.own_crash >= 0.0) & (together.own_crash <= 1.0)).all()


def test_the_contest_measures_pace(tracks):
    contest = load_race_config("contest", duration=4.0)
    archive = random_archive(
        tracks[1:], contest, policies=6, opponents=1, races=2, held_out_races=2, segment_seconds=4.0, crash_limit=1.0
    )
    assert archive.characteristics == ("pace", "restraint")
    assert archive.preset == "contest"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"races": 3}, "races is 3; it must be an even number"),
        ({"segment_seconds": 3.0}, "no multiple of segment_seconds"),
        ({"policies": 1}, "take at least 1, 2 and 1"),
        ({"crash_limit": -0.1}, "all 20 policies crash in more than"),
        ({"characteristics": ("charm",)}, "'charm' is unknown"),
    ],
)
def test_impossible_settings_are_one_clear_error(tracks, changes, message):
    with pytest.raises(InputError, match=message):
        small(tracks, **changes)


def test_the_command_writes_an_archive(tmp_path, capsys):
    arguments = ["--tracks", "Pipkin", "--policies", "30", "--duration", "8"]
    assert main([str(tmp_path / "mine"), *arguments]) == 0
    assert "moves that lead nowhere" in capsys.readouterr().out
    assert PolicyArchive.load(tmp_path / "mine").name == "mine"
    assert main([str(tmp_path / "other"), "--tracks", "Nowhere"]) == 2
    assert "error: unknown track 'Nowhere'" in capsys.readouterr().err
