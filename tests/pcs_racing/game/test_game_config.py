"""Rules of a game: defaults, consequences and bounds."""

import dataclasses
from enum import Enum
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, PAPER, load_archive
from pcs_racing.base.errors import ConfigError
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.identity import check_same_game, game_identity


def test_the_papers_game_and_the_contest():
    """Section V: a step to watch and four moves, of 8 s each; the lead at the end of 40 s is what
    counts.
    """
    config = GameConfig()
    assert config == load_game_config() == load_game_config("paper") == load_game_config(PAPER)
    assert (config.race, config.moves, config.step_seconds) == (PAPER, 4, 8.0)
    assert config.horizon == 40.0
    assert (config.utility, config.fault_penalty, config.discount) == ("lead", 0.0, 1.0)
    assert (config.stay, config.mask_duplicates, config.characteristics) == (False, True, None)
    assert config.epsilon == 0.5
    config = load_game_config("contest")
    assert (config.race, config.utility, config.stay) == (CONTEST, "win", True)
    assert config.ends == (0.0, 2.0, 8.0, 16.0, 24.0, 32.0, 40.0)
    # One of the three lengths sets all of them.
    assert load_game_config("contest", moves=2).ends == (8.0, 16.0, 24.0)
    assert GameConfig(CONTEST, step_seconds=2.0).ends == (2.0, 4.0, 6.0, 8.0, 10.0)
    assert dataclasses.replace(config, stay=False, utility="lead-at-crash").stay is False


@pytest.mark.parametrize(("moves", "seconds"), [(1, 0.1), (4, 8.0), (2, 0.3), (9, 12.5)])
def test_the_race_lasts_for_a_step_more_than_there_are_moves_and_an_hour_at_most(moves, seconds):
    config = GameConfig(moves=moves, step_seconds=seconds)
    assert config.horizon == pytest.approx((moves + 1) * seconds)
    assert config.ends[0] == pytest.approx(seconds)
    assert config.race_rules.duration == config.horizon
    assert config.race_rules.ticks == config.end_ticks[-1] == (moves + 1) * round(100 * seconds)
    assert dataclasses.replace(config.race_rules, duration=PAPER.duration) == PAPER
    assert GameConfig(moves=5, step_seconds=600.0).horizon == 3600.0
    refused("6 moves of 600 s", GameConfig, moves=6, step_seconds=600.0, error=ConfigError)


def test_players_may_move_before_the_start():
    config = GameConfig(moves=3, first_steps=[0, 2])
    assert config.ends == (0.0, 2.0, 10.0, 18.0)
    assert config.horizon == 18.0
    for wrong, text in (
        ((2.0, 0.0), "0.1 to 600 s"),
        ((0.05,), "whole tenths"),
        (2.0, "list 0 or more"),
        ((1.0,) * 4, "may have 3 lengths"),
    ):
        refused(f"first_steps.*{text}", GameConfig, moves=3, first_steps=wrong, error=ConfigError)


def test_step_sizes_and_axes_are_kept_in_one_form_and_changed_by_name():
    assert GameConfig(epsilon=(0.2, 0.6)).epsilon == (0.2, 0.6)
    assert GameConfig(epsilon=(0.3,)).epsilon == 0.3
    config = GameConfig(characteristics=["speed", "restraint"])
    assert config.characteristics == ("speed", "restraint")
    hash(config)
    refused("'speed'", GameConfig, characteristics="speed", error=ConfigError)
    config = load_game_config(GameConfig(moves=2), step_seconds=1.0)
    assert (config.moves, config.step_seconds) == (2, 1.0)
    refused("unknown game setting 'move'", load_game_config, move=3, error=ConfigError)


def test_each_rule_has_its_limits():
    for key, fine, wrong in [
        ("moves", (1, 100), (0, 101, 2.0, True, "4")),
        ("step_seconds", (0.1, 600.0, 1), (0.0, 0.05, 0.15, 600.1, True, "8", np.nan)),
        ("fault_penalty", (0.0, 1e6), (-0.1, 1e6 + 1.0, True, None, np.nan)),
        ("discount", (1e-6, 1.0), (0.0, 1.1, -1.0, False, np.nan)),
        ("stay", (True, False, None), (1, "yes")),
        ("mask_duplicates", (True, False), (None, 0)),
        ("utility", ("lead", "lead-at-crash", "win", None), ("score", 1, ["lead"])),
        ("epsilon", (0.5, (0.1, 0.9)), (0.0, -0.5, (0.5, 0.5), (), "far", np.inf)),
        ("characteristics", (None, ("speed",)), ("speed", 3)),
        ("race", ("contest", PAPER), (3, None)),
    ]:
        more = (
            {"moves": 1}
            if key == "step_seconds"
            else {"step_seconds": 0.1}
            if key == "moves"
            else {}
        )
        for value in fine:
            GameConfig(**{key: value}, **more)
        for value in wrong:
            refused(f"{key}", GameConfig, error=ConfigError, **{key: value}, **more)


def test_a_game_is_recognised_by_its_moves_observations_and_archive():
    archive = load_archive("default")
    own = game_identity(SimpleNamespace(archive=archive, config=GameConfig(moves=2)))
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
    several = GameConfig(moves=2, epsilon=(0.2, 0.6), stay=True)
    moves = (
        f"{axis} {sign} {step}"
        for step in (0.2, 0.6)
        for axis in archive.characteristics
        for sign in "+-"
    )
    assert game_identity(SimpleNamespace(archive=archive, config=several))[1:3] == (
        (*moves, "stay"),
        (0.2, 0.6),
    )
    # missing records are not compared
    unknown = own._replace(elements=(), moves=(), decisions=0)
    for mine, other in [
        (own, own),
        (own, own._replace(moves=(*own.moves, "stay"), preset="contest", archive="other")),
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
    huge = 10**5000
    for wrong in ({"moves": huge}, {"epsilon": huge}, {"first_steps": ENDLESS}, {"race": ENDLESS}):
        refused(f"^{next(iter(wrong))} ", GameConfig, **wrong, error=ConfigError)


def test_members_of_enumerations_are_stored_as_their_values():
    config = GameConfig(utility=Enum("Utility", {"LEAD": "lead"}, type=str).LEAD)
    assert type(config.utility) is str
