"""What remembering the opponent is worth in a match, beside never changing the policy and knowing
the opponent.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_seed, check_whole
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.game.match import MatchGame
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.races import start_lines
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import Run, run_races
from pcs_racing_agents.base.statistics import Estimate, clustered_mean
from pcs_racing_agents.base.tables import aligned, write_csv
from studies.matches.behaviours import Behaviours
from studies.matches.play import FixedChoice, KnownOpponentChoice, play_matches
from studies.matches.remember import RememberedReply

Floats = NDArray[np.float64]

ARMS = ("best fixed", "remember", "nearest", "known")
"""The players that are compared: the best policy on average over the opponents in every race; the
reply to what was seen, by likelihood and to the nearest behaviour; the best reply to the opponent,
which is known from the start. All are chosen on the training races."""

HEAD = (
    "track",
    "learned",
    "fixed",
    "gain",
    "low",
    "high",
    "by race",
    "nearest",
    "known",
    "low",
    "high",
)
NOTE = """learned: whether behaviours and scores were learned on this circuit, in other races;
fixed: races won per race by the best fixed policy of the training races; gain: races that
remembering adds to it per race, over the whole match and by race; low, high: 95 % interval,
clustered by opponent; nearest: gain of the reply to the nearest behaviour; known: gain if the
opponent is known before the first race"""


@dataclass(frozen=True, eq=False)
class MatchTest:
    """Matches against each policy of an archive, played by all players with the same lines, sides
    and noise.
    """

    spec: GameSpec  #: Archive and rules.
    table: Behaviours  #: What was learned; its opponents are the policies of the archive.
    tracks: tuple[Track | str, ...]
    races: int = 3  #: Races of a match.
    #: Matches against each policy on each circuit, even: the first race starts from both sides in
    #: turn.
    matches: int = 32
    seed: int = 0  #: Root of start lines and noise.

    def __post_init__(self) -> None:
        self.check(self.tracks, self.races, self.matches, self.seed)
        self.table.check_fits(self.spec, "the table of behaviours")
        if len(self.table.opponents) != len(self.spec.archive):
            raise InputError(
                f"the table holds {len(self.table.opponents)} opponents; they must be the"
                f" {len(self.spec.archive)} policies of archive {self.spec.archive.name!r}"
            )

    @staticmethod
    def check(tracks: Sequence[Track | str], races: int, matches: int, seed: int) -> None:
        """Check what can be checked before anything is learned."""
        if not tracks:
            raise InputError("there are no tracks; name at least one")
        check_whole("matches", matches, 2, 10_000)
        if matches % 2:
            raise InputError(
                f"matches is {matches}; it must be even, since the sides of the first race take"
                " turns"
            )
        check_seed(name="seed", seed=seed)
        check_whole("races", races, 1, 100, ConfigError)


class TrackGain(NamedTuple):
    """Results of all players on one circuit, against N opponents in M matches of R races each."""

    track: str
    learned: bool  #: Whether the table was learned on this circuit.
    scores: Floats  #: shape (A, N, M, R): Score of each of :data:`ARMS`.

    def gain(self, arm: str) -> Estimate:
        """Gain of a player over the best fixed policy per race, clustered by opponent."""
        return _estimate(self.scores, arm)

    def gain_by_race(self, arm: str) -> Floats:
        """Mean gain in each race of the match, shape (R,)."""
        return _gain_by_race(self.scores, arm)


def _estimate(scores: Floats, arm: str) -> Estimate:
    differences = (scores[ARMS.index(arm)] - scores[0]).mean(axis=2)
    opponents = np.repeat(np.arange(len(differences)), differences.shape[1])
    return clustered_mean(differences.reshape(-1), opponents)


def _gain_by_race(scores: Floats, arm: str) -> Floats:
    return np.asarray((scores[ARMS.index(arm)] - scores[0]).mean(axis=(0, 1)))


def match_gains(test: MatchTest, **run: Unpack[Run]) -> list[TrackGain]:
    """Play the matches of all players on each circuit; progress counts opponents."""
    opponents = range(len(test.table.opponents))
    tasks = [(test, track, opponent) for track in range(len(test.tracks)) for opponent in opponents]
    results = run_races("matches", _play_opponent, tasks, **run)
    known = str(test.table.training.get("tracks", "")).split(", ")
    gains = []
    for number, track in enumerate(test.tracks):
        mine = [
            result["scores"]
            for (_, n, _), result in zip(tasks, results, strict=True)
            if n == number
        ]
        name = as_track(track).name
        gains.append(TrackGain(name, name in known, np.stack(mine, axis=1)))
    return gains


def _play_opponent(task: tuple[MatchTest, int, int], threads: int | None = None) -> Arrays:
    """Play all players' matches against one opponent on one circuit: scores, shape (A, M, R)."""
    test, number, opponent = task
    spec, table, count = test.spec, test.table, test.matches
    game = RaceGame(as_track(test.tracks[number]), spec.archive, spec.config, threads=threads)
    match = MatchGame(game, races=test.races)
    rules = replace(game.setup.config, start_lines=count * test.races)
    # Other lines and noise than those of training, whatever its seed.
    lines = start_lines(game.track, rules, np.random.SeedSequence(test.seed, spawn_key=(2, number)))
    noise = np.random.SeedSequence(test.seed, spawn_key=(3, number, opponent)).generate_state(
        count, np.uint64
    )
    given: dict[str, Any] = {
        "keys": noise.astype(np.uint64),
        "policies": np.array([table.best_fixed, opponent]),
        "lines": lines.reshape(count, test.races),
        "sides": np.arange(count) % 2,
    }
    players = {
        "best fixed": FixedChoice(table.best_fixed),
        "remember": _ReplyChooser(RememberedReply(table, spec)),
        "nearest": _ReplyChooser(RememberedReply(table, spec, "nearest")),
        "known": KnownOpponentChoice(np.full(count, int(table.scores[:, opponent].argmax()))),
    }
    played = [play_matches(match, players[arm], None, **given) for arm in ARMS]
    return {"scores": np.stack([one.scores[:, 0] for one in played])}


class _ReplyChooser(NamedTuple):
    """A chooser made of a reply."""

    reply: RememberedReply

    def choose(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the replies."""
        return self.reply(observation)


def gain_text(gains: Sequence[TrackGain]) -> str:
    """Return the table of all circuits, with their mean if there are several, and the meaning of
    its columns.
    """
    rows: list[tuple[str, ...]] = [HEAD]
    rows += [_row(gain.track, "yes" if gain.learned else "no", gain.scores) for gain in gains]
    if len(gains) > 1:
        rows.append(_row("mean", "", np.concatenate([gain.scores for gain in gains], axis=2)))
    return "\n".join([*aligned(rows), "", NOTE])


def _row(track: str, learned: str, scores: Floats) -> tuple[str, ...]:
    remembered, known = _estimate(scores, "remember"), _estimate(scores, "known")
    by_race = _gain_by_race(scores, "remember")
    return (
        track,
        learned,
        f"{scores[0].mean():.3f}",
        *(f"{number:+.3f}" for number in (remembered.mean, remembered.low, remembered.high)),
        " ".join(f"{number:+.3f}" for number in by_race),
        *(
            f"{number:+.3f}"
            for number in (_estimate(scores, "nearest").mean, known.mean, known.low, known.high)
        ),
    )


def write_gains(gains: Sequence[TrackGain], names: Sequence[str], file: Path) -> Path:
    """Write a line for each circuit, opponent and race of the match: mean score of each player."""
    lines: list[tuple[object, ...]] = [("track", "learned", "opponent", "race", "matches", *ARMS)]
    for gain in gains:
        means = gain.scores.mean(axis=2)
        for (n, r), _ in np.ndenumerate(means[0]):
            scores = (f"{mean:.6f}" for mean in means[:, n, r])
            lines.append(
                (gain.track, int(gain.learned), names[n], r, gain.scores.shape[2], *scores)
            )
    return write_csv(lines, file)
