import pickle
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused
from same_arrays import assert_same

from pcs_racing import CONTEST, load_archive, load_rules, load_track, make_game
from pcs_racing.base.seeds import race_seeds, random_bits
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import Segment, get_characteristics, measure
from pcs_racing.game.moves import move
from pcs_racing.game.observation import (
    encode_observation,
    observation_elements,
)
from pcs_racing.game.reward import reward
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, put_games, take_games
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race.config import Rules
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import TIE_WITHIN, start_lines, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import empty_state


@pytest.fixture(scope="module")
def track():
    return load_track("Tarnfjord")


@pytest.fixture(scope="module")
def game(track):
    return make_game(track, steps=(2.0,) * 5)


def play(game: RaceGame, state: GameState, actions) -> GameState:
    for pair in actions:
        state = game.step(state, np.broadcast_to(pair, (state.games, 2)))
    return state


def crash(state: GameState, fault: tuple[int, int]) -> GameState:
    """The same moment, but car 0 and car 1 have just run into each other."""
    after = state.copy()
    after.race.crash[:] = 2
    after.race.fault[:] = fault
    return after


def test_a_game_is_the_sequence_of_races_that_its_rules_say(track):
    """Four moves, driven by hand with nothing but :func:`pcs_racing.game.advance`."""
    game = make_game(track)
    archive, axes = game.archive, get_characteristics(game.archive.characteristics)
    policy = np.array([3, 9])
    actions = [(0, 2), (1, 3), (2, 0), (0, 0)]
    # many, so that at least one game is played to its end, for any tuning
    lines = game.start_lines
    starts = Starts(lines, np.arange(len(lines)) % 2)
    ends = play(game, game.reset(np.arange(len(starts)), policies=policy, starts=starts), actions)
    whole = np.flatnonzero(~ends.race.crashed)[:1]
    assert len(whole), "every game ends in a crash"
    end = take_games(ends, whole)

    setup = game.setup
    assert setup.rules.duration == 40.0
    race = start_races(setup, starts.take(whole), end.race.seed)
    moves = {0: (0, 1), 1: (0, -1), 2: (1, 1), 3: (1, -1)}  # aggressiveness +, -, restraint +, -
    for step in range(5):
        if step > 0:
            made = zip(policy, actions[step - 1], strict=True)
            policy = np.array([move(archive, p, *moves[a], 0.5) for p, a in made])
        before = race.copy()
        advance(setup, race, archive.complete(archive.parameters[policy])[None], 800)
        seen = measure(Segment.between(before, race, 8.0), axes)[0]
        span = archive.ideal - archive.nadir
        np.testing.assert_array_equal(
            end.estimates[0, :, step], np.clip((seen - archive.nadir) / span, -1.0, 2.0)
        )
        np.testing.assert_array_equal(
            end.own[0, :, step], (archive.coordinates[policy] - archive.nadir) / span
        )
        assert end.leads[0, step] == race.lead[0]
    assert_same(end.race, race)
    np.testing.assert_array_equal(end.policy[0], policy)
    assert game.done(end).all()
    np.testing.assert_array_equal(game.reward(end)[0], [race.lead[0], -race.lead[0]])


def test_a_game_depends_on_neither_its_batch_nor_the_threads(game):
    keys = np.array([5, 6, 7, 8], np.uint64)
    together = play(game, game.reset(keys), [(0, 3), (2, 1)])
    for i, key in enumerate(keys):
        assert_same(play(game, game.reset([key]), [(0, 3), (2, 1)]), take_games(together, [i]))
    assert_same(game.reset(games=4, seed=3), take_games(game.reset(games=6, seed=3), [0, 1, 2, 3]))
    one = replace(game, threads=1)
    assert_same(play(game, game.reset(games=5), [(0, 1)]), play(one, one.reset(games=5), [(0, 1)]))


def test_players_may_move_before_the_start(track):
    """The first step takes no time, the second one 2 s; games of a batch that are at different
    moments keep to that.
    """
    game = make_game(track, steps=(0, 2, 3, 3))
    start = game.reset([4, 5])
    np.testing.assert_array_equal(start.race.tick, 0)
    np.testing.assert_array_equal(
        game.observation(start)[:, 0, :2], game.points[start.policy[:, 0]].astype(np.float32)
    )
    actions = [(0, 3), (2, 1), (1, 1)]
    ends = [play(game, start, actions[:k]) for k in range(4)]
    assert [end.race.tick[0] for end in ends] == [0, 200, 500, 800]
    np.testing.assert_array_equal(ends[1].policy, game.table[start.policy, np.array(actions[0])])
    assert game.done(ends[3]).all()
    # The second game is a move ahead of the first one.
    mixed = start.copy()
    put_games(mixed, [1], take_games(ends[1], [1]))
    after = play(game, mixed, actions[:1])
    assert_same(take_games(after, [0]), take_games(ends[1], [0]))
    assert after.race.tick.tolist() == [200, 500]
    np.testing.assert_array_equal(
        after.race.cars[1], play(game, take_games(ends[1], [1]), actions[:1]).race.cars[0]
    )


def test_what_is_drawn_for_a_game_is_drawn_for_each_thing_by_itself(track):
    """Line, side, both policies and the noise: no two depend on each other, for any keys."""
    game = make_game(track, steps=(0.1,) * 2)
    state = game.reset(np.arange(400, dtype=np.uint64), redraw=False)
    races, count = state.race, len(game.archive)
    at = np.round(races.frenet[:, 0, 0] / 2.0)
    side = races.frenet[:, 0, 1] > races.frenet[:, 1, 1]  # whether car 0 started on the left
    numbers = np.column_stack([at, side, state.policy, races.seed >> np.uint64(32)]).astype(float)
    together = np.corrcoef(np.argsort(np.argsort(numbers, axis=0), axis=0).T)
    assert np.abs(together - np.eye(5)).max() < 0.2
    assert 0.4 < side.mean() < 0.6
    assert len(np.unique(races.seed)) == 400
    begin = np.round((races.frenet[:, 0, 0] - races.progress[:, 0]) % track.length, 6)
    assert len(np.unique(begin % track.length)) == len(np.unique(game.start_lines)) > 30
    assert len(np.unique(state.policy, axis=0)) > 0.5 * min(400, count**2)
    for car in range(2):
        assert np.bincount(state.policy[:, car], minlength=count).max() < 4.0 * 400 / count + 5.0


def test_a_step_leaves_the_state_alone_and_games_that_are_over_stand_still(game):
    named = game.empty_state(empty_state(2, 3))._asdict()
    for name, array in {**named.pop("race")._asdict(), **named}.items():
        assert array.shape[0] == 2, name
        assert (array == (-1 if name == "leader" else 0)).all(), name
    state = game.reset(games=3)
    before = state.copy()
    game.step(state, np.zeros((3, 2), np.int64))
    assert_same(state, before)
    state = game.reset(games=3)
    halfway = crash(take_games(state, [0, 1]), (1, 0))
    mixed = state.copy()
    put_games(mixed, [0, 1], halfway)
    after = game.step(mixed, np.full((3, 2), 2))
    assert_same(take_games(after, [0, 1]), take_games(mixed, [0, 1]))
    np.testing.assert_array_equal(after.step, [0, 0, 1])
    assert_same(take_games(after, [2]), game.step(take_games(state, [2]), np.full((1, 2), 2)))


def test_a_game_by_laps_ends_in_the_step_of_the_last_lap(track):
    game = make_game(track, rules=load_rules("paper", laps=1))
    state = game.reset(games=8)
    while not game.done(state).all():
        state = game.step(state, np.zeros((8, 2), int))
    race, whole = state.race, np.flatnonzero(~state.race.crashed)
    assert len(whole)
    finish = race.finish_time[whole].min(axis=1)
    assert (np.abs(0.01 * race.tick[whole] - finish) < 0.02).all()
    ends = np.array(game.rules.ends)
    assert state.step[whole].tolist() == np.searchsorted(ends, finish).tolist()
    assert (state.step[whole] < game.rules.moves).all()
    first = race.finish_time[whole].argmin(axis=1)
    assert game.winner(state)[whole].tolist() == first.tolist()
    assert_same(game.step(state, np.zeros((8, 2), int)).race, race)


def test_any_moment_can_be_kept_and_continued_and_a_step_driven_without_a_state(game):
    middle = play(game, game.reset(games=3), [(0, 3)])
    end = play(game, middle, [(2, 2), (1, 0), (3, 3)])
    for kept in (middle.copy(), pickle.loads(pickle.dumps(middle))):
        assert_same(play(game, kept, [(2, 2), (1, 0), (3, 3)]), end)
    before = game.reset(games=6)
    after = game.step(before, np.full((6, 2), 2))
    races = before.race.copy()
    seen = game.drive(races, after.theta)
    assert_same(races, after.race)
    np.testing.assert_array_equal(seen, after.estimates[:, :, 1])
    end = play(game, after, [(0, 0)] * 3)
    np.testing.assert_array_equal(reward(game.rules, end.race, end.step), game.reward(end)[:, 0])


BOUNDS = {
    "own": ("range", -1.0, 2.0),
    "opponent": ("range", -1.0, 2.0),
    "lead": ("20 m", -5.0, 5.0),
}


def test_an_observation_holds_what_its_elements_name():
    """In the order, the units and the bounds of the elements, for both cars."""
    rng, axes = np.random.default_rng(0), get_characteristics(("aggressiveness", "restraint"))
    own, other = rng.uniform(-1.0, 2.0, (2, 3, 2, 4, 2))  # games, cars, steps, axes
    leads, over = rng.uniform(-200.0, 200.0, (3, 4)), np.array([1, 2, 3])
    handicaps = rng.uniform(0.0, 0.2, (3, 2))
    steps: list[dict[str, np.ndarray]] = [{}, {}]
    for car in range(2):
        lead = np.clip((1 - 2 * car) * leads / 20.0, -5.0, 5.0)
        for k in range(4):
            seen = (k <= over).astype(float)
            for word, numbers in (("own", own[:, car]), ("opponent", other[:, 1 - car])):
                for i, axis in enumerate(axes):
                    steps[car][f"{word}_{axis.name}_{k}"] = seen * numbers[:, k, i] + 0.0
            steps[car][f"lead_{k}"] = seen * lead[:, k] + 0.0
            steps[car][f"seen_{k}"] = seen
        steps[car]["step"] = over / 3.0
        steps[car]["handicap"] = handicaps[:, car]
    elements = observation_elements(axes, 3, handicaps=True)
    assert [element.name for element in elements] == list(steps[0])
    for element in elements:
        word = element.name.partition("_")[0]
        assert element[1:4] == BOUNDS.get(word, ("1", 0.0, 1.0)), element.name
    observation = encode_observation(own, other, leads, over, handicaps)
    expected = np.stack([np.stack(list(of_car.values()), axis=1) for of_car in steps], axis=1)
    np.testing.assert_array_equal(observation, expected.astype(np.float32))
    assert observation.dtype == np.float32
    assert not np.signbit(observation[observation == 0.0]).any()
    low, high = (np.array([getattr(one, end) for one in elements]) for end in ("low", "high"))
    assert ((observation >= low) & (observation <= high)).all()


def three_axes(archive: PolicyArchive, third: str) -> PolicyArchive:
    extra = np.random.default_rng(0).normal(size=(len(archive), 1))
    return PolicyArchive(
        "three",
        archive.planner,
        archive.parameter_names,
        archive.parameters,
        (*archive.characteristics, third),
        np.hstack([archive.coordinates, extra]),
    )


def test_several_step_sizes_and_three_characteristics(track):
    game = make_game(track, epsilon=(0.2, 0.6), stay=True, steps=(2.0,) * 3)
    assert game.offered == len(game.moves) == 9
    state = game.reset(games=2)
    after = game.step(state, np.array([[8, 4], [0, 8]]))
    assert after.policy[0, 0] == state.policy[0, 0]
    assert after.policy[1, 1] == state.policy[1, 1]
    assert after.policy[0, 1] == move(game.archive, int(state.policy[0, 1]), 0, 1, 0.6)
    assert after.policy[1, 0] == move(game.archive, int(state.policy[1, 0]), 0, 1, 0.2)
    game = make_game(track, three_axes(load_archive("default"), "smoothness"), steps=(2.0,) * 5)
    assert game.moves[4:] == ("smoothness +", "smoothness -", "stay")
    assert len(game.observation_elements) == 5 * 8 + 1
    end = play(game, game.reset(games=2), [(4, 5)] * 4)
    assert game.observation(end).shape == (2, 2, 41)
    assert game.done(end).all()
    narrow = replace(game.archive, ideal=np.quantile(game.archive.coordinates, 0.2, axis=0))
    points = make_game(track, narrow).points
    np.testing.assert_array_equal(points, np.clip(narrow.normalised, -1.0, 2.0))
    assert points.max() == 2.0 < narrow.normalised.max()
    two = make_game(
        track, game.archive, steps=(2.0,) * 5, characteristics=("aggressiveness", "restraint")
    )
    switches = ("aggressiveness +", "aggressiveness -", "restraint +", "restraint -")
    assert (two.moves, two.offered) == ((*switches, "stay"), 4)


WIN = {"rules": "contest", "utility": None, "fault_penalty": 0.0}


@pytest.mark.parametrize(
    ("settings", "fault", "expected"),
    [
        ({}, (1, 0), 0.0),
        ({"utility": "lead-at-crash"}, (1, 0), "lead"),
        ({"utility": "win"}, (1, 0), 0.0),  # the paper's rules name no loser
        ({"fault_penalty": 3.0}, (1, 0), -3.0),
        ({"fault_penalty": 3.0}, (0, 1), 3.0),
        ({"fault_penalty": 3.0}, (1, 1), 0.0),
        (WIN, (1, 0), -1.0),
        (WIN, (0, 1), 1.0),
        ({**WIN, "discount": 0.5}, (0, 1), 0.25),
    ],
)
def test_what_a_crash_is_worth(track, settings, fault, expected):
    game = make_game(track, steps=(2.0,) * 5, **settings)
    state = play(game, game.reset(1), [(0, 0), (0, 0)])
    np.testing.assert_array_equal(game.reward(state), 0.0)  # not over yet
    end = crash(state, fault)
    assert game.done(end).all()
    first = state.race.lead[0] if expected == "lead" else expected
    np.testing.assert_array_equal(game.reward(end), [[first, -first]])


def test_who_leads_at_the_end_wins(track):
    game = make_game(track, steps=(2.0,) * 2, utility="win")
    end = game.step(game.reset(games=6, seed=2), np.zeros((6, 2), np.int64))
    over = game.done(end) & ~end.race.crashed
    ahead = np.where(np.abs(end.race.lead) > TIE_WITHIN, np.sign(end.race.lead), 0)
    assert (ahead[over] != 0).any()
    np.testing.assert_array_equal(
        game.winner(end)[over], np.select([ahead > 0, ahead < 0], [0, 1], -1)[over]
    )
    np.testing.assert_array_equal(game.reward(end)[over, 0], ahead[over])
    assert (game.winner(game.reset(games=2)) == -1).all()


def test_games_that_end_while_watching_are_drawn_again(track):
    game = make_game(track, rules=replace(CONTEST, steering_noise=0.08), steps=(4.0,) * 5)
    once = game.reset(games=40, redraw=False)
    again = game.reset(games=40)
    crashed = once.race.crashed
    assert crashed.any(), "choose more noise: this test needs crashes"
    assert again.race.crashed.sum() < crashed.sum()
    assert_same(
        take_games(again, np.flatnonzero(~crashed)), take_games(once, np.flatnonzero(~crashed))
    )
    bad = int(np.flatnonzero(crashed)[0])
    assert_same(game.reset(games=40).copy(), again)
    key = race_seeds(0, 40)[bad : bad + 1]
    assert_same(game.reset(key), take_games(again, [bad]))
    grid = game.grid(key, again.race.seed[[bad]])  # of the draw that was kept
    advance(game.setup, grid, again.theta[[bad]], 400)
    assert_same(grid, take_games(again, [bad]).race)


def test_drivers_from_outside_the_archive(track):
    """Car 1 may be any policy, even of another planner; its moves do nothing then."""
    game = RaceGame(track, load_archive("default"), Rules(steps=(2.0,) * 5), PURE_PURSUIT)
    opponent = PURE_PURSUIT.policy()
    state = game.reset([1, 2], opponents=opponent)
    np.testing.assert_array_equal(state.policy[:, 1], -1)
    a, b = (game.step(state, np.array([[0, move], [0, move]])) for move in (0, 3))
    assert_same(a, b)
    np.testing.assert_array_equal(a.own[:, 1], a.estimates[:, 1])
    assert (a.policy[:, 0] >= 0).all()
    refused(r"game 0: car 1 .*'pure-pursuit'", game.reset, 1)
    refused(r"game 0: the opponent .*'lattice'", game.reset, 1, opponents=LATTICE.policy())

    mixed = make_game(track, steps=(2.0,) * 5)
    wild = mixed.archive.explored_policy(5)
    state = mixed.reset([1, 2], opponents=[None, wild])
    np.testing.assert_array_equal(state.theta[1, 1], wild.parameters)
    assert state.policy[0, 1] >= 0
    assert state.policy[1, 1] == -1
    assert_same(take_games(state, [0]), mixed.reset(1))


def test_drivers_from_outside_in_either_car(track):
    """Two drivers from outside: the game is the race that run_races drives, with their seats and
    its noise.
    """
    config = replace(CONTEST, steps=(0.8,) * 5)
    archive = load_archive("default")
    game = RaceGame(track, archive, config, "lattice", ego_planner=PURE_PURSUIT)
    egos, wild = (
        [PURE_PURSUIT.policy({"pace": pace}) for pace in (0.2, 0.9)],
        archive.explored_policy(5),
    )
    starts = Starts(start_lines(track, game.setup.rules, 3)[:2], np.array([0, 1]))
    state = game.reset([1, 2], starts=starts, egos=egos, opponents=wild)
    assert (state.policy == -1).all()
    np.testing.assert_array_equal(state.own, state.estimates)
    state = play(game, state, [(0, 0), (3, 1), (2, 2), (1, 0)])

    race = start_races(game.setup, starts, state.race.seed)
    theta = np.stack(
        [pad_parameters(cars, game.setup.theta_size) for cars in (egos, [wild, wild])], axis=1
    )
    advance(game.setup, race, theta, 400)
    assert_same(state.race, race)

    # Fewer parameters than the archive's policies have.
    small = RaceGame(track, archive, config, PURE_PURSUIT, ego_planner=PURE_PURSUIT)
    end = play(small, small.reset([1], egos=egos[0], opponents=egos[1]), [(0, 0)] * 4)
    assert small.done(end).all()

    refused(r"game 0: car 0 .*'pure-pursuit'.* egos", game.reset, 1, opponents=wild)
    refused(r"1 games .*2 egos", game.reset, 1, egos=egos)
    refused(r"game 0: the ego .*'lattice'", game.reset, 1, egos=wild)


def test_masks_and_the_table_of_an_observation(track, game):
    free = make_game(track, steps=(2.0,) * 5, mask_duplicates=False)
    assert free.action_mask(free.reset(games=2)).all()
    strict = make_game(track, steps=(2.0,) * 5)
    state = strict.reset(games=50, redraw=False)
    mask = strict.action_mask(state)
    assert mask[..., 0].all()  # so there always is a move
    staying = make_game(track, stay=True)
    assert staying.action_mask(staying.reset(games=50))[..., -1].all()
    for allowed, policy in zip(mask.reshape(-1, 4), state.policy.reshape(-1), strict=True):
        there = strict.table[policy, : strict.offered]
        assert sorted(there[allowed]) == sorted(set(there))
    elements = observation_elements(game.characteristics, 4)
    assert elements == game.observation_elements


def test_impossible_resets_and_actions_are_one_clear_error(game):
    for arguments, message in [
        ({"seeds": [-1]}, "seeds are"),
        ({"seeds": [0.5]}, "seeds are"),
        ({"seeds": [1], "games": 1}, "give one of the two"),
        ({"games": -1}, "games is -1"),
        ({"seed": "x"}, "seed is 'x'"),
        ({"policies": [0, 99]}, "game 0, car 1: policy 99"),
        ({"policies": [0, -2]}, "policy -2"),
        ({"policies": [0.0, 1.0]}, "type float64"),
        ({"games": 2, "policies": [[0, 1]]}, r"policies has shape \(1, 2\)"),
        (
            {"starts": Starts(np.array([20.0, 20.0, 21.0]), np.array([0, 1, 0]))},
            "1 games but 3 starts",
        ),
        ({"starts": Starts(np.array([1e6]), np.array([0]))}, "race 0: the start line"),
        ({"games": 2, "opponents": [None]}, "2 games but 1 opponents"),
        ({"opponents": ["fast"]}, r"game 0: the opponent .*'fast'"),
    ]:
        refused(message, game.reset, **arguments)
    for actions, message in [
        ([[0, 4]], r"game 0, car 1: move 4 .*aggressiveness"),
        ([[-1, 0]], "game 0, car 0: move -1"),
        ([[0.0, 1.0]], "type float64"),
        ([[np.nan, 1.0]], "type float64"),
        ([0, 1], r"shape \(2,\)"),
        ([[True, False]], "type bool"),
    ]:
        refused(message, game.step, game.reset(1), actions)


MASK = 2**64 - 1


def splitmix64(x: int) -> int:
    """The finaliser of Steele and others (2014), in whole numbers of any size."""
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9 & MASK
    x = (x ^ (x >> 27)) * 0x94D049BB133111EB & MASK
    return x ^ (x >> 31)


def test_the_bits_of_a_game_are_a_hash_of_its_key_and_of_the_attempt():
    keys = [0, 1, 2**63 + 5]
    for attempt in (0, 3):
        steps = [(5 * attempt + 1 + i) * 0x9E3779B97F4A7C15 for i in range(5)]
        expected = [[splitmix64((splitmix64(key) + step) & MASK) for step in steps] for key in keys]
        assert random_bits(np.array(keys, np.uint64), attempt).tolist() == expected
