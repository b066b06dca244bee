from pcs_racing_agents.jobs.configuration import shipped_configs


def test_shipped_configurations_go_by_their_names():
    shipped = shipped_configs("train")
    assert list(shipped) == ["quick", "study"]
    assert all(file.is_file() for file in shipped.values())
