"""``python -m studies axes``: learn characteristics from races, show them, and put an archive on their axes."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pcs_racing.base.checks import check_names, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.game.archive_files import load_archive, save_archive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import load_race_config
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import Command, Option, SettingOptions, command
from pcs_racing_agents.cli.options import DEFAULT_TRACK, POLICY_HELP, Circuits, Rules, Workers, can_draw
from pcs_racing_agents.policies.policy_pool import PolicyPool, spanning_policies
from studies.axes.apply import ApplySettings, apply_characteristics
from studies.axes.learn import LearnSettings, learn_characteristics
from studies.axes.learned import load_learned, save_learned
from studies.axes.pools import CANDIDATES, draw_pool
from studies.axes.report import learned_text, learning_text, write_weights

FILE = "characteristics.yaml"


axes = Command(
    "axes",
    "Learn characteristics from races, show them, and put an archive on their axes.",
    (
        "python -m studies axes learn --track Brackwater Pipkin --race contest --out out/learned",
        "python -m studies axes apply --archive contest --learned out/learned/characteristics.yaml --out out/mine",
    ),
)


@command(
    "axes learn",
    "python -m studies axes learn --track Brackwater Pipkin --race contest --out out/learned",
    "python -m studies axes learn --archive contest --size 24 --race contest --out out/mine",
)
def run_learn(
    *,
    track: Circuits = (DEFAULT_TRACK,),
    planner: Annotated[str, Option("planner of a pool that is drawn")] = "lattice",
    size: Annotated[
        int,
        Option(
            f"policies of the pool; drawn at random, the best of {CANDIDATES} times as many, evenly spaced in speed, "
            "or taken from the archive"
        ),
    ] = 24,
    archive: Annotated[
        str | None, Option("archive whose policies are the pool instead: its name or folder", "A")
    ] = None,
    policies: Annotated[Sequence[str], Option(f"a pool of your own instead: {POLICY_HELP}", "POLICY")] = (),
    rules: Rules,
    races: Annotated[int, Option("races of each pair on each track")] = 32,
    changes: Annotated[
        dict[str, Any],
        SettingOptions(LearnSettings, "name", "inputs", "degree", "segments", "opponents", "starts", "folds"),
    ],
    out: Annotated[Path, Option(f"folder for {FILE}, weights.csv and a picture; a stopped run resumes there", "DIR")],
    workers: Workers,
) -> None:
    """Race all pairs of a pool, and learn axes that tell rating and cyclic plane from 8 s of driving."""
    from pcs_racing_agents.base.style import save_picture

    settings = replace(LearnSettings(), **changes)
    tracks = tuple(load_track(name) for name in track)
    config = rules.config()
    given: tuple[Policy, ...] | None = None
    if policies and archive:
        raise InputError("--policies goes without --archive: the pool is one or the other")
    if policies:
        given = tuple(parse_policy(text) for text in policies)
    elif archive:
        given = spanning_policies(load_archive(archive), size)[1]
    drawing = get_planner(planner)
    size = len(given) if given is not None else check_whole("size", size, 3, 1000)
    # Checked before anything is raced, with stand-ins for policies that are yet to be drawn.
    pool = PolicyPool(given or (drawing.policy(),) * size, tracks, config, races=races, seed=rules.seed)
    if size < settings.folds:
        raise InputError(f"the pool holds {size} policies; {settings.folds} folds need as many")
    stated = {
        "tracks": [circuit.content_hash for circuit in tracks],
        "pool": [[policy.planner.name, *policy.parameters.tolist()] for policy in given]
        if given
        else [drawing.name, size],
        "race": repr(config),
        "races": pool.races,
        "folds": pool.folds,
        "seed": pool.seed,
        "settings": repr(settings),
    }
    with workers.start() as executor, open_job(out, "characteristics", stated) as job:
        if given is None:
            drawn = draw_pool(
                drawing,
                tracks,
                config,
                size,
                seed=rules.seed,
                segment_seconds=settings.segment_seconds,
                job=job,
                executor=executor,
                progress=show_progress("blocks"),
            )
            pool = replace(pool, policies=drawn)
        learning = learn_characteristics(pool, settings, job=job, executor=executor, progress=show_progress("blocks"))
        print(learning_text(learning))
        print(f"written: {save_learned(learning.characteristics, out / FILE)}")
        print(f"written: {write_weights(learning.characteristics, out / 'weights.csv')}")
        if can_draw("what was learned"):
            from studies.axes.report import learning_picture

            print(f"picture: {save_picture(learning_picture(learning), out / 'characteristics.png')}")


@command("axes show", "python -m studies axes show out/learned/characteristics.yaml")
def run_show(learned: Annotated[Path, Option("learned characteristics", "FILE")]) -> None:
    """Print what learned characteristics are made of."""
    print(learned_text(load_learned(learned)))


@command(
    "axes apply",
    "python -m studies axes apply --archive contest --learned out/learned/characteristics.yaml "
    "--track Brackwater Pipkin --out out/contest-learned",
    "python -m studies axes apply --archive contest --axes speed restraint --out out/contest-speed",
)
def run_apply(
    *,
    track: Circuits = (DEFAULT_TRACK,),
    archive: Annotated[str, Option("archive: its name or folder", "A")] = "contest",
    learned: Annotated[Path | None, Option("learned characteristics", "FILE")] = None,
    axes: Annotated[
        Sequence[str], Option("axes of the new archive, learned or not (default: all learned ones)", "NAME")
    ] = (),
    name: Annotated[str | None, Option("name of the new archive (default: that of its folder)")] = None,
    race: Annotated[str | None, Option("rules of the races (default: the archive's)")] = None,
    seed: Annotated[int, Option("seed of starts and noise")] = 0,
    changes: Annotated[dict[str, Any], SettingOptions(ApplySettings, "opponents", "starts", "explored_opponents")],
    out: Annotated[Path, Option("folder of the new archive", "DIR")],
    workers: Workers,
) -> None:
    """Measure the policies of an archive on learned axes, and write it as an archive of its own."""
    settings = replace(ApplySettings(), **changes)
    given = load_archive(archive)
    brought = None if learned is None else load_learned(learned)
    if brought is None and not axes:
        raise InputError("there is nothing to change; give --learned, --axes or both")
    tracks = tuple(load_track(place) for place in track)
    config = load_race_config(race or given.preset)
    chosen = check_names("axes", list(axes or (brought.names if brought is not None else ())))
    get_characteristics(chosen)
    stated = {
        "tracks": [circuit.content_hash for circuit in tracks],
        "archive": given.content_hash,
        "learned": None if brought is None else brought.content_hash,
        "axes": list(chosen),
        "race": repr(config),
        "settings": repr(settings),
        "seed": seed,
    }
    with workers.start() as executor, open_job(out / "job", "axes", stated) as job:
        made = apply_characteristics(
            given,
            brought,
            tracks,
            config,
            axes=chosen,
            name=name or out.resolve().name,
            settings=settings,
            seed=seed,
            job=job,
            executor=executor,
            progress=show_progress("blocks"),
        )
        print(f"archive: {save_archive(made, out)}")
        if brought is not None:  # without which nobody can read the archive
            print(f"written: {save_learned(brought, out / FILE)}")
    print(made)
    for axis, low, high in zip(made.characteristics, made.nadir, made.ideal, strict=True):
        print(f"{axis}: {low:.2f} to {high:.2f}")
