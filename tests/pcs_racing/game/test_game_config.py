"""Rules of a game: defaults, consequences and bounds."""

import dataclasses
from enum import Enum

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, PAPER, load_archive, load_rules, make_game
from pcs_racing.base.errors import ConfigError
from pcs_racing.game.identity import check_same_game
from pcs_racing.race.config import Rules


def test_the_papers_game_and_the_contest():
    """Section V: a step to watch and four moves, of 8 s each; the lead at the end of 40 s is what
    counts.
    """
    assert Rules() == load_rules() == load_rules("paper") == load_rules({"rules": "paper"})
    assert (PAPER.moves, PAPER.step_seconds, PAPER.payoff) == (4, 8.0, "lead")
    assert PAPER.ends == (8.0, 16.0, 24.0, 32.0, 40.0)
    assert (CONTEST.moves, CONTEST.payoff, CONTEST.stay) == (6, "lead-at-crash", True)
    assert CONTEST.ends == (0.0, 2.0, 8.0, 16.0, 24.0, 32.0, 40.0)
    assert load_rules("contest", utility="win").payoff == "win"
    assert load_rules({"rules": "contest", "stay": False}) == dataclasses.replace(
        CONTEST, stay=False
    )


@pytest.mark.parametrize(("moves", "seconds"), [(1, 0.1), (4, 8.0), (2, 0.3), (9, 12.5)])
def test_the_race_lasts_for_a_step_more_than_there_are_moves(moves, seconds):
    rules = Rules(steps=(seconds,) * (moves + 1))
    assert rules.ends[0] == rules.step_seconds == pytest.approx(seconds)
    assert rules.for_game.duration == rules.ends[-1] == pytest.approx((moves + 1) * seconds)
    assert rules.for_game.ticks == rules.end_ticks[-1] == (moves + 1) * round(100 * seconds)


def test_the_steps_fill_the_duration_of_a_race():
    assert load_rules("contest", duration=20.0).ends == (0.0, 1.0, 4.0, 8.0, 12.0, 16.0, 20.0)
    assert Rules(laps=2).ends == (16.0, 32.0, 48.0, 64.0, 80.0)
    assert Rules(duration=6.0, steps=(2.0,) * 3).step_seconds == 2.0
    refused(
        r"^duration is 3\.7 s; a game of 4 moves lasts a multiple of 0\.5 s$",
        make_game,
        rules=load_rules("paper", duration=3.7),
    )


def test_each_rule_has_its_limits():
    for key, fine, wrong in [
        ("steps", ((0, 0.1), (600.0,) * 6), ((600.0,) * 7, (1.0,) * 102, (0.0, 0.0), "8", 8.0)),
        ("fault_penalty", (0.0, 1e6), (-0.1, 1e6 + 1.0, True, None, np.nan)),
        ("discount", (1e-6, 1.0), (0.0, 1.1, -1.0, False, np.nan)),
        ("stay", (True, False), (1, "yes", None)),
        ("mask_duplicates", (True, False), (None, 0)),
        ("utility", ("lead", "lead-at-crash", "win", None), ("score", 1, ["lead"])),
        ("epsilon", (0.5, (0.1, 0.9)), (0.0, -0.5, (0.5, 0.5), (), "far", np.inf)),
        ("characteristics", (None, ("speed",)), ("speed", 3)),
    ]:
        for value in fine:
            Rules(**{key: value})
        for value in wrong:
            refused(f"{key}", Rules, error=ConfigError, **{key: value})
    assert Rules(epsilon=(0.3,)).epsilon == 0.3
    hash(Rules(characteristics=["speed", "restraint"]))


def test_a_game_is_recognised_by_its_moves_observations_and_archive():
    archive = load_archive("default")
    own = make_game(None, archive, steps=(8.0,) * 3).identity
    assert own._replace(elements=()) == (
        (),
        ("aggressiveness +", "aggressiveness -", "restraint +", "restraint -"),
        (0.5,),
        "default",
        archive.content_hash,
        "paper",
        2,
    )
    assert own.elements[:3] + own.elements[-1:] == (
        "own_aggressiveness_0",
        "own_restraint_0",
        "opponent_aggressiveness_0",
        "step",
    )
    several = make_game(None, archive, steps=(8.0,) * 3, epsilon=(0.2, 0.6), stay=True)
    moves = (
        f"{axis} {sign} {step}"
        for step in (0.2, 0.6)
        for axis in archive.characteristics
        for sign in "+-"
    )
    assert several.identity[1:3] == (
        (*moves, "stay"),
        (0.2, 0.6),
    )
    # missing records are not compared
    unknown = own._replace(elements=(), moves=(), decisions=0)
    for mine, other in [
        (own, own),
        (own, own._replace(moves=(*own.moves, "stay"), rules="contest", archive="other")),
        (unknown, own),
        (own._replace(decisions=0), own._replace(decisions=3)),
        (own, own._replace(decisions=0)),
    ]:
        check_same_game(mine, other, "it")
    for change, message in [
        ({"decisions": 3}, "^it was made for games of 2 moves; the game has 3$"),
        (
            {"elements": own.elements[:4]},
            r"^it sees 19 \(own_.*_0 to step\); .* 4 \(own_.*, opponent_restraint_0\)$",
        ),
        (
            {"elements": ("a", *own.elements[1:])},
            "^it sees 'own_aggressiveness_0' at place 0; the game has 'a' there$",
        ),
        (
            {"moves": (*own.moves, "more")},
            r"^it values moves 4 \(.*\); the game has 5 \(.*, more\)$",
        ),
        (
            {"moves": own.moves[::-1]},
            "^it values moves 'aggressiveness .' at place 0; the game has 'restraint -'",
        ),
        ({"epsilon": (0.25, 1.0)}, "^it was made for moves of epsilon 0.5; the game has 0.25, 1$"),
        (
            {"archive": "b", "archive_sha256": 20 * "b"},
            r"'default' \(sha256 \w{12}\); .* 'b' \(sha256 b{12}\)$",
        ),
    ]:
        refused(message, check_same_game, own, own._replace(**change), "it")


ENDLESS: list = []
ENDLESS.append(ENDLESS)


def test_values_without_a_text_or_an_end_are_refused():
    for wrong in ({"epsilon": 10**5000}, {"steps": ENDLESS}):
        refused(f"^{next(iter(wrong))} ", Rules, **wrong, error=ConfigError)


def test_members_of_enumerations_are_stored_as_their_values():
    rules = Rules(utility=Enum("Utility", {"LEAD": "lead"}, type=str).LEAD)
    assert type(rules.utility) is str
