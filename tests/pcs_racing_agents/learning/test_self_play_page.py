"""Families of opponents for training and for tests are apart."""

from pcs_racing_agents.agents.zoo import SHIPPED
from pcs_racing_agents.study.family_gains import FAMILIES, family_of


def test_an_opponent_is_for_training_or_for_tests_never_both():
    members = [member for family in FAMILIES for member in family.members]
    assert len(members) == len(set(members))
    assert set(members) <= set(SHIPPED)
    assert family_of("lane-switcher:3").use == "test"
    assert family_of("always-pace+") is None
    training = {family.name for family in FAMILIES if family.use == "training"}
    assert training == {"archive", "random moves", "gap follower"}
