"""Pages of the documentation that are made from something else, so that nothing is said twice.

The environments' pages are the docstrings of their classes; changelog, contribution guide,
archives, planners and networks are files that live elsewhere in the repository; the reference is
made of all public modules; circuits, gallery and zoo are made of data files. All of them are
written to ``docs/generated``, which git ignores, whenever the site is built.
"""

import ast
import importlib
import inspect
import os
import re
import sys
from collections.abc import Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from pcs_racing.base.settings import listed_settings
from pcs_racing.base.typing import ObservationElement
from pcs_racing.envs.game_batch import GameOptions
from pcs_racing.race.config import Rules

REPOSITORY = Path(__file__).resolve().parent.parent

ENVIRONMENTS = {
    "head_to_head": ("pcs_racing.envs.duel", "HeadToHeadEnv", "Head to head: two agents"),
    "drive_head_to_head": (
        "pcs_racing.envs.drive",
        "DriveHeadToHeadEnv",
        "Drive head to head: two agents steer",
    ),
    "duel": ("pcs_racing.envs.duel", "DuelEnv", "Duel: one agent's moves"),
    "drive": ("pcs_racing.envs.drive", "DriveEnv", "Drive: steering and speed"),
    "line": ("pcs_racing.envs.line", "LineEnv", "Line: a choice among candidates"),
}
NAMES = {
    "head_to_head": '`pettingzoo.make("parallel", "pcs_racing/head_to_head-v1")`, or `"aec"`',
    "drive_head_to_head": (
        '`pettingzoo.make("parallel", "pcs_racing/drive_head_to_head-v0")`, or `"aec"`'
    ),
    "duel": '`gym.make("pcs_racing/Duel-v1")`',
    "drive": '`gym.make("pcs_racing/Drive-v1")`',
    "line": '`gym.make("pcs_racing/Line-v0")`',
}
TABLES: dict[str, dict[str, Any]] = {"duel": {}, "drive": {"beams": 2}}
"""Arguments of the environments whose pages list the elements of an observation."""
COPIES = {
    "changelog": "CHANGELOG.md",
    "contributing": "CONTRIBUTING.md",
    "examples": "examples/README.md",
    "shipped_archives": "pcs_racing/data/archives/README.md",
    "shipped_planners": "pcs_racing/data/planners/README.md",
    "shipped_networks": "pcs_racing_agents/data/networks/README.md",
}
REFERENCE = {
    "pcs_racing": "The package itself",
    "pcs_racing.base": "Errors, files, seeds, compilation",
    "pcs_racing.track": "Circuits",
    "pcs_racing.track.building": "How a track is built",
    "pcs_racing.track.mapping": "Mapping tools",
    "pcs_racing.car": "One car",
    "pcs_racing.planners": "Planners",
    "pcs_racing.planners.field": "Planners of the literature",
    "pcs_racing.race": "Races",
    "pcs_racing.game": "The game",
    "pcs_racing.envs": "Environments",
    "pcs_racing.f1tenth": "Programs of the F1TENTH gym",
    "pcs_racing.testing": "Checks for your own parts",
    "pcs_racing_agents": "The package itself",
    "pcs_racing_agents.base": "Jobs, tables, pictures",
    "pcs_racing_agents.policies": "Archives of policies",
    "pcs_racing_agents.solvers": "Solvers",
    "pcs_racing_agents.trees": "Game trees",
    "pcs_racing_agents.networks": "Networks",
    "pcs_racing_agents.agents": "Agents",
    "pcs_racing_agents.tournament": "Tournaments",
    "pcs_racing_agents.learning": "PPO, learned responses and self-play",
    "pcs_racing_agents.study": "The study",
    "pcs_racing_agents.watch": "Explanations and the race viewer",
}
"""Packages with a page of the reference each: their own modules, without the packages inside them.
"""


def made_pages() -> dict[str, str]:
    """Return all pages that are made: paths below ``docs/generated`` and texts."""
    pages = {f"{name}.md": environment_page(name) for name in ENVIRONMENTS}
    pages |= {f"{name}.md": copied_page(source) for name, source in COPIES.items()}
    pages |= {f"api/{package}.rst": reference_page(package) for package in packages()}
    pages["api/names.md"] = names_page()
    return pages | pages_of_data()


def write(folder: Path) -> None:
    """Write all pages below ``folder``/generated; a page that would not change is left alone."""
    pages = made_pages()
    made = folder / "generated"
    for name, text in pages.items():
        file = made / name
        file.parent.mkdir(parents=True, exist_ok=True)
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
    for file in made.rglob("*.*"):
        if file.relative_to(made).as_posix() not in pages:
            file.unlink()


# Environments


def environment_page(name: str) -> str:
    """Return the page of an environment, as Markdown: the docstring of its class."""
    module, class_name, title = ENVIRONMENTS[name]
    described = getattr(importlib.import_module(module), class_name)
    text = inspect.getdoc(described) or ""
    summary, _, rest = text.partition("\n")
    head = f"# {title}\n\n{summary}\n\n{NAMES[name]}; the class is `{module}.{class_name}`.\n"
    listed = ["Parameters", "----------", *_arguments(described.options_type)]
    if name in TABLES:
        table = element_table(described(**TABLES[name]).elements)
        rest = rest.replace("\n## Rewards\n", f"\n{table}\n\n## Rewards\n", 1)
    before, mark, after = rest.partition("## Vectorized environment")
    return head + _to_markdown("\n".join([before, *listed, "", mark + after])) + "\n"


def element_table(elements: Sequence[ObservationElement]) -> str:
    """Return the table of the elements of an observation; # replaces the number in a name."""
    rows: dict[tuple[str, ...], list[tuple[int, str]]] = {}
    for index, one in enumerate(elements):
        number = re.search(r"\d+", one.name)
        name = re.sub(r"\d+", "#", one.name)
        meaning = re.sub(rf"\b{number[0]}\b", "#", one.meaning, count=1) if number else one.meaning
        row = (name, one.unit, f"{one.low:g}", f"{one.high:g}")
        rows.setdefault(row, []).append((index, meaning))
    lines = ["| index | name | unit | low | high | meaning |", "|---|---|---|---|---|---|"]
    for row, found in rows.items():
        place = str(found[0][0])
        if len(found) > 1:
            place += f" + {found[1][0] - found[0][0]} i".replace(" 1 i", " i")
        lines.append(f"| {' | '.join([place, *row, found[0][1]])} |")
    return "\n".join(lines)


def _arguments(options: Any) -> list[str]:
    """Return lines about the arguments of an environment, from its configuration."""
    listed = listed_settings(options)
    if issubclass(options, GameOptions):
        others = {one.name for one in fields(Rules)} - {*options.defaults()}
        listed += listed_settings(Rules, *others)
    return listed


def _to_markdown(text: str) -> str:
    """Turn the reStructuredText of a docstring into Markdown."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text)
    text = text.replace("``", "`")
    parts = re.split(r"^(Parameters|Examples|Returns)\n-+\n", text, flags=re.MULTILINE)
    made = [parts[0]]
    for heading, body in zip(parts[1::2], parts[2::2], strict=True):
        numpydoc, mark, after = body.partition("\n## ")
        made.append(_numpydoc_section(heading, numpydoc) + mark + after)
    return "".join(made)


def _numpydoc_section(heading: str, body: str) -> str:
    if heading == "Examples":
        return f"## Examples\n\n```pycon\n{body.strip()}\n```\n"
    items = [f"**{heading}**\n"]
    for entry in re.split(r"\n(?=\S)", body.strip("\n")):
        first, _, meaning = entry.partition("\n")
        names, _, kind = first.partition(" : ")
        kind = kind.strip().removesuffix(", optional")
        names = ", ".join(f"`{name}`" for name in names.split(", "))
        told = names + (f" ({kind})" if kind else "")
        meaning = " ".join(inspect.cleandoc(f"\n{meaning}").split()).replace("<", r"\<")
        items.append(f"- {told}: {meaning}" if meaning else f"- {told}")
    return "\n".join(["", *items, ""])


# Tables of measurements and other data


def pages_of_data() -> dict[str, str]:
    """Return the pages of circuits, gallery and zoo."""
    if str(REPOSITORY / "dev" / "tools") not in sys.path:
        sys.path.append(str(REPOSITORY / "dev" / "tools"))
    circuits, gallery, zoo = (
        importlib.import_module(name) for name in ("circuits_page", "gallery", "zoo_page")
    )
    return {
        "circuits.md": circuits.circuits_page(),
        "gallery.md": gallery.gallery_page(),
        "zoo.md": zoo.zoo_page(),
    }


# Files that live elsewhere


def copied_page(source: str) -> str:
    """Return a Markdown file of the repository, its links turned so that they hold in
    docs/generated.
    """
    file = REPOSITORY / source
    own_page = {REPOSITORY / path: f"{name}.md" for name, path in COPIES.items()}

    def turned(match: re.Match[str]) -> str:
        link, mark, anchor = match[2].partition("#")
        if not link or "://" in link:
            return match[0]
        target = Path(os.path.normpath(file.parent / link))
        if target in own_page:
            return f"{match[1]}({own_page[target]}{mark}{anchor})"
        place = os.path.relpath(target, REPOSITORY / "docs" / "generated")
        return f"{match[1]}({place}{mark}{anchor})"

    return re.sub(r"(\[[^\]]*\])\(([^)\s]+)\)", turned, file.read_text(encoding="utf-8"))


# Reference


def packages() -> list[str]:
    """Names of the packages that have a page."""
    found = [
        _dotted(file.parent)
        for root in ("pcs_racing", "pcs_racing_agents")
        for file in _initials(root)
    ]
    return [name for name in found if name in REFERENCE]


def _initials(root: str) -> list[Path]:
    return sorted((REPOSITORY / root).rglob("__init__.py"))


def _dotted(path: Path) -> str:
    return ".".join(path.relative_to(REPOSITORY).with_suffix("").parts)


def public_modules(package: str) -> list[str]:
    """Modules of a package that hold something public."""
    files = sorted((REPOSITORY / package.replace(".", "/")).glob("*.py"))
    return [_dotted(file) for file in files if file.stem != "__init__" and public_names(file)]


@cache
def public_names(file: Path) -> list[str]:
    """Names that a module defines without a leading underscore; those that ``__all__`` lists, if
    there is one.
    """
    names: list[str] = []
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            parts = [
                part
                for target in targets
                for part in ast.walk(target)
                if isinstance(part, ast.Name)
            ]
            assigned = [part.id for part in parts if isinstance(part.ctx, ast.Store)]
            if assigned == ["__all__"]:
                return list(ast.literal_eval(node.value))
            names += assigned
    return [name for name in names if not name.startswith("_")]


def reference_page(package: str) -> str:
    """Return the page of a package, as reStructuredText."""
    title = (
        package
        if REFERENCE[package] == "The package itself"
        else f"{REFERENCE[package]}: {package}"
    )
    text = [title, "=" * len(title), ""]
    for module in public_modules(package):
        name = module.removeprefix(f"{package}.")
        text += [name, "-" * len(name), "", f".. automodule:: {module}", "   :members:"]
        if package == "pcs_racing.f1tenth":
            # its names are the gym's, some of them ours: Track means ours in a signature
            text.append("   :no-index:")
        if again := _names_from_elsewhere(module):
            text.append(f"   :exclude-members: {', '.join(again)}")
        text.append("")
    return "\n".join(text)


def _names_from_elsewhere(module: str) -> list[str]:
    """Return the public names of a module that another one of ours defines."""
    file = REPOSITORY / f"{module.replace('.', '/')}.py"
    imported = {
        alias.name
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("pcs_racing")
        for alias in node.names
    }
    return sorted(imported & set(public_names(file)))


def names_page() -> str:
    """Return a table of the names of ``pcs_racing``, with links to their descriptions."""
    import pcs_racing

    lines = ["# What `pcs_racing` offers\n", "| name | meaning | defined in |", "|---|---|---|"]
    for name in pcs_racing.__all__:
        thing = getattr(pcs_racing, name)
        if inspect.ismodule(thing):
            continue
        explained = callable(thing) and str(getattr(thing, "__module__", "")).startswith(
            "pcs_racing"
        )
        module = thing.__module__ if explained else _where(name)
        meaning = (inspect.getdoc(thing) or "").partition("\n\n")[0] if explained else "A value."
        lines.append(
            f"| {{py:obj}}`~{module}.{name}` | {_to_markdown(' '.join(meaning.split()))} |"
            f" `{module}` |"
        )
    return "\n".join(lines) + "\n"


def _where(name: str) -> str:
    files = sorted((REPOSITORY / "pcs_racing").rglob("*.py"))
    return next(
        _dotted(file) for file in files if file.stem != "__init__" and name in public_names(file)
    )


# The list of pages


def unlisted(folder: Path) -> list[str]:
    """Pages of a folder that its index does not list."""
    index = (folder / "index.md").read_text(encoding="utf-8")
    lists = "\n".join(re.findall(r"```\{toctree\}\n(.*?)```", index, flags=re.DOTALL))
    listed = set(re.findall(r"^(?:.*<)?([\w/]+)>?$", lists, flags=re.MULTILINE)) | {"index"}
    return [page.stem for page in sorted(folder.glob("*.md")) if page.stem not in listed]


def mend_page(app, name, source) -> None:
    """Turn links to copied pages to the copies; add to the index what it does not list, so that no
    page is lost.
    """
    if "/" not in name:
        for copy, original in {**COPIES, "../index": "README.md"}.items():
            source[0] = source[0].replace(f"](../{original}", f"](generated/{copy}.md")
    rest = unlisted(Path(app.srcdir)) if name == "index" else []
    if rest:
        source[0] += "\n```{toctree}\n:caption: More\n:hidden:\n\n" + "\n".join(rest) + "\n```\n"


# Docstrings and signatures for autodoc

SOURCE = re.compile(r"^\.\. (\[\d+\])")
CITED = re.compile(r"(\[\d+\])_")
ARRAY = re.compile(
    r"~?[\w.]*ndarray\[tuple\[~?[\w.]*Any, \.\.\.\], ~?[\w.]*dtype\[[^\[\]]*(\[[^\[\]]*\])?\]\]"
)
ARRAY_LIKE = re.compile(
    r"~?[\w.]*_Buffer \| .*?\| ~?[\w.]*_NestedSequence\[complex \| bytes \| str\]"
)


def mend_docstring(app, what, name, thing, options, lines) -> None:
    """Make a docstring good for Sphinx, before napoleon reads it.

    The environments' descriptions are Markdown, and pages of their own: the reference only links
    them. Bars stand for absolute values, not for substitutions; the numbers of sources count within
    their module, not on the whole page.
    """
    del app, thing, options
    if lines and lines[0].startswith("Alias for field number"):
        lines.clear()  # a field of a named tuple without a comment of ours
    if what in ("data", "attribute", "property") and lines:
        # or napoleon takes what stands before a colon for its type, and Sphinx links its words
        lines[:0] = ["..", ""]
    for page, (module, class_name, _) in ENVIRONMENTS.items():
        if name == f"{module}.{class_name}":
            lines[:] = [lines[0], "", f"Its page is :doc:`/generated/{page}`.", ""]
    for number, line in enumerate(lines):
        if SOURCE.match(line):
            for after in range(number + 1, len(lines)):
                if not lines[after].strip():
                    break
                lines[after] = lines[after].strip()
        literals = re.split(r"(``.*?``)", CITED.sub(r"\1", SOURCE.sub(r"\1", line)))
        lines[number] = "".join(
            part if part.startswith("``") else part.replace("|", r"\|") for part in literals
        )


def skip_settings(app, what, name, thing, skip, options):
    """Skip a setting without a value: the list of settings in the docstring has it."""
    del app, options
    return True if what == "class" and name == "opponent" and thing is None else skip


def shorten_signature(app, what, name, thing, options, signature, returned):
    """Say ``ndarray`` and ``ArrayLike`` in signatures, not the parts of these types; docstrings
    give the shapes.
    """
    del app, what, name, thing, options
    return tuple(
        part and ARRAY_LIKE.sub("ArrayLike", ARRAY.sub("ndarray", part))
        for part in (signature, returned)
    )
