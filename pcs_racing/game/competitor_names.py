"""Competitors by name: baselines, the policies of planners, and what other packages register.

A package that brings competitors names, in the entry point group ``pcs_racing.opponents``, a module with two functions:
``names(archive, config) -> list of str`` and ``make(text, archive, config) -> competitor``. A program may call
:func:`~pcs_racing.game.competitor_collections.register_competitors` instead.
"""

from pcs_racing.base.errors import UnknownNameError, choices
from pcs_racing.game.competitor import Competitor, PolicySet, RandomMoves, SameMove, is_model
from pcs_racing.game.competitor_collections import collections
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.registry import parse_policy, planner_names

NEVER_SWITCH = "never-switch"
RANDOM_MOVES = "random-moves"
ALWAYS = "always-"


def competitor_names(game: RaceGame) -> list[str]:
    """Return the names of all competitors for a game, sorted; the policies of planners have more forms."""
    names = {NEVER_SWITCH, RANDOM_MOVES, *planner_names()}
    names |= {ALWAYS + move for move in game.competitor_moves}
    for collection in collections():
        names |= {name for name in collection.names(game.archive, game.config) if not name.startswith(ALWAYS)}
    return sorted(names)


def make_competitor(text: str, game: RaceGame) -> Competitor:
    """Make a competitor for a game from its name.

    "never-switch": a policy of the archive, drawn for each game and kept; "random-moves"; "always-<move>"; a policy
    such as "lattice:pace=0.8"; or the name of a registered competitor, such as "cfr-argmax", with its options, or a
    model's file, "model.zip".
    """
    if text == RANDOM_MOVES:
        return RandomMoves()
    if text == NEVER_SWITCH:
        return PolicySet(text, tuple(game.archive.policy(i) for i in range(len(game.archive))))
    if text.startswith(ALWAYS):
        wanted = "".join(text.removeprefix(ALWAYS).split())
        for i, move in enumerate(game.competitor_moves):
            if "".join(move.split()) == wanted:
                return SameMove(f"{ALWAYS}{move}", i)
    name = text.partition(":")[0].strip()
    if name in planner_names():
        return parse_policy(text)
    # Last: what other packages bring is only imported for names that are not ours.
    for collection in collections():
        if is_model(text) or name in collection.names(game.archive, game.config):
            made: Competitor = collection.make(text, game.archive, game.config)
            return made
    raise UnknownNameError(f"opponent {text!r} is unknown; {choices(text, competitor_names(game))}")
