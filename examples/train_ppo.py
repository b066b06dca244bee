"""Train PPO on the duel against an opponent, and draw its learning curve.

    python examples/train_ppo.py
    python examples/train_ppo.py --steps 200000 --games 2000
    python examples/train_ppo.py --archive default --rules paper --opponent random-moves

A table compares the trained agent with random and constant moves in the same test games.
learning_curve.png and the model are saved. The default takes one to two minutes on an idle core;
examples/clients/rl_zoo3_ppo.yaml has hyperparameters for the other environments.
"""

import argparse
from pathlib import Path

import numpy as np

from pcs_racing.envs import DuelVectorEnv, Result

try:
    import torch
    from matplotlib.figure import Figure
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    from pcs_racing.envs import make_sb3_vec_env
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning,plots]"') from None


class Curve(BaseCallback):
    """Records the return of every game and the step of its end."""

    def __init__(self) -> None:
        super().__init__()
        self.steps: list[int] = []
        self.returns: list[float] = []

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self.steps.append(self.num_timesteps)
                self.returns.append(info["episode"]["r"])
        return True


def main() -> None:
    arguments = parse()
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    arguments.out.mkdir(parents=True, exist_ok=True)
    game = {name: getattr(arguments, name) for name in ("track", "archive", "opponent")} | {
        "rules": arguments.rules
    }
    envs = make_sb3_vec_env("duel", arguments.envs, **game)
    model = PPO(
        "MlpPolicy",
        envs,
        seed=arguments.seed,
        learning_rate=lambda left: left * arguments.learning_rate,
        n_steps=16,
        batch_size=256,
        n_epochs=8,
        gamma=1.0,  # a game has four moves: no discount
        ent_coef=0.01,
        policy_kwargs={"net_arch": [64, 64]},
        device="cpu",
    )
    curve = Curve()
    model.learn(arguments.steps, callback=curve)
    model.save(arguments.out / "model.zip")

    print(
        f"against {arguments.opponent} on {arguments.track}, rules {arguments.rules},"
        f" {arguments.games} games each:"
    )
    print(f"{'agent':28} {'utility':>8} {'+-':>6} {'won':>6} {'crashed':>8}")
    duel = envs.get_attr("game")[0]
    constant = {f"always {name}": move for move, name in enumerate(duel.moves[: duel.offered])}
    rng = np.random.default_rng(arguments.seed)
    moves = len(constant)
    players = {
        "PPO": lambda observations: model.predict(observations, deterministic=True)[0],
        "random moves": lambda observations: rng.integers(moves, size=len(observations)),
        **{
            name: lambda observations, move=move: np.full(len(observations), move)
            for name, move in constant.items()
        },
    }
    means, returns_of = {}, {}
    for name, player in players.items():
        returns, results = measure(player, arguments, game)
        means[name], returns_of[name] = returns.mean(), returns
        error = returns.std() / np.sqrt(len(returns))
        print(
            f"{name:28} {returns.mean():8.2f} {error:6.2f} {np.mean(results == Result.WIN):6.1%} "
            f"{np.mean(results == Result.CRASH):8.1%}"
        )
    gain = returns_of["PPO"] - returns_of["random moves"]  # in the same games
    print(f"PPO over random moves: {gain.mean():+.2f} +- {gain.std() / np.sqrt(len(gain)):.2f}")
    draw(curve, means, arguments)
    print(f"{arguments.out / 'learning_curve.png'}")


def measure(player, arguments: argparse.Namespace, game: dict) -> tuple[np.ndarray, np.ndarray]:
    """Play test games, with the same starts for every player; give their returns and results."""
    envs = DuelVectorEnv(arguments.games, **game)
    observations, _ = envs.reset(seed=1_000_000 + arguments.seed)
    returns, results = np.zeros(arguments.games), np.zeros(arguments.games, int)
    going = np.ones(arguments.games, bool)
    while going.any():
        observations, rewards, done, _, info = envs.step(player(observations))
        ended = going & done
        returns[ended] = rewards[ended]
        if ended.any():
            results[ended] = info["result"][ended]
        going &= ~done
    return returns, results


def draw(curve: Curve, means: dict[str, float], arguments: argparse.Namespace) -> None:
    """Draw the mean return in up to fifty parts of the training, and the test results."""
    steps, returns = np.array(curve.steps), np.array(curve.returns)
    parts = np.array_split(np.arange(len(steps)), min(50, max(1, len(steps) // 50)))
    at = [steps[part].mean() for part in parts]
    mean = np.array([returns[part].mean() for part in parts])
    error = np.array([returns[part].std() / np.sqrt(len(part)) for part in parts])
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.fill_between(at, mean - error, mean + error, alpha=0.25, linewidth=0, color="tab:blue")
    axes.plot(at, mean, color="tab:blue", label="PPO in training (mean, standard error)")
    axes.axhline(
        means["PPO"], color="tab:blue", linestyle="--", label="PPO after training (test games)"
    )
    best = max((name for name in means if name.startswith("always")), key=means.__getitem__)
    axes.axhline(means[best], color="tab:orange", linestyle="--", label=best)
    axes.axhline(means["random moves"], color="gray", linestyle=":", label="random moves")
    axes.set_title(f"Duel on {arguments.track} against {arguments.opponent}")
    axes.set(xlabel="moves", ylabel="utility of a game")
    axes.legend(frameon=False)
    figure.savefig(arguments.out / "learning_curve.png", dpi=120)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    option = parser.add_argument
    option("--steps", type=int, default=60_000, help="training moves")
    option("--track", default="Brackwater", help="name of a shipped track or a map folder")
    option("--archive", default="contest", help="archive of policies that both cars drive with")
    option("--rules", default="contest", help="rules: paper, contest or a YAML file")
    option(
        "--opponent",
        default="never-switch",
        help="agent or policy, such as random-moves or lane-switcher:3",
    )
    option("--envs", type=int, default=64, help="games at once")
    option(
        "--learning-rate", type=float, default=1e-3, help="initial learning rate, which falls to 0"
    )
    option("--games", type=int, default=1000, help="test games")
    option("--seed", type=int, default=0, help="seed of all random numbers")
    option(
        "--out",
        type=Path,
        default=Path("out/train_ppo"),
        help="folder of learning_curve.png and model.zip",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
