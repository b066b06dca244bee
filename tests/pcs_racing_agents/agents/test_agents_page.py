"""docs/agents.md and the page of the zoo agree with the zoo."""

import numpy as np
import pytest
from repository import load_tool
from zoo_games import measured_agent

from pcs_racing_agents import make
from pcs_racing_agents.agents import describe, make_game_spec, names
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.describe import facts_of, measurements, option_meanings
from pcs_racing_agents.agents.zoo import SHIPPED, entries, options

zoo_page = load_tool("zoo_page")


def test_the_page_of_the_zoo_explains_every_option_with_and_without_measurements(monkeypatch):
    page = zoo_page.zoo_page()
    for name in (*SHIPPED, "always-MOVE"):
        assert f"\n### `{name}`\n" in page
    for one in measurements().values():
        assert f"\n| `{one.agent}` | {one.score:.3f} | " in page
    assert "nan" not in page
    for name, entry in entries().items():
        assert set(options(name)) <= set(option_meanings(entry.build)), name
    # As between the day agents are made and the day they are measured.
    monkeypatch.setattr(zoo_page, "measurements", dict)
    assert zoo_page.zoo_page().count("Not measured yet.") == len(zoo_page.SHIPPED_GAMES)


@pytest.mark.parametrize(("archive", "race"), zoo_page.SHIPPED_GAMES)
def test_every_agent_was_measured_as_it_is_now(archive, race):
    known = {
        name: one.sha256
        for (*where, name), one in measurements().items()
        if where == [archive, race]
    }
    shipped = {}
    for name in {*names(archive, race), *known}:
        try:
            shipped[name] = competitor_hash(make(name, archive=archive, rules=race))
        except LookupError:  # nothing is shipped for it
            continue
    changed = sorted(name for name in {*known, *shipped} if known.get(name) != shipped.get(name))
    assert not changed, (
        f"{', '.join(changed)} not measured as they are: run: python dev/benchmarks/zoo.py --write"
    )


def test_a_measurement_holds_for_the_very_agent_that_was_measured(monkeypatch, tmp_path):
    for module in (describe, zoo_page):
        monkeypatch.setattr(module, "measured_file", lambda: tmp_path / "measured.csv")
    measurements.cache_clear()
    try:
        digest = competitor_hash(make("never-switch"))
        assert not measurements()
        one = measured_agent("default", digest, {"random-moves": 0.625})
        zoo_page.write_measurements(
            [one, one._replace(agent="lane-switcher", many_us=np.nan, against={})]
        )
        assert measurements()["default", "paper", "never-switch"] == one
        assert np.isnan(measurements()["default", "paper", "lane-switcher"].many_us)
        page = zoo_page.zoo_page()
        assert (
            f"| `never-switch` | 0.500 | -12 [-40, +20] | 2.0% | 46 | 0.53 | `{digest[:12]}` |"
            in page
        )
        assert (
            f"| `lane-switcher` | 0.500 | -12 [-40, +20] | 2.0% | 46 |  | `{digest[:12]}` |" in page
        )
    finally:
        measurements.cache_clear()


def test_the_command_tells_the_same(printed):
    out = printed("agents", "cfr-argmax")
    for line in facts_of("cfr-argmax", make_game_spec("default", "paper")):
        assert f"- {line}\n" in out
    assert "- Not shipped for this game." in printed("agents", "ppo", "--archive", "contest")
