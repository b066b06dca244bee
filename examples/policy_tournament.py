"""A head-to-head tournament between policies of one planner, told apart by their weights.

    python examples/policy_tournament.py
    python examples/policy_tournament.py --track Brackwater --rules paper --races 100

It prints the table and the payoff matrix, and writes the results and a replay of the liveliest
race.
"""

import argparse
from dataclasses import dataclass, fields
from pathlib import Path

from pcs_racing import load_race_config, load_track, save_replay
from pcs_racing.planners import Policy, get_planner
from pcs_racing_agents.tournament import (
    RaceRow,
    play_tournament,
    record_row,
    show_progress,
    tournament_text,
    write_results,
)


@dataclass(frozen=True)
class Arguments:
    """What can be chosen on the command line."""

    track: str = "Tarnfjord"
    """name of a shipped circuit or a map folder"""
    rules: str = "contest"
    """rules of the race: paper, contest or a YAML file"""
    races: int = 60
    """races of each pair, even: every start line is driven from both sides"""
    duration: float = 40.0
    """length of a race in s"""
    seed: int = 0
    """root of start lines and noise"""
    out: Path = Path("out/policy_tournament")
    """folder for results.csv and replay.html"""


def drivers() -> list[Policy]:
    """Four characters of the lattice planner; what is not said is as in the default."""
    lattice = get_planner("lattice")
    return [
        lattice.policy({"pace": 0.1, "side_margin": 0.3, "walls": 0.5}, name="careful"),
        lattice.policy({"pace": 0.45}, name="steady"),
        lattice.policy(
            {"pace": 0.65, "overtaking": 0.7, "attack": 0.18, "side_margin": 0.25}, name="attacker"
        ),
        lattice.policy({"pace": 1.0, "walls": -1.5}, name="reckless"),
    ]


def main() -> None:
    arguments = parse(Arguments)
    track = load_track(arguments.track)
    config = load_race_config(arguments.rules, duration=arguments.duration)
    tournament = play_tournament(
        track,
        drivers(),
        config,
        races_per_pair=arguments.races,
        seed=arguments.seed,
        progress=show_progress(),
    )
    print(tournament_text(tournament))

    arguments.out.mkdir(parents=True, exist_ok=True)
    print("\nresults:", write_results(tournament.races, arguments.out / "results.csv"))
    replay = record_row(tournament, max(tournament.races, key=liveliness)).replay
    print(
        "replay: ",
        save_replay(replay, arguments.out / "replay.html"),
        f"({replay.title}: {replay.outcome})",
    )


def liveliness(row: RaceRow) -> tuple[int, bool, float]:
    """What makes a race worth watching: overtakes, a finish, a close one."""
    return row.ego_overtakes + row.opponent_overtakes, row.crash == "none", -abs(row.lead)


def parse(kind: type[Arguments]) -> Arguments:
    """Command-line options from the fields of a dataclass."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for field in fields(kind):
        parser.add_argument(f"--{field.name}", type=type(field.default), default=field.default)
    return kind(**vars(parser.parse_args()))


if __name__ == "__main__":
    main()
