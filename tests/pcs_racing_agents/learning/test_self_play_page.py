"""The code in docs/self_play.md runs, and families of opponents are apart."""

import pytest
from repository import python_blocks, read_page, run_block

from pcs_racing_agents.agents.zoo import SHIPPED
from pcs_racing_agents.study.family_gains import FAMILIES, family_of

PAGE = read_page("self_play.md")
BLOCKS = python_blocks(PAGE)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, tmp_path, monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed")
    monkeypatch.chdir(tmp_path)
    run_block(BLOCKS[number])


def test_an_opponent_is_for_training_or_for_tests_never_both():
    members = [member for family in FAMILIES for member in family.members]
    assert len(members) == len(set(members))
    assert set(members) <= set(SHIPPED)
    assert family_of("lane-switcher:3").use == "test"
    assert family_of("always-pace+") is None
    training = {family.name for family in FAMILIES if family.use == "training"}
    assert training == {"archive", "random moves", "gap follower"}
