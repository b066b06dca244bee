"""Train PPO and race it against the CFR agent (counterfactual regret minimization).

    python examples/ppo_against_cfr.py
    python examples/ppo_against_cfr.py --steps 200000 --rules contest --archive contest

PPO of Stable-Baselines3 trains on the game of moves against a mixture of opponents. Its weights are
saved, and loaded again without torch. Four agents then drive the same races, on both sides of each
start line, against three opponents: the trained PPO, which switches its policy every 8 s;
``line-ppo``, a shipped planner, which chooses a path ten times a second; the CFR agent; and
``never-switch``. The default takes a minute. The shipped networks were trained for longer; the full
comparison is ``python -m studies ppo-against-cfr`` (docs/reports/ppo.md). A stopped training
resumes.
"""

import argparse
from pathlib import Path

import numpy as np

from pcs_racing import InputError, load_track, make_game, save_replay
from pcs_racing_agents import learning, make
from pcs_racing_agents.tournament import (
    compare,
    draw_schedule,
    play_pairing,
    repeat_race,
    schedule_pairing,
    show_progress,
)

try:
    import stable_baselines3  # noqa: F401  for the training
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--track", default="Tarnfjord", help="track of the training and the races")
    parser.add_argument("--rules", default="paper", help="rules of the race: paper or contest")
    parser.add_argument("--archive", default="default", help="archive that both move in")
    parser.add_argument("--steps", type=int, default=20_000, help="moves to learn from")
    parser.add_argument(
        "--opponent", default="cfr-argmax", help="agent of the zoo to compare with PPO"
    )
    parser.add_argument(
        "--opponent-network",
        metavar="DIR",
        help="network folder of the opponent, if none is shipped",
    )
    parser.add_argument("--races", type=int, default=100, help="races of each pair, even")
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers")
    parser.add_argument(
        "--out", type=Path, default=Path("out/ppo_against_cfr"), help="output folder"
    )
    arguments = parser.parse_args()

    # 0. The game, its races and the opponent; bad input is reported before the training.
    seed = arguments.seed + 1
    world = {"archive": arguments.archive, "race": arguments.rules}
    options = {"network": arguments.opponent_network} if arguments.opponent_network else {}
    try:
        game = make_game(load_track(arguments.track), arguments.archive, arguments.rules)
        schedule = draw_schedule(game.track, game.config.race_rules, arguments.races, seed)
        opponent = make(arguments.opponent, **world, **options)
    except InputError as error:
        raise SystemExit(f"ppo_against_cfr: error: {error}") from None

    # 1. Train against a mixture of opponents. The folder holds curves and weights.
    settings = learning.DuelSettings(
        archive=arguments.archive,
        race=arguments.rules,
        tracks=(arguments.track,),
        opponents={"never-switch": 2, "random-moves": 1},
        steps=arguments.steps,
        seeds=(arguments.seed,),
        envs=min(192, max(8, arguments.steps // 64)),
        entropy=0.01,
        reward_scale=0.1 if arguments.rules == "paper" else 1.0,
        evaluate_every=max(1, arguments.steps // 5),
        evaluation_races=60,
    )
    trained = learning.train_ppo(
        settings, arguments.out / "training", name="ppo-example", progress=show_progress("moves")
    )

    # 2. The folder holds weights.safetensors, manifest.yaml and curve.csv. The races need no torch.
    print(f"saved: {trained.folder} (seed {trained.seed}, after {trained.steps} moves)")
    racers = {
        "ppo": make("ppo", network=trained.folder, **world),
        "line-ppo": make("line-ppo", **world),
        opponent.name: opponent,
        "never-switch": make("never-switch", **world),
    }

    # 3. Race. Race k has the same start line, side, noise and start policies for all agents, which
    # reduces the variance of their differences.
    opponents = [opponent, racers["never-switch"], make("random-moves", **world)]
    pairings = {
        name: [schedule_pairing(game, racer, other, schedule, seed) for other in opponents]
        for name, racer in racers.items()
    }
    played = {name: [play_pairing(pairing) for pairing in own] for name, own in pairings.items()}
    labels = pairings["never-switch"]
    egos = np.concatenate([pairing.variants[:, 0] for pairing in labels])
    others = np.concatenate([1000 * k + one.variants[:, 1] for k, one in enumerate(labels)])
    starts = np.tile(np.arange(arguments.races) // 2, len(opponents))
    print(
        f"\n{game.track.name}, rules {arguments.rules}, {arguments.races} races of each pair: score"
    )
    heads = [f"against {other.name}" for other in opponents]
    width = max(map(len, racers))
    print(f"{'':{width}}", *heads, "own crashes", "minus never-switch (95 %)", sep="  ")
    base = np.concatenate([races.score for races in played["never-switch"]])
    for name, tables in played.items():
        score = np.concatenate([races.score for races in tables])
        own_crashes = np.mean([races.fault[:, 0] == 1 for races in tables])
        gain = compare(score, base, egos, others, start=starts)
        cells = [
            f"{races.score.mean():{len(head)}.3f}"
            for races, head in zip(tables, heads, strict=True)
        ]
        interval = f"{gain.difference:+.3f} [{gain.low:+.3f}, {gain.high:+.3f}]"
        print(f"{name:{width}}", *cells, f"{own_crashes:11.3f}", f"{interval:>25}", sep="  ")

    # 4. Record the race of PPO with the longest lead.
    best = int(np.argmax(played["ppo"][0].lead))
    recording = repeat_race(pairings["ppo"][0], best)
    print(f"\nreplay: {save_replay(recording.replay, arguments.out / 'race.html')}")


if __name__ == "__main__":
    main()
