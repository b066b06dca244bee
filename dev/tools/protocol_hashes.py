"""Write the hashes of everything that a protocol's results depend on into its file, when a new
version is made.

python dev/tools/protocol_hashes.py bench_v2
"""

import argparse
import re
from pathlib import Path

from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.benchmark.protocol import load_protocol


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("protocol", help="name of a shipped protocol")
    given = parser.parse_args()
    file: Path = shipped_configs("protocol")[given.protocol]
    kept = re.sub(r"\nhashes:\n(?:- .*\n)*", "\n", file.read_text(encoding="utf-8"))
    # Loading checks the hashes that a file states: the old ones must go before the new ones are
    # asked for.
    file.write_text(kept, encoding="utf-8")
    lines = [f"- {line}\n" for line in load_protocol(given.protocol).hashes]
    file.write_text(f"{kept}hashes:\n{''.join(lines)}", encoding="utf-8")
    print(f"{file}: {len(lines)} hashes")


if __name__ == "__main__":
    main()
