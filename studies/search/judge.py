"""Judgement of policies on circuits held out: scores, own crashes, payoffs of all pairs."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.planners.registry import parse_policy
from pcs_racing.race.config import load_race_config
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.policies.evaluate import draw_scenarios, race_points, race_policies
from pcs_racing_agents.policies.headroom import headroom, jackknife_error, transitive_share
from pcs_racing_agents.policies.policy_pool import PolicyPool, pool_payoffs
from pcs_racing_agents.policies.tuning import policy_text
from studies.search.arms import FOUND, HAND_SET

SEED = 77


class Meeting(NamedTuple):
    """Result of a policy against an opponent over several circuits."""

    policy: str
    opponent: str
    score: float  #: Share of races won; a tie is a half.
    low: float  #: ``low``, ``high``: 95 % interval, clustered by circuit and start line.
    high: float
    own_crash: float

    @property
    def cells(self) -> tuple[str, str]:
        """Texts of the score with its interval, and of the own crashes."""
        return f"{self.score:.3f} [{self.low:.3f}, {self.high:.3f}]", f"{self.own_crash:.3f}"


def judge(
    policies: Sequence[str],
    opponents: Sequence[str],
    tracks: Sequence[str],
    *,
    races: int,
    rules: str = "contest",
) -> list[Meeting]:
    """Race policies of one planner against opponents, ``races`` for each pair and circuit."""
    parsed = [parse_policy(text) for text in policies]
    scenarios = draw_scenarios(
        parsed[0].planner.name,
        tracks,
        load_race_config(rules, duration=40.0),
        rivals=tuple(opponents),
        starts=races // 2,
        seed=SEED,
    )
    raced = race_policies((scenarios, np.stack([policy.parameters for policy in parsed])))
    points = race_points(raced)
    places = zip(scenarios.track, scenarios.start_s, strict=True)
    starts = np.array([f"{track} {start:.3f}" for track, start in places])
    found = []
    for k, policy in enumerate(policies):
        for o, opponent in enumerate(opponents):
            met = scenarios.opponent == o
            score = clustered_mean(points[k, met], starts[met])
            crash = float(raced["own_crash"][k, met].mean())
            found.append(Meeting(policy, opponent, score.mean, score.low, score.high, crash))
    return found


def arm_rows(arms: Sequence[tuple[str, str]], tracks: Sequence[str]) -> list[tuple[str, ...]]:
    """Return scores of each arm's policy against the two reference policies."""
    met = judge([text for _, text in arms], (FOUND, HAND_SET), tracks, races=120)
    return _pair_rows("arm", (name for name, _ in arms), met)


def field_rows(
    strongest: str, field: Sequence[tuple[str, str]], tracks: Sequence[str], rules: str = "contest"
) -> list[tuple[str, ...]]:
    """Return scores of a policy against each of some others."""
    met = judge([strongest], [text for _, text in field], tracks, races=200, rules=rules)
    rows = [(name, *one.cells) for (name, _), one in zip(field, met, strict=True)]
    return [("opponent", "score against it", "own crashes"), *rows]


def archive_rows(name: str, tracks: Sequence[str]) -> list[tuple[str, ...]]:
    """Return scores of the policies of an archive, as of arms, and their means."""
    archive = load_archive(name)
    texts = [_text_of(archive, k) for k in range(len(archive))]
    met = judge(texts, (FOUND, HAND_SET), tracks, races=200)
    numbers = np.array([(one.score, one.own_crash) for one in met]).reshape(len(archive), 4)
    mean = tuple(f"{value:.3f}" for value in numbers.mean(axis=0))
    return [*_pair_rows("policy", map(str, range(len(archive))), met), ("mean", *mean)]


def best_of(name: str) -> str:
    """Return the last champion of an archive, or its policy with the max on the first axis."""
    archive = load_archive(name)
    champion = archive.settings.get(f"champion_{archive.settings['champions']}")
    return str(champion or _text_of(archive, int(np.argmax(archive.coordinates[:, 0]))))


def _text_of(archive: PolicyArchive, index: int) -> str:
    policy = archive.policy(index)
    return policy_text(policy.planner, policy.parameters)


def _pair_rows(what: str, names: Iterable[str], met: Sequence[Meeting]) -> list[tuple[str, ...]]:
    """Return the table of meetings with the two reference policies."""
    head = (what, "against found", "own crashes", "against the hand-set lattice", "own crashes")
    pairs = zip(names, met[::2], met[1::2], strict=True)
    return [head, *((name, *first.cells, *second.cells) for name, first, second in pairs)]


def round_rows(winners: Sequence[tuple[str, str]], tracks: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the game of all winners: mean payoffs, ratings, transitive share and headroom."""
    names = [*(name for name, _ in winners), "found", "hand-set", "early"]
    texts = [*(text for _, text in winners), FOUND, HAND_SET, "lattice:early"]
    config = load_race_config("contest", duration=40.0)
    policies = tuple(parse_policy(text) for text in texts)
    pool = PolicyPool(policies, tuple(tracks), config, races=64, seed=SEED)
    payoffs = pool_payoffs(pool)
    mean = payoffs.mean(axis=(0, 1)) + 0.5
    estimates = [headroom(folds) for folds in payoffs]
    shares = [transitive_share(folds) for folds in payoffs]
    gains = np.mean([one.gains for one in estimates], axis=0)
    error = jackknife_error(np.mean([one.without for one in estimates], axis=0))
    rows = [("policy", *names), *zip(names, *np.char.mod("%.3f", mean.T), strict=True)]
    width = len(names)
    facts = (
        ("headroom", f"{gains.mean():+.3f}", f"{error:.3f}"),
        ("low", f"{np.mean([one.low for one in estimates]):+.3f}"),
        ("transitive share", f"{np.nanmean(shares):.3f}"),
    )
    return [*rows, *((*fact, *[""] * (width + 1 - len(fact))) for fact in facts)]
