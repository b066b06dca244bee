"""``pcs-racing race``: simulate one race, print its events and write a replay."""

import argparse
import shlex
from pathlib import Path

from pcs_racing.base.checks import check_seed, check_whole
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import parse_policy
from pcs_racing.race.recording import LAST_INDEX, record_race
from pcs_racing.race.replay import Replay
from pcs_racing.race.replay_files import save_replay
from pcs_racing.track.loading import load_track
from pcs_racing_agents.cli.options import POLICY_HELP, Commands, add_command, add_rules, add_track, output_file, rules

# The default race. It lasts its full time and has an overtake; `python benchmarks/first_race.py` searched the seed.
EGO = "lattice:pace=0.7,attack=0.1"
OPPONENT = "lattice"
SEED = 7


def add(commands: Commands) -> None:
    """Add the command ``race``."""
    parser = add_command(
        commands,
        "race",
        "simulate one race between two policies",
        "pcs-racing race",
        "pcs-racing race --replay race.html",
        "pcs-racing race --track Tarnfjord --ego lattice:pace=0.6 --opponent lattice --seed 3 --replay race.html",
        'pcs-racing race --track "my maps/Spielberg" --ego lattice --opponent lattice --race contest',
    )
    add_track(parser)
    parser.add_argument("--ego", default=EGO, metavar="POLICY", help=f"policy of car 0: {POLICY_HELP} (default: {EGO})")
    parser.add_argument("--opponent", default=OPPONENT, metavar="POLICY", help=f"policy of car 1 (default: {OPPONENT})")
    add_rules(parser, seed=SEED)
    parser.add_argument(
        "--index",
        type=int,
        default=0,
        metavar="K",
        help=f"number of the race of this seed, 0 to {LAST_INDEX} (default: 0)",
    )
    parser.add_argument(
        "--replay",
        type=Path,
        metavar="FILE",
        help="file for a replay: a page that plays the race (.html), or data (.json)",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Simulate the race and print what happened."""
    config = rules(arguments)
    check_seed(arguments.seed)
    check_whole("index", arguments.index, 0, LAST_INDEX)
    ego, opponent = _policy("--ego", arguments.ego), _policy("--opponent", arguments.opponent)
    target = output_file(arguments.replay, ".html", ".json") if arguments.replay else None
    track = load_track(arguments.track)
    about = f"preset {config.name}, seed {arguments.seed}, race {arguments.index}"
    print(f"{track.name}, {track.length:.1f} m a lap, {about}", flush=True)  # before the race, which may be compiled
    replay = record_race(
        track, ego, opponent, config, seed=arguments.seed, index=arguments.index, candidates=target is not None
    )
    print(_story(replay))
    if target is None:
        print(f"to watch it: {_command(arguments)} --replay race.html")
    else:
        print(f"replay: {save_replay(replay, target)}")


def _policy(option: str, text: str) -> Policy:
    """Read a policy; an agent, which is none, is told where it can race."""
    try:
        return parse_policy(text)
    except UnknownNameError:
        from pcs_racing_agents.agents import zoo

        name = text.partition(":")[0].strip()
        if name not in zoo.entries() and not name.startswith(zoo.ALWAYS):
            raise
    raise InputError(
        f"{option} is {text!r}, an agent, which moves between the policies of an archive; this command takes policies "
        f"(pcs-racing policies). For agents: pcs-racing tournament --agents {shlex.quote(text)} never-switch"
    )


def _command(arguments: argparse.Namespace) -> str:
    """Return the command that repeats this race; it names every option except those left to the preset."""
    names = ("track", "ego", "opponent", "race", "duration", "seed", "index")
    options = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    return shlex.join(
        ["pcs-racing", "race", *(f for name, value in options.items() for f in (f"--{name}", str(value)))]
    )


def _story(replay: Replay) -> str:
    lines = [
        f"car {car}: {name}, {replay.progress[-1, car] - replay.progress[0, car]:.1f} m driven"
        for car, name in enumerate(replay.car_names)
    ]
    lines += [f"{event.time:5.1f} s  car {event.car} {event.text}" for event in replay.events]
    return "\n".join([*lines, replay.outcome])
