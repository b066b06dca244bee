"""The agent that only remembers: what it replies to what it saw, and the table that it looks it up
in.
"""

import numpy as np
import pytest
from made_up_behaviours import made_up_behaviours

from pcs_racing import InputError, PolicyArchive, UnknownNameError, make_game
from pcs_racing.base.artifacts import MANIFEST
from pcs_racing.envs.match import MatchVectorEnv
from pcs_racing_agents.agents import make_game_spec
from studies.matches.behaviours import Behaviours, load_behaviours, save_behaviours
from studies.matches.remember import MatchAgent, remember

POLICIES = 3  # the rivals that are made up; policy 3 is the best one on average


def observed(spec, *races, left=1):
    """What a player knows of a match: (own policy, opponent's first coordinate) of each race that
    is over.
    """
    blocks = []
    for own, coordinate in races:
        blocks += [*spec.archive.normalised[own], coordinate, 0.0, 0.0, 0.0, 1.0]
    blocks += [0.0] * (7 * left)
    return np.array([*blocks, left / (len(races) + left), 1.0], np.float32)


@pytest.fixture(scope="module")
def agent(spec) -> MatchAgent:
    return remember(spec, table=made_up_behaviours(spec))


def test_without_knowledge_it_drives_the_best_fixed_policy(agent, spec):
    assert agent.choose(observed(spec, left=3)[None]).tolist() == [POLICIES]
    assert agent.choice.table.best_fixed == POLICIES


@pytest.mark.parametrize("rival", range(POLICIES))
@pytest.mark.parametrize("reply", ["likely", "nearest"])
def test_it_replies_to_the_behaviour_that_it_saw(spec, rival, reply):
    agent = remember(spec, table=made_up_behaviours(spec), reply=reply)
    coordinate = rival / 2.0 + 0.1
    assert agent.choose(observed(spec, (POLICIES, coordinate), left=2)[None]).tolist() == [rival]


def test_between_two_behaviours_the_likely_reply_is_to_both(spec):
    table = made_up_behaviours(spec)
    half = observed(spec, (3, 0.25), left=2)[None]
    # .65 against both halves; the first of two
    assert remember(spec, table=table).choose(half).tolist() == [0]
    safe = np.array(table.scores)
    safe[4, :2] = 0.7
    cautious = Behaviours(table.game, table.opponents, safe, table.seen, table.covariance)
    assert remember(spec, table=cautious).choose(half).tolist() == [4]
    slightly = observed(spec, (3, 0.24), left=2)[None]
    assert remember(spec, table=cautious, reply="nearest").choose(slightly).tolist() == [0]


def test_later_races_count_as_the_earlier_ones(agent, spec):
    """One odd race is outweighed by two others."""
    seen = observed(spec, (3, 0.3), (0, 1.0), (0, 1.0))[None]
    assert agent.choose(seen).tolist() == [2]


def test_what_is_seen_depends_on_the_own_policy(spec):
    """Beside a fast car everybody looks slow: a behaviour is compared with what the own policy
    sees.
    """
    table = made_up_behaviours(spec)
    seen = np.array(table.seen)
    seen[0, :, 0] = [-1.0, 0.0, 0.5]
    moved = Behaviours(table.game, table.opponents, table.scores, seen, table.covariance)
    agent = remember(spec, table=moved)
    matches = np.stack([observed(spec, (own, 0.5), left=2) for own in (0, 1)])
    assert agent.choose(matches).tolist() == [2, 1]


def test_a_batch_is_many_matches(agent, spec):
    rows = np.stack(
        [observed(spec, (own, value), left=2) for own in range(4) for value in (0.0, 0.4, 1.1)]
    )
    np.testing.assert_array_equal(agent.choose(rows), [agent.choose(row[None])[0] for row in rows])
    assert len(set(agent.choose(rows).tolist())) == 3


def test_in_a_game_of_its_own_it_moves_to_the_best_fixed_policy(agent, game):
    state = game.reset(games=6, seed=2)
    for _ in range(game.config.moves):
        moves = agent.act(game.observation(state)[:, 0])
        state = game.apply(state, np.column_stack([moves, moves]))
    assert (state.policy[~state.race.crashed, 0] == POLICIES).any()


def test_it_is_an_opponent_of_a_match(spec, oval):
    envs = MatchVectorEnv(
        4,
        track=oval,
        archive=spec.archive,
        race=spec.config,
        opponent=remember(spec, table=table(spec)),
    )
    envs.reset(seed=1)
    assert (envs.step(np.array([0, 5, 8, 11]))[4]["race"] == 1).all()
    assert envs.batch.played.policy[:, 1].tolist() == [POLICIES] * 4
    envs.step(np.array([0, 5, 8, 11]))
    assert set(envs.batch.played.policy[:, 1].tolist()) <= {0, 1, 2}


def table(spec) -> Behaviours:
    return made_up_behaviours(spec)


def test_its_table_may_be_a_folder(spec, tmp_path):
    folder = save_behaviours(table(spec), tmp_path / "behaviours")
    agent = remember(spec, table=folder)
    assert agent.facts["pool"] == "3 opponents"
    assert agent.content_hash == remember(spec, table=table(spec)).content_hash
    assert agent.content_hash != remember(spec, table=table(spec), reply="nearest").content_hash
    with pytest.raises(UnknownNameError, match="table of behaviours"):
        remember(spec)
    with pytest.raises(InputError, match="'often'"):
        remember(spec, table=folder, reply="often")


def test_a_table_is_shipped_for_the_contest():
    assert len(remember(make_game_spec("contest", "contest")).choice.table.opponents) == 16


def test_a_table_of_another_archive_is_refused(spec, archive, tmp_path):
    folder = save_behaviours(table(spec), tmp_path / "behaviours")
    values = {
        key: getattr(archive, key)
        for key in ("name", "planner", "parameter_names", "characteristics")
    }
    other = PolicyArchive(
        **values, parameters=archive.parameters[:5], coordinates=archive.coordinates[:5]
    )
    with pytest.raises(InputError, match="archive 'toy'"):
        remember(make_game_spec(other, spec.config), table=folder)
    with pytest.raises(InputError, match="games of 4 moves"):
        remember(
            make_game_spec(archive, make_game("Pipkin", archive, moves=2).config), table=folder
        )


def test_a_table_is_kept(spec, tmp_path):
    made = table(spec)
    kept = load_behaviours(save_behaviours(made, tmp_path / "kept"))
    assert (kept.game, kept.opponents) == (made.game, made.opponents)
    for name in ("scores", "seen", "covariance"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(made, name))
    assert load_behaviours(made) is made


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda text: text.replace("- rival 1\n", ""), "2 opponents"),
        (lambda text: text.replace("sha256: ", "sha256: 0"), "digest"),
        (lambda text: text.replace("moves: 4", "moves: many"), "moves is 'many'"),
        (lambda text: text.replace("training: {}", "training: 5"), "training is 5"),
        (lambda text: text.replace("archive: toy", "archive: 7"), "archive is 7"),
    ],
)
def test_a_damaged_table_is_one_clear_error(spec, tmp_path, harm, message):
    folder = save_behaviours(table(spec), tmp_path / "kept")
    manifest = (folder / MANIFEST).read_text(encoding="utf-8")
    harmed = harm(manifest)
    assert harmed != manifest
    (folder / MANIFEST).write_text(harmed, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_behaviours(folder)


def test_impossible_tables_are_refused(spec):
    made = table(spec)
    for change in (
        {"scores": made.scores[:2]},
        {"seen": np.full_like(made.seen, np.nan)},
        {"covariance": np.zeros_like(made.covariance)},
        {"opponents": ("one",)},
    ):
        arguments = {
            name: getattr(made, name)
            for name in ("game", "opponents", "scores", "seen", "covariance")
        }
        with pytest.raises(InputError):
            Behaviours(**{**arguments, **change})
