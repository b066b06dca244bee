"""What the PPO baselines are worth on fresh starts, and how they learned.

    python benchmarks/ppo_baselines.py
    python benchmarks/ppo_baselines.py --egos 20 --variants 20 --lines 5 --picture docs/images/ppo_curves.png

Every baseline that is shipped (or given with ``--policies``) races opponents on circuits that it learned on and on
others: start policies x opponents x start lines x both sides, from start lines and with noise that no training saw.
Agents that make moves are compared with "never-switch" and with the best of the constant moves in the same races.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcs_racing import load_track, make_game
from pcs_racing_agents import make
from pcs_racing_agents.approximator.network_files import read_network, shipped_folder
from pcs_racing_agents.ppo.curves import read_curve
from pcs_racing_agents.ppo.driver import load_driver, read_driver
from pcs_racing_agents.ppo.scores import Cell
from pcs_racing_agents.strategies import as_competitor
from pcs_racing_agents.tournament.cells import play_cell
from pcs_racing_agents.tournament.statistics import clustered_mean, compare

SEED = 20_011  # of these races, and of nothing else
UNSEEN = ("Larkmoor", "Quillburg", "Saltmere", "Tarnfjord", "Kestrelheim", "Brackwater", "Pipkin")
DRIVE_RULES = (("paper", "default"), ("contest", "contest"))


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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policies", type=Path, nargs="+", help="folders that 'pcs-racing ppo' wrote")
    parser.add_argument("--egos", type=int, default=10, help="start policies of an agent that makes moves")
    parser.add_argument("--variants", type=int, default=20, help="opponents of each kind")
    parser.add_argument("--lines", type=int, default=5, help="start lines")
    parser.add_argument("--unseen", type=int, default=2, help="circuits that were not learned on")
    parser.add_argument("--picture", type=Path, help="draw the learning curves into this file")
    arguments = parser.parse_args()
    baselines = [look_at(folder) for folder in arguments.policies or sorted(shipped_folder().glob("*"))]
    for baseline in filter(None, baselines):
        tell(baseline)
        unseen = [name for name in UNSEEN if name not in baseline.tracks][: arguments.unseen]
        for track in [*baseline.tracks, *unseen]:
            where = f"{track}{'' if track in baseline.tracks else ' (unseen)'}"
            (race_driver if baseline.drives else race_agent)(baseline, track, where, arguments)
    if arguments.picture:
        draw([baseline for baseline in baselines if baseline], arguments.picture)
        print(arguments.picture)


def look_at(folder: Path) -> Shipped | None:
    """What a folder holds, if it is one of our baselines."""
    if (folder / "driver.yaml").is_file():
        return Shipped(folder, True, read_driver(folder)[1]["training"])
    if not (folder / "manifest.yaml").is_file():
        return None
    network = read_network(folder)
    return Shipped(folder, False, dict(network.training)) if network.target == "ppo" else None


def tell(baseline: Shipped) -> None:
    training = baseline.training
    print(
        f"\n{baseline.folder.name}: seed {training['seed']} of {training['setting_seeds']}, kept after "
        f"{training['steps']} of {training['steps_of_all_seeds']} steps\n"
        f"{'circuit':22} {'rules':8} {'against':24} {'races':>6} {'score':>6} {'+-':>6} {'won':>6} {'lost':>6} "
        f"{'crashed':>8} {'at fault':>9}"
    )


def line(where: str, rules: str, against: str, cell) -> str:
    """Score of a cell with a standard error that knows which races share an opponent or a start policy."""
    matches = cell.matches
    egos, opponents = cell.units.variants.T
    clusters = [labels for labels in (egos, opponents, cell.units.line) if len(set(labels.tolist())) > 1]
    error = clustered_mean(cell.score, *clusters[:2]).se
    return (
        f"{where:22} {rules:8} {against:24} {len(cell.score):6} {cell.score.mean():6.3f} {error:6.3f} "
        f"{np.mean(matches.winner == 0):6.1%} {np.mean(matches.winner == 1):6.1%} "
        f"{np.mean(matches.crash.any(axis=1)):8.1%} {np.mean(matches.fault[:, 0] == 1):9.1%}"
    )


def race_driver(baseline: Shipped, track: str, where: str, arguments: argparse.Namespace) -> None:
    """A driver against policies that never change, under each set of rules."""
    driver = as_competitor(load_driver(baseline.folder).policy())
    draws = {"egos": 1, "opponents": arguments.variants, "lines": arguments.lines, "seed": SEED}
    for rules, archive in DRIVE_RULES:
        game = make_game(load_track(track), archive, rules)
        for name in ("never-switch", "lane-switcher"):
            opponent = make(name, archive=archive, race=rules)
            print(line(where, rules, name, play_cell(game, driver, opponent, **draws)), flush=True)


def race_agent(baseline: Shipped, track: str, where: str, arguments: argparse.Namespace) -> None:
    """An agent against several kinds of opponents, and what it gains over agents that never look."""
    training = baseline.training
    archive, rules = str(training["setting_archive"]), str(training["setting_race"])
    world = {"archive": archive, "race": rules}
    game = make_game(load_track(track), archive, rules)
    agent = make("ppo", network=baseline.folder, **world)
    blind = {f"always-{''.join(name.split())}" for name in game.move_names if name != "stay"}
    egos = {name: make(name, **world) for name in ("never-switch", *sorted(blind))}
    draws = {"egos": arguments.egos, "opponents": arguments.variants, "lines": arguments.lines, "seed": SEED}
    for name in ("never-switch", "random-moves", "lane-switcher"):
        opponent = make(name, **world)
        cell = play_cell(game, agent, opponent, **draws)
        print(line(where, rules, name, cell), flush=True)
        others = {key: play_cell(game, ego, opponent, **draws).score for key, ego in egos.items()}
        best = max(blind, key=lambda key: others[key].mean())
        for key in ("never-switch", best):
            gain = compare(cell.score, others[key], *cell.units.variants.T)
            print(f"{'':31} over {key:32} {gain.difference:+.3f} [{gain.low:+.3f}, {gain.high:+.3f}]", flush=True)


def kind_of(cell: Cell) -> str:
    """Rules and opponent, its variants taken together."""
    return f"{cell.race}, {cell.opponent.partition(':')[0]}"


def draw(baselines: list[Shipped], file: Path) -> None:
    """Won races over steps, for each set of rules and kind of opponent."""
    from matplotlib.figure import Figure

    colours = ("#1f6fd6", "#f0a202", "#2a9d5c", "#c43d3d", "#7a4fc0", "#8a94a3")
    figure = Figure(figsize=(5.0 * len(baselines), 3.6), layout="constrained")
    axes = figure.subplots(1, len(baselines), squeeze=False)[0]
    for panel, baseline in zip(axes, baselines, strict=True):
        curves = read_curve(baseline.folder / "curve.csv")
        for k, kind in enumerate(dict.fromkeys(kind_of(cell) for cell in curves[0].scores[0])):
            for curve in curves:
                won = [
                    np.mean([score.won for cell, score in scores.items() if kind_of(cell) == kind])
                    for scores in curve.scores
                ]
                at = np.array(curve.steps) / 1e6
                label = kind if curve is curves[0] else None
                panel.plot(at, won, color=colours[k % len(colours)], label=label, linewidth=1.3)
        panel.axvline(int(baseline.training["steps"]) / 1e6, color="#444", linewidth=0.8, linestyle=":")
        panel.set_title(baseline.folder.name, fontsize=10, loc="left")
        panel.set(xlabel=f"million {'steps' if baseline.drives else 'moves'}", ylabel="races won", ylim=(-0.02, 1.02))
        panel.grid(color="#eef0f3")
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        panel.legend(frameon=False, fontsize=8)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main()
