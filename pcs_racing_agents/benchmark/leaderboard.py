"""The leaderboard: cards of one protocol, ranked by score."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from pcs_racing.base.errors import InputError
from pcs_racing_agents.benchmark.card import Card, read_card, render
from pcs_racing_agents.results.text_table import with_interval

BOARD_COLUMNS = ("agent", "score", "95 % interval", "seen", "unseen", "own crashes", "gain", "best reply", "us")


def read_cards(paths: Iterable[Path]) -> list[Card]:
    """Read cards, ranked by their score over all races.

    Parameters
    ----------
    paths : iterable of Path
        Folders of cards, or folders that hold such folders.
    """
    files = [card for path in paths for card in _cards_in(path)]
    cards = [read_card(path) for path in files]
    if not cards:
        raise InputError("there are no cards; give at least one folder that 'pcs-racing benchmark' wrote")
    first, names = cards[0], set()
    for path, card in zip(files, cards, strict=True):
        if card.protocol != first.protocol:
            raise InputError(f"{path} is a card of protocol {card.protocol!r}, the first one of {first.protocol!r}")
        if card.protocol_sha256 != first.protocol_sha256:
            raise InputError(
                f"{path} is a card of {card.protocol!r} with hash {card.protocol_sha256[:16]}, the first one has "
                f"{first.protocol_sha256[:16]}: archive, circuits or opponents differ"
            )
        if card.agent in names:
            raise InputError(
                f"{path} is a second card of agent {card.agent!r}; give one of each (--name renames an agent)"
            )
        names.add(card.agent)
    return sorted(cards, key=lambda card: (-card.score().score, card.agent))


def _cards_in(path: Path) -> list[Path]:
    """Return a folder of a card, or the folders of cards that it holds."""
    inside = sorted(card.parent for card in path.glob("*/card.json"))
    return inside if inside and not (path / "card.json").exists() else [path]


def board_rows(cards: Sequence[Card]) -> list[tuple[str, ...]]:
    """Return the table as text, a row for each card."""
    rows: list[tuple[str, ...]] = []
    for card in cards:
        whole, gain, reply = card.score(), card.gains.get("all"), card.best_reply
        rows.append(
            (
                card.agent,
                f"{whole.score:.3f}",
                f"[{whole.low:.3f}, {whole.high:.3f}]",
                f"{card.score('all', 'seen').score:.3f}",
                f"{card.score('all', 'unseen').score:.3f}",
                f"{whole.own_crash:.1%}",
                "" if gain is None else f"{gain['gain']:+.3f}",
                "not measured" if reply is None else with_interval(reply["loss"], reply["low"], reply["high"]),
                "" if card.cost_us is None else f"{card.cost_us:.0f}",
            )
        )
    return rows


def board_page(cards: Sequence[Card]) -> str:
    """Return the leaderboard as one page."""
    return render("leaderboard.html", cards=cards, columns=BOARD_COLUMNS, rows=board_rows(cards))
