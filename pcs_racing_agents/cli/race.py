"""``pcs-racing race``: simulate one race, print its events and write a replay."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from pcs_racing.base.errors import InputError, check_seed, check_whole, require
from pcs_racing.car.vehicle import VehicleParams, load_vehicles
from pcs_racing.game.reward import reward, sum_winners
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import policy_racer
from pcs_racing.race.config import Rules
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, race_keys, start_races, starts_of, winners
from pcs_racing.race.recording import LAST_INDEX, record_race
from pcs_racing.race.replay import Replay, save_replay
from pcs_racing.race.state import MAX_CARS
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    DEFAULT_TRACK,
    POLICY_HELP,
    Circuit,
    Like,
    RaceOptions,
    output_file,
)

# The default race lasts its full time and has an overtake; found by `python studies/first_race.py`.
EGO = "lattice:pace=0.5"
OPPONENT = "lattice:pace=0.6"


@command(
    "race",
    "pcs-racing race",
    "pcs-racing race --replay race.html",
    "pcs-racing race --track Tarnfjord --ego lattice:pace=0.6 --opponent lattice --seed 3 --replay"
    " race.html",
    'pcs-racing race --track "my maps/Spielberg" --ego lattice --opponent lattice --rules contest',
)
def run(
    *,
    track: Circuit = DEFAULT_TRACK,
    ego: Annotated[str, Option(f"policy of car 0: {POLICY_HELP}", "POLICY")] = EGO,
    opponent: Annotated[
        Sequence[str], Option("policy of car 1, or of car 1, 2 ... up to 7", "POLICY")
    ] = (OPPONENT,),
    rules: RaceOptions,
    like: Like = None,
    vehicle: Annotated[
        Sequence[str],
        Option("car of all planners, or of each: a name (f1tenth-pacejka) or a YAML file", "CAR"),
    ] = ("f1tenth",),
    index: Annotated[int, Option(f"race index for this seed, 0 to {LAST_INDEX}")] = 0,
    replay: Annotated[
        Path | None,
        Option("file for a page that plays the race (.html)", "FILE"),
    ] = None,
    video: Annotated[Path | None, Option("file for a video (.mp4, or .gif)", "FILE")] = None,
) -> None:
    """Simulate one race between two or more policies."""
    config = rules.read()
    check_seed(rules.seed)
    check_whole("index", index, 0, LAST_INDEX)
    if len(opponent) > MAX_CARS - 1:
        raise InputError(
            f"--opponent names {len(opponent)} policies; a race has at most {MAX_CARS - 1} of them"
        )
    cars = load_vehicles(vehicle[0] if len(vehicle) == 1 else vehicle, 1 + len(opponent))
    first, *others = (policy_racer(text, code=True, like=like) for text in (ego, *opponent))
    target = output_file(replay, ".html") if replay else None
    film = output_file(video, ".mp4", ".gif") if video else None
    # A missing library is reported before the race, not after it.
    if film is not None and film.suffix == ".mp4":
        require("imageio_ffmpeg", extra="video")
    circuit = load_track(track)
    # Printed before the race, which may need compilation first.
    about = f"rules {config.name}, seed {rules.seed}, race {index}"
    print(f"{circuit.name}, {circuit.length:.1f} m a lap, {about}", flush=True)
    recorded = record_race(
        circuit,
        first,
        others,
        config,
        seed=rules.seed,
        index=index,
        vehicle=cars,
        candidates=target is not None,
    )
    print(_story(recorded))
    if config.heats > 1 and len(others) == 1:
        print(_series(circuit, first, others[0], config, cars, rules.seed, index))
    if target is None:
        print("to watch it: run the same command with --replay race.html")
    else:
        print(f"replay: {save_replay(recorded, target)}")
    if film is not None:
        from pcs_racing_agents.watch.frames import write_gif, write_video

        print(f"video: {(write_gif if film.suffix == '.gif' else write_video)(recorded, film)}")


def _series(
    track: Track,
    ego: Policy,
    opponent: Policy,
    config: Rules,
    cars: tuple[VehicleParams, ...],
    seed: int,
    index: int,
) -> str:
    """Return the result of a race's series: the races counted as one in tables."""
    numbers = [index // config.heats * config.heats + heat for heat in range(config.heats)]
    setup = RaceSetup(track, config, (ego.planner, opponent.planner), cars)
    state = start_races(
        setup,
        starts_of(track, config, numbers, seed),
        race_keys(config, seed, numbers),
    )
    theta = np.tile(pad_parameters([ego, opponent], setup.theta_size), (config.heats, 1, 1))
    advance(setup, state, theta, config.ticks)
    if config.legs == 2:
        sums = reward(config, state, [0, 0]).sum(keepdims=True)
        winner = int(sum_winners(config, sums)[0])
        prize = f"car {winner} wins" if winner >= 0 else "a tie"
        return f"two legs, races {numbers[0]} and {numbers[1]}: {sums[0]:+.1f} m for car 0, {prize}"
    won = [int((winners(config, state) == car).sum()) for car in range(2)]
    counts = ", ".join(f"car {car} won {count}" for car, count in enumerate(won))
    return f"best of {config.heats}, races {numbers[0]} to {numbers[-1]}: {counts}"


def _story(replay: Replay) -> str:
    lines = [
        f"car {car}: {name}, {replay.progress[-1, car] - replay.progress[0, car]:.1f} m driven"
        for car, name in enumerate(replay.car_names)
    ]
    lines += [f"{event.time:5.1f} s  car {event.car} {event.text}" for event in replay.events]
    return "\n".join([*lines, replay.outcome])
