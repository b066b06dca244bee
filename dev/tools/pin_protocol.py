"""Write the hashes of its inputs into the file of the shipped protocol, once for a version.

python dev/tools/pin_protocol.py
"""

from pathlib import Path

import yaml

from pcs_racing.base.files import write_atomically
from pcs_racing_agents.base.configurations import load_config, shipped_configs
from pcs_racing_agents.tournament.protocol import ProtocolConfig, load_protocol


def pin_hashes(file: Path) -> None:
    """Write the hashes of this installation into a protocol's file."""
    config = load_config("protocol", ProtocolConfig(), file, hashes=())
    hashes = yaml.safe_dump({"hashes": list(load_protocol(config, []).hashes)})
    head = file.read_text(encoding="utf-8").partition("hashes:\n")[0]
    write_atomically(file, head + hashes)


if __name__ == "__main__":
    pin_hashes(shipped_configs("protocol")["bench-v4"])
