"""``python -m studies family``: the archive of ``line-ppo`` against the archive of the lattice."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive_files import load_archive
from pcs_racing_agents.base.tables import aligned, with_interval, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import output_folder
from pcs_racing_agents.policies.tuning import policy_text
from studies.circuits import real_circuits
from studies.judge import judge

LATTICE = Path(__file__).with_name("lattice_archive.txt")
"""Policies of the archive of the lattice, found by the same search: its champion, then the rest."""
CIRCUITS = ("Saltmere", "Vellindra")
"""Shipped circuits held out of both searches."""
REAL = ("Austin", "Monza")
"""Real circuits, held out of both searches."""
RACES, SMALL = (200, 8), (4, 2)
"""Races of the pair of champions, and of each pair of policies, on a circuit; the same in the small
study."""
HEAD = ("comparison", "races", "score [95 %]", "own crashes", "own crashes of the lattice")


def archive_policies(name: str) -> list[str]:
    """Return the policies of an archive as text: its last champion, then all policies."""
    archive = load_archive(name)
    if "champion_1" not in archive.settings:
        raise InputError(f"archive {name!r} has no champion; give one of policies far apart")
    champion = str(archive.settings["champion_1"])
    parts = [archive.policy(k) for k in range(len(archive))]
    return [champion, *(policy_text(one.planner, one.parameters) for one in parts)]


def compared(
    name: str, ours: Sequence[str], lattice: Sequence[str], tracks: Sequence[str], races: int
) -> tuple[str, ...]:
    """Return a line of the table: policies against policies of the lattice, and own crashes of
    both.
    """
    own, other = (
        judge(ours, lattice, tracks, races=races),
        judge(lattice, ours, tracks, races=races),
    )
    score = own.score()
    crashes = (f"{one.own_crash.mean():.3f}" for one in (own, other))
    return name, str(score.units), with_interval(score.mean, score.low, score.high), *crashes


@command("family", "python -m studies family --maps maps --out out/family")
def run(
    *,
    archive: Annotated[str, Option("archive of line-ppo: its name or folder", "A")] = "contest",
    maps: Annotated[
        Path | None, Option(f"folder of {' and '.join(REAL)} (default: without them)", "DIR")
    ] = None,
    small: Annotated[bool, Option("four races of the champions, three policies")] = False,
    out: Annotated[Path, Option("folder for family.csv", "DIR")],
) -> None:
    """Race champions and all policies of two archives against each other on held-out circuits."""
    tracks = (*CIRCUITS, *([] if maps is None else real_circuits(REAL, maps)))
    ours, lattice = archive_policies(archive), LATTICE.read_text(encoding="utf-8").split()
    folder, limit = output_folder(out), 4 if small else None
    pair, each = SMALL if small else RACES
    rows = [
        HEAD,
        compared("champions", ours[:1], lattice[:1], tracks, pair),
        compared("all policies", ours[1:limit], lattice[1:limit], tracks, each),
    ]
    print("\n".join(aligned(rows)))
    print(f"written: {write_csv(rows, folder / 'family.csv')}")
