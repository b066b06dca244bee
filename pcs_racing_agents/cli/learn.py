"""``pcs-racing learn``, ``best-reply`` and ``ppo``: train agents, best responses and PPO."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import require
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
)
from pcs_racing_agents.learning.ppo.settings import PPOSettings

if TYPE_CHECKING:
    from pcs_racing_agents.agents.agent import Competitor
    from pcs_racing_agents.agents.game_spec import GameSpec


METHODS = {
    "response": "an approximate best response to a pool of opponents",
    "psro": "a mixture of responses: policy-space response oracles, beginning with the pool",
    "self-play": "an average strategy of counterfactual regret minimisation; it needs no pool",
}


# The default configuration of a method comes first.
CONFIGS = {
    name: sorted(shipped_configs(name), key=lambda config: config not in ("default", "response"))
    for name in METHODS
}

# Default: one opponent with a fixed policy of the archive, one with random changes of policy.
Pool = Annotated[Sequence[str], Option(f"opponents: {AGENT_HELP}", "AGENT")]
POOL = ("never-switch", "random-moves")


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
        from pcs_racing_agents.agents.zoo import parse_agent

        return [parse_agent(text, spec, seed=self.rules.seed, code=True) for text in texts]


@command(
    "learn",
    "pcs-racing learn self-play --track Brackwater --rules contest --out out/self-play",
    "pcs-racing learn psro --track Pipkin Saltmere --pool never-switch lane-switcher --out"
    " out/psro",
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
    pool: Pool = POOL,
    config: Annotated[
        str | None,
        Option(
            "settings of the method, the first by default, or a YAML file "
            f"({'; '.join(f'{name}: ' + ', '.join(configs) for name, configs in CONFIGS.items())})",
            "NAME",
        ),
    ] = None,
    name: Annotated[
        str | None, Option("name of the agent's networks (default: the method)")
    ] = None,
    out: Annotated[
        Path,
        Option(
            "folder of the work, with the result in its folder 'agent'; a stopped run resumes"
            " there",
            "DIR",
        ),
    ],
    workers: Workers,
) -> None:
    """Train an agent in branched races: a response to opponents, PSRO, or CFR in self-play."""
    from pcs_racing_agents.learning import psro, responses, self_play
    from pcs_racing_agents.networks import NetworkSet, save_network, save_network_set

    spec, made = games.make()
    # Self-play needs no pool: an invalid agent of the pool must not stop it.
    opponents = [] if method == "self-play" else games.agents(pool, spec)
    methods: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
        "response": (responses.load_response_settings, responses.learn_response),
        "psro": (psro.load_psro_settings, psro.learn_psro),
        "self-play": (self_play.load_self_play_settings, self_play.learn_self_play),
    }
    load, train = methods[method]
    settings = load(config or CONFIGS[method][0], seed=games.rules.seed)
    players: tuple[Any, ...] = (made, opponents, spec)
    if method == "self-play":
        players = ([self_play.RaceSampler(game, spec, settings.worth) for game in made],)
    name = name or method
    identity = {
        **run_identity(made, spec, opponents),
        "name": name,
        "settings": plain_settings(settings),
    }
    with workers.start() as executor, open_job(out, method, identity) as job:
        learned = train(
            *players, settings, job, executor=executor, name=name, progress=show_progress("tasks")
        )
        folder = out / "agent"
        if isinstance(learned, NetworkSet):
            save_network_set(learned, folder)
            weights = ", ".join(f"{weight:.3g}" for weight in learned.weights)
            print(f"{len(learned.networks)} networks, played with probabilities {weights}")
            option = "networks"
        else:
            save_network(learned, folder)
            print(learned)
            option = "network"
    print(f"written: {folder}; race it as {method}:{option}={folder}")


def run_identity(
    games: "list[RaceGame]", spec: "GameSpec", competitors: "list[Competitor]"
) -> dict[str, Any]:
    """Return the identity of games and competitors for a job's manifest."""
    from pcs_racing_agents.agents.agent import competitor_hash

    return {
        "archive": spec.archive.content_hash,
        "rules": repr(games[0].config),
        "tracks": [game.track.content_hash for game in games],
        "competitors": [competitor_hash(competitor) for competitor in competitors],
    }


@command(
    "best-reply",
    "pcs-racing best-reply response --track Pipkin --rules contest --out out/reply",
    "pcs-racing best-reply lane-switcher --track Pipkin Saltmere --rules contest --starts 512 --out"
    " out/quick",
)
def run_best_reply(
    agent: Annotated[str, Option(f"agent or driver: {AGENT_HELP}")],
    *,
    games: Games,
    config: Annotated[
        str,
        Option(
            f"settings of the learner: {', '.join(shipped_configs('response'))} or a YAML file",
            "NAME",
        ),
    ] = "best-reply",
    starts: Annotated[
        int | None, Option("the learner's budget: games branched at every step, on each circuit")
    ] = None,
    races: Annotated[int, Option("fresh races on all circuits together")] = 4000,
    out: Annotated[
        Path,
        Option(
            "folder for best_reply.csv, results.csv and the opponent's network; an interrupted run"
            " resumes here",
            "DIR",
        ),
    ],
    workers: Workers,
) -> None:
    """Train an opponent against one agent alone, and print the agent's loss."""
    from pcs_racing_agents.agents.agent import competitor_hash
    from pcs_racing_agents.learning.responses.best_reply import (
        FEWEST,
        best_reply,
        reply_text,
        write_replies,
    )
    from pcs_racing_agents.learning.responses.learner import load_response_settings
    from pcs_racing_agents.networks.network_files import save_network
    from pcs_racing_agents.tournament.race_files import write_results

    budget = {} if starts is None else {"starts": starts}
    settings = load_response_settings(config, seed=games.rules.seed, **budget)
    spec, made = games.make()
    (target,) = games.agents([agent], spec)
    check_whole("races", races, FEWEST * len(made))
    identity = {
        "agent": competitor_hash(target),
        "archive": spec.archive.content_hash,
        "rules": repr(spec.config),
        "tracks": [game.track.content_hash for game in made],
        "races": races,
        "learner": plain_settings(settings),
    }
    with workers.start() as executor, open_job(out, "best reply", identity) as job:
        progress = show_progress("tasks")
        reply = best_reply(
            made, target, spec, settings, job, races=races, executor=executor, progress=progress
        )
        print(reply_text({agent: reply}, settings))
        write_results(reply.races, out / "results.csv")
        print(f"written: {write_replies({agent: reply}, out / 'best_reply.csv')}")
        print(f"network: {save_network(reply.network, out / 'reply')}")


@command(
    "ppo",
    "pcs-racing ppo --config duel-paper --out out/ppo",
    "pcs-racing ppo --config drive --steps 2000000 --seeds 0 1 2 --executor processes --out"
    " out/ppo-drive",
)
def run_ppo(
    *,
    config: Annotated[
        str, Option(f"settings: {', '.join(shipped_configs('ppo'))} or a YAML file", "NAME")
    ],
    changes: Annotated[dict[str, Any], ConfigOptions(PPOSettings, "steps", "seeds")],
    name: Annotated[
        str | None,
        Option("name of the policy (default: the name under which the agent 'ppo' looks for it)"),
    ] = None,
    tensorboard: Annotated[bool, Option("also write the learning curves for TensorBoard")] = False,
    no_picture: Annotated[bool, Option("do not draw the learning curves")] = False,
    out: Annotated[
        Path,
        Option(
            "folder for weights and learning curves; a stopped training keeps its finished seeds"
            " there",
            "DIR",
        ),
    ],
    workers: Workers,
) -> None:
    """Train a baseline by PPO at the strategy or control level, or resume such a training."""
    from pcs_racing_agents.base.curves import curves_picture, write_tensorboard
    from pcs_racing_agents.base.progress import show_progress
    from pcs_racing_agents.base.style import save_picture
    from pcs_racing_agents.learning.ppo.evaluation import evaluation_curves, mean_score, score_table
    from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
    from pcs_racing_agents.learning.ppo.train import train_ppo

    settings = load_ppo_settings(config, **changes)
    if tensorboard:
        require("tensorboard", extra="learning")
    if not no_picture:
        require("matplotlib", extra="plots")
    with workers.start() as executor:
        trained = train_ppo(
            settings,
            out,
            name=name,
            executor=executor,
            progress=show_progress("steps"),
        )
    opponents = settings.opponents
    if tensorboard:
        runs = {
            f"seed-{curve.seed}": [
                (
                    steps,
                    {
                        f"evaluation/{key}": value
                        for key, value in mean_score(scores, opponents)._asdict().items()
                    },
                )
                for steps, scores in zip(curve.steps, curve.scores, strict=True)
            ]
            for curve in trained.curves
        }
        write_tensorboard(out / "tensorboard", runs)
    if not no_picture:
        panels = evaluation_curves(trained.curves, opponents)
        x_label, title = f"million {trained.task.unit}", f"PPO: {trained.task.default_name}"
        save_picture(curves_picture(panels, x_label=x_label, title=title), out / "curve.png")
    steps = ", ".join(f"{curve.steps[-1]} with seed {curve.seed}" for curve in trained.curves)
    print(
        f"{steps}: {trained.seconds:.0f} s of training; best: seed {trained.seed}, {trained.steps}"
        f" {trained.task.unit}\n\n{score_table(trained.scores, opponents)}\n\npolicy:"
        f" {trained.folder}"
    )
