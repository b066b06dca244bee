import pytest

from pcs_racing import InputError
from pcs_racing.game.moves import move_names, move_table
from pcs_racing_agents.explain.pcs_picture import archive_picture
from pcs_racing_agents.pictures.style import save_picture


def test_the_archive_shows_where_moves_lead(archive, tmp_path):
    figure = archive_picture(archive, epsilon=0.5, policy=3)
    texts = " ".join(text.get_text() for text in figure.axes[0].texts)
    names, leads_to = move_names(archive, 0.5), move_table(archive, 0.5)[3]
    assert all(name in texts for name in names)
    arrows = [text for text in figure.axes[0].texts if text.get_text() == "" and text.arrow_patch is not None]
    assert len(arrows) == len(set(leads_to.tolist()) - {3})
    assert save_picture(figure, tmp_path / "archive.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="policy is 12"):
        archive_picture(archive, policy=12)
