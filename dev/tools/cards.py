"""Make the cards of the leaderboard: the agents of the zoo, and planners by name.

    python dev/tools/cards.py --pin           # once for a version: write the hashes of its inputs
    python dev/tools/cards.py --out out/cards

An interrupted run resumes. Every card is copied to a file in ``studies/bench_v3``.
"""

import argparse
import re
import shutil
import sys
from pathlib import Path

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.agents.zoo import SHIPPED, build
from pcs_racing_agents.benchmark.protocol import Protocol, load_protocol
from pcs_racing_agents.cli.main import main as run_command

REPOSITORY = Path(__file__).resolve().parents[2]
PROTOCOL = REPOSITORY / "pcs_racing_agents" / "data" / "configurations" / "protocol_bench_v3.yaml"
CARDS = REPOSITORY / "studies" / "bench_v3"
PLANNERS = (
    *("line-ppo", "lidar-ppo", "lattice", "lattice:early", "iterated-best-response"),
    *("alpha-racer", "ppo-drive", "gap-follower", "pure-pursuit", "spliner"),
)


def shipped_agents(protocol: Protocol) -> list[str]:
    """Return the agents of the zoo that are shipped for the game of a protocol."""
    found = []
    for name in SHIPPED:
        try:
            build(name, protocol.spec)
        except UnknownNameError as error:
            print(f"no card: {error}", file=sys.stderr)
        else:
            found.append(name)
    return found


def pin_hashes() -> None:
    """Write the hashes of the protocol's inputs into its file."""
    text = PROTOCOL.read_text(encoding="utf-8")
    head = re.split(r"^hashes:", text, flags=re.MULTILINE)[0]
    lines = "".join(f"- {line}\n" for line in load_protocol(str(PROTOCOL), hashes=()).hashes)
    write_atomically(PROTOCOL, f"{head}hashes:\n{lines}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("--pin", action="store_true", help="write the hashes of the protocol")
    parser.add_argument("--out", type=Path, help="folder of the races and cards")
    given = parser.parse_args()
    if given.pin:
        pin_hashes()
    if given.out is None:
        return 0
    agents = [*shipped_agents(load_protocol()), *PLANNERS]
    failed = run_command(["benchmark", "card", *agents, "--out", str(given.out)])
    CARDS.mkdir(exist_ok=True)
    for card in given.out.glob("*/card.json"):
        shutil.copyfile(card, CARDS / f"{card.parent.name}.json")
    return failed


if __name__ == "__main__":
    raise SystemExit(main())
