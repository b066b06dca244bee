"""League: the opponents of a training, planners and frozen copies of the learner, in a folder.

A training draws an opponent for each race and adds a frozen copy of its policy now and then. The
more even the races against an opponent are, the more often it is drawn: an opponent that is always
beaten makes room for stronger ones. Weights change between rollouts only, so an opponent drives its
race to the end.

The folder holds ``league.yaml`` (names, weights, races) and a model of Stable-Baselines3 for each
copy. No code of a file runs.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.artifacts import ManifestFormat
from pcs_racing.base.errors import (
    InputError,
    check_number,
    check_path,
    check_text,
    check_whole,
    check_whole_array,
    require,
    say_once,
)
from pcs_racing.envs.batch import WEIGHTS
from pcs_racing.envs.infos import Result
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import policy_racer
from pcs_racing_agents.agents.sb3_files import is_sb3, save_model, training_origin

FILE = "league.yaml"
LEAGUE_FORMAT = ManifestFormat("league", ("members",), "save_league")
MAX_MEMBERS = 100
RARE = 0.1  # weight of an opponent with a certain result, as a share of its weight in even races
KEEP = 0.95  # share of the former races that still count after new results
COPY = re.compile(r"self-\d{4,9}")
_FIELDS = ("name", "weight", "races", "won")


@dataclass(frozen=True, eq=False)
class Member:
    """An opponent of a league."""

    name: str  #: Text of a policy, such as "lattice:pace=0.7", or name of a copy: "self-0001".
    policy: Policy = field(repr=False)  #: Policy that drives the opponent's car.
    weight: float = 1.0  #: Weight in the draw in even races.
    races: float = 0.0  #: Number of races of the learner against it; older races count less.
    won: float = 0.0  #: Number of these races that the learner won; a tie counts half.

    @property
    def is_copy(self) -> bool:
        """True for a frozen copy of the learner."""
        return COPY.fullmatch(self.name) is not None

    @property
    def won_share(self) -> float:
        """Share of the races that the learner won; 0.5 without a race."""
        return (self.won + 1.0) / (self.races + 2.0)


@dataclass(frozen=True, eq=False)
class League:
    """Opponents of a training; all methods return a new league.

    Examples
    --------
    >>> league = make_league({"lattice:pace=0": 1, "pure-pursuit": 1})
    >>> league = league.record([0, 0, 0, 0], [Result.WIN] * 4)
    >>> league.weights().round(2).tolist()
    [0.56, 1.0]
    """

    members: tuple[Member, ...]

    def __post_init__(self) -> None:
        names = [member.name for member in self.members]
        if not 1 <= len(names) <= MAX_MEMBERS:
            raise InputError(
                f"a league has {len(names)} opponents; it must have 1 to {MAX_MEMBERS}"
            )
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"a league lists {twice!r} twice; give its weight instead")

    def opponents(self) -> list[tuple[float, Policy]]:
        """Return the argument ``opponent`` of an environment."""
        return [
            (weight, member.policy)
            for weight, member in zip(self.weights().tolist(), self.members, strict=True)
        ]

    def weights(self) -> NDArray[np.float64]:
        """Return the weight of each opponent in the draw, shape (n,)."""
        shares = np.array([member.won_share for member in self.members])
        own = np.array([member.weight for member in self.members])
        return own * np.maximum(RARE, 4.0 * shares * (1.0 - shares))

    def record(self, opponents: ArrayLike, results: ArrayLike) -> "League":
        """Add finished races of the learner: the index of each opponent, and each result.

        Results are numbers of :class:`pcs_racing.envs.infos.Result`; a no-contest does not count.
        """
        met = check_whole_array(
            "opponents", opponents, (None,), minimum=0, maximum=len(self.members) - 1
        )
        ended = check_whole_array(
            "results", results, met.shape, minimum=min(Result), maximum=max(Result)
        )
        worth = {Result.WIN: 1.0, Result.TIE: 0.5, Result.LOSS: 0.0}
        members = list(self.members)
        for k, member in enumerate(members):
            scores = [worth[Result(one)] for one in ended[met == k].tolist() if one in worth]
            if scores:
                races, won = KEEP * member.races + len(scores), KEEP * member.won + sum(scores)
                members[k] = replace(member, races=races, won=won)
        return League(tuple(members))

    def with_copy(
        self, model: Any, folder: str | Path, weight: float = 1.0, *, max_copies: int = 8
    ) -> "League":
        """Save a model of Stable-Baselines3 in a folder, and add it as a frozen copy.

        The oldest copy leaves if there are more than ``max_copies`` copies. ``folder`` is the
        folder of :func:`save_league`, made if missing.
        """
        check_number("the weight of a copy", weight, *WEIGHTS)
        check_whole("max_copies", max_copies, 1, MAX_MEMBERS)
        if not is_sb3(model):
            raise InputError(f"a {type(model).__name__} is no model of Stable-Baselines3")
        copies = [member for member in self.members if member.is_copy]
        if (training_origin(model, "copy") or {}).get("environment") != "drive":
            raise InputError("the model of a copy was not trained in an environment of Drive")
        folder = _make_folder(folder)
        # The copies of another league in the folder stay as they are.
        taken = {one.name for one in copies} | {one.stem for one in folder.glob("self-????.zip")}
        number = 1 + max((int(one[5:]) for one in taken if one[5:].isdigit()), default=0)
        name = f"self-{number:04d}"
        save_model(folder / name, model)
        left = copies[: max(0, len(copies) + 1 - max_copies)]
        stays = [one for one in self.members if one not in left]
        return League((*stays, Member(name, _policy(name, folder), weight)))


def make_league(opponents: Mapping[str, float] | Sequence[str]) -> League:
    """Make a league of planners' policies by name, with weights if a mapping is given."""
    listed = isinstance(opponents, Sequence) and not isinstance(opponents, str)
    if not isinstance(opponents, Mapping) and not listed:
        raise InputError(
            f"opponents is {opponents!r:.80}; it must list names, or map names to weights"
        )
    names = [check_text("the name of an opponent", name) for name in opponents]
    given = opponents if isinstance(opponents, Mapping) else dict.fromkeys(names, 1.0)
    return League(
        tuple(
            _member(f"opponent {k}", {"name": name, "weight": weight, "races": 0.0, "won": 0.0})
            for k, (name, weight) in enumerate(given.items())
        )
    )


def save_league(folder: str | Path, league: League) -> Path:
    """Write a league into a folder, made if missing; return the folder.

    The folder holds the models of the copies already (:meth:`League.with_copy`).
    """
    folder = _make_folder(folder)
    members = [{key: getattr(member, key) for key in _FIELDS} for member in league.members]
    LEAGUE_FORMAT.write(folder / FILE, {"members": members})
    return folder


def _make_folder(folder: str | Path) -> Path:
    folder = Path(check_path("the folder of the league", folder))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"can't write a league into {folder}: {error.strerror}") from None
    return folder


def load_league(folder: str | Path) -> League:
    """Return the league in a folder of :func:`save_league`."""
    file = Path(folder) / FILE
    members = LEAGUE_FORMAT.read(file)["members"]
    if not isinstance(members, list):
        raise InputError(f"{file}: members must be a list")
    return League(
        tuple(_member(f"{file}: member {k}", one, file.parent) for k, one in enumerate(members))
    )


def _member(where: str, given: Any, folder: Path | None = None) -> Member:
    """Return a member from its fields; ``where`` begins messages."""
    if not isinstance(given, dict) or set(given) != set(_FIELDS):
        raise InputError(f"{where} is {given!r:.80}; it must have the fields {', '.join(_FIELDS)}")
    name = check_text(f"{where}: name", given["name"])
    weight = check_number(f"{where}: weight", given["weight"], *WEIGHTS)
    races = check_number(f"{where}: races", given["races"], 0.0, 1e12)
    won = check_number(f"{where}: won", given["won"], 0.0, races)
    try:
        policy = _policy(name, folder)
    except InputError as error:
        raise type(error)(f"{where}: {error}") from None
    return Member(name, policy, float(weight), float(races), float(won))


def _policy(name: str, folder: Path | None) -> Policy:
    """Return the policy of a text, or of a copy in a folder."""
    if folder is None or not COPY.fullmatch(name):
        return policy_racer(name)
    return replace(policy_racer(folder / f"{name}.zip"), name=name)


def league_callback(league: League) -> Any:
    """Return a callback of Stable-Baselines3 that sets the weights of the draw after each rollout.

    The opponents of the training's environment are ``league.opponents()``. The ``league`` of the
    callback is the league with the races so far.
    """
    require("stable_baselines3", extra="learning")
    from stable_baselines3.common.callbacks import BaseCallback

    class _LeagueCallback(BaseCallback):
        """Count the races against each opponent, and set the weights of the draw."""

        def __init__(self) -> None:
            super().__init__()
            self.league = league
            self._ended: list[tuple[int, int]] = []

        def _on_step(self) -> bool:
            ends = [info for info in self.locals["infos"] if "episode" in info]
            self._ended += [(info["opponent"], info["result"]) for info in ends]
            return True

        def _on_rollout_end(self) -> None:
            if self._ended and all(result == Result.CRASH for _, result in self._ended):
                say_once(
                    "no race of the league counts: each ended in a crash, a no-contest under these"
                    " rules; make the environment with rules='contest'"
                )
            if self._ended:
                self.league = self.league.record(*zip(*self._ended, strict=True))
                self._ended = []
            self.training_env.set_opponent_weights(self.league.weights())  # type: ignore[attr-defined]
            for member in self.league.members:
                self.logger.record(f"league/won against {member.name}", member.won_share)

    return _LeagueCallback()
