"""PPO of Stable-Baselines3 with the tuned settings of every environment: learning curves, time, and what it is worth.

    python dev/benchmarks/tuned_ppo.py --only pcs_racing/Match-v0 --out out/tuned
    python dev/benchmarks/tuned_ppo.py --out out/tuned
    python dev/benchmarks/tuned_ppo.py --only --out out/tuned --picture docs/images/tuned_ppo.png     # the picture alone

Each environment is trained once, then measured on starts that no training had, beside random actions and, where
policies are chosen, beside players that never look at the race: those are chosen on other starts. Intervals at the
strategy level are clustered by the opponent's policy. A folder holds model and curve of each environment; a training
that is there is not made again.
"""

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from pcs_racing.base.files import write_atomically
from pcs_racing.envs.drive import DriveVectorEnv
from pcs_racing.envs.duel import DuelVectorEnv
from pcs_racing.envs.infos import Result
from pcs_racing.envs.match import MatchVectorEnv
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.blind import walk_to
from pcs_racing_agents.agents.zoo import make
from pcs_racing_agents.base.tables import markdown, with_interval, write_csv
from pcs_racing_agents.learning.ppo.tuned import TunedPPO, tuned_environments, tuned_ppo
from pcs_racing_agents.tournament.statistics import clustered_mean
from studies.matches.remember import remember

CHOOSING, JUDGING = 50_000_000, 90_000_000  # seeds of the starts; those of trainings are small
POINTS = 40  # of a learning curve
PROBES = {"pcs_racing/head_to_head-v1": DuelVectorEnv, "pcs_racing/head_to_head_match-v0": MatchVectorEnv}
PROBED = "never-switch"  # the opponent in the curves of self-play of moves and of matches
Player = Callable[[np.ndarray], np.ndarray]
Probe = Callable[[Player], np.ndarray]


class Curve(BaseCallback):
    """Mean return and the time so far, in each of :data:`POINTS` parts of the training.

    The return is that of the episodes that ended in the part; or, with a probe, what the model reaches in it: where
    both cars learn, and one gets what the other one loses, the return of the training says nothing.
    """

    def __init__(self, steps: int, probe: Probe | None = None) -> None:
        super().__init__()
        self.every, self.returns, self.probe = steps / (POINTS if probe is None else POINTS // 4), [], probe
        self.rows: list[tuple[object, ...]] = [("steps", "episodes", "return", "error", "wall_s", "processor_s")]
        self.began = np.array([time.perf_counter(), time.process_time()])

    def _on_step(self) -> bool:
        self.returns += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        if self.num_timesteps >= len(self.rows) * self.every and len(self.returns) > 1:
            spent = np.array([time.perf_counter(), time.process_time()]) - self.began
            if self.probe is not None:
                self.returns = list(self.probe(lambda seen: self.model.predict(seen, deterministic=True)[0]))
                # The time of the training is reported, without that of its probes.
                self.began = np.array([time.perf_counter(), time.process_time()]) - spent
            figures = np.mean(self.returns), np.std(self.returns) / np.sqrt(len(self.returns)), *spent
            self.rows.append((self.num_timesteps, len(self.returns), *(f"{number:.4f}" for number in figures)))
            if self.probe is not None or len(self.rows) % 5 == 1:
                print(f"  {self.num_timesteps} steps: {figures[0]:+.3f} after {spent[0]:.0f} s", flush=True)
            self.returns = []
        return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=tuned_environments(), help="environments")
    parser.add_argument("--share", type=float, default=1.0, help="share of the tuned number of steps, for a first look")
    parser.add_argument("--games", type=int, default=1024, help="games (matches, races) that a player is judged in")
    parser.add_argument("--choices", type=int, default=256, help="games in which each baseline is tried")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    parser.add_argument("--out", type=Path, default=Path("out/tuned"), help="folder for models and curves")
    parser.add_argument("--picture", type=Path, help="draw the learning curves in the folder into this file")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    judges = {
        "pcs_racing/Duel-v1": judge_duel,
        "pcs_racing/Match-v0": judge_match,
        "pcs_racing/Drive-v1": judge_drive,
        "pcs_racing/head_to_head-v1": judge_self_play,
        "pcs_racing/head_to_head_match-v0": judge_match_self_play,
        "pcs_racing/drive_head_to_head-v0": judge_drive_self_play,
    }
    for name in given.only:
        tuned = tuned_ppo(name)
        print(f"\n{name}: {dict(tuned.arguments)}", flush=True)
        player = trained(tuned, given)
        rows = judges[name](tuned, player, given.games, given.choices)
        print("\n".join(["", *markdown(rows)]), flush=True)
    if given.picture:
        draw(given.out, given.picture)


def file_name(environment: str) -> str:
    return environment.partition("/")[2]


def trained(tuned: TunedPPO, given: argparse.Namespace) -> Player:
    """Train, or read what was trained before; return the player that takes the most probable actions."""
    model_file, scale_file = (given.out / f"{file_name(tuned.environment)}{end}" for end in (".zip", "-scale.npz"))
    curve_file = given.out / f"{file_name(tuned.environment)}.csv"
    if not model_file.is_file():
        model = tuned.make_model(given.seed)
        steps = max(1, int(tuned.steps * given.share))
        curve = Curve(steps, probe_of(tuned))
        model.learn(steps, callback=curve)
        write_csv(curve.rows, curve_file)
        envs = model.get_env()
        if isinstance(envs, VecNormalize):
            scale = {"mean": envs.obs_rms.mean, "variance": envs.obs_rms.var}
            write_atomically(scale_file, lambda file: np.savez(file, **scale))
        model.save(model_file)
    last = list(csv.DictReader(curve_file.open(encoding="utf-8")))[-1]
    print(f"trained {last['steps']} steps, {last['wall_s']} s, {last['processor_s']} s of processor time", flush=True)
    model = PPO.load(model_file, device="cpu")
    # PPO learned on observations scaled by VecNormalize; what it sees here must be scaled by the same numbers.
    if not scale_file.is_file():
        return lambda seen: model.predict(seen, deterministic=True)[0]
    with np.load(scale_file, allow_pickle=False) as arrays:
        mean, spread = arrays["mean"], np.sqrt(arrays["variance"] + 1e-8)

    def choose(seen: np.ndarray) -> np.ndarray:
        scaled = np.clip((seen - mean) / spread, -10.0, 10.0).astype(np.float32)
        return np.asarray(model.predict(scaled, deterministic=True)[0])

    return choose


def probe_of(tuned: TunedPPO) -> Probe | None:
    """Return games against policies that stay the same, where the two cars that learn share a fixed sum."""
    if tuned.environment not in PROBES:
        return None
    return Arena(PROBES[tuned.environment], {**tuned.arguments, "opponent": PROBED}, 128, CHOOSING).returns


def play(envs: Any, player: Player, seed: int, options: dict[str, Any] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return and result of the first episode of each environment: the same starts and noise for every player."""
    seen, _ = envs.reset(seed=seed, options=options)
    returns, results = np.zeros(envs.num_envs), np.zeros(envs.num_envs, np.int64)
    going = np.ones(envs.num_envs, bool)
    while going.any():
        seen, rewards, terminated, truncated, info = envs.step(player(seen))
        returns[going] += rewards[going]
        ended = going & (terminated | truncated)
        if ended.any():
            results[ended] = info["result"][ended]
        # Environments begin anew by themselves: only the first episode of each counts.
        going &= ~ended
    return returns, results


class Arena:
    """Games or matches against each policy of the archive in turn, or against another opponent."""

    def __init__(self, kind: Any, arguments: Any, games: int, seed: int) -> None:
        self.envs, self.seed = kind(games, **arguments), seed
        self.opponents = np.arange(games) % len(self.envs.game.archive)
        self.options = {"policies": np.stack([np.full_like(self.opponents, -1), self.opponents], axis=1)}

    def returns(self, player: Player) -> np.ndarray:
        """Return of each game, shape (games,)."""
        return play(self.envs, player, self.seed, self.options)[0]

    def row(self, name: str, looks: str, returns: np.ndarray, blind: np.ndarray) -> tuple[str, ...]:
        """Name, whether it looks, mean return, and gain over the best baseline with its interval."""
        mean = clustered_mean(returns, self.opponents)
        gain = clustered_mean(returns - blind, self.opponents)
        interval = "" if returns is blind else with_interval(gain.mean, gain.low, gain.high)
        return name, looks, f"{mean.mean:.3f} +- {mean.se:.3f}", interval


HEAD = ("player", "looks at", "return", "gain over the best baseline")


def always(action: int) -> Player:
    return lambda seen: np.full(len(seen), action)


def by_agent(agent: Any) -> Player:
    return lambda seen: agent.predict(seen)[0]


def at_random(actions: int) -> Player:
    rng = np.random.default_rng(JUDGING)
    return lambda seen: rng.integers(actions, size=len(seen))


def judge_duel(tuned: TunedPPO, ppo: Player, games: int, choices: int) -> list[tuple[str, ...]]:
    """Moves that never change and walks to one policy, chosen on other starts; agents that look; and PPO."""
    choosing = Arena(DuelVectorEnv, tuned.arguments, choices, CHOOSING)
    game = choosing.envs.game
    setting = make_setting(game.archive, game.config)
    constant = {f"always {move}": always(k) for k, move in enumerate(game.move_names)}
    walks = [walk_to(setting, k) for k in range(len(game.archive))]
    fixed = {f"walk to policy {k}": lambda seen, walk=walk: walk(seen).argmax(axis=1) for k, walk in enumerate(walks)}
    world = {"archive": tuned.arguments["archive"], "race": tuned.arguments["race"]}
    blind = {
        **dict([best(choosing, constant)]),
        **dict([best(choosing, fixed)]),
        "best-schedule": by_agent(make("best-schedule", **world)),
    }
    base = best(choosing, blind)[0]
    judging = Arena(DuelVectorEnv, tuned.arguments, games, JUDGING)
    reference = judging.returns(blind[base])
    rows = [HEAD, judging.row("random moves", "nothing", judging.returns(at_random(len(constant))), reference)]
    for name, player in blind.items():
        returns = reference if name == base else judging.returns(player)
        rows.append(judging.row(name, "nothing", returns, reference))
    for name, looks in (("best-lead-plan", "who leads"), ("response", "all"), ("robust", "all")):
        rows.append(judging.row(name, looks, judging.returns(by_agent(make(name, **world))), reference))
    return [*rows, judging.row("PPO", "all", judging.returns(ppo), reference)]


def best(arena: Arena, players: dict[str, Player]) -> tuple[str, Player]:
    """Name and player with the highest mean return."""
    means = {name: arena.returns(player).mean() for name, player in players.items()}
    name = max(means, key=means.__getitem__)
    return name, players[name]


def judge_match(tuned: TunedPPO, ppo: Player, games: int, choices: int) -> list[tuple[str, ...]]:
    """One policy in all races, or one for each place on the grid, chosen on other starts; remember; and PPO."""
    choosing = Arena(MatchVectorEnv, tuned.arguments, choices, CHOOSING)
    policies = len(choosing.envs.game.archive)
    scores, fronts = [], []
    for k in range(policies):
        won, front = races_of(choosing, always(k))
        scores.append(won)
        fronts.append(front)
    won, front = np.array(scores), np.array(fronts[0], bool)
    # Chosen on these starts, judged on others: the best of many on the same starts would be too good.
    fixed = int(won.mean(axis=(1, 2)).argmax())
    ahead, behind = (int((won * at).sum(axis=(1, 2)).argmax()) for at in (front, ~front))
    judging = Arena(MatchVectorEnv, tuned.arguments, games, JUDGING)
    players = {
        f"always policy {fixed}": (always(fixed), "nothing"),
        f"policy {ahead} in front, {behind} behind": (
            lambda seen: np.where(seen[:, -1] > 0.5, ahead, behind),
            "place on the grid",
        ),
    }
    world = {"archive": tuned.arguments["archive"], "race": tuned.arguments["race"]}
    players["remember"] = (remember(make_setting(world["archive"], world["race"])).choose, "the races before")
    players["PPO"] = (ppo, "the races before")
    returns = {name: judging.returns(player) for name, (player, _) in players.items()}
    blind = max(list(returns.values())[:2], key=np.mean)
    rows = [HEAD, judging.row("random policies", "nothing", judging.returns(at_random(policies)), blind)]
    return [*rows, *(judging.row(name, looks, returns[name], blind) for name, (_, looks) in players.items())]


def races_of(arena: Arena, player: Player) -> tuple[np.ndarray, np.ndarray]:
    """Score of each race, and whether it was started in front, both of shape (matches, races)."""
    seen, _ = arena.envs.reset(seed=arena.seed, options=arena.options)
    scores, fronts, over = [], [], False
    while not over:
        fronts.append(seen[:, -1] > 0.5)
        seen, rewards, terminated, *_ = arena.envs.step(player(seen))
        scores.append(rewards)
        over = bool(terminated.all())
    return np.stack(scores, axis=1), np.stack(fronts, axis=1)


def judge_self_play(tuned: TunedPPO, ppo: Player, games: int, choices: int) -> list[tuple[str, ...]]:
    """PPO and others against opponents that it never met."""
    del choices
    world = {"archive": tuned.arguments["archive"], "race": tuned.arguments["race"]}
    rows = [("opponent", "random moves", "best-fixed", "PPO", "PPO over random moves")]
    for opponent in ("random-moves", "never-switch", "best-fixed", "response"):
        arena = Arena(DuelVectorEnv, {**tuned.arguments, "opponent": opponent}, games, JUDGING)
        players = at_random(arena.envs.single_action_space.n), by_agent(make("best-fixed", **world)), ppo
        found = [arena.returns(player) for player in players]
        gain = clustered_mean(found[2] - found[0], arena.opponents)
        means = (f"{returns.mean():+.3f}" for returns in found)
        rows.append((opponent, *means, with_interval(gain.mean, gain.low, gain.high)))
    return rows


def judge_match_self_play(tuned: TunedPPO, ppo: Player, games: int, choices: int) -> list[tuple[str, ...]]:
    """PPO and others in matches against opponents that it never met."""
    del choices
    world = {"archive": tuned.arguments["archive"], "race": tuned.arguments["race"]}
    rows = [("opponent", "random policies", "remember", "PPO", "PPO over random policies")]
    remembering = remember(make_setting(world["archive"], world["race"]))
    for opponent in ("never-switch", "random-moves", remembering):
        arena = Arena(MatchVectorEnv, {**tuned.arguments, "opponent": opponent}, games, JUDGING)
        policies = len(arena.envs.game.archive)
        players = at_random(policies), remembering.choose, ppo
        found = [arena.returns(player) for player in players]
        gain = clustered_mean(found[2] - found[0], arena.opponents)
        means = (f"{returns.mean():.3f}" for returns in found)
        rows.append((getattr(opponent, "name", opponent), *means, with_interval(gain.mean, gain.low, gain.high)))
    return rows


DRIVE_HEAD = ("opponent", "player", "return", "error", "won", "crashed or lost")


def judge_drive(tuned: TunedPPO, ppo: Player, games: int, choices: int) -> list[tuple[str, ...]]:
    """PPO and random actions against the opponents of the training, one by one."""
    del choices
    tasks = {name: {**tuned.arguments, "opponent": name} for name in tuned.arguments["opponent"]}
    return drive_rows(tasks, ppo, games)


def judge_drive_self_play(tuned: TunedPPO, ppo: Player, games: int, choices: int) -> list[tuple[str, ...]]:
    """PPO and random actions against planners that it never met, in races as long as those of the rules."""
    del choices
    drivers = ("lattice:pace=0.3", "lattice:pace=0.8", "pure-pursuit", "lattice")
    whole = {**tuned.arguments, "duration": None}
    return drive_rows({name: {**whole, "opponent": name} for name in drivers}, ppo, games)


def drive_rows(tasks: dict[str, Any], ppo: Player, games: int) -> list[tuple[str, ...]]:
    rng = np.random.default_rng(JUDGING)
    players = {"random actions": lambda seen: rng.uniform(-1.0, 1.0, (len(seen), 2)), "PPO": ppo}
    rows = [DRIVE_HEAD]
    for opponent, arguments in tasks.items():
        envs = DriveVectorEnv(games, **arguments)
        for name, player in players.items():
            returns, results = play(envs, player, JUDGING)
            shares = np.mean(results == Result.WIN), np.mean((results == Result.LOSS) | (results == Result.CRASH))
            figures = f"{returns.mean():.1f}", f"{returns.std() / np.sqrt(games):.1f}"
            rows.append((opponent, name, *figures, *(f"{share:.0%}" for share in shares)))
    return rows


def draw(folder: Path, picture: Path) -> None:
    """Mean return over steps, a panel for each environment that has a curve in the folder."""
    from matplotlib.figure import Figure

    names = [name for name in tuned_environments() if (folder / f"{file_name(name)}.csv").is_file()]
    columns = min(3, len(names))
    rows_of_panels = -(-len(names) // columns)
    figure = Figure(figsize=(3.6 * columns, 3.0 * rows_of_panels), layout="constrained")
    panels = figure.subplots(rows_of_panels, columns, squeeze=False).ravel()
    for panel in panels[len(names) :]:
        panel.set_visible(False)
    for panel, name in zip(panels, names, strict=False):
        with (folder / f"{file_name(name)}.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        steps, mean, error = (np.array([float(row[key]) for row in rows]) for key in ("steps", "return", "error"))
        panel.fill_between(steps / 1e3, mean - error, mean + error, alpha=0.25, linewidth=0, color="#1f6fd6")
        panel.plot(steps / 1e3, mean, color="#1f6fd6", linewidth=1.3)
        panel.set_title(file_name(name), fontsize=10, loc="left")
        probed = name in PROBES
        panel.set(xlabel="thousand steps", ylabel=f"return against {PROBED}" if probed else "return in training")
        panel.grid(color="#eef0f3")
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(picture, dpi=100)
    print(picture)


if __name__ == "__main__":
    main()
