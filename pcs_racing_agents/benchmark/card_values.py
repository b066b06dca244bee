"""Declared and checked values of score cards, since third parties submit cards."""

import re
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from annotated_types import Interval

from pcs_racing.base.checks import check_text
from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import Checked, Settings

LONGEST_NAME = 200  # characters


def _name(_: str, value: Any) -> str:
    name = check_text("a name", value, ConfigError)
    if len(name) > LONGEST_NAME or not name.isprintable():
        raise ConfigError(
            f"a name is {name[:40]!r}...; it must have at most {LONGEST_NAME} printable characters"
        )
    return name


def _sha256(_: str, value: Any) -> str:
    if not isinstance(value, str) or re.fullmatch("[0-9a-f]{64}", value) is None:
        raise ConfigError(f"a hash is {value!r:.80}; it must have 64 hexadecimal digits")
    return value


SHA256 = Checked(_sha256)
NAME, COUNT = (
    Checked(_name, f"at most {LONGEST_NAME} printable characters"),
    Interval(ge=1, le=10**9),
)
SHARE, DIFFERENCE = Interval(ge=0.0, le=1.0), Interval(ge=-1.0, le=1.0)


@dataclass(frozen=True)
class _Estimate(Settings):
    """A value between ``low`` and ``high``."""

    value: ClassVar[str]  #: Name of the value.

    def __post_init__(self) -> None:
        super().__post_init__()
        low, value, high = (getattr(self, name) for name in ("low", self.value, "high"))
        if not low <= value <= high:
            raise ConfigError(
                f"{self.value} is {value:g}, outside of its interval from {low:g} to {high:g}"
            )

    @property
    def interval(self) -> str:
        """Interval as text, for a value without a sign."""
        low, high = (getattr(self, name) for name in ("low", "high"))
        return f"[{low:.3f}, {high:.3f}]"


@dataclass(frozen=True)
class CardScore(_Estimate):
    """The score over a part of the races.

    The interval is robust to clusters of start policies and of opponents' variants; it holds for
    these tracks.
    """

    value = "score"
    part: Annotated[str, NAME, 'Opponents: "all", a kind of them, or one.']
    circuits: Annotated[str, NAME, 'Circuits: "seen", "unseen", "all", or one.']
    races: Annotated[int, COUNT, "Number of races."]
    score: Annotated[float, SHARE, "Mean score: 1 for a win, 0.5 for a tie, else 0."]
    low: Annotated[float, SHARE, "Lower limit of its 95 % interval."]
    high: Annotated[float, SHARE, "Upper limit."]
    own_crash: Annotated[
        float, SHARE, "Share of the races that ended in a crash by the agent's own fault."
    ]
    other_crash: Annotated[float, SHARE, "Share that ended in another crash."]


@dataclass(frozen=True)
class Gain(_Estimate):
    """The adaptivity gain on some tracks."""

    value = "gain"
    over: Annotated[str, NAME, "The baseline that it is a gain over."]
    gain: Annotated[float, DIFFERENCE, "Difference of the scores."]
    low: Annotated[float, DIFFERENCE, "Lower limit of its 95 % interval."]
    high: Annotated[float, DIFFERENCE, "Upper limit."]


@dataclass(frozen=True)
class ReplyLoss(_Estimate):
    """The loss of an agent to a learned best response."""

    value = "loss"
    loss: Annotated[float, DIFFERENCE, "Races lost per race."]
    low: Annotated[float, DIFFERENCE, "Lower limit of its 95 % interval."]
    high: Annotated[float, DIFFERENCE, "Upper limit."]
    starts: Annotated[int, COUNT, "Starts of the learner on each circuit."]
    rounds: Annotated[int, COUNT, "Rounds of the learner."]
    races: Annotated[int, COUNT, "Races in which the loss was measured."]
