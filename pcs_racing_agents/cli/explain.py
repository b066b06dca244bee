"""``pcs-racing explain``: explain an agent's moves in one race."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pcs_racing.base.errors import InputError
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    AGENT_HELP,
    DEFAULT_TRACK,
    RACED_CODE,
    TRACK_HELP,
    ArchiveName,
    Rules,
    archive_for,
    can_draw,
    output_folder,
)

if TYPE_CHECKING:
    from pcs_racing_agents.tournament.pairings import Pairing


@dataclass(frozen=True, kw_only=True)
class _Planned:
    """Races between two agents that are planned here, in place of a folder of results."""

    agents: Annotated[
        Sequence[str],
        Option(
            f"instead of a folder: the agents of car 0 and car 1: {AGENT_HELP}; with a folder:"
            f" {RACED_CODE}",
            "AGENT",
        ),
    ] = ()
    track: Annotated[
        str | None, Option(f"with --agents: {TRACK_HELP} (default: {DEFAULT_TRACK})", "T")
    ] = None
    rules: Rules
    archive: ArchiveName = None
    races: Annotated[
        int | None, Option("with --agents: number of planned races, even (default: 20)")
    ] = None

    def pairing(self) -> "Pairing":
        """Return the races of a tournament between the two agents."""
        from pcs_racing.track.loading import load_track
        from pcs_racing_agents.tournament import plan_tournament

        config = self.rules.config()
        plan = plan_tournament(
            load_track(DEFAULT_TRACK if self.track is None else self.track),
            self.agents,
            config,
            archive=archive_for(self.archive, config),
            races_per_pair=20 if self.races is None else self.races,
            seed=self.rules.seed,
            code=True,
        )
        return plan.pairings[0]


@command(
    "explain",
    "pcs-racing explain --agents cfr-argmax never-switch",
    "pcs-racing explain out/mine --index 12",
    "pcs-racing explain out/mine --index 12 --car 1 --out out/race-12",
    "pcs-racing explain --agents random-moves lane-switcher --track Tarnfjord --seed 3 --out"
    " out/race",
)
def run(
    results: Annotated[Path | None, Option("folder of a tournament or a study", "RESULTS")] = None,
    *,
    index: Annotated[
        int | None,
        Option("the race: its line in the results, or its number with --agents (default: 0)", "K"),
    ] = None,
    planned: _Planned,
    car: Annotated[
        int | None,
        Option(
            "car whose moves are explained (default: the first that makes moves)", choices=(0, 1)
        ),
    ] = None,
    out: Annotated[
        Path | None, Option("folder for the pictures, the text and the replay", "DIR")
    ] = None,
) -> None:
    """Explain the moves of an agent in a race: its observations, its moves and their effect."""
    if results is None and len(planned.agents) != 2:
        raise InputError("give a folder of results, or two agents with --agents")
    if results is not None:
        own = {"track": planned.track, "duration": planned.rules.duration, "races": planned.races}
        for option, value in own.items():
            if value is not None:
                raise InputError(
                    f"--{option} goes with --agents; the races of a folder have their own"
                )
    if out is not None:
        output_folder(out)
    _race(results, index or 0, planned, car, out)


def _race(
    folder: Path | None, number: int, planned: _Planned, car: int | None, out: Path | None
) -> None:
    from pcs_racing_agents.agents.agent import Driver
    from pcs_racing_agents.study.results import open_results
    from pcs_racing_agents.watch.explain import explain_race
    from pcs_racing_agents.watch.words import story

    results = None
    if folder is not None:
        results = open_results(folder, planned.agents)
        row = results.row(number)
        pairing, race = results.pairing(row), row.race
    else:
        pairing, race = planned.pairing(), number
    if car is None:
        # A planner has no moves to explain: then the other car is explained.
        car = int(isinstance(pairing.ego, Driver))
    explanation = explain_race(pairing, race, car=car, candidates=out is not None)
    if results is not None:
        # A repeated race with another end than in the results would be another race.
        results.check_lead(number, explanation.played.lead[0])
    text = story(explanation)
    print(text)
    if out is not None:
        from pcs_racing.base.files import write_atomically
        from pcs_racing.race.replay import save_replay

        write_atomically(out / "race.txt", f"{text}\n")
        print(f"to watch: {save_replay(explanation.replay, out / 'race.html')}")
        if can_draw("the picture of the race"):
            from pcs_racing_agents.base.style import save_picture
            from pcs_racing_agents.watch.pictures import explanation_picture

            print(f"picture: {save_picture(explanation_picture(explanation), out / 'race.png')}")
