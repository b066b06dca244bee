"""Settings that every learner of values from branched games has."""

from dataclasses import dataclass

from pcs_racing.base.settings import Settings, choice, number, setting, whole, wholes
from pcs_racing_agents.learning.responses.branches import WORTH
from pcs_racing_agents.networks.settings import TrainSettings

ROWS_PER_EPOCH = 50_000


@dataclass(frozen=True)
class LearnerSettings(Settings):
    """What is learned from branched games, and how networks are fitted to it."""

    worth: str = setting("win", choice(WORTH), "Value of an outcome: a race won, or the game's utility.")
    hidden: tuple[int, ...] = setting((64, 64), wholes(1, 4096, longest=8), "Units of each hidden layer of a network.")
    learning_rate: float = setting(3e-3, number(1e-8, 10.0), "Initial learning rate of Adam.")
    weight_decay: float = setting(1e-3, number(0.0, 10.0), "Weight decay of AdamW.")
    batch_size: int = setting(512, whole(1, 1_000_000), "Rows in the batch of a gradient step.")
    epochs: int = setting(60, whole(1, 100_000), "Maximum number of epochs.")
    patience: int = setting(12, whole(1, 100_000), "Epochs without a lower validation loss after which training stops.")

    def fit_settings(self, seed: int) -> TrainSettings:
        """Return the settings of the training of a network."""
        return TrainSettings(
            hidden=self.hidden,
            learning_rate=self.learning_rate,
            weight_decay=self.weight_decay,
            batch_size=self.batch_size,
            epochs=self.epochs,
            patience=self.patience,
            rows_per_epoch=ROWS_PER_EPOCH,
            seed=seed,
        )
