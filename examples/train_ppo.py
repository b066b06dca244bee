"""Train PPO on the game of moves against an opponent, and draw its learning curve.

    python examples/train_ppo.py
    python examples/train_ppo.py --steps 200000 --games 2000
    python examples/train_ppo.py --archive default-early --rules paper --opponent random-moves

It prints how the trained player does against the opponent beside players that never look at the
race, all in the same games, and writes learning_curve.png and the model. The default takes one to
two minutes on an idle core; examples/clients/rl_zoo3_ppo.yaml has settings for the other
environments.
"""

import argparse
from dataclasses import dataclass, fields
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


@dataclass(frozen=True)
class Arguments:
    """What can be chosen on the command line."""

    steps: int = 60_000
    """moves to learn from"""
    track: str = "Brackwater"
    """name of a shipped circuit or a map folder"""
    archive: str = "contest-early"
    """archive of policies that both cars drive with"""
    rules: str = "contest"
    """rules of the race: paper, contest or a YAML file"""
    opponent: str = "never-switch"
    """random-moves, never-switch, always-<move>, or a driver such as lane-switcher:3"""
    envs: int = 64
    """games that are played at once"""
    learning_rate: float = 1e-3
    """step size of the optimiser at first, falling linearly to 0"""
    games: int = 1000
    """games in which the trained player is measured"""
    seed: int = 0
    """root of everything random"""
    out: Path = Path("out/train_ppo")
    """folder for learning_curve.png and model.zip"""


class Curve(BaseCallback):
    """Keeps the return of every game and the step at which it ended."""

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
    arguments = parse(Arguments)
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    arguments.out.mkdir(parents=True, exist_ok=True)
    game = {name: getattr(arguments, name) for name in ("track", "archive", "opponent")} | {
        "race": arguments.rules
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
        gamma=1.0,  # a game has four moves: nothing needs discounting
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
    print(f"{'player':28} {'utility':>8} {'+-':>6} {'won':>6} {'crashed':>8}")
    constant = {
        f"always {name}": move for move, name in enumerate(envs.get_attr("game")[0].move_names)
    }
    rng = np.random.default_rng(arguments.seed)
    moves = len(constant)
    players = {
        "PPO": lambda seen: model.predict(seen, deterministic=True)[0],
        "random moves": lambda seen: rng.integers(moves, size=len(seen)),
        **{
            name: lambda seen, move=move: np.full(len(seen), move)
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


def measure(player, arguments: Arguments, game: dict) -> tuple[np.ndarray, np.ndarray]:
    """Returns and results of the first game of each of many environments: the same starts for every
    player.
    """
    envs = DuelVectorEnv(arguments.games, **game)
    seen, _ = envs.reset(seed=1_000_000 + arguments.seed)
    returns, results = np.zeros(arguments.games), np.zeros(arguments.games, int)
    going = np.ones(arguments.games, bool)
    while going.any():
        seen, rewards, done, _, info = envs.step(player(seen))
        ended = going & done
        returns[ended] = rewards[ended]
        if ended.any():
            results[ended] = info["result"][ended]
        going &= ~done
    return returns, results


def draw(curve: Curve, means: dict[str, float], arguments: Arguments) -> None:
    """The mean return of the games of each of up to fifty stretches of training, and the level of
    others.
    """
    steps, returns = np.array(curve.steps), np.array(curve.returns)
    parts = np.array_split(np.arange(len(steps)), min(50, max(1, len(steps) // 50)))
    at = [steps[part].mean() for part in parts]
    mean = np.array([returns[part].mean() for part in parts])
    error = np.array([returns[part].std() / np.sqrt(len(part)) for part in parts])
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.fill_between(at, mean - error, mean + error, alpha=0.25, linewidth=0, color="tab:blue")
    axes.plot(at, mean, color="tab:blue", label="PPO while it learns (mean, standard error)")
    axes.axhline(
        means["PPO"], color="tab:blue", linestyle="--", label="PPO, trained, its best moves"
    )
    best = max((name for name in means if name.startswith("always")), key=means.__getitem__)
    axes.axhline(means[best], color="tab:orange", linestyle="--", label=best)
    axes.axhline(means["random moves"], color="gray", linestyle=":", label="random moves")
    axes.set_title(f"Duel on {arguments.track} against {arguments.opponent}")
    axes.set(xlabel="moves", ylabel="utility of a game")
    axes.legend(frameon=False)
    figure.savefig(arguments.out / "learning_curve.png", dpi=120)


def parse(kind: type[Arguments]) -> Arguments:
    """Turn every field of the arguments into an option with the field's default and type."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for field in fields(kind):
        parser.add_argument(
            f"--{field.name.replace('_', '-')}", type=type(field.default), default=field.default
        )
    return kind(**vars(parser.parse_args()))


if __name__ == "__main__":
    main()
