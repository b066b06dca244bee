"""League: the opponents of a training, planners and frozen copies of the learner, in a folder.

A training draws an opponent for each race and adds a frozen copy of its policy now and then. The
more even the races against an opponent are, the more often it is drawn: an opponent that is always
beaten makes room for stronger ones. Weights change between rollouts only, so an opponent drives its
race to the end.

The folder holds ``league.yaml`` (names, weights, races) and a safetensors file for each copy. No
code of a file runs.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.artifacts import ManifestFormat
from pcs_racing.base.checks import (
    check_choice,
    check_number,
    check_path,
    check_text,
    check_whole,
    check_whole_array,
)
from pcs_racing.base.dense import layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import read_limited, write_together
from pcs_racing.envs.batch import WEIGHTS
from pcs_racing.envs.infos import Result
from pcs_racing.envs.models import KEPT, model_policy
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import parse_policy
from pcs_racing_agents.agents.sb3_files import (
    ACTIVATIONS,
    ObservationScale,
    Sb3Policy,
    drive_arguments_of,
    frozen_model,
)

FILE = "league.yaml"
LEAGUE_FORMAT = ManifestFormat("league", ("members",), "save_league")
MAX_MEMBERS = 100
MAX_BYTES = 16_000_000  # of the weights of a copy
RARE = 0.1  # weight of an opponent with a certain result, as a share of its weight in even races
KEEP = 0.95  # share of the former races that still count after new results
COPY = re.compile(r"self-\d{4,9}")
_KEYS = ("name", "weight", "races", "won")
_COPY_KEYS = ("sha256", "hidden", "activation", "squash", "clip", "arguments")


@dataclass(frozen=True, eq=False)
class Member:
    """An opponent of a league."""

    name: str  #: Text of a policy, such as "lattice:pace=0.7", or name of a copy: "self-0001".
    weight: float = 1.0  #: Weight in the draw in even races.
    races: float = 0.0  #: Number of races of the learner against it; older races count less.
    won: float = 0.0  #: Number of these races that the learner won; a tie counts half.
    #: Frozen policy of a copy; None for a planner's policy.
    model: Sb3Policy | None = field(default=None, repr=False)
    arguments: Mapping[str, Any] = field(default_factory=dict)  #: Arguments of its environment.

    @cached_property
    def policy(self) -> Policy:
        """Policy that drives the opponent's car."""
        if self.model is None:
            return parse_policy(self.name)
        return model_policy(self.model, name=self.name, **self.arguments)

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

    def with_copy(self, model: Any, weight: float = 1.0, *, max_copies: int = 8) -> "League":
        """Add a frozen copy of a model of Stable-Baselines3; the oldest leaves if there are more
        than ``max_copies`` copies.
        """
        check_number("the weight of a copy", weight, *WEIGHTS)
        check_whole("max_copies", max_copies, 1, MAX_MEMBERS)
        copies = [member for member in self.members if member.model is not None]
        number = 1 + max((int(one.name.removeprefix("self-")) for one in copies), default=0)
        name = f"self-{number:04d}"
        frozen, arguments = frozen_model(model, name), drive_arguments_of(model, name)
        old = copies[: max(0, len(copies) + 1 - max_copies)]
        kept = [one for one in self.members if one not in old]
        return League((*kept, Member(name, weight, model=frozen, arguments=arguments)))


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
        tuple(_member(f"opponent {k}", _planner(*one)) for k, one in enumerate(given.items()))
    )


def _planner(name: str, weight: float) -> dict[str, Any]:
    return {"name": name, "weight": weight, "races": 0.0, "won": 0.0}


def save_league(folder: str | Path, league: League) -> Path:
    """Write a league into a folder, which is made if missing; return the folder.

    The folder holds the former league or the new one at any time.
    """
    folder = Path(check_path("the folder of the league", folder))
    try:
        return _save(folder, league)
    except OSError as error:
        raise InputError(
            f"can't write a league into {folder}: {error.strerror} ({error.filename or folder})"
        ) from None


def _save(folder: Path, league: League) -> Path:
    files: dict[str, bytes] = {}
    members = []
    for member in league.members:
        fields: dict[str, Any] = {key: getattr(member, key) for key in _KEYS}
        fields |= {key: float(fields[key]) for key in _KEYS[1:]}
        if member.model is not None:
            content = _weights(member.model)
            scale = member.model.scale
            files[f"{member.name}.safetensors"] = content
            fields |= {
                "sha256": hashlib.sha256(content).hexdigest(),
                "hidden": list(member.model.layers.hidden),
                "activation": member.model.activation,
                "squash": member.model.squash,
                "clip": None if scale is None else scale.clip,
                "arguments": dict(member.arguments),
            }
        members.append(fields)
    write_together(folder, {**files, FILE: LEAGUE_FORMAT.text({"members": members})})
    return folder


def load_league(folder: str | Path) -> League:
    """Return the league in a folder of :func:`save_league`."""
    file = Path(folder) / FILE
    members = LEAGUE_FORMAT.read(file)["members"]
    if not isinstance(members, list):
        raise InputError(f"{file}: members must be a list")
    return League(tuple(_member(f"{file}: member {k}", one) for k, one in enumerate(members)))


def _weights(model: Sb3Policy) -> bytes:
    scale = model.scale
    others = {} if scale is None else {"mean": scale.mean, "spread": scale.spread}
    return layers_to_bytes(
        model.layers, {key: value.astype(np.float32) for key, value in others.items()}
    )


def _member(where: str, given: Any) -> Member:
    """Return a member from its fields; ``where`` begins with the file, for messages."""
    copied = isinstance(given, dict) and COPY.fullmatch(str(given.get("name"))) is not None
    keys = (*_KEYS, *(_COPY_KEYS if copied else ()))
    if not isinstance(given, dict) or set(given) != set(keys):
        raise InputError(f"{where} is {given!r:.80}; it must have the fields {', '.join(keys)}")
    name = check_text(f"{where}: name", given["name"])
    weight = check_number(f"{where}: weight", given["weight"], *WEIGHTS)
    races = check_number(f"{where}: races", given["races"], 0.0, 1e12)
    won = check_number(f"{where}: won", given["won"], 0.0, races)
    try:
        more = _read_copy(where, given) if copied else {}
        member = Member(name, float(weight), float(races), float(won), **more)
        member.policy  # noqa: B018  refuses unknown names and arguments
    except InputError as error:
        raise type(error)(f"{where}: {error}") from None
    return member


def _read_copy(where: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the frozen policy of a copy and the arguments of its environment."""
    file = Path(where.rpartition(":")[0]).parent / f"{given['name']}.safetensors"
    content = read_limited(file, MAX_BYTES, "the weights of a copy", InputError)
    if hashlib.sha256(content).hexdigest() != given["sha256"]:
        raise InputError(f"{file} is not the file that it describes: its digest differs")
    scaled = given["clip"] is not None
    others = ("mean", "spread") if scaled else ()
    layers, scale = layers_from_bytes(file, content, given["hidden"], others)
    check_choice("activation", given["activation"], ACTIVATIONS)
    if not isinstance(given["squash"], bool) or not isinstance(given["arguments"], dict):
        raise InputError("squash must be true or false, and arguments a mapping")
    for key in given["arguments"]:
        check_choice("a name in arguments", key, ("cars", *KEPT, "vehicle"))
    model = Sb3Policy(str(given["name"]), layers, given["activation"], False, given["squash"])
    if scaled:
        clip = float(check_number("clip", given["clip"], above=0.0))
        mean, spread = (scale[key].astype(np.float64) for key in others)
        shape = (layers.sizes[0],)
        if mean.shape != shape or spread.shape != shape or not (spread > 0.0).all():
            raise InputError(
                f"{file}: mean and spread must have {shape[0]} numbers, spreads above 0"
            )
        model = replace(model, scale=ObservationScale(mean, spread, clip))
    return {"model": model, "arguments": given["arguments"]}
