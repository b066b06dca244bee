"""The environment at the level of strategy: the moves of one car for an agent, an opponent in the other."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.envs.arguments import Declared
from pcs_racing.envs.filmed import FilmedEnv
from pcs_racing.envs.game_batch import GameBatch, GameOptions
from pcs_racing.envs.opponents import Opponent
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.game.config import GameConfig
from pcs_racing.game.rules import RaceGame


class DuelEnv(FilmedEnv):
    """Play the game of moves in Policy Characteristic Space against an opponent.

    ## Description

    The view that the player of car 0 has of :class:`pcs_racing.envs.head_to_head.HeadToHeadEnv`. Both cars are driven
    by a motion planner with a policy from an archive. The players watch one step of 8 s, then make 4 moves; each asks
    for a bit more or less of one characteristic, the car goes on with the nearest policy of the archive, and 8 s are
    driven.

    ## Action Space

    ``Discrete(2 G)`` for G characteristics: move ``2 i`` asks for more of characteristic ``i``, move ``2 i + 1`` for
    less. With the default archive: 0 ``aggressiveness +``, 1 ``aggressiveness -``, 2 ``restraint +``, 3 ``restraint
    -``; with ``stay`` the last move keeps the policy. ``action_masks()`` and ``info["action_mask"]`` say which may be
    made.

    ## Observation Space

    ``Box(float32)`` with ``(moves + 1) (2 G + 2) + 1`` elements, 31 by default; ``env.unwrapped.elements`` holds name,
    unit, bounds and meaning of each. Step 0 is the one in which the players only watch, step ``k`` follows move ``k``.
    "Range" means that 0 is the archive's smallest and 1 its largest value.

    | Index | Element | Unit | Low | High |
    |---|---|---|---|---|
    | 6k | own_aggressiveness_k | range | -1 | 2 |
    | 6k + 1 | own_restraint_k | range | -1 | 2 |
    | 6k + 2 | opponent_aggressiveness_k | range | -1 | 2 |
    | 6k + 3 | opponent_restraint_k | range | -1 | 2 |
    | 6k + 4 | lead_k | 20 m | -5 | 5 |
    | 6k + 5 | seen_k | 1 | 0 | 1 |
    | 30 | step | 1 | 0 | 1 |

    ## Rewards

    0 until the game ends; then the utility: by default the own lead in m, and 0 after a crash. ``utility``,
    ``fault_penalty`` and ``discount`` change it (:class:`pcs_racing.game.config.GameConfig`).

    ## Starting State

    Start line, side, both policies, the steering noise (none in "paper") and the opponent are drawn from the
    environment's generator; then the first step is driven. Should it end in a crash, the game is drawn again.

    ``reset(options=...)`` takes ``policies`` (two indices of the archive; -1 draws one), ``start`` (arc length of the
    line in m, and side: 0 puts car 0 on the left or in front), ``obstacles`` (boxes: x, y, heading, length and width in
    m and rad, shape (K, 5)), ``opponent`` and ``track``, which replace the arguments from then on, and ``state``, what
    ``get_state()`` returned. Others are refused.

    ## Episode End

    *Terminated* after the last move has been driven, or when a car crashes; never truncated.

    ## Information

    Numbers: ``time`` (s), ``progress`` and ``lead`` (m), ``crash`` and ``opponent_crash``
    (:class:`pcs_racing.envs.infos.Crash`: 0 none, 1 wall, 2 car), ``fault`` (1 if the own car is to blame for a crash),
    ``overtakes``, ``result`` (:class:`pcs_racing.envs.infos.Result`: 0 running, 1 win, 2 tie, 3 loss, 4 a crash that
    pays nobody), ``opponent`` (index of the game's opponent), ``move`` and ``opponent_move`` (-1 before the first, and
    for a driver), ``policy`` (index in the archive), ``action_mask``, ``laps`` (complete ones, from one crossing of the
    line s = 0 to the next), ``lap_time`` and ``best_lap`` (s, of the last and the shortest of them; -1 if there is
    none), and where episodes differ in it, ``track`` (its number) and what ``randomize`` drew.
    ``env.unwrapped.metadata["codes"]`` holds the words of all codes; ``env.unwrapped.outcome()`` is the info in words.

    ## Arguments

    Parameters
    ----------
    track : str, Path or Track, a list of these, "random" or RandomCircuits
        A circuit's name, its folder, or a track. Of a list one is drawn for each episode; with "random" each episode is
        driven on a newly generated circuit, or as :class:`pcs_racing.race.random_circuits.RandomCircuits` says.
    archive : str, Path or PolicyArchive
    opponent : str, competitor, or list
        By name: "random-moves"; "never-switch" (a policy of the archive, drawn for each game and kept);
        "always-<move>", for instance "always-aggressiveness +"; a driver such as "lane-switcher:3", which makes no
        moves; or any agent of :mod:`pcs_racing_agents`, such as "cfr-argmax". As an object: an agent, a driver or a
        policy; a model of Stable-Baselines3 or any object with its ``predict(observation, state, episode_start,
        deterministic)``; an object with ``decide(game, state, car)``; or a function ``f(observation, generator) ->
        move``. Of a list, in which entries may be (weight, opponent), one is drawn for each game. The opponent
        observes what car 1 observes, and may also stay, whatever moves the rules offer.
    race : str, Path, RaceConfig or GameConfig
        Rules: "paper", "contest", a YAML file or a configuration.
    deterministic_opponent : bool
        Whether models take their best move; if not, they draw with a generator of their own, which no seed of this
        environment reaches.
    vehicle : VehicleParams, dict, str or Path, or a list of two
        Parameters of both cars, or of car 0 and car 1: a dict or a YAML file names those that differ from F1TENTH's
        (:class:`pcs_racing.VehicleParams`), such as ``{"mu": 0.8}``.
    randomize : Randomization, dict, str or Path, optional
        Ranges from which each episode draws friction, mass, steering delay and steering noise of its cars
        (:class:`pcs_racing.envs.randomization.Randomization`), such as ``{"friction": [0.7, 1.1]}``.
    obstacles : Obstacles, int, dict, str or Path, optional
        Boxes that stand on the track, drawn for each episode: how many, or their settings
        (:class:`pcs_racing.envs.obstacles.Obstacles`).
        A car that touches one has crashed as into a wall, and the lattice planner avoids most.
    render_mode : {"rgb_array", "rgb_array_list", "human"}, optional
        With "rgb_array" a frame shows how a step ended; with "rgb_array_list" `render` returns all frames since it was
        last called, or since the reset, 25 for each second of racing
        (:class:`pcs_racing.envs.video.RecordRaces` makes a video of them).
    view : {"track", "both", "car_0", "car_1"}
        What a frame shows.
    render_size : tuple of int
        Width and height of a frame in pixels.
    **settings
        Fields of :class:`pcs_racing.game.config.GameConfig`: ``moves``, ``step_seconds``, ``epsilon``, ``stay``...

    Raises
    ------
    InputError
        If an argument, an action or the order of calls is impossible.
    UnknownArgumentError
        A TypeError, if there is no such argument.

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Duel-v1", num_envs=256)`` gives :class:`pcs_racing.envs.duel.DuelVectorEnv`: one
    compiled call for all games, and the same numbers as this class gives with the same seeds.

    ## Version History

    * v1: fifty start lines at places found by driving, which no table uses; drivers leave room and do not brake for a
      car behind; the same bits on every x86-64 machine.
    * v0: first version.

    Examples
    --------
    >>> env = DuelEnv(opponent=[(1, "random-moves"), (2, "never-switch")])
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (31,)
    """

    batch_type = GameBatch
    batch: GameBatch
    declared = Declared(GameOptions, positional=("track", "archive", "opponent", "race"), more=GameConfig)

    @property
    def game(self) -> RaceGame:
        """The rules."""
        return self.batch.game

    @property
    def opponents(self) -> list[Opponent]:
        """The opponents among which each episode's is drawn."""
        return list(self.batch.opponents)

    def action_masks(self) -> NDArray[np.bool_]:
        """Moves that may be made, shape (M,), as sb3-contrib's MaskablePPO asks for them."""
        return self.batch.action_masks()[0]


class DuelVectorEnv(BatchVectorEnv):
    """Many :class:`DuelEnv` in one, with the same numbers for the same seeds.

    Parameters
    ----------
    num_envs : int
        Number of games.
    autoreset_mode : AutoresetMode or str
        What happens after a game has ended: see :class:`pcs_racing.envs.vector.BatchVectorEnv`.
    max_episode_steps : int, optional
        Moves after which a game is truncated.
    threads : int, optional
        Threads that share a step, all cores by default; the result does not depend on it.
    track, archive, opponent, race, deterministic_opponent, vehicle, randomize, obstacles, render_mode, view
        As for :class:`DuelEnv`; `render` returns a frame for each environment.
    render_size, **settings
        As for :class:`DuelEnv`.

    Raises
    ------
    InputError
        If an argument, an action or the order of calls is impossible; of actions and seeds the index is named.
    UnknownArgumentError
        A TypeError, if there is no such argument.

    Examples
    --------
    >>> envs = DuelVectorEnv(4, opponent="never-switch")
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 31)
    """

    batch_type = GameBatch
    batch: GameBatch
    declared = replace(DuelEnv.declared, positional=())

    @property
    def game(self) -> RaceGame:
        """The rules."""
        return self.batch.game

    def action_masks(self) -> NDArray[np.bool_]:
        """Moves that each player may make, shape (num_envs, M), as sb3-contrib's MaskablePPO asks for them."""
        return self.batch.action_masks()


class SelfPlayVectorEnv(DuelVectorEnv):
    """Games in which both cars belong to the agent: environment ``2 i`` is car 0 of game ``i``, ``2 i + 1`` its car 1.

    One policy that acts in all environments plays against itself; rewards of a pair add up to zero. Seeds belong to
    games: ``reset(seed=...)`` takes one for each game.

    Parameters
    ----------
    num_envs : int
        Twice the number of games.
    **arguments
        As for :class:`DuelVectorEnv`, without ``opponent``.
    """

    declared = replace(DuelVectorEnv.declared, changed={"opponent": None})
    players = 2
