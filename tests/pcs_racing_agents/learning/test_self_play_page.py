"""The table of families in docs/self_play.md is that of the package."""

from repository import read_page

from pcs_racing_agents.agents.zoo import SHIPPED
from pcs_racing_agents.study.family_gains import FAMILIES, family_of

PAGE = read_page("self_play.md")


def test_the_page_names_every_family_and_its_use():
    rows = [
        line.split(" | ")
        for line in PAGE.splitlines()
        if line.startswith("| ") and line.endswith(("training |", "test |"))
    ]
    assert [(row[0].removeprefix("| "), row[-1].removesuffix(" |")) for row in rows] == [
        (family.name, family.use) for family in FAMILIES
    ]


def test_an_opponent_is_for_training_or_for_tests_never_both():
    members = [member for family in FAMILIES for member in family.members]
    assert len(members) == len(set(members))
    assert set(members) <= set(SHIPPED)
    assert family_of("lane-switcher:3").use == "test"
    assert family_of("always-pace+") is None
    training = {family.name for family in FAMILIES if family.use == "training"}
    assert training == {"archive", "random moves", "gap follower"}
