import pytest

from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing_agents.networks import TrainSettings, load_train_settings
from pcs_racing_agents.networks.settings import settings_for_trees


def test_settings_come_from_yaml_and_can_be_changed(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("target: advantage\nhidden: [8, 4]\nlearning_rate: 1.0e-3\n")
    settings = load_train_settings(file, epochs=7)
    assert settings == TrainSettings(target="advantage", hidden=(8, 4), learning_rate=1e-3, epochs=7)
    assert load_train_settings(settings, seed=2) == load_train_settings(file, epochs=7, seed=2)
    assert load_train_settings() == TrainSettings()
    with pytest.raises(UnknownNameError, match="settings 'nowhere' are unknown"):
        load_train_settings("nowhere")


def test_open_choices_are_made_as_fits_the_target():
    def chosen(target, **given):
        made = settings_for_trees(load_train_settings(target=target, **given))
        return made.row_weights, made.floor, made.differences

    assert chosen("regret") == ("uniform", 0.25, True)
    assert chosen("advantage") == ("random", 0.25, True)
    assert chosen("nash") == ("random", 0.0, False)
    assert chosen("advantage", row_weights="uniform", floor=0.0, differences=False) == ("uniform", 0.0, False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("target: joy", "target is 'joy'"),
        ("row_weights: x", "row_weights is 'x'"),
        ("differences: 1", "differences is 1"),
        ("{validation_share: 0.5, test_share: 0.5}", "together"),
        ("hidden: [1, 1, 1, 1, 1, 1, 1, 1, 1]", "at most 8"),
    ],
)
def test_impossible_settings_are_one_clear_error(tmp_path, text, message):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_train_settings(file)
