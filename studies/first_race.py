"""Which seed gives a first race worth watching: driven to its end, with overtakes, and close.

    python studies/first_race.py  # the policies that `pcs-racing race` has by itself
    python studies/first_race.py --ego lattice --opponent lane-switcher:3 --seeds 40

A line for each seed whose race 0 ends without a crash and with an overtake, the closest first. Seed
0, the default of all commands, must be one of these for `EGO` and `OPPONENT` in
pcs_racing_agents/cli/race.py; start places that change may need other planners.
"""

import argparse

from pcs_racing import load_rules, load_track, racer, run_races
from pcs_racing_agents.cli.options import DEFAULT_TRACK
from pcs_racing_agents.cli.race import EGO, OPPONENT


def main() -> None:
    """Print a line for each such seed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for option, default in (
        ("track", DEFAULT_TRACK),
        ("ego", EGO),
        ("opponent", OPPONENT),
        ("rules", "paper"),
    ):
        parser.add_argument(f"--{option}", default=default)
    parser.add_argument(
        "--seeds", type=int, default=30, help="try seeds 0 to this number, less one"
    )
    arguments = parser.parse_args()
    track, config = load_track(arguments.track), load_rules(arguments.rules)
    ego, opponent = racer(arguments.ego), racer(arguments.opponent)
    crashes, found = 0, []
    for seed in range(arguments.seeds):
        result = run_races(track, [ego], opponent, config, seed=seed)
        crashes, overtakes = crashes + int(result.crashed[0]), int(result.state.overtakes[0].sum())
        if not result.crashed[0] and overtakes > 0:
            found.append((abs(float(result.lead[0])), seed, overtakes, int(result.winner[0])))
    print(
        f"{track.name}, {config.name}: {ego.name} against {opponent.name}, race 0 of"
        f" {arguments.seeds} seeds:"
    )
    print(f"{crashes} end in a crash, {len(found)} are driven to the end with an overtake")
    for lead, seed, overtakes, winner in sorted(found):
        print(f"seed {seed:3d}: {overtakes} overtakes, car {winner} wins by {lead:.1f} m")


if __name__ == "__main__":
    main()
