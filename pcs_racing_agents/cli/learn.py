"""``pcs-racing learn`` and ``ppo``: train agents in branched races, and by PPO."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import ConfigOptions, Option, command
from pcs_racing_agents.cli.options import (
    AGENT_HELP,
    DEFAULT_TRACK,
    ArchiveName,
    Circuits,
    Rules,
    Workers,
    archive_for,
    can_draw,
)
from pcs_racing_agents.learning.ppo.settings import DuelSettings

if TYPE_CHECKING:
    from pcs_racing.game.players import Competitor
    from pcs_racing_agents.agents.game_spec import GameSpec
    from pcs_racing_agents.networks import RegretNetwork


POOL = ("never-switch", "random-moves")  # a policy that stays, and random moves
METHODS = {
    "response": "an approximate best response to a pool of opponents",
    "best-reply": "an opponent of the one agent in the pool, and the agent's loss in test races",
    "psro": "a mixture of responses: policy-space response oracles, beginning with the pool",
    "self-play": "an average strategy of counterfactual regret minimisation; it needs no pool",
}
DEFAULTS = {
    "response": "response",
    "best-reply": "best-reply",
    "psro": "default",
    "self-play": "default",
}
"""Settings of each method."""
KINDS = ("response", "psro", "self-play")
"""Kinds of settings; a best reply has settings of a response."""


@dataclass(frozen=True, kw_only=True)
class Games:
    """The games in which an agent learns."""

    track: Circuits = (DEFAULT_TRACK,)
    archive: ArchiveName = None
    rules: Rules

    def make(self) -> "tuple[GameSpec, list[RaceGame]]":
        """Return archive and rules of the options, and the game on each track."""
        from pcs_racing_agents.agents.game_spec import make_game_spec
        from pcs_racing_agents.tournament.play import game_rules

        config = game_rules(self.rules.config())
        spec = make_game_spec(archive_for(self.archive, config.race), config)
        return spec, [make_game(load_track(name), spec.archive, config) for name in self.track]

    def agents(self, texts: Sequence[str], spec: "GameSpec") -> "list[Competitor]":
        """Return the named agents."""
        from pcs_racing.game.players import competitor

        return [competitor(text, spec, seed=self.rules.seed, code=True) for text in texts]


@command(
    "learn",
    "pcs-racing learn self-play --track Brackwater --rules contest --out out/self-play",
    "pcs-racing learn psro --track Pipkin Saltmere --pool never-switch lane-switcher --out"
    " out/psro",
    "pcs-racing learn best-reply --pool response --rules contest --out out/reply",
)
def run(
    method: Annotated[
        str,
        Option(
            "; ".join(f"{name}: {meaning}" for name, meaning in METHODS.items()), choices=METHODS
        ),
    ],
    *,
    games: Games,
    pool: Annotated[
        Sequence[str], Option(f"opponents: {AGENT_HELP} (default: {' '.join(POOL)})", "AGENT")
    ] = (),
    config: Annotated[
        str | None,
        Option(
            "settings of the method: a YAML file or a name ("
            + "; ".join(f"{kind}: {', '.join(shipped_configs(kind))}" for kind in KINDS)
            + ")",
            "NAME",
        ),
    ] = None,
    races: Annotated[
        int | None,
        Option("test races of a best reply, on all circuits together (default: 4000)"),
    ] = None,
    name: Annotated[
        str | None, Option("name of the agent's networks (default: the method)")
    ] = None,
    out: Annotated[
        Path,
        Option(
            "folder of the work, with the result in its folder 'agent'; an interrupted run resumes"
            " here",
            "DIR",
        ),
    ],
    workers: Workers,
) -> None:
    """Train an agent in branched races: a response to opponents, PSRO, or CFR in self-play."""
    from pcs_racing_agents.agents.agent import competitor_hash
    from pcs_racing_agents.learning import psro, responses, self_play
    from pcs_racing_agents.networks import NetworkSet, save_network, save_network_set

    if method == "self-play" and pool:
        raise InputError("self-play meets itself; leave out --pool")
    if method != "best-reply" and races is not None:
        raise InputError("--races goes with best-reply")
    pool, races = pool or POOL, 4000 if races is None else races
    if method == "best-reply" and len(pool) != 1:
        raise InputError(f"a best reply is trained against one agent; --pool names {len(pool)}")
    spec, made = games.make()
    # Self-play needs no pool: an invalid agent of the pool must not stop it.
    opponents = [] if method == "self-play" else games.agents(pool, spec)
    load: Callable[..., Any] = {
        "psro": psro.load_psro_settings,
        "self-play": self_play.load_self_play_settings,
    }.get(method, responses.load_response_settings)
    settings = load(config or DEFAULTS[method], seed=games.rules.seed)
    name = name or method
    identity: dict[str, Any] = {
        "archive": spec.archive.content_hash,
        "rules": repr(made[0].config),
        "tracks": [game.track.content_hash for game in made],
        "competitors": [competitor_hash(competitor) for competitor in opponents],
        "name": name,
        "settings": plain_settings(settings),
    }
    if method == "best-reply":
        responses.check_races(races, len(made))
        identity["races"] = races
    with workers.start() as executor, open_job(out, method, identity) as job:
        run: Any = {"executor": executor, "progress": show_progress("tasks")}
        learned: NetworkSet | RegretNetwork
        if method == "best-reply":
            reply = responses.best_reply(
                made, opponents[0], spec, settings, job, races=races, name=name, **run
            )
            print(responses.reply_text(pool[0], reply, settings))
            print(f"written: {responses.write_reply(pool[0], reply, out)}")
            learned = reply.network
        elif method == "self-play":
            samplers = [self_play.RaceSampler(game, spec, settings.worth) for game in made]
            learned = self_play.learn_self_play(samplers, settings, job, name=name, **run)
        else:
            train = psro.learn_psro if method == "psro" else responses.learn_response
            learned = train(made, opponents, spec, settings, job, name=name, **run)
        folder = out / "agent"
        if isinstance(learned, NetworkSet):
            save_network_set(learned, folder)
            weights = ", ".join(f"{weight:.3g}" for weight in learned.weights)
            print(f"{len(learned.networks)} networks, played with probabilities {weights}")
            agent = f"{method}:networks={folder}"
        else:
            save_network(learned, folder)
            print(learned)
            agent = f"response:network={folder}"
    print(f"written: {folder}; race it as {agent}")


@command(
    "ppo",
    "pcs-racing ppo --config duel-paper --out out/ppo",
    "pcs-racing ppo --config duel-paper --seeds 0 1 2 --executor processes --out out/ppo-3",
)
def run_ppo(
    *,
    config: Annotated[
        str, Option(f"settings: {', '.join(shipped_configs('ppo'))} or a YAML file", "NAME")
    ],
    changes: Annotated[dict[str, Any], ConfigOptions(DuelSettings, "steps", "seeds")],
    name: Annotated[
        str | None,
        Option("name of the policy (default: the name under which the agent 'ppo' looks for it)"),
    ] = None,
    out: Annotated[
        Path,
        Option(
            "folder for weights and learning curves; an interrupted run resumes here with the"
            " seeds that are not finished",
            "DIR",
        ),
    ],
    workers: Workers,
) -> None:
    """Train a baseline by PPO, or resume such a training."""
    from pcs_racing_agents.base.curves import curves_picture
    from pcs_racing_agents.base.style import save_picture
    from pcs_racing_agents.learning.ppo.evaluation import evaluation_curves, score_table
    from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
    from pcs_racing_agents.learning.ppo.train import train_ppo

    settings = load_ppo_settings(config, **changes)
    with workers.start() as executor:
        trained = train_ppo(
            settings, out, name=name, executor=executor, progress=show_progress("steps")
        )
    if can_draw("the learning curve"):
        panels = evaluation_curves(trained.curves, settings.opponents)
        x_label, title = f"million {trained.task.unit}", f"PPO: {trained.task.default_name}"
        save_picture(curves_picture(panels, x_label=x_label, title=title), out / "curve.png")
    steps = ", ".join(f"{curve.steps[-1]} with seed {curve.seed}" for curve in trained.curves)
    print(
        f"{steps}: {trained.seconds:.0f} s of training; best: seed {trained.seed}, {trained.steps}"
        f" {trained.task.unit}\n\n{score_table(trained.scores, settings.opponents)}\n\npolicy:"
        f" {trained.folder}"
    )
