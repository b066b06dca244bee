from dataclasses import replace
from inspect import signature

import numpy as np
import pytest
from refusal import refused
from repository import load_tool
from same_move import Model
from zoo_games import CONFIG, measured_agent, untrained

import pcs_racing_agents
from pcs_racing import make_game
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game.players import always, competitor, random_moves
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.agents import Agent, describe, make, names, register_agent, zoo
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.describe import facts_of, measurements, option_meanings
from pcs_racing_agents.agents.zoo import SHIPPED, build, entries, options
from pcs_racing_agents.networks import NetworkSet
from pcs_racing_agents.tournament.games import game_between


def learned(name: str, spec) -> dict:
    """Options that an agent of the zoo needs if nothing is shipped for its game."""
    given = {
        "best-schedule": {"moves": ["stay"] * 4},
        "best-fixed": {"target": 3},
        "best-lead-plan": {"targets": {"behind": 3, "ahead": 5}},
    }
    if name in SHIPPED and entries()[name].needs == "network":
        return {"network": untrained(spec)}
    if name in SHIPPED and entries()[name].needs == "networks":
        networks = tuple(untrained(spec, "advantage", seed) for seed in (1, 2))
        return {"networks": NetworkSet("untrained", networks, np.ones(2), "regret-matching")}
    return given.get(name, {})


def test_everything_in_the_zoo_can_be_made_and_asked(spec, seen):
    listed = names(spec.archive, spec.rules)
    assert len(listed) == len(set(listed)) >= len(SHIPPED) + 4
    assert len(SHIPPED) + 1 <= 16  # and always-MOVE: few enough to read
    assert {"always-aggressiveness+", "always-restraint-"} <= set(listed)
    for name in listed:
        if name.startswith("always-"):
            continue
        created = build(name, spec, seed=3, **learned(name, spec))
        assert created.name == name
        if name in SHIPPED:
            assert signature(entries()[name].build).parameters["seed"].default == 0
            assert entries()[name].moves == (not isinstance(created, PolicySet))
        if isinstance(created, PolicySet):
            assert name == "random-policy"
            continue
        for rows in seen[:-1]:
            chances = created.probabilities(rows)
            np.testing.assert_allclose(chances.sum(axis=1), 1.0, atol=1e-9)
            moves = created.act(rows)
            assert (chances[np.arange(len(rows)), moves] > 0.0).all()
        if isinstance(created, Agent):
            assert created.facts["does"] == entries()[name].summary
            assert created.facts["source"] == entries()[name].source


def test_the_archive_of_a_setting_has_the_axes_of_the_game(archive):
    one = make_game(None, archive, replace(CONFIG, characteristics=("restraint",)))
    assert (one.archive.characteristics, one.moves) == (
        ("restraint",),
        ("restraint +", "restraint -", "stay"),
    )
    same = make_game(None, archive, replace(CONFIG, characteristics=archive.characteristics))
    assert same.archive is archive
    assert [
        make_game(None, archive, replace(CONFIG, stay=stay)).offered for stay in (False, True)
    ] == [4, 5]
    assert (one.move("restraint-"), len(one.observation_elements)) == (1, 5 * 4 + 1)


def test_agents_are_made_by_name_for_a_shipped_archive_and_told_from_those_of_another(
    game, spec, oval
):
    agent = pcs_racing_agents.make("random-moves", rules="contest", seed=1)
    assert agent.chances == (0.2,) * 5  # the contest offers "stay" to all
    assert "never-switch" in pcs_racing_agents.agents.names()
    explored = len(make_game(None).archive.explored_parameters)
    assert len(make("random-policy").policies) == explored
    assert len(make("random-policy", first=80).policies) == 80
    refused("first is 0; it must be a whole number from 1 to", make, "random-policy", first=0)
    with pytest.raises(AttributeError, match="mak"):
        pcs_racing_agents.mak  # noqa: B018
    other = make("cfr-argmax")
    refused(
        r"agent 'cfr-argmax' was made for archive 'default' \(.*\)",
        game_between,
        game,
        other,
        other,
    )
    agent = build("cfr-argmax", spec, network=untrained(spec))
    wider = make_game(oval, spec.archive, spec.rules, epsilon=0.7)
    refused(r"epsilon 0\.5; .*0\.7", game_between, wider, agent, agent)


def test_agents_as_text_and_bad_names_and_options(spec):
    assert competitor("best-fixed:target=3", spec).name == "best-fixed:target=3"
    assert competitor("always-restraint +", spec).name == "always-restraint+"
    spec = make_game(None, "contest", "contest")
    drawn = competitor("cfr-argmax:decision=sample,network=contest-contest-regret", spec)
    assert drawn.facts["decision"] == "sample"
    for text in (
        "best-fixed:3",
        "best-fixed:target=3,target=4",
        "best-fixed:name=x",
        "best-fixed:target=[1",
    ):
        refused("'best-fixed", competitor, text, spec)
    for name, given, message in [
        ("cfr-armax", {}, "did you mean 'cfr-argmax'?"),
        ("never-switch", {"speed": 3}, r"'never-switch' .*'speed'"),
        ("best-fixed", {"goal": 3}, "has no option 'goal'"),
        ("always-restraint+", {"x": 1}, r"'always-restraint\+' is unknown"),
        ("lattice:pace=0.5", {"x": 1}, "'lattice:pace=0.5' is unknown"),
        ("random-policy", {"first": 1, "x": 2}, "has no option 'x'; it has first"),
        ("never-switch", {"x": 2}, "has no option 'x'; it has none"),
    ]:
        refused(message, build, name, spec, **given)
    refused(
        "unknown archive 'nowhere'", make, "never-switch", archive="nowhere", error=UnknownNameError
    )


def third_party(spec, *, name="x", seed=0, bold=False):
    """Make the first move for ever."""
    return always(spec, spec.moves[0], name=name, seed=seed) if bold else Model()


def test_agents_of_other_people(spec, monkeypatch):
    monkeypatch.setattr(zoo, "_registered", {})
    register_agent("first-move", third_party)
    register_agent("first-move", third_party)  # again changes nothing
    assert entries()["first-move"].summary == "Make the first move for ever."
    assert "first-move" in names(spec.archive, spec.rules)
    assert options("first-move") == {"bold": False}
    assert build("first-move", spec).name == "first-move"
    assert build("first-move", spec, bold=True).chances[0] == 1.0
    register_agent("any-options", lambda spec, **given: third_party(spec, **given))
    assert build("any-options", spec, bold=True).chances[0] == 1.0
    refused("agent 'first-move' already", register_agent, "first-move", random_moves)
    for name in ("", "a b", "nash", "always-x", "a:b"):
        refused("agent", register_agent, name, third_party)

    far = {"far": f"{__name__}:third_party", "broken": "no.such:thing"}
    monkeypatch.setattr(zoo, "declared", lambda group: far)
    assert {"far", "broken"} <= set(names(spec.archive, spec.rules))
    assert build("far", spec, bold=True).name == "far"
    refused(r"agent 'broken' can't be loaded from no\.such:thing", build, "broken", spec)


def test_a_shipped_agent_is_a_file_and_a_line(spec, monkeypatch, tmp_path):
    """With its line in SHIPPED it is listed, made, asked and described, by the command as well."""
    (tmp_path / "bold_agent.py").write_text(
        "from pcs_racing_agents.agents.blind import best_fixed\n"
        "from pcs_racing_agents.agents.zoo import Entry\n"
        "def bold(spec, *, name='bold', seed=0, target=3):\n"
        "    return best_fixed(spec, name=name, seed=seed, target=target)\n"
        "BOLD = Entry(bold, 'races ever more aggressively', 'a test')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(SHIPPED, "bold", "bold_agent:BOLD")
    assert "bold" in names(spec.archive, spec.rules)
    assert options("bold") == {"target": 3}
    created = build("bold", spec)
    assert (created.name, created.facts["does"]) == ("bold", "races ever more aggressively")
    text = describe.describe("bold", entries()["bold"])
    assert "Races ever more aggressively." in text
    assert "- Option `target`, by default `3`." in text


def test_an_agent_is_described_with_its_options_and_as_it_was_measured(spec, monkeypatch):
    assert describe.describe("nash", entries()["nash"]).splitlines() == [
        "Draws its moves from an approximate equilibrium strategy.",
        "",
        "- Source: backward induction, sampled.",
        "- Needs the network `ARCHIVE-RULES-nash`, or `network=FOLDER`.",
        (
            "- Option `decision`, by default `sample`. The rule: `argmax`, `regret-matching`,"
            " `sample` or `softmax`."
        ),
        (
            "- Option `network`, by default `None`. Another network: the name of a shipped one or"
            " its folder."
        ),
    ]
    digest = competitor_hash(build("never-switch", spec))
    one = measured_agent("toy", digest, {"random-moves": 0.625, "nash": 0.25})
    monkeypatch.setattr(describe, "measurements", lambda: {("toy", "paper", "never-switch"): one})
    assert describe.facts_of("never-switch", spec) == [
        (
            "Strength: score 0.500, rating -12 [-40, +20], on Tarnfjord, Saltmere in 300 races"
            " (0.625 against random-moves, 0.250 against nash); own crashes 2.0%."
        ),
        "Cost: 46 us for one observation, 0.53 us for each of 1,000 at once.",
        f"Hash: {digest[:16]}.",
    ]
    changed = competitor_hash(build("random-moves", spec))
    unmeasured = ["Strength and cost: not measured as it is.", f"Hash: {changed[:16]}."]
    assert describe.facts_of("random-moves", spec) == unmeasured
    assert describe.facts_of("nash", spec) == describe.NOT_SHIPPED
    assert describe.facts_of("response", make_game(None, "contest", "contest"))[0].startswith(
        "Network: contest-contest-"
    )


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


def test_the_command_tells_the_same(printed):
    out = printed("agents", "cfr-argmax")
    for line in facts_of("cfr-argmax", make_game(None, "default", "paper")):
        assert f"- {line}\n" in out
    assert "- Not shipped for this game." in printed("agents", "ppo", "--archive", "contest")
