"""What a decision costs: microseconds of each agent of the zoo, for one observation and for each of 1,000 at once.

    python benchmarks/agent_cost.py

Networks have learned nothing here (two hidden layers of 64, as trained ones have by default): their time is the same.
"""

import time
from itertools import pairwise
from typing import Any

import numpy as np

from pcs_racing import make_game
from pcs_racing.base.dense import DenseLayers
from pcs_racing.game.identity import game_identity
from pcs_racing_agents.agents import Agent, make_setting
from pcs_racing_agents.agents.zoo import SHIPPED, build
from pcs_racing_agents.networks import NetworkSet, RegretNetwork


def untrained(game: Any) -> RegretNetwork:
    rng = np.random.default_rng(0)
    sizes = (len(game.observation_elements), 64, 64, len(game.move_names))
    layers = DenseLayers(
        tuple(rng.normal(size=(above, below)) / below**0.5 for below, above in pairwise(sizes)),
        tuple(np.zeros(size) for size in sizes[1:]),
    )
    return RegretNetwork("untrained", game_identity(game), "any", False, layers, np.zeros(sizes[0]),
                         np.ones(sizes[0]))  # fmt: skip


def microseconds(agent: Agent, rows: np.ndarray, seconds: float = 0.2) -> float:
    agent.predict(rows)
    begin, calls = time.perf_counter(), 0
    while time.perf_counter() - begin < seconds:
        agent.predict(rows)
        calls += 1
    return 1e6 * (time.perf_counter() - begin) / calls / len(rows)


def main() -> None:
    game = make_game("Tarnfjord", stay=True)
    setting = make_setting("default", game.config)
    network = untrained(game)
    learned: dict[str, dict[str, Any]] = {
        "best-schedule": {"moves": ["stay"] * 4},
        "best-fixed": {"target": 0},
        "best-lead-plan": {"targets": {"behind": 0, "ahead": 1}},
        "adaptive": {"network": network, "blind": build("best-fixed", setting, target=0)},
    }
    several = NetworkSet("untrained", (network,) * 4, np.ones(4), "argmax")
    learned |= {name: {"networks": several} for name in ("robust", "psro", "self-play")}
    state = game.reset(games=500, seed=0)
    state = game.step(state, np.tile([0, 2], (500, 1)))
    rows = game.observation(state).reshape(1000, -1)
    print("| agent | one observation, us | one of 1,000, us |\n|---|---|---|")
    for name, entry in SHIPPED.items():
        if not entry.moves:
            continue
        given = learned.get(name, {"network": network} if entry.needs == "network" else {})
        agent = build(name, setting, **given)
        print(f"| `{name}` | {microseconds(agent, rows[:1]):.0f} | {microseconds(agent, rows):.2f} |")


if __name__ == "__main__":
    main()
