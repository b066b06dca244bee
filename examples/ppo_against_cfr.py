"""PPO against the agent of counterfactual regret: train it, save it, race it.

    python examples/ppo_against_cfr.py
    python examples/ppo_against_cfr.py --steps 200000 --rules contest --archive contest-early

PPO learns the game of moves against a mixture of opponents with Stable-Baselines3. What it has
learned is saved as plain numbers, read again without torch, and raced against the opponent and
others: every start policy against every opponent, from both sides, in the very races that the agent
which never switches drives, too. The default is a look at how it works, in about a minute; the
weights that come with the package were trained for longer (docs/ppo.md). Stop the training and
start it again: it goes on where it was.
"""

import argparse
from pathlib import Path

import numpy as np

from pcs_racing import InputError, load_track, make_game, save_replay
from pcs_racing_agents import learning, make
from pcs_racing_agents.tournament import (
    compare,
    cross_pairing,
    play_pairing,
    repeat_race,
    show_progress,
)

try:
    import stable_baselines3  # noqa: F401  what trains
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--track", default="Tarnfjord", help="circuit to learn and to race on")
    parser.add_argument("--rules", default="paper", help="rules of the race: paper or contest")
    parser.add_argument("--archive", default="default-early", help="archive that both move in")
    parser.add_argument("--steps", type=int, default=20_000, help="moves to learn from")
    parser.add_argument("--opponent", default="cfr-argmax", help="agent of the zoo to race against")
    parser.add_argument(
        "--opponent-network", metavar="DIR", help="its network, where none is shipped"
    )
    parser.add_argument("--egos", type=int, default=8, help="start policies of each agent")
    parser.add_argument("--variants", type=int, default=8, help="start policies of each opponent")
    parser.add_argument("--seed", type=int, default=0, help="root of everything random")
    parser.add_argument(
        "--out", type=Path, default=Path("out/ppo_against_cfr"), help="folder for all that is made"
    )
    arguments = parser.parse_args()

    # 0. Who races; a name that is unknown is told before anything is trained.
    world = {"archive": arguments.archive, "race": arguments.rules}
    options = {"network": arguments.opponent_network} if arguments.opponent_network else {}
    try:
        opponent = make(arguments.opponent, **world, **options)
    except InputError as error:
        raise SystemExit(
            f"ppo_against_cfr: error: {error}; or race another one with --opponent"
        ) from None

    # 1. Train, against opponents that PPO is to beat. The folder keeps curves and weights.
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

    # 2. What was saved: weights.safetensors, manifest.yaml and curve.csv. No torch is needed from
    # here on.
    print(f"saved: {trained.folder} (seed {trained.seed}, after {trained.steps} moves)")
    ppo = make("ppo", network=trained.folder, **world)

    # 3. Race. All cells against an opponent have the same races, so their differences are not those
    # of luck.
    game = make_game(load_track(arguments.track), arguments.archive, arguments.rules)
    never_switch = make("never-switch", **world)
    draws = {
        "egos": arguments.egos,
        "opponents": arguments.variants,
        "lines": 3,
        "seed": arguments.seed + 1,
    }
    print(
        f"\n{game.track.name}, rules {arguments.rules}: score (a win 1, a tie a half), difference"
        " at 95 %"
    )
    print(
        f"{'against':>24} {'races':>6} {'never-switch':>13} {'ppo':>7} {'difference':>11}"
        f" {'interval':>18}"
    )
    for other in (opponent, never_switch, make("random-moves", **world)):
        pairings = [cross_pairing(game, ego, other, **draws) for ego in (never_switch, ppo)]
        base, score = (play_pairing(pairing).score for pairing in pairings)
        egos, opponents = pairings[0].variants.T
        # its interval knows which races share a policy
        gain = compare(score, base, egos, opponents)
        interval = f"[{gain.low:+.3f}, {gain.high:+.3f}]"
        figures = f"{base.mean():13.3f} {score.mean():7.3f} {gain.difference:+11.3f} {interval:>18}"
        print(f"{other.name:>24} {len(score):6} {figures}")

    # 4. One of these races to watch.
    pairing = cross_pairing(game, ppo, opponent, **draws)
    best = int(np.argmax(play_pairing(pairing).lead))
    recording = repeat_race(pairing, best)
    print(f"\nto watch: {save_replay(recording.replay, arguments.out / 'race.html')}")


if __name__ == "__main__":
    main()
