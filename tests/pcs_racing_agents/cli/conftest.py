"""Folders of results as commands leave them."""

import pytest

from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.base.folders import claim_folder
from pcs_racing_agents.study.config import StudyConfig, TableConfig
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament import write_results
from pcs_racing_agents.tournament.pairings import cross_pairing, play_pairing
from pcs_racing_agents.tournament.races import concatenate_races


@pytest.fixture(scope="package")
def study_folder(saved_archive, tmp_path_factory):
    """The races of a small study, as it leaves them."""
    place = tmp_path_factory.mktemp("study") / "mine"
    agents = ("never-switch", "always-aggressiveness+")
    config = StudyConfig(
        archive=str(saved_archive),
        table=TableConfig(("Pipkin",), ("lane-switcher:any",), agents, egos=2, variants=2, lines=2),
        best=agents[1],
        seed=3,
    )
    study = Study(config, place, quiet=True)
    with claim_folder(place, "study", plain_settings(config)):
        game = study.game("Pipkin")
        pairs, rival = {"egos": 2, "opponents": 2}, study.agent("lane-switcher:any")
        pairings = [
            cross_pairing(game, study.agent(arm), rival, lines=2, seed=3, **pairs) for arm in agents
        ]
        # A second table has the same pairs with other lines.
        pairings += [
            cross_pairing(game, study.agent("never-switch"), rival, lines=1, seed=103, **pairs)
        ]
        write_results(concatenate_races(map(play_pairing, pairings)), place / "results.csv")
    return place, pairings
