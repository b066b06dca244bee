"""Record a race between two policies as a replay page, and optionally as a GIF.

    python examples/watch_a_race.py
    python examples/watch_a_race.py --track Saltmere --opponent lane-switcher:4 --gif

The page works offline in a browser: play, seek, follow a car, and show the candidate paths of each
planner.
"""

import argparse
from pathlib import Path

import pcs_racing_agents
from pcs_racing import load_rules, load_track, racer, record_race, save_replay


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name of a shipped track or a map folder"
    )
    parser.add_argument("--ego", default="lattice:pace=0.7,overtaking=0.5", help="policy of car 0")
    parser.add_argument("--opponent", default="lattice:pace=0.4", help="policy of car 1")
    parser.add_argument("--rules", default="contest", help="rules: paper, contest or a YAML file")
    parser.add_argument("--duration", type=float, default=40.0, help="length of the race in s")
    parser.add_argument("--seed", type=int, default=0, help="seed of the start and the noise")
    parser.add_argument(
        "--out", type=Path, default=Path("out/race"), help="folder of the page and the GIF"
    )
    parser.add_argument("--gif", action="store_true", help="write race.gif, too (some seconds)")
    arguments = parser.parse_args()

    track = load_track(arguments.track)
    config = load_rules(arguments.rules, duration=arguments.duration)
    ego, opponent = racer(arguments.ego), racer(arguments.opponent)
    replay = record_race(track, ego, opponent, config, seed=arguments.seed)
    for event in replay.events:
        print(f"{event.time:5.1f} s  {replay.car_names[event.car]} {event.text}")
    print(replay.outcome)

    arguments.out.mkdir(parents=True, exist_ok=True)
    print("page:", save_replay(replay, arguments.out / "race.html"))
    if arguments.gif:
        print("gif: ", pcs_racing_agents.watch.write_gif(replay, arguments.out / "race.gif"))


if __name__ == "__main__":
    main()
