"""What the PPO baselines are worth on fresh starts, beside other agents in the same races, and how
they learned.

    python dev/benchmarks/ppo_baselines.py
    python dev/benchmarks/ppo_baselines.py --egos 20 --variants 20 --lines 5
    # the picture alone
    python dev/benchmarks/ppo_baselines.py --lines 0 --picture docs/images/ppo_curves.png

Every baseline that is shipped (or given with ``--policies``) races opponents on circuits that it
learned on and on others: start policies x opponents x start lines x both sides, with seeds that no
training had. An agent that makes moves is compared with other agents in the same races, a driver
with the archive's policies.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcs_racing import load_track, make_game
from pcs_racing.base.artifacts import MANIFEST
from pcs_racing.planners.trained import PLANNER_FORMAT, load_trained, read_trained
from pcs_racing_agents import make
from pcs_racing_agents.agents import as_agent
from pcs_racing_agents.base.statistics import clustered_mean, compare
from pcs_racing_agents.base.tables import read_csv, with_interval
from pcs_racing_agents.learning.ppo.evaluation import (
    EvaluationCurve,
    Matchup,
    MatchupScore,
)
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network
from pcs_racing_agents.tournament import cross_pairing, play_pairing
from pcs_racing_agents.tournament.games import variant_count

SEED = 20_011  # of these races, and of nothing else
OTHERS = ("Saltmere", "Tarnfjord", "Larkmoor", "Quillburg", "Kestrelheim", "Brackwater", "Pipkin")
DRIVE_RULES = (("paper", "default-early"), ("contest", "contest-early"))
ARMS = ("best-fixed", "cfr-argmax", "response")  # beside a constant move, never-switch and ppo
OPPONENTS = ("never-switch", "random-moves", "lane-switcher", "cfr-argmax")
MAX_LINES = 125  # a cell takes eight times as many from the circuit, which has at most 1,000
DRIVERS = ("never-switch", "lane-switcher", "pure-pursuit")


class Shipped(NamedTuple):
    """A baseline in a folder: a driver, or an agent that makes moves."""

    folder: Path
    drives: bool
    training: dict

    @property
    def tracks(self) -> list[str]:
        """Circuits that it learned on."""
        return str(self.training["setting_tracks"]).split(", ")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--policies", type=Path, nargs="+", help="folders that 'pcs-racing ppo' wrote"
    )
    parser.add_argument(
        "--egos", type=int, default=10, help="start policies of an agent that makes moves"
    )
    parser.add_argument("--variants", type=int, default=10, help="opponents of each kind")
    parser.add_argument(
        "--lines", type=int, default=2, help="start lines of each pair; 0 for no races"
    )
    parser.add_argument("--seen", type=int, default=1, help="circuits that were learned on")
    parser.add_argument("--unseen", type=int, default=1, help="circuits that were not")
    parser.add_argument("--picture", type=Path, help="draw the learning curves into this file")
    arguments = parser.parse_args()
    found = [
        look_at(folder)
        for folder in arguments.policies
        or sorted(
            file.parent
            for kind in (NETWORK_FORMAT, PLANNER_FORMAT)
            for file in kind.shipped.glob(f"*/{MANIFEST}")
        )
    ]
    baselines = [baseline for baseline in found if baseline is not None]
    for baseline in baselines if arguments.lines > 0 else ():
        unseen = [name for name in OTHERS if name not in baseline.tracks]
        tracks = [*baseline.tracks[: arguments.seen], *unseen[: arguments.unseen]]
        (race_driver if baseline.drives else race_agent)(baseline, tracks, arguments)
    if arguments.picture:
        draw(baselines, arguments.picture)
        print(arguments.picture)


def look_at(folder: Path) -> Shipped | None:
    """What a folder holds, if it is one of our baselines."""
    text = (folder / MANIFEST).read_text(encoding="utf-8")
    if "pcs-racing driver\n" in text:
        return Shipped(folder, True, read_trained(folder)[1]["training"])
    if "pcs-racing network\n" not in text:
        return None
    network = load_network(folder)
    return Shipped(folder, False, dict(network.training)) if network.target == "ppo" else None


def tell(baseline: Shipped, races: str, columns: str) -> None:
    training = baseline.training
    print(
        f"\n{baseline.folder.name}: seed {training['seed']} of {training['setting_seeds']}, kept"
        f" after {training['steps']} of {training['steps_of_all_seeds']} steps; {races} races a"
        f" cell\n\n| {columns} |\n|{'---|' * (columns.count('|') + 1)}",
        flush=True,
    )


def place(baseline: Shipped, track: str) -> str:
    return f"{track} ({'seen' if track in baseline.tracks else 'unseen'})"


def race_driver(baseline: Shipped, tracks: list[str], arguments: argparse.Namespace) -> None:
    """A driver, and the archive's policies that never change, against drivers under each set of
    rules.
    """
    driver = as_agent(load_trained(baseline.folder).policy())
    columns = (
        "circuit",
        "rules",
        "opponent",
        baseline.folder.name,
        "won",
        "lost",
        "crashed",
        "at fault",
        "never-switch",
    )
    races = arguments.egos * arguments.variants * arguments.lines
    tell(baseline, f"at most {2 * races}", " | ".join(columns))
    for track in tracks:
        for rules, archive in DRIVE_RULES:
            game = make_game(load_track(track), archive, rules)
            policies = make("never-switch", archive=archive, race=rules)
            for name in DRIVERS:
                opponent = make(name, archive=archive, race=rules)
                variants = min(arguments.variants, variant_count(game, opponent))
                draws = {"opponents": variants, "seed": SEED}
                driven = min(races // variants, MAX_LINES)
                raced = play_pairing(
                    cross_pairing(game, driver, opponent, egos=1, lines=driven, **draws)
                )
                # The archive's policies beside it drive about as many races, spread over start
                # policies.
                lines = max(races // (variants * arguments.egos), 1)
                beside = play_pairing(
                    cross_pairing(
                        game, policies, opponent, egos=arguments.egos, lines=lines, **draws
                    )
                )
                # A label that never varies splits nothing, and its variance would be that of one
                # cluster.
                clusters = [
                    labels for labels in (raced.variants[:, 1], raced.places) if np.ptp(labels) > 0
                ]
                clusters = clusters or [np.arange(len(raced))]
                print(
                    f"| {place(baseline, track)} | {rules} | {name} | {raced.score.mean():.3f} +-"
                    f" {clustered_mean(raced.score, *clusters).se:.3f} |"
                    f" {np.mean(raced.winner == 0):.0%} | {np.mean(raced.winner == 1):.0%} |"
                    f" {np.mean(raced.crashed):.0%} | {np.mean(raced.fault[:, 0] == 1):.0%} |"
                    f" {beside.score.mean():.3f} |",
                    flush=True,
                )


def race_agent(baseline: Shipped, tracks: list[str], arguments: argparse.Namespace) -> None:
    """An agent against several kinds of opponents, and what it and others gain over never
    switching.
    """
    training = baseline.training
    world = {"archive": str(training["setting_archive"]), "race": str(training["setting_race"])}
    moving = next(
        name
        for name in str(training["setting_opponents"]).replace(",", " ").split()
        if "always-" in name
    )
    agents = {name: make(name, **world) for name in ("never-switch", moving, *ARMS)}
    agents["ppo"] = make("ppo", network=baseline.folder, **world)
    draws = {
        "egos": arguments.egos,
        "opponents": arguments.variants,
        "lines": arguments.lines,
        "seed": SEED,
    }
    columns = " | ".join(("circuit", "opponent", *agents, "ppo - cfr-argmax", "ppo - response"))
    tell(baseline, f"{2 * arguments.egos * arguments.variants * arguments.lines}", columns)
    for track in tracks:
        game = make_game(load_track(track), world["archive"], world["race"])
        for name in OPPONENTS:
            opponent = make(name, **world)
            cells = {
                key: play_pairing(cross_pairing(game, agent, opponent, **draws))
                for key, agent in agents.items()
            }
            groups = cells["ppo"].variants.T
            same = name == "never-switch"  # the archive's policies on both sides

            def gain(key: str, over: str, cells=cells, groups=groups, same=same) -> str:
                found = compare(cells[key].score, cells[over].score, *groups, same_pool=same)
                return with_interval(found.difference, found.low, found.high)

            texts = [f"{cells['never-switch'].score.mean():.3f}"]
            texts += [
                f"{cells[key].score.mean() - cells['never-switch'].score.mean():+.3f}"
                for key in (moving, *ARMS)
            ]
            texts += [gain("ppo", over) for over in ("never-switch", "cfr-argmax", "response")]
            print(f"| {place(baseline, track)} | {name} | {' | '.join(texts)} |", flush=True)


def kind_of(cell: Matchup) -> str:
    """Rules and opponent, its variants taken together."""
    return f"{cell.race}, {cell.opponent.partition(':')[0]}"


def read_evaluations(file: Path) -> list[EvaluationCurve]:
    """Return the learning curves in a file of a training run."""
    curves: dict[int, dict[int, dict[Matchup, MatchupScore]]] = {}
    for row in read_csv(file).rows():
        matchup = Matchup(*(row[key] for key in Matchup._fields))
        score = MatchupScore(
            int(row["races"]), *(float(row[key]) for key in MatchupScore._fields[1:])
        )
        curves.setdefault(int(row["seed"]), {}).setdefault(int(row["steps"]), {})[matchup] = score
    return [
        EvaluationCurve(seed, tuple(moments), tuple(moments.values()))
        for seed, moments in curves.items()
    ]


def draw(baselines: list[Shipped], file: Path) -> None:
    """Won races over steps, for each set of rules and kind of opponent."""
    from matplotlib.figure import Figure

    colours = ("#1f6fd6", "#f0a202", "#2a9d5c", "#c43d3d", "#7a4fc0", "#8a94a3")
    figure = Figure(figsize=(5.0 * len(baselines), 3.6), layout="constrained")
    axes = figure.subplots(1, len(baselines), squeeze=False)[0]
    for panel, baseline in zip(axes, baselines, strict=True):
        curves = read_evaluations(baseline.folder / "curve.csv")
        for k, kind in enumerate(dict.fromkeys(kind_of(cell) for cell in curves[0].scores[0])):
            for curve in curves:
                won = [
                    np.mean([score.won for cell, score in scores.items() if kind_of(cell) == kind])
                    for scores in curve.scores
                ]
                at = np.array(curve.steps) / 1e6
                label = kind if curve is curves[0] else None
                panel.plot(at, won, color=colours[k % len(colours)], label=label, linewidth=1.3)
        panel.axvline(
            int(baseline.training["steps"]) / 1e6, color="#444", linewidth=0.8, linestyle=":"
        )
        panel.set_title(f"{baseline.folder.name} (dotted: kept)", fontsize=10, loc="left")
        panel.set(
            xlabel=f"million {'steps' if baseline.drives else 'moves'}",
            ylabel="races won",
            ylim=(-0.02, 1.02),
        )
        panel.grid(color="#eef0f3")
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        panel.legend(frameon=False, fontsize=8)
    figure.savefig(file, dpi=100)


if __name__ == "__main__":
    main()
