"""``make quick``: which tests a change needs."""

from repository import load_tool


def test_a_change_is_tested_in_its_rooms_and_by_the_pages_that_name_it():
    quick = load_tool("quick")
    changed = [
        "pcs_racing/car/lidar.py",
        "pcs_racing_agents/learning/ppo/train.py",
        "docs/view.md",
        "dev/tools/quick.py",
    ]
    rooms = ["tests/pcs_racing/car", "tests/pcs_racing_agents/learning/ppo", "tests/test_docs.py"]
    assert quick.select(changed) == [*quick.ALWAYS, *rooms]
    assert quick.select(
        ["tests/test_floors.py", "tests/browser.py", "pcs_racing/__init__.py"]
    ) == list(quick.ALWAYS)
    assert quick.select(["pcs_racing/race/replay.html"])[-1] == "tests/pcs_racing/race"
