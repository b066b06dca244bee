"""Parts of the report as HTML: tables, pictures, lists of facts. All text is escaped here."""

import base64
import html
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from pcs_racing_agents.study.table import Difference, StudyTable, TableRow

__all__ = ["drawn", "facts", "image", "overview", "table_of"]


def overview(table: StudyTable) -> str:
    """Return the short table: a line for each row, a column for each agent, differences with their intervals."""
    others = [arm for arm in table.arms if arm != table.base]
    papers = any(row.paper is not None for row in table.rows)
    head = ["circuit", "opponent", *(["paper"] if papers else []), f"{table.base}: score", *others]
    lines = [f"<tr>{''.join(_cell('th', cell, i < 2) for i, cell in enumerate(head))}</tr>"]
    for row in table.rows:
        found = {one.arm: one for one in row.differences}
        cells = [
            f'<th class="name">{html.escape(row.track)}{"" if row.seen else "<br><small>unseen</small>"}</th>',
            f'<td class="word">{html.escape(row.opponent)}</td>',
            *([f'<td class="paper">{_paper(row)}</td>'] if papers else []),
            f"<td>{row.arms[0].score:.3f}</td>",
            *(_difference(found.get(arm)) for arm in others),
        ]
        lines.append(f"<tr>{''.join(cells)}</tr>")
    told = (
        f"Score of {table.base}, then what each agent scores more than it; small: half of the 95 % interval; bold: p "
        "(Holm) below 0.05"
    )
    told += "; paper: what its game-theoretic agent won more than its other one." if papers else "."
    page = f'<div class="scroll"><table class="short">{"".join(lines)}</table></div>'
    return f'{page}<p class="note">{html.escape(told)}</p>'


def _paper(row: TableRow) -> str:
    return "" if row.paper is None else f"{row.paper.difference:+.3f}"


def _difference(one: Difference | None) -> str:
    if one is None:
        return "<td></td>"
    sure = ' class="sure"' if one.p_holm < 0.05 else ""
    result = one.result
    return f"<td{sure}>{result.difference:+.3f}<br><small>± {0.5 * (result.high - result.low):.3f}</small></td>"


def table_of(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table; columns of numbers stand to the right."""
    words = [not any(_numeric(row[i]) for row in rows) for i in range(len(head))]
    lines = [f"<tr>{''.join(_cell('th', cell, word) for cell, word in zip(head, words, strict=True))}</tr>"]
    for row in rows:
        cells = [
            f'<th class="name">{html.escape(cell)}</th>' if i == 0 else _cell("td", cell, words[i])
            for i, cell in enumerate(row)
        ]
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return f'<div class="scroll"><table>{"".join(lines)}</table></div>'


def _cell(tag: str, text: str, word: bool) -> str:
    kind = ' class="word"' if word else ""
    return f"<{tag}{kind}>{html.escape(text)}</{tag}>"


def _numeric(cell: str) -> bool:
    return bool(re.match(r"[-+\[<]?\s?[-+]?[0-9]", cell))


def facts(values: Mapping[str, Any]) -> str:
    """Return names and values as a table of two columns."""
    rows = "".join(
        f'<tr><th class="name">{html.escape(str(k))}</th><td>{html.escape(_plain(v))}</td></tr>'
        for k, v in values.items()
    )
    return f'<div class="scroll"><table>{rows}</table></div>'


def _plain(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def drawn(name: str, caption: str, *arguments: Any, **options: Any) -> Iterator[str]:
    """Draw one of the study's pictures, if there is something to draw with."""
    if find_spec("matplotlib") is None:
        yield f'<p class="note">{html.escape(caption)} Not drawn: matplotlib is not installed.</p>'
        return
    from pcs_racing_agents.explain import pcs_picture, situations
    from pcs_racing_agents.pictures.style import picture_bytes
    from pcs_racing_agents.study import figures

    place = {"archive_picture": pcs_picture, "situations_picture": situations}.get(name, figures)
    draw = getattr(place, name)
    yield image(picture_bytes(draw(*arguments, **options)), caption)


def image(content: bytes, caption: str) -> str:
    """Return a picture (SVG or PNG) with its caption; its bytes are part of the page."""
    kind = "png" if content.startswith(b"\x89PNG") else "svg+xml"
    data = base64.b64encode(content).decode("ascii")
    told = html.escape(caption)
    return f'<figure><img alt="{told}" src="data:image/{kind};base64,{data}"><figcaption>{told}</figcaption></figure>'
