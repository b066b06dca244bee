"""Train a lidar driver by imitation, write its folder, and count its own crashes alone.

    python dev/training/imitate_from_lidar.py cnn --out out/lidar-cnn
    python dev/training/imitate_from_lidar.py gru --out out/lidar-gru --hold-out Pipkin Saltmere

First a driver with a map races, then in every round the network, and each time the driver with the
map says what it would do there (DAgger [1]_). Half of the cars race each other, half are alone; all
have random paces and noise on their steering. Circuits are those that ship, but for the ones that
are held out, and random ones.

.. [1] S. Ross, G. J. Gordon and J. A. Bagnell, "A reduction of imitation learning and structured
   prediction to no-regret online learning", AISTATS, 2011.
"""

import argparse
from functools import cache
from pathlib import Path

import numpy as np

try:
    import torch
    from torch import nn
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

from pcs_racing import CONTEST, load_track, run_races
from pcs_racing.base.compilation import compiled
from pcs_racing.base.dense import weight_count
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.planners import view as _view
from pcs_racing.planners.field import lidar_networks as _networks
from pcs_racing.planners.field.lidar_networks import (
    BEAMS,
    FAR,
    LAYERS,
    MEMORY,
    NEAR,
    OUTPUTS,
    SEEN,
    flat_weights,
    load_lidar_planner,
    save_lidar_planner,
)
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.scanning import WORK
from pcs_racing.race.calibration import calibration_of
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import RaceSetup, advance, start_races
from pcs_racing.race.random_circuits import RandomCircuits, random_circuit
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

TEACHER = "predictive-spliner"
SCALES = (0.8, 1.4)  # speed scales of pace 0 and 1 while data are collected
NOISE = 0.03  # rad
LAST = 8  # point of the teacher's path up to which the network's path fits it
# steps of a sequence of the recurrent network, and those before its answers count
WINDOW, WARM = 40, 5
MIRRORED = torch.tensor([-1.0, -1.0, 1.0, 1.0])


@cache
def make_recorder(network: str) -> Planner:
    """A planner that keeps in its memory what a network sees and what the teacher plans, and drives
    as either.
    """
    teacher = get_planner(TEACHER)
    teach, answer, observe, lay_path = (
        teacher.plan,
        _networks.ANSWERS[network],
        _networks.observe,
        _networks.lay_path,
    )
    own, first = len(teacher.parameters), 1 + SEEN + OUTPUTS
    state = first + MEMORY[network]

    @compiled
    def plan(track, theta, view, memory, scratch, path):
        seen, label, work = memory[1 : 1 + SEEN], memory[1 + SEEN : first], scratch[WORK:]
        observe(track, view, theta[0], scratch[:WORK], seen)
        teach(track, theta, view, memory[state:], scratch, path)
        # The path of the teacher as the outputs that would lay it, in the frame of the car.
        sine, cosine = sine_cosine(view[_view.OWN_PSI])
        xx = xxx = xxxx = xy = xxy = 0.0
        for j in range(1, LAST + 1):
            dx, dy = path[j, 0] - view[_view.OWN_X], path[j, 1] - view[_view.OWN_Y]
            x, y = dx * cosine + dy * sine, dy * cosine - dx * sine
            xx, xxx, xxxx, xy, xxy = xx + x**2, xxx + x**3, xxxx + x**4, xy + x * y, xxy + x * x * y
        determinant = max(xx * xxxx - xxx * xxx, 1e-9)
        label[0] = 10.0 * (xy * xxxx - xxy * xxx) / determinant
        label[1] = 10.0 * (xx * xxy - xxx * xy) / determinant
        label[2], label[3] = 0.5 * path[NEAR, 2] - 3.0, 0.5 * path[FAR, 2] - 3.0
        if memory[0] != 0.0:
            answer(theta[own:], seen, memory[first:state], work)
            lay_path(view, work, memory[0], path)

    weights = sum(weight_count(sizes) for sizes in LAYERS[network])
    return Planner(
        name="recorder",
        parameters=(
            *teacher.parameters,
            *(Parameter(f"weight{i}", -1e3, 1e3, 0.0, "") for i in range(weights)),
        ),
        plan=plan,
        memory_size=state + teacher.memory_size,
        scratch_size=max(WORK + _networks.SCRATCH, teacher.scratch_size),
    )


def collect(
    track: Track, network: str, weights: np.ndarray | None, races: int, seconds: int, seed: int
) -> tuple:
    """Drive races; return what was seen (2 races, T, SEEN), the labels (2 races, T, OUTPUTS) and
    which count.
    """
    rng, planner = np.random.default_rng(seed), make_recorder(network)
    found = []
    for gap in (3.0, min(0.5 * track.length, 50.0)):
        config = RaceConfig(
            start="rolling",
            start_gap=gap,
            start_spacing=0.0,
            steering_noise=NOISE,
            speed_range=SCALES,
            duration=float(seconds),
        )
        setup = RaceSetup(track, config, (planner, planner))
        starts = Starts(rng.uniform(0.0, track.length, races // 2), rng.integers(0, 2, races // 2))
        state = start_races(setup, starts, rng.integers(2**63, size=races // 2, dtype=np.uint64))
        theta = np.tile(planner.default, (races // 2, 2, 1))
        theta[:, :, 0] = rng.uniform(0.0, 1.0, (races // 2, 2))
        if weights is not None:
            theta[:, :, -len(weights) :] = weights
            # Most drive as the network, at any share of its speed: else it learns to drive as fast
            # as it does.
            driven, shares = rng.uniform(size=(2, races // 2, 2))
            state.memory[:, :, 0] = (driven < 0.8) * (0.7 + 0.35 * shares)
        kept, counts = [], []
        for step in range(10 * seconds):
            advance(setup, state, theta, 10, threads=1, ittc=False)
            kept.append(state.memory[:, :, 1 : 1 + SEEN + OUTPUTS].astype(np.float32))
            counts.append(np.repeat((state.tick == 10 * (step + 1))[:, None], 2, axis=1))
        found.append(
            [np.stack(values, axis=2).reshape(races, 10 * seconds, -1) for values in (kept, counts)]
        )
    rows, counts = (np.concatenate(values) for values in zip(*found, strict=True))
    return rows[..., :SEEN], rows[..., SEEN:], counts[..., 0]


class Cnn(nn.Module):
    """The convolutional network, of whose layers `layers` gives weights and biases as the driver
    takes them.
    """

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = nn.ModuleList(
            [nn.Conv1d(1, 8, 7, 3), nn.Conv1d(8, 12, 5, 2), nn.Conv1d(12, 16, 4, 2)]
        )
        self.head = nn.ModuleList([nn.Linear(*sizes) for sizes in LAYERS["cnn"][3:]])

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Outputs for rows of what is seen, (..., SEEN) to (..., OUTPUTS)."""
        x = seen.reshape(-1, SEEN)[:, None, :BEAMS]
        for convolution in self.convolutions:
            x = torch.relu(convolution(x))
        features = torch.cat(
            [x.transpose(1, 2).flatten(1), seen.reshape(-1, SEEN)[:, BEAMS:]], dim=1
        )
        return self.head[1](torch.relu(self.head[0](features))).reshape(*seen.shape[:-1], OUTPUTS)

    def layers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weights and biases."""
        windows = [
            (layer.weight.permute(0, 2, 1).flatten(1), layer.bias) for layer in self.convolutions
        ]
        return [
            (w.detach().numpy(), b.detach().numpy())
            for w, b in [*windows, *((one.weight, one.bias) for one in self.head)]
        ]


class Gru(nn.Module):
    """The recurrent network."""

    def __init__(self) -> None:
        super().__init__()
        self.units = nn.GRU(SEEN, MEMORY["gru"], batch_first=True)
        self.head = nn.Linear(MEMORY["gru"], OUTPUTS)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Outputs for sequences of what is seen, (B, T, SEEN) to (B, T, OUTPUTS)."""
        return self.head(self.units(seen)[0])

    def layers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weights and biases."""
        u = self.units
        pairs = (
            (u.weight_ih_l0, u.bias_ih_l0),
            (u.weight_hh_l0, u.bias_hh_l0),
            (self.head.weight, self.head.bias),
        )
        return [(w.detach().numpy(), b.detach().numpy()) for w, b in pairs]


def fit(
    model: nn.Module, data: list, steps: int, rates: tuple[float, float], rng: np.random.Generator
) -> float:
    """Train on random pieces of the data, half of them mirrored; returns the mean loss of the last
    tenth.
    """
    optimizer = torch.optim.Adam(model.parameters(), rates[0])
    losses = []
    window = WINDOW if isinstance(model, Gru) else 1
    warm, size = (WARM, 48) if window > 1 else (0, 1024)
    sizes = np.array([seen.shape[0] for seen, _, _ in data], np.float64)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = rates[0] * (rates[1] / rates[0]) ** (step / steps)
        pieces = []
        for k in rng.choice(len(data), 8, p=sizes / sizes.sum()):
            rows = rng.integers(sizes[k], size=size // 8)[:, None]
            at = rng.integers(data[k][0].shape[1] - window + 1, size=size // 8)[
                :, None
            ] + np.arange(window)
            pieces.append([torch.from_numpy(values[rows, at]) for values in data[k]])
        seen, labels, counts = (torch.cat(parts) for parts in zip(*pieces, strict=True))
        half = len(seen) // 2
        seen[:half, :, :BEAMS] = seen[:half, :, :BEAMS].flip(2)
        seen[:half, :, BEAMS + 1 : BEAMS + 3] *= -1.0
        labels[:half] *= MIRRORED
        counts[:, :warm] = False
        errors = nn.functional.smooth_l1_loss(model(seen), labels, beta=0.2, reduction="none").sum(
            dim=2
        )
        loss = errors[counts].mean()
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        losses.append(loss.item())
    return float(np.mean(losses[-max(steps // 10, 1) :]))


def crashes_alone(track: Track, planner: Planner, races: int, seconds: float) -> float:
    """Share of cars alone that crash in 40 s, at the default parameters with the noise and speeds
    of `contest`.
    """
    gap = min(0.5 * track.length, 50.0)
    config = RaceConfig(
        start="staggered",
        start_gap=gap,
        start_spacing=0.0,
        steering_noise=CONTEST.steering_noise,
        duration=seconds,
        speed_range=calibration_of(track, CONTEST).speed_range,
    )
    starts = Starts(np.arange(races) / races * track.length, np.zeros(races, np.int64))
    state = run_races(
        track, [planner.policy()] * races, planner.policy(), config, starts=starts, threads=1
    ).state
    return float(1.0 - np.exp(-40.0 * (state.crash == 1).sum() / (0.02 * state.tick.sum())))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("network", choices=sorted(LAYERS))
    parser.add_argument("--out", type=Path, required=True, help="folder of the driver")
    parser.add_argument(
        "--hold-out",
        nargs="*",
        default=["Saltmere", "Vellindra"],
        help="circuits left out of training",
    )
    parser.add_argument("--tracks", nargs="*", default=list_tracks(), help="circuits")
    parser.add_argument("--random", type=int, default=24, help="random circuits, beside the others")
    parser.add_argument(
        "--rounds", type=int, default=6, help="rounds of data, the first one by the teacher"
    )
    parser.add_argument("--races", type=int, default=12, help="races of a round on a circuit")
    parser.add_argument("--seconds", type=int, default=16, help="length of these races, s")
    parser.add_argument(
        "--steps",
        type=int,
        default=1500,
        help="steps of training after a round; three times as many at last",
    )
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(arguments.seed)
    training = [load_track(name) for name in arguments.tracks if name not in arguments.hold_out]
    training += [random_circuit(RandomCircuits(), number) for number in range(arguments.random)]
    model: Cnn | Gru = Cnn() if arguments.network == "cnn" else Gru()
    data = []
    for turn in range(arguments.rounds):
        weights = flat_weights(model.layers()) if turn > 0 else None
        for track in training:
            seed = int(rng.integers(2**31))
            data.append(
                collect(track, arguments.network, weights, arguments.races, arguments.seconds, seed)
            )
        last = turn == arguments.rounds - 1
        steps = arguments.steps * (3 if last else 1)
        loss = fit(model, data, steps, (2e-3, 2e-5 if last else 5e-4), rng)
        driven = sum(int(counts.sum()) for _, _, counts in data[-len(training) :])
        share = driven / (len(training) * 20.0 * arguments.races * arguments.seconds)
        print(f"round {turn}: drove {share:.1%} of the time, loss {loss:.4f}", flush=True)
    about = {"teacher": TEACHER, "held_out": ", ".join(arguments.hold_out)}
    about |= {
        key: getattr(arguments, key)
        for key in ("random", "rounds", "races", "seconds", "steps", "seed")
    }
    name = f"lidar-{arguments.network}"
    planner = load_lidar_planner(
        save_lidar_planner(
            arguments.out, arguments.network, model.layers(), name=name, training=about
        )
    )
    for track in [load_track(name) for name in arguments.tracks]:
        crashes = crashes_alone(track, planner, arguments.races, 40.0)
        note = ", held out" if track.name in arguments.hold_out else ""
        print(f"{track.name}: own crashes alone in 40 s {crashes:.3f}{note}", flush=True)


if __name__ == "__main__":
    main()
