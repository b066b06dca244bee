"""Score cards of agents by a protocol, as values, JSON and a page; the leaderboard.

Third parties submit cards, so all values are declared and checked.
"""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from annotated_types import Interval

from pcs_racing.base.checks import check_text
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.files import parse_json, read_limited, write_atomically
from pcs_racing.base.settings import Checked, Settings
from pcs_racing_agents.base.tables import Column, table_rows, with_interval
from pcs_racing_agents.watch.pages import Standing, rendered, winner_text

FORMAT = "pcs-racing card 1"
MAX_BYTES = 1_000_000
MAX_SCORES = 1000
MAX_NAME = 200  # characters
CIRCUITS = ("all", "train", "test")
SCORED = "Score: 1 for a race won, 0.5 for a tie, else 0; lines: 95 % intervals."

S = TypeVar("S", bound=Settings)


def _name(_: str, value: Any) -> str:
    name = check_text("a name", value, ConfigError)
    if len(name) > MAX_NAME or not name.isprintable():
        raise ConfigError(
            f"a name is {name[:40]!r}...; it must have at most {MAX_NAME} printable characters"
        )
    return name


def _sha256(_: str, value: Any) -> str:
    if not isinstance(value, str) or re.fullmatch("[0-9a-f]{64}", value) is None:
        raise ConfigError(f"a hash is {value!r:.80}; it must have 64 hexadecimal digits")
    return value


def _made(kind: type[S], _: str, value: Any) -> S:
    """Return declared values from an instance, or from a mapping with all fields."""
    if isinstance(value, kind):
        return value
    names = [field.name for field in fields(kind)]
    if not isinstance(value, Mapping) or set(value) != set(names):
        raise ConfigError(f"{value!r:.80} must be a mapping of {', '.join(names)}")
    return kind(**value)


NAME = Checked(_name, f"at most {MAX_NAME} printable characters")
SHA256 = Checked(_sha256)
COUNT = Interval(ge=1, le=10**9)
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
    circuits: Annotated[str, NAME, 'Circuits: "train", "test", "all", or one.']
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


def _scores(name: str, value: Any) -> tuple[CardScore, ...]:
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= MAX_SCORES:
        raise ConfigError(f"scores are {value!r:.40}; they must be a list of 1 to {MAX_SCORES}")
    return tuple(_made(CardScore, name, one) for one in value)


def _gains(name: str, value: Any) -> dict[str, Gain]:
    if not isinstance(value, Mapping) or not set(value) <= set(CIRCUITS):
        raise ConfigError(
            f"gains are {value!r:.80}; they must be a mapping of some of {', '.join(CIRCUITS)}"
        )
    return {circuits: _made(Gain, name, gain) for circuits, gain in value.items()}


@dataclass(frozen=True)
class Card(Settings):
    """The result of an agent in the benchmark."""

    protocol: Annotated[str, NAME, "Name of the protocol, with its version."]
    protocol_sha256: Annotated[
        str, SHA256, "Hash of the protocol and of everything that its results depend on."
    ]
    agent: Annotated[str, NAME, "Name of the agent."]
    agent_sha256: Annotated[str, SHA256, "Hash of the agent."]
    scores: Annotated[
        tuple[CardScore, ...],
        Checked(_scores),
        "Over everything, by kind of opponent, and cell by cell.",
    ]
    gains: Annotated[dict[str, Gain], Checked(_gains), "Adaptivity gain on some circuits."]
    cost_us: Annotated[float | None, Interval(ge=0.0, le=1e9), "Time of a decision, us."] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for circuits in CIRCUITS:  # columns of the leaderboard
            self.score("all", circuits)

    def score(self, part: str = "all", circuits: str = "all") -> CardScore:
        """Return the score of a part of the races."""
        for score in self.scores:
            if (score.part, score.circuits) == (part, circuits):
                return score
        raise InputError(
            f"the card of {self.agent!r} has no score of {part!r} on {circuits!r} circuits"
        )


COLUMNS = (
    Column("part", "opponents"),
    Column("circuits"),
    Column("score", format=".3f"),
    Column("interval", "95 % interval"),
    Column("own_crash", "own crashes", ".1%"),
    Column("other_crash", "other crashes", ".1%"),
    Column("races"),
)


def summary_rows(card: Card) -> list[tuple[str, ...]]:
    """Return the scores by kind of opponent as a table."""
    return table_rows(COLUMNS, (score for score in card.scores if score.circuits in CIRCUITS))


def fact_lines(card: Card) -> list[str]:
    """Return the other results as sentences."""
    lines = [
        f"Adaptivity gain over the best baseline ({gain.over}), {circuits} circuits: "
        f"{with_interval(gain.gain, gain.low, gain.high)}."
        for circuits, gain in card.gains.items()
    ]
    if card.cost_us is not None:
        lines.append(f"One decision takes {card.cost_us:.0f} us.")
    return lines


def card_page(card: Card) -> str:
    """Return the card as one self-contained page."""
    whole = card.score()
    shares = [f"{card.score('all', part).score:.3f} on {part} circuits" for part in CIRCUITS[1:]]
    return rendered(
        "pcs_racing_agents.benchmark",
        "card.html",
        title=f"{card.agent}: {card.protocol}",
        result=(
            f"{card.agent} scores {whole.score:.3f} {whole.interval} over {whole.races:,} races:"
            f" {' and '.join(shares)}."
        ),
        facts=f"{_protocol(card)}; agent {card.agent_sha256[:16]}. {SCORED}",
        card=card,
        table=summary_rows(card),
        gains=fact_lines(card),
    )


def write_card(card: Card, folder: Path) -> list[Path]:
    """Write ``card.json`` and ``card.html`` into an existing folder; return their paths."""
    values = json.dumps({"format": FORMAT, **asdict(card)}, indent=1, allow_nan=False) + "\n"
    texts = {folder / "card.json": values, folder / "card.html": card_page(card)}
    for path, text in texts.items():
        write_atomically(path, text)
    return list(texts)


def read_card(path: Path) -> Card:
    """Read a card from its folder or its ``card.json``."""
    file = path / "card.json" if path.is_dir() else path
    try:
        values = parse_json(file, read_limited(file, MAX_BYTES, "a card"))
    except OSError as error:
        raise InputError(
            f"can't read {file}: {error.strerror}; give a folder that 'pcs-racing benchmark card'"
            " wrote"
        ) from None
    if not isinstance(values, dict) or values.pop("format", None) != FORMAT:
        raise InputError(f"{file} is no card of this version; its format must be {FORMAT!r}")
    try:
        return _made(Card, "a card", values)
    except InputError as error:
        raise InputError(f"{file} is a damaged card: {error}") from None


def read_cards(paths: Iterable[Path]) -> list[Card]:
    """Read cards, ranked by their score over all races.

    ``paths``: folders of cards, files of cards, or folders of several cards.
    """
    cards: dict[str, Card] = {}
    for path in (card for folder in paths for card in _cards_in(folder)):
        card = read_card(path)
        first = next(iter(cards.values()), card)
        # Scores are comparable only under the same protocol, archive and opponents.
        if (card.protocol, card.protocol_sha256) != (first.protocol, first.protocol_sha256):
            raise InputError(
                f"{path} is a card of {card.protocol!r} with hash {card.protocol_sha256[:16]}, the"
                f" first one of {first.protocol!r} with {first.protocol_sha256[:16]}: version,"
                " archive, circuits or opponents differ"
            )
        if card.agent in cards:
            raise InputError(
                f"{path} is a second card of agent {card.agent!r}; give one of each (--name renames"
                " an agent)"
            )
        cards[card.agent] = card
    if not cards:
        raise InputError(
            "there are no cards; give at least one folder that 'pcs-racing benchmark card' wrote"
        )
    # Equal scores are sorted by name: the page does not depend on the order of the folders.
    return sorted(cards.values(), key=lambda card: (-card.score().score, card.agent))


def _cards_in(path: Path) -> list[Path]:
    """Return a card's own place, or the places of all cards in a folder."""
    if not path.is_dir() or (path / "card.json").exists():
        return [path]
    inside = sorted(card.parent for card in path.glob("*/card.json"))
    return inside or sorted(path.glob("*.json")) or [path]


BOARD = (
    "agent",
    "score",
    "95 % interval",
    "train",
    "test",
    "own crashes",
    "gain",
    "us",
)
"""Columns of the leaderboard."""


def board_rows(cards: Sequence[Card]) -> list[tuple[str, ...]]:
    """Return the leaderboard as a table, one line per card."""
    return [BOARD, *map(_board_row, cards)]


def _board_row(card: Card) -> tuple[str, ...]:
    whole, gain = card.score(), card.gains.get("all")
    return (
        card.agent,
        f"{whole.score:.3f}",
        whole.interval,
        f"{card.score('all', 'train').score:.3f}",
        f"{card.score('all', 'test').score:.3f}",
        f"{whole.own_crash:.1%}",
        "" if gain is None else f"{gain.gain:+.3f}",
        "" if card.cost_us is None else f"{card.cost_us:.0f}",
    )


def board_page(cards: Sequence[Card]) -> str:
    """Return the leaderboard as one page."""
    wholes = [(card.agent, card.score()) for card in cards]
    return rendered(
        "pcs_racing_agents.benchmark",
        "leaderboard.html",
        title=f"Leaderboard: {cards[0].protocol}",
        result=winner_text(
            [Standing(name, one.score, one.low, one.high, one.races) for name, one in wholes]
        ),
        facts=f"{len(cards)} agents; {_protocol(cards[0])}. {SCORED}",
        cards=cards,
        table=board_rows(cards),
    )


def _protocol(card: Card) -> str:
    return f"protocol {card.protocol} {card.protocol_sha256[:16]}"
