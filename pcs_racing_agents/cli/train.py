"""``pcs-racing train``: train the networks of agents."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pcs_racing.base.errors import InputError, require
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing.race.config import load_rules
from pcs_racing.track.loading import load_track
from pcs_racing_agents import learning
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.folders import hold_folder
from pcs_racing_agents.base.jobs import open_job, show_progress
from pcs_racing_agents.base.tables import aligned, table_rows, write_csv
from pcs_racing_agents.cli.commands import Command, ConfigOptions, Option, command
from pcs_racing_agents.cli.options import (
    AGENT_HELP,
    DEFAULT_TRACK,
    ArchiveName,
    Circuits,
    RaceOptions,
    Workers,
    archive_for,
    output_folder,
)
from pcs_racing_agents.learning.ppo import COLUMNS, PPOSettings
from pcs_racing_agents.networks import (
    NetworkSet,
    RegretNetwork,
    load_train_settings,
    save_network,
    save_network_set,
)
from pcs_racing_agents.networks.from_trees import train_regrets
from pcs_racing_agents.networks.metrics import score_table
from pcs_racing_agents.networks.training import TrainSettings, write_epochs
from pcs_racing_agents.tournament.race_files import write_results
from pcs_racing_agents.trees import load_trees
from pcs_racing_agents.trees.storage import stored_identity

group = Command(
    "train",
    "Train the network of an agent: on game trees, by PPO, or in branched races.",
    (
        "pcs-racing train regret out/trees --out out/networks/regret",
        "pcs-racing train ppo --config duel-paper --out out/ppo",
    ),
)

POOL = ("never-switch", "random-moves")  # a policy that stays, and random moves
Name = Annotated[str | None, Option("name of the network (default: the kind)")]
Out = Annotated[
    Path,
    Option(
        "folder of the work, with the result in its folder 'agent'; an interrupted run resumes"
        " here",
        "DIR",
    ),
]
Pool = Annotated[Sequence[str], Option(f"opponents: {AGENT_HELP}", "AGENT")]


def _config(kind: str) -> Option:
    names = ", ".join(shipped_configs(kind))
    return Option(f"settings: {names} or a YAML file", "NAME")


@dataclass(frozen=True, kw_only=True)
class Games:
    """Return the games of an agent's training."""

    track: Circuits = (DEFAULT_TRACK,)
    archive: ArchiveName = None
    rules: RaceOptions


@command(
    "train regret",
    "pcs-racing train regret out/trees --out out/networks/regret",
    "pcs-racing train regret out/trees-a out/trees-b --config study --target advantage --out"
    " out/networks/advantage",
)
def run_regret(
    trees: Annotated[
        Sequence[Path], Option("folders of game trees, written by 'pcs-racing tree'", "DIR")
    ],
    *,
    config: Annotated[str | None, _config("train")] = None,
    changes: Annotated[
        dict[str, Any], ConfigOptions(TrainSettings, "target", "epochs", "hidden", "seed")
    ],
    name: Annotated[str | None, Option("name of the network (default: name of the folder)")] = None,
    out: Annotated[Path, Option("folder for the network and its learning curves", "DIR")],
    workers: Workers,
) -> None:
    """Train on game trees: regrets for 'cfr-argmax', or another target."""
    settings = load_train_settings(config, **changes)
    name = name or out.resolve().name
    stored = [load_trees(folder) for folder in trees]
    manifests = [part.settings for part in stored]
    _check_one_game(trees, manifests)
    index = [(part, i) for part in stored for i in range(len(part))]
    # A missing library is reported before any long work.
    require("torch", extra="learning")
    with hold_folder(out), workers.start() as executor:
        folder = output_folder(out)
        network, result, rows, scores = train_regrets(
            lambda number: index[number][0][index[number][1]],
            np.concatenate([np.asarray(part.settings["pairs"]) for part in stored]),
            stored_identity(manifests[0]),
            settings,
            name=name,
            about=_about(manifests),
            executor=executor,
            solving=show_progress("trees"),
            learning=show_progress("epochs"),
        )
        best = result.epochs[result.best]
        save_network(network, folder)
        write_epochs(result, folder / "learning_curves.csv")
    print(
        f"{network}\n{network.training['rows']} rows from {network.training['tracks']}; epoch"
        f" {best.epoch} of {result.epochs[-1].epoch} kept, validation loss"
        f" {best.validation_loss:.4f}\n\n{score_table(rows, scores)}\n\nnetwork: {folder}"
    )


def _check_one_game(folders: Sequence[Path], manifests: Sequence[Mapping[str, Any]]) -> None:
    """Check that all trees have equal archives (by content) and rules; tracks may differ."""

    def facts(settings: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "archive": settings["archive"]["sha256"],
            "encoding": settings["encoding"],
            **settings["rules"],
        }

    first = facts(manifests[0])
    for folder, settings in zip(folders, manifests, strict=True):
        for key, value in facts(settings).items():
            if value != first[key]:
                raise InputError(
                    f"{folder} and {folders[0]} hold trees of different games: {key} is"
                    f" {value!r:.60} in one and {first[key]!r:.60} in the other"
                )


def _about(manifests: Sequence[Mapping[str, Any]]) -> dict[str, str | int | float | bool]:
    rules = load_rules(manifests[0]["rules"])
    return {
        "tracks": ", ".join(sorted({manifest["track"]["name"] for manifest in manifests})),
        "utility": rules.payoff,
        "step_seconds": rules.step_seconds,
    }


@command(
    "train ppo",
    "pcs-racing train ppo --config duel-paper --out out/ppo",
    "pcs-racing train ppo --config duel-paper --seeds 0 1 2 --workers 3 --out out/ppo-3",
)
def run_ppo(
    *,
    config: Annotated[str, _config("ppo")],
    changes: Annotated[dict[str, Any], ConfigOptions(PPOSettings, "archive", "steps", "seeds")],
    name: Annotated[
        str | None,
        Option("name of the network (default: name of the shipped network of the agent 'ppo')"),
    ] = None,
    out: Out,
    workers: Workers,
) -> None:
    """Train 'ppo': PPO of Stable-Baselines3, in the games of a configuration."""
    settings = learning.load_ppo_settings(config, **changes)
    with workers.start() as executor:
        trained = learning.train_ppo(
            settings, out, name=name, executor=executor, progress=show_progress("steps")
        )
    table = "\n".join(aligned(table_rows(COLUMNS, trained.best)))
    print(
        f"{trained.seconds:.0f} s of training; best: seed {trained.best[0].seed},"
        f" {trained.best[0].steps} moves\n\n{table}\n\nwritten: {out / 'agent'}; race it as"
        f" ppo:network={out / 'agent'}"
    )


@command(
    "train response",
    "pcs-racing train response --pool never-switch lane-switcher --out out/response",
)
def run_response(
    *,
    games: Games,
    pool: Pool = POOL,
    config: Annotated[str, _config("response")] = "response",
    name: Name = None,
    out: Out,
    workers: Workers,
) -> None:
    """Train 'response': a best response to a pool of opponents."""
    settings = learning.load_response_settings(config, seed=games.rules.seed)
    _learn("response", learning.learn_response, games, pool, settings, name, out, workers)


@command(
    "train psro",
    "pcs-racing train psro --track Pipkin Saltmere --pool never-switch lane-switcher --out"
    " out/psro",
)
def run_psro(
    *,
    games: Games,
    pool: Pool = POOL,
    config: Annotated[str, _config("psro")] = "default",
    name: Name = None,
    out: Out,
    workers: Workers,
) -> None:
    """Train 'psro': a mixture of responses, by policy-space response oracles."""
    settings = learning.load_psro_settings(config, seed=games.rules.seed)
    _learn("psro", learning.learn_psro, games, pool, settings, name, out, workers)


@command(
    "train self-play",
    "pcs-racing train self-play --track Brackwater --rules contest --out out/self-play",
)
def run_self_play(
    *,
    games: Games,
    config: Annotated[str, _config("self-play")] = "default",
    name: Name = None,
    out: Out,
    workers: Workers,
) -> None:
    """Train 'self-play': the average strategy of CFR against itself."""
    settings = learning.load_self_play_settings(config, seed=games.rules.seed)
    _learn("self-play", learning.learn_self_play, games, None, settings, name, out, workers)


@command(
    "train best-reply",
    "pcs-racing train best-reply response --rules contest --out out/reply",
)
def run_best_reply(
    agent: Annotated[str, Option(f"agent: {AGENT_HELP}", "AGENT")],
    *,
    games: Games,
    config: Annotated[str, _config("response")] = "best-reply",
    races: Annotated[int, Option("test races, on all circuits together")] = 4000,
    name: Name = None,
    out: Out,
    workers: Workers,
) -> None:
    """Train an opponent of one agent, and print the loss of the agent."""
    from pcs_racing_agents.learning.best_replies import REPLY_NOTE, check_races, loss_table

    settings = learning.load_response_settings(config, seed=games.rules.seed)
    check_races(races, len(games.track))

    def learn(made: Any, agents: Any, *rest: Any, **run: Any) -> RegretNetwork:
        reply = learning.best_reply(made, agents[0], *rest, races=races, **run)
        table = loss_table(agent, reply, made[0].rules)
        budget = (
            f"learner: {settings.starts} games branched at every step and on each circuit,"
            f" {settings.rounds} rounds, {settings.members} networks"
        )
        print("\n".join([*aligned(table), "", REPLY_NOTE, budget]))
        write_results(reply.races, out / "results.csv")
        print(f"written: {write_csv(table, out / 'best_reply.csv')}")
        return reply.network

    _learn("best-reply", learn, games, [agent], settings, name, out, workers, races)


def _learn(
    kind: str,
    learn: Callable[..., RegretNetwork | NetworkSet],
    games: Games,
    pool: Sequence[str] | None,
    settings: Any,
    name: str | None,
    out: Path,
    workers: Workers,
    races: int | None = None,
) -> None:
    """Learn in branched races in the folder of a job, and save the result."""
    rules = games.rules.read()
    spec = make_game(None, archive_for(games.archive, rules), rules)
    made = [replace(spec, track=load_track(track)) for track in games.track]
    opponents = [competitor(text, spec, code=True, seed=games.rules.seed) for text in pool or ()]
    identity: dict[str, Any] = {
        "archive": spec.archive.content_hash,
        "rules": repr(rules),
        "tracks": [game.track.content_hash for game in made],
        "competitors": [competitor_hash(opponent) for opponent in opponents],
        "name": name or kind,
        "settings": plain_settings(settings),
        "races": races,
    }
    folder = out / "agent"
    with workers.start() as executor, open_job(out, kind, identity) as job:
        played = (made, spec) if pool is None else (made, opponents, spec)
        run: Any = {"executor": executor, "progress": show_progress("tasks")}
        learned = learn(*played, settings, job, name=name or kind, **run)
        if isinstance(learned, NetworkSet):
            save_network_set(learned, folder)
            agent = f"{kind}:networks={folder}"
        else:
            save_network(learned, folder)
            agent = f"response:network={folder}"
    print(f"{learned}\nwritten: {folder}; race it as {agent}")
