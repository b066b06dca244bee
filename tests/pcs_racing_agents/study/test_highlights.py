from pcs_racing_agents.study.highlights import select_highlights


def test_highlights_are_what_they_are_called(raced):
    _, ours, baseline = raced
    result = select_highlights(ours, baseline)
    assert len(result) >= 2
    for kind, (title, race) in result.items():
        assert title.startswith(f"A {kind}")
        if kind == "win":
            assert ours.winner[race] == 0
            assert len(set(ours[race].ego_path)) > 1
        if kind == "loss":
            assert ours.winner[race] == 1
        if kind == "crash":
            assert ours.fault[race, 0] == 1
        else:
            assert not ours.crash[race]
        if "starts alike" in title:
            assert baseline.winner[race] == 1 - ours.winner[race]


def test_a_race_to_watch_is_the_race(raced, watched):
    _, ours, baseline = raced
    race = dict(select_highlights(ours, baseline).values())[watched.title]
    assert watched.replay.lead[-1] == ours.lead[race]
    assert watched.text.startswith("random-moves (car 0) against lane-switcher on oval, contest rules")
