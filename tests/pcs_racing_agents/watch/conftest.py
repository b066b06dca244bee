import pytest

from pcs_racing_agents.cli.main import main


@pytest.fixture(scope="session")
def page(tournament_folder, tmp_path_factory):
    """Its page, with five races to watch."""
    path = tmp_path_factory.mktemp("pages") / "view.html"
    assert (
        main(["view", str(tournament_folder[0]), "--replays", "5", "--out", str(path), "--no-open"])
        == 0
    )
    return path
