"""Learned planners from folders, on the command line and in Python."""

import pytest
from refusal import refused

from pcs_racing.planners.learned import is_planner_folder, load_planner
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.trained import PLANNER_FORMAT


@pytest.mark.parametrize("name", ["line-ppo", "lidar-ppo"])
def test_each_kind_is_loaded_from_its_folder(name):
    folder = PLANNER_FORMAT.find(name)
    planner, shipped = load_planner(folder), get_planner(name)
    assert planner.name == str(folder)
    assert (planner.plan, planner.parameters) == (shipped.plan, shipped.parameters)


def test_a_folder_of_another_kind_is_refused(tmp_path):
    (tmp_path / "manifest.yaml").write_text("format: pcs-racing archive\n")
    assert is_planner_folder(tmp_path)
    refused("begins with 'format: pcs-racing archive'", load_planner, tmp_path)
