# /// script
# dependencies = ["rl_zoo3==2.9.2"]
# ///
"""rl_zoo3: train PPO on the duel with the hyperparameters of rl_zoo3_ppo.yaml.

    python examples/clients/rl_zoo3_train.py
    python -m rl_zoo3.train --algo ppo --env pcs_racing/Drive-v1 --gym-packages pcs_racing \
        --conf-file examples/clients/rl_zoo3_ppo.yaml

The second command trains on steering and speed, without this file.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

SETTINGS = Path(__file__).with_name("rl_zoo3_ppo.yaml")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        command = (
            "--algo ppo --env pcs_racing/Duel-v1 --gym-packages pcs_racing -n 1100 --eval-freq -1"
            " --device cpu"
        )
        files = ["--conf-file", str(SETTINGS), "--log-folder", folder]
        subprocess.run(
            [sys.executable, "-m", "rl_zoo3.train", *command.split(), *files], check=True
        )
        print("saved:", *sorted(path.name for path in Path(folder).rglob("*.zip")))


if __name__ == "__main__":
    main()
