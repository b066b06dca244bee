"""Score cards of agents by a protocol, as values, JSON, Markdown and a page; the leaderboard."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

from annotated_types import Interval

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.files import parse_json, read_limited, write_atomically
from pcs_racing.base.settings import Checked, Settings
from pcs_racing.race.replay import Replay
from pcs_racing_agents.base.tables import Column, markdown, table_rows, with_interval
from pcs_racing_agents.benchmark.card_values import NAME, SHA256, CardScore, Gain, ReplyLoss
from pcs_racing_agents.study.report_page import page_environment

FORMAT = "pcs-racing card 1"
LARGEST = 1_000_000
MOST_SCORES = 1000
CIRCUITS = ("all", "seen", "unseen")

S = TypeVar("S", bound=Settings)


def _scores(_: str, value: Any) -> tuple[CardScore, ...]:
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= MOST_SCORES:
        raise ConfigError(f"scores are {value!r:.40}; they must be a list of 1 to {MOST_SCORES}")
    return tuple(_made(CardScore, one) for one in value)


def _gains(_: str, value: Any) -> dict[str, Gain]:
    if not isinstance(value, Mapping) or not set(value) <= set(CIRCUITS):
        raise ConfigError(
            f"gains are {value!r:.80}; they must be a mapping of some of {', '.join(CIRCUITS)}"
        )
    return {circuits: _made(Gain, gain) for circuits, gain in value.items()}


def _made(kind: type[S], value: Any) -> S:
    """Return declared values from an instance, or from a mapping with all fields."""
    if isinstance(value, kind):
        return value
    names = [field.name for field in fields(kind)]
    if not isinstance(value, Mapping) or set(value) != set(names):
        raise ConfigError(f"{value!r:.80} must be a mapping of {', '.join(names)}")
    return kind(**value)


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
    rating: Annotated[float | None, Interval(ge=-1e4, le=1e4), "Rating among the zoo."] = None
    cost_us: Annotated[float | None, Interval(ge=0.0, le=1e9), "Time of a decision, us."] = None
    best_reply: Annotated[
        ReplyLoss | None,
        Checked(lambda _, value: _made(ReplyLoss, value)),
        "Loss to a learned best reply, if it was measured.",
    ] = None

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


def write_card(card: Card, folder: Path, races: Sequence[tuple[str, Replay]] = ()) -> list[Path]:
    """Write ``card.json``, ``card.md`` and ``card.html`` into a folder; return their paths.

    ``folder``: an existing folder. ``races``: races to watch on the page, with titles.
    """
    values = {"format": FORMAT, **asdict(card)}
    texts = {
        "card.json": json.dumps(values, indent=1, allow_nan=False) + "\n",
        "card.md": card_markdown(card),
        "card.html": card_page(card, races),
    }
    paths = []
    for name, text in texts.items():
        write_atomically(folder / name, lambda file, text=text: file.write(text.encode()))  # type: ignore[misc]
        paths.append(folder / name)
    return paths


def read_card(path: Path) -> Card:
    """Read a card from its folder or its ``card.json``."""
    file = path / "card.json" if path.is_dir() else path
    try:
        values = parse_json(file, read_limited(file, LARGEST, "a card"))
    except OSError as error:
        raise InputError(
            f"can't read {file}: {error.strerror}; give a folder that 'pcs-racing benchmark card'"
            " wrote"
        ) from None
    if not isinstance(values, dict) or values.pop("format", None) != FORMAT:
        raise InputError(f"{file} is no card of this version; its format must be {FORMAT!r}")
    try:
        return _made(Card, values)
    except InputError as error:
        raise InputError(f"{file} is a damaged card: {error}") from None


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
    return table_rows(
        COLUMNS, (score for score in card.scores if score.circuits in ("seen", "unseen", "all"))
    )


def fact_lines(card: Card) -> list[str]:
    """Return the other results as sentences."""
    lines = [
        f"Adaptivity gain over the best baseline ({gain.over}), {circuits} circuits: "
        f"{with_interval(gain.gain, gain.low, gain.high)}."
        for circuits, gain in card.gains.items()
    ]
    if card.best_reply is not None:
        reply = card.best_reply
        lines.append(
            f"Loss to a learned best reply ({reply.starts} starts, {reply.rounds} "
            f"{'round' if reply.rounds == 1 else 'rounds'}): "
            f"{with_interval(reply.loss, reply.low, reply.high)}."
        )
    if card.rating is not None:
        lines.append(f"Rating among the zoo: {card.rating:+.0f}.")
    if card.cost_us is not None:
        lines.append(f"One decision takes {card.cost_us:.0f} us.")
    return lines


def card_markdown(card: Card) -> str:
    """Return the card as Markdown."""
    head = (
        f"# {card.agent}: {card.protocol}\n\nProtocol {card.protocol_sha256[:16]}, agent"
        f" {card.agent_sha256[:16]}.\n"
    )
    return "\n".join([head, *markdown(summary_rows(card)), "", *fact_lines(card), ""])


def card_page(card: Card, races: Sequence[tuple[str, Replay]] = ()) -> str:
    """Return the card as one self-contained page; all text is escaped."""
    return render(
        "card.html", card=card, table=summary_rows(card), facts=fact_lines(card), races=races
    )


def render(name: str, **values: Any) -> str:
    """Return a page from a template of this folder."""
    return page_environment("pcs_racing_agents.benchmark").get_template(name).render(**values)


def read_cards(paths: Iterable[Path]) -> list[Card]:
    """Read cards, ranked by their score over all races.

    ``paths``: folders of cards, or parents of such folders.
    """
    files = [card for path in paths for card in _cards_in(path)]
    cards = [read_card(path) for path in files]
    if not cards:
        raise InputError(
            "there are no cards; give at least one folder that 'pcs-racing benchmark card' wrote"
        )
    # Scores are comparable only under the same protocol, archive and opponents.
    first, names = cards[0], set()
    for path, card in zip(files, cards, strict=True):
        if card.protocol != first.protocol:
            raise InputError(
                f"{path} is a card of protocol {card.protocol!r}, the first one of"
                f" {first.protocol!r}"
            )
        if card.protocol_sha256 != first.protocol_sha256:
            raise InputError(
                f"{path} is a card of {card.protocol!r} with hash {card.protocol_sha256[:16]}, the"
                f" first one has {first.protocol_sha256[:16]}: archive, circuits or opponents"
                " differ"
            )
        if card.agent in names:
            raise InputError(
                f"{path} is a second card of agent {card.agent!r}; give one of each (--name renames"
                " an agent)"
            )
        names.add(card.agent)
    # Equal scores are sorted by name: the page does not depend on the order of the folders.
    return sorted(cards, key=lambda card: (-card.score().score, card.agent))


def _cards_in(path: Path) -> list[Path]:
    """Return a card's folder, or all folders of cards in a folder."""
    inside = sorted(card.parent for card in path.glob("*/card.json"))
    return inside if inside and not (path / "card.json").exists() else [path]


def board_rows(cards: Sequence[Card]) -> list[tuple[str, ...]]:
    """Return the leaderboard as a table, one line per card."""
    rows: list[tuple[str, ...]] = [
        (
            "agent",
            "score",
            "95 % interval",
            "seen",
            "unseen",
            "own crashes",
            "gain",
            "best reply",
            "us",
        )
    ]
    for card in cards:
        whole, gain, reply = card.score(), card.gains.get("all"), card.best_reply
        rows.append(
            (
                card.agent,
                f"{whole.score:.3f}",
                whole.interval,
                f"{card.score('all', 'seen').score:.3f}",
                f"{card.score('all', 'unseen').score:.3f}",
                f"{whole.own_crash:.1%}",
                "" if gain is None else f"{gain.gain:+.3f}",
                (
                    "not measured"
                    if reply is None
                    else with_interval(reply.loss, reply.low, reply.high)
                ),
                "" if card.cost_us is None else f"{card.cost_us:.0f}",
            )
        )
    return rows


def board_page(cards: Sequence[Card]) -> str:
    """Return the leaderboard as one page."""
    return render("leaderboard.html", cards=cards, table=board_rows(cards))
