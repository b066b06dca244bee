"""Arms of the study: each is the full search with one thing changed back to the former search."""

from dataclasses import replace

from pcs_racing_agents.policies.tuning import TUNING_TRACKS, TuningConfig

HAND_SET = "lattice:early,pace=0.7,pace_behind=0.2"
FOUND = (
    "lattice:length=-1.672,max_curvature=-1.576,mean_curvature=-1.682,curvature_rate=-0.602,"
    "lateral_acceleration=-0.7704,braking=-1.352,similarity=-0.6951,progress=0.02182,"
    "deviation=-0.3872,walls=0.859,proximity=-1.234,overtaking=1.807,blocking=-0.6984,"
    "pace=0.9995,attack=0.2639,side_margin=0.2001,pace_behind=0.3348"
)
"""Winner of an earlier scalar search, within the former bounds."""
OTHERS = ("iterated-best-response", "gap-follower")
"""Planners of other families, one fast and one slow, in every pool."""
WEAK = ("pure-pursuit", "lane-switcher", "spliner", "disparity-extender")
"""Opponents by which the former search judged strength."""
FIELD = (
    "alpha-racer",
    "bimatrix-game",
    "disparity-extender",
    "follow-the-gap",
    "frenet-sampling",
    "gap-follower",
    "iterated-best-response",
    "lane-switcher",
    "mppi",
    "potential-field",
    "predictive-spliner",
    "pure-pursuit",
    "residual",
    "spliner",
    "stanley",
)
"""Planners with two parameters or more, besides the lattice."""
REAL = ("Austin", "Monza", "Sepang", "Zandvoort")
"""Real circuits, held out of all searches."""
ROUNDS, SEEDS = 5, 3

FULL = TuningConfig(
    against=(FOUND, HAND_SET, *OTHERS),
    tracks=TUNING_TRACKS,
    held_out=(),
    start=HAND_SET,
    generations=40,
)
ARMS = {
    "full": FULL,
    "races of 16 s": replace(FULL, duration=16.0),
    "weak opponents": replace(FULL, against=WEAK),
    "crashes cost nothing": replace(FULL, crash_limit=1.0),
    "pace fixed at 1": replace(FULL, fixed=("pace",), start=HAND_SET.replace("0.7", "1")),
}

PAPER = TuningConfig(
    against=(HAND_SET, "lattice:early", "lattice:early,pace=0.9", "lattice:early,pace=0.2"),
    preset="paper",
    tracks=("Tarnfjord", "Vellindra", "Kestrelheim"),
    held_out=(),
    start="lattice:early",
    fixed=("pace_behind",),
    generations=40,
)
"""Scalar search under the rules of the paper, on the circuits of the archive ``default``."""


def round_config(winner: str, seed: int, number: int) -> TuningConfig:
    """Return the search of a round against the last winner, which it starts from."""
    return replace(
        FULL,
        against=(winner, *OTHERS),
        start=winner,
        generations=16,
        seed=1000 * number + seed,
    )


def field_config(planner: str) -> TuningConfig:
    """Return the search of a planner of the field, from its default."""
    pool = (HAND_SET, "iterated-best-response", "stanley", "gap-follower")
    return TuningConfig(
        planner=planner, against=pool, held_out=(), generations=16, population=12, starts=1
    )
