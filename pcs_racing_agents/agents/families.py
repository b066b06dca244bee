"""Families of opponents: which of them agents may learn against, and which are kept to test them.

An agent that learned against one kind of opponent may lose to another that it never met. So opponents are sorted into
families, and a family is either for training or for testing: never both. Studies show their gains by family.
"""

from dataclasses import dataclass

TRAINING, TEST = "training", "test"


@dataclass(frozen=True)
class OpponentFamily:
    """Opponents that drive alike."""

    name: str
    use: str  #: "training" or "test"
    members: tuple[str, ...]  #: Names in the zoo.
    what: str  #: What they have in common.


FAMILIES = (
    OpponentFamily("archive", TRAINING, ("never-switch",), "policies of the game's archive, kept for the whole race"),
    OpponentFamily("random moves", TRAINING, ("random-moves",), "policies of the archive, changed at random"),
    OpponentFamily("gap follower", TRAINING, ("gap-follower",), "follows the largest gap in its lidar scan"),
    OpponentFamily(
        "other lattice",
        TEST,
        ("random-policy",),
        "policies of the lattice planner that are not in the archive",
    ),
    OpponentFamily("lane switcher", TEST, ("lane-switcher",), "race line or overtaking lane"),
    OpponentFamily("pure pursuit", TEST, ("pure-pursuit",), "follows the race line and never overtakes"),
    OpponentFamily("trained driver", TEST, ("ppo-drive",), "a network that steers"),
    OpponentFamily(
        "switching agents",
        TEST,
        ("best-schedule", "best-lead-plan", "cfr-argmax", "response", "robust", "psro", "self-play", "ppo"),
        "agents that choose their moves",
    ),
)
"""All families; each opponent belongs to one."""


def family_of(opponent: str) -> OpponentFamily | None:
    """Return the family of an opponent by name, options left out; None if it belongs to none."""
    name = opponent.partition(":")[0]
    return next((family for family in FAMILIES if name in family.members), None)
