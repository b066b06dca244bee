"""Nouns come first in pages, docstrings, comments and strings: odd patterns are rare."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache

import pytest
from repository import REPOSITORY

ODD = re.compile(
    r"\A\W*(?:what|how|who|whose|those)\b|\b(?:"
    r"(?:of|in|from|to|by|on|for|with|at|after|before|through|between) which"
    r"|(?:that|those) of|ones? that|what (?!if\b)\w+"
    r"|stand(?:s|ing)? (?:for|in)|stands(?! still)|beside"
    r"|anew|by turns|in turn|at hand|if need be|be it"
    r"|nobody|whoever|anybody|everybody|whatever|wherever"
    r"|tells?|told|mend(?:s|ed)?)\b",
    re.IGNORECASE,
)
CODE = re.compile(r"```.*?```|``.*?``|`[^`\n]*`", re.DOTALL)
WORD = re.compile(r"[A-Za-z][A-Za-z']*")
PACKAGES = ("pcs_racing/**/*.py", "pcs_racing_agents/**/*.py")
OTHERS = ("studies/**/*.py", "dev/**/*.py", "examples/**/*.py", "docs/*.py")


def texts(python: str) -> Iterator[tuple[str, int, str]]:
    """Yield kind, line and text of docstrings, comments, and strings of two words or more."""
    alone = set()
    for node in ast.walk(ast.parse(python)):
        if isinstance(node, ast.Expr):
            alone.add(node.value)
        elif isinstance(node, ast.Constant) and " " in str(node.value).strip():
            yield "docstrings" if node in alone else "strings", node.lineno, str(node.value)
    for token in tokenize.generate_tokens(io.StringIO(python).readline):
        if token.type == tokenize.COMMENT:
            yield "comments", token.start[0], token.string.lstrip("#: ")


@cache
def read(pattern: str) -> list[tuple[str, str, str]]:
    """Return kind, place and text of all texts in some files, without names and blocks of code."""
    found = []
    for file in sorted(REPOSITORY.glob(pattern)):
        content = file.read_text(encoding="utf-8")
        rows = texts(content) if file.suffix == ".py" else [("pages", 1, content)]
        name = file.relative_to(REPOSITORY).as_posix()
        found += [(kind, f"{name}:{line}", CODE.sub("", text)) for kind, line, text in rows]
    return found


@pytest.mark.parametrize(
    ("patterns", "kinds", "limit"),
    [
        (("*.md", "docs/*.md", "docs/notebooks/*.md"), "pages", 0.5),
        (("docs/reports/*.md",), "pages", 0.5),
        (PACKAGES, "strings", 0.5),
        (PACKAGES, "docstrings", 0.7),
        (PACKAGES, "comments", 0.8),
        (("tests/**/*.py",), "docstrings comments", 1.5),
        (OTHERS, "docstrings comments strings", 3.0),
    ],
)
def test_odd_patterns_are_rare(patterns, kinds, limit):
    rows = [row for pattern in patterns for row in read(pattern) if row[0] in kinds.split()]
    odd = [f"{place}: {hit[0]}" for _, place, text in rows for hit in ODD.finditer(text)]
    words = sum(len(WORD.findall(text)) for _, _, text in rows)
    assert 1000 * len(odd) <= limit * words, f"repeat the noun ({words} words): {odd}"


def test_all_kinds_of_texts_are_read():
    python = '"""What it\nis."""\nx = f"one {y} two three"  #: a note\nz = "a b"\n'
    assert sorted(texts(python)) == [
        ("comments", 3, "a note"),
        ("docstrings", 1, "What it\nis."),
        ("strings", 3, " two three"),
        ("strings", 4, "a b"),
    ]


@pytest.mark.parametrize(
    ("text", "odd"),
    [
        ("What rewards are multiplied by", True),
        ("a crash pays nobody", True),
        ("the place in which it stands", True),
        ("distance to what is beside the car", True),
        ("the speed of the car, and that of the other", True),
        ("reward factor; clearance below which it steers away; a car stands still", False),
    ],
)
def test_odd_patterns_are_found(text, odd):
    assert bool(ODD.search(text)) is odd
