"""``python -m studies match``: what remembering the opponent is worth in a series of races against
it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcs_racing.game.archive_files import load_archive
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import DEFAULT_TRACK, TRACK_HELP, Circuits, Rules, Workers


@command(
    "match",
    "python -m studies match --rules contest --track Pipkin Saltmere --test-track Tarnfjord --out"
    " out/match",
)
def run(
    *,
    track: Circuits = (DEFAULT_TRACK,),
    test_track: Annotated[Sequence[str], Option(f"held-out circuits: {TRACK_HELP}", "T")] = (),
    archive: Annotated[str, Option("archive: its name or folder", "A")] = "contest",
    rules: Rules,
    races: Annotated[int, Option("races of a match", "R")] = 3,
    matches: Annotated[
        int, Option("matches of each player against each policy on each track, even")
    ] = 32,
    learning_races: Annotated[
        int, Option("races of each two policies on each track that is learned on, even")
    ] = 64,
    out: Annotated[
        Path,
        Option(
            "folder for matches.csv and the table of behaviours; a stopped run resumes there", "DIR"
        ),
    ],
    workers: Workers,
) -> None:
    """Learn how an archive's policies behave and what beats them, and play matches with and without
    that memory.
    """
    from pcs_racing_agents.agents.game_spec import make_game_spec
    from pcs_racing_agents.tournament.play import game_rules
    from studies.matches.behaviours import save_behaviours
    from studies.matches.gain import MatchTest, gain_text, match_gains, write_gains
    from studies.matches.learning import LearningRaces, learn_behaviours

    spec = make_game_spec(load_archive(archive), game_rules(rules.config()))
    learned = tuple(load_track(name) for name in track)
    tracks = (*learned, *(load_track(name) for name in test_track))
    learning = LearningRaces(spec, learned, learning_races, rules.seed)
    MatchTest.check(tracks, races, matches, rules.seed)
    settings = {
        "archive_sha256": spec.archive.content_hash,
        "game": spec.config,
        "learned": [one.content_hash for one in learned],
        "tracks": [one.content_hash for one in tracks],
        "races": races,
        "matches": matches,
        "learning_races": learning_races,
        "seed": rules.seed,
    }
    with workers.start() as executor, open_job(out, "match", settings) as job:
        table = learn_behaviours(
            learning, job=job, executor=executor, progress=show_progress("blocks")
        )
        test = MatchTest(spec, table, tracks, races, matches, rules.seed)
        gains = match_gains(test, job=job, executor=executor, progress=show_progress("opponents"))
        print(f"the best fixed policy is {table.opponents[table.best_fixed]}")
        print(gain_text(gains))
        print(f"written: {save_behaviours(table, out / 'behaviours')}")
        print(f"written: {write_gains(gains, table.opponents, out / 'matches.csv')}")
