# /// script
# dependencies = []
# ///
"""Zoo: race every shipped agent, by name and as an object, in every environment.

    python examples/clients/zoo_opponents.py

Both shipped games are played. An agent without a network for a game is listed as missing.
"""

import gymnasium as gym
import pettingzoo

import pcs_racing
import pcs_racing_agents
from pcs_racing import InputError

gym.register_envs(pcs_racing)

GAMES = {"default": "paper", "contest": "contest"}  # the rules by the archive
ALONE = ("pcs_racing/Duel-v1", "pcs_racing/Drive-v1")


def meet(opponent: object, archive: str) -> None:
    """Race an opponent in each environment, for a few steps."""
    game = {"archive": archive, "rules": GAMES[archive]}
    for name in ALONE:
        env = gym.make(name, opponent=opponent, **game)
        env.reset(seed=1)
        for _ in range(2):
            _, _, terminated, _, info = env.step(env.action_space.sample())
            if terminated:
                break
        assert info["opponent"] == 0
    pair = pettingzoo.make("parallel", "pcs_racing/head_to_head-v1", opponent=opponent, **game)
    pair.reset(seed=1)
    pair.step({"car_0": 0})
    drive = pettingzoo.make(
        "parallel", "pcs_racing/drive_head_to_head-v0", opponent=opponent, **game
    )
    drive.reset(seed=1)
    drive.step({"car_0": drive.action_space("car_0").sample()})


def main() -> None:
    for archive, race in GAMES.items():
        shipped, missing = [], []
        for name in pcs_racing_agents.agents.names(archive, race):
            try:
                agent = pcs_racing_agents.make(name, archive=archive, rules=race)
            except InputError as error:  # it has no network for this archive
                missing.append(str(error))
                continue
            meet(name, archive)
            meet(agent, archive)
            shipped.append(name)
        print(
            f"archive {archive}, rules {race}: {len(shipped)} opponents: {', '.join(shipped)}",
            flush=True,
        )
        print(*(f"  missing: {why:.110}" for why in missing), sep="\n", flush=True)


if __name__ == "__main__":
    main()
