"""``python -m pcs_racing_agents``: the command ``pcs-racing``."""

import sys

from pcs_racing_agents.cli.main import main

sys.exit(main())
