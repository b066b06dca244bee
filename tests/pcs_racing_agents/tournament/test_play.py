import pytest
from refusal import refused
from same_move import Model

from pcs_racing import load_archive, load_rules, racer
from pcs_racing.game.archive_files import save_archive
from pcs_racing.game.make import make_game
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.tournament import (
    plan_tournament,
    play_tournament,
    tournament_settings,
)

CONTEST = load_rules("contest", duration=6.0)
POLICIES = [racer(f"lattice:pace={pace}") for pace in (0.0, 0.5, 1.0)]
MIXED = ["random-moves", "best-fixed:target=3", "lane-switcher:any", POLICIES[1]]


def test_every_pair_drives_the_same_races_on_every_track(tournament):
    assert tournament.plan.names == ("lattice:pace=0.0", "lattice:pace=0.5", "lattice:pace=1.0")
    assert [track.name for track in tournament.plan.tracks] == ["oval", "Pipkin"]
    assert len(tournament.races) == 2 * 3 * 6
    met = {(row.track, row.ego, row.opponent) for row in tournament.races}
    assert len(met) == 2 * 3
    # Common random numbers: race k has the same line, side and noise for each pair; both sides of
    # each line.
    for track in tournament.plan.tracks:
        rows = [row for row in tournament.races if row.track == track.name]
        starts = {row.race: (row.start_s, row.side) for row in rows}
        assert all(starts[row.race] == (row.start_s, row.side) for row in rows)
        assert [starts[k][1] for k in range(6)] == [0, 1] * 3
        assert [starts[k][0] for k in (0, 2, 4)] == [starts[k][0] for k in (1, 3, 5)]
        assert len({s for s, _ in starts.values()}) == 3  # no race is driven twice


def test_agents_start_from_policies_that_are_fair_to_both_seats(mixed, archive):
    """Races 2j and 2j + 1 swap all that belongs to a seat: side and start policy. All pairs meet
    the same.
    """
    rows = [
        row
        for row in mixed.races
        if (row.ego, row.opponent) == ("random-moves", "best-fixed:target=3")
    ]
    for one, other in zip(rows[::2], rows[1::2], strict=True):
        assert (one.ego_variant, one.opponent_variant) == (
            other.opponent_variant,
            other.ego_variant,
        )
        assert (one.side, other.side) == (0, 1)
    fixed = [row for row in mixed.races if (row.ego, row.opponent) == ("random-moves", MIXED[2])]
    assert [row.ego_variant for row in fixed] == [row.ego_variant for row in rows]
    assert all(0 <= row.opponent_variant < 20 for row in fixed)
    assert len({row.opponent_variant for row in fixed}) > 2
    assert all(row.opponent_path == row.opponent_moves == () for row in fixed)


def test_a_row_tells_the_game_again_and_its_race_can_be_watched(mixed, archive, tournament):
    spec = make_game(None, archive, mixed.plan.spec.rules)
    for row in mixed.races:
        for variant, path, moves in (
            (row.ego_variant, row.ego_path, row.ego_moves),
            (row.opponent_variant, row.opponent_path, row.opponent_moves),
        ):
            assert len(moves) == max(len(path) - 1, 0)
            if path:
                assert path[0] == variant
            for policy, move, there in zip(path, moves, path[1:], strict=False):
                assert spec.table[policy, spec.move(move)] == there
        assert (row.crash != "none") == (row.duration < 6.0) == (row.fault != "none")
    for played in (tournament, mixed):
        for row in list(played.races)[3:30:9]:
            recording = played.record(row, candidates=False)
            assert recording.replay.lead[-1] == row.lead
            assert recording.replay.car_names == (row.ego, row.opponent)
            assert recording.replay.candidates is None
    assert tournament.record(tournament.races[0]).replay.candidates is not None
    refused("was not raced here", tournament.record, tournament.races[0]._replace(track="Monza"))


def test_races_by_laps_end_before_their_last_steps_and_have_best_laps(oval, archive):
    rules = load_rules("contest", laps=1, contact="restart", duration=20.0)
    played = play_tournament(oval, MIXED[1:3], rules, archive=archive, races_per_pair=4)
    for row in played.races:
        laps = {"ego": row.ego_best_lap, "opponent": row.opponent_best_lap}
        assert 0.0 <= row.duration - laps[row.winner] < 0.02
        assert len(row.ego_path) < 7
        replay = played.record(row, candidates=False).replay
        assert replay.lead[-1] == row.lead
        assert [event.kind for event in replay.events].count("lap") >= 1


def test_the_settings_of_a_job_hold_everything_that_the_races_depend_on(
    mixed, oval, archive, tmp_path
):
    plan = plan_tournament(oval, MIXED)
    default = load_archive("default")
    expected = {
        "rules": load_rules("paper"),
        "archive": "default",
        "archive_sha256": default.content_hash,
    }
    assert tournament_settings(plan) == {
        "seed": 0,
        "races_per_pair": 20,
        **expected,
        "tracks": {"oval": oval.content_hash},
        "agents": dict(zip(plan.names, map(competitor_hash, plan.competitors), strict=True)),
    }
    assert plan_tournament(
        oval, MIXED, archive=str(save_archive(default, tmp_path))
    ).archive == str(tmp_path.resolve())
    assert mixed.plan.archive == archive.name


def test_names_for_models(oval, archive):
    both = {"trained": Model(), "untrained": Model()}
    played = play_tournament(oval, both, CONTEST, archive=archive, races_per_pair=2)
    assert played.plan.names == ("trained", "untrained")
    assert {move for row in played.races for move in row.ego_moves} == {"aggressiveness +"}


def test_bad_input_is_refused_before_any_race(oval):
    for change, message in [
        ({"entrants": POLICIES[:1]}, "1 competitors given"),
        ({"entrants": [*POLICIES, POLICIES[1]]}, r"lattice:pace=0.5"),
        ({"tracks": []}, "0 tracks given"),
        ({"races_per_pair": 3}, "races_per_pair is 3"),
        ({"races_per_pair": 0}, "races_per_pair is 0"),
        ({"races_per_pair": 2002}, "races_per_pair is 2002"),
        ({"rules": load_rules("paper", start_spacing=5.0)}, "no place"),
    ]:
        arguments = {
            "tracks": oval,
            "entrants": POLICIES,
            "rules": CONTEST,
            "races_per_pair": 2,
        } | change
        refused(
            message,
            play_tournament,
            **arguments,
            progress=lambda *_: pytest.fail("a race was driven"),
        )
