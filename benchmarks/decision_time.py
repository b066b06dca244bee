"""Time of a decision of the regret approximator, without torch and with it, in one run.

    python benchmarks/decision_time.py
    python benchmarks/decision_time.py --hidden 128 128 --repeats 7

A decision is a move from one observation: the values of all moves, and the highest. Both networks have the same
weights, torch works in one thread and without gradients, and every figure is the best of several repeats. Needs torch:
pip install ".[learning]".
"""

import argparse
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from pcs_racing.base.dense import DenseLayers
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.networks import RegretNetwork

INPUTS = 31  # of a game with two characteristics and four moves
MOVES = ("aggressiveness +", "aggressiveness -", "restraint +", "restraint -")
BATCHES = (1, 16, 256, 8738)  # the last: all decisions in a tree of four moves each


def random_network(hidden: list[int], rng: np.random.Generator) -> RegretNetwork:
    sizes = list(pairwise([INPUTS, *hidden, len(MOVES)]))
    return RegretNetwork(
        name="random",
        identity=GameIdentity(tuple(f"x{i}" for i in range(INPUTS)), MOVES, (0.35,), "none", "0" * 64, "paper"),
        target="regret",
        clipped=True,
        layers=DenseLayers(
            tuple(rng.normal(0.0, (2.0 / below) ** 0.5, (above, below)) for below, above in sizes),
            tuple(rng.normal(0.0, 0.1, above) for _, above in sizes),
        ),
        mean=np.zeros(INPUTS, np.float32),
        scale=np.ones(INPUTS, np.float32),
    )


def torch_decision(network: RegretNetwork) -> Callable[[Any], Any]:
    import torch

    layers: list[torch.nn.Module] = []
    for weight, bias in zip(network.layers.weights, network.layers.biases, strict=True):
        layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
        layer.weight.data, layer.bias.data = torch.tensor(weight), torch.tensor(bias)
        layers += [layer, torch.nn.ReLU()]
    model = torch.nn.Sequential(*layers[:-1]).eval()

    def decide(x: Any) -> Any:
        with torch.inference_mode():
            return model(torch.from_numpy(x)).argmax(dim=-1).numpy()

    return decide


def best_time(function: Callable[[Any], Any], x: Any, repeats: int) -> float:
    """Seconds of a call: the best of several repeats, each of which takes about a tenth of a second."""
    function(x)
    begin = time.perf_counter()
    function(x)
    calls = max(1, int(0.1 / max(time.perf_counter() - begin, 1e-7)))
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        for _ in range(calls):
            function(x)
        times.append((time.perf_counter() - begin) / calls)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description="Time of a decision, without torch and with it.", allow_abbrev=False)
    parser.add_argument("--hidden", type=int, nargs="+", default=[64, 64], help="hidden layers (default: 64 64)")
    parser.add_argument("--repeats", type=int, default=5, help="repeats, of which the best counts (default: 5)")
    options = parser.parse_args()
    import torch

    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    network = random_network(options.hidden, rng)
    with_torch = torch_decision(network)
    layers = "-".join(str(n) for n in (INPUTS, *options.hidden, len(MOVES)))
    print(f"network {layers}, us per decision, best of {options.repeats}")
    print("   batch   here  torch  torch / here")
    for batch in BATCHES:
        shape = (INPUTS,) if batch == 1 else (batch, INPUTS)
        x = rng.normal(size=shape).astype(np.float32)
        assert np.mean(network.choose(x) == with_torch(x)) > 0.999  # rounding may decide between equal values
        here, there = (1e6 * best_time(f, x, options.repeats) / batch for f in (network.choose, with_torch))
        print(f"  {batch:>6}  {here:5.2f}  {there:5.2f}  {there / here:12.1f}")


if __name__ == "__main__":
    main()
