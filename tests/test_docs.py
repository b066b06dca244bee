"""The documentation holds: its code runs, its commands parse, its links lead somewhere, its site
is complete.
"""

import ast
import contextlib
import csv
import io
import re
import shlex
from pathlib import Path

import pytest
from repository import REPOSITORY, load_tool, python_blocks, run_block

from pcs_racing.track.maps import list_tracks
from pcs_racing_agents.cli.main import _parser

DOCS = REPOSITORY / "docs"
OF_DOCS = [
    page for pattern in ("*.md", "reports/*.md", "notebooks/*.md") for page in DOCS.glob(pattern)
]
PAGES = sorted([*OF_DOCS, *REPOSITORY.glob("*.md"), *REPOSITORY.glob("[!.]*/README.md")])
TEXTS = {
    page.relative_to(REPOSITORY).as_posix(): page.read_text(encoding="utf-8") for page in PAGES
}

# PPO of SB3 drives at least a rollout.
SHORTER = {
    "learn(20_000, progress_bar=True)": "learn(1)",
    "learn(10_000, progress_bar=True)": "learn(1)",
    "learn(4_096)": "learn(1)",
    "races_per_pair=100": "races_per_pair=2",
    "for k in range(2)]": "for k in range(1)]",
}
BLOCKS = {page: python_blocks(text) for page, text in TEXTS.items()}


@pytest.mark.usefixtures("own_registry")
@pytest.mark.parametrize(
    ("page", "number"),
    [(page, number) for page, blocks in BLOCKS.items() for number in range(len(blocks))],
)
def test_the_code_runs(page, number, tmp_path, monkeypatch):
    code = BLOCKS[page][number]
    if code.startswith("# after the code above"):
        code = BLOCKS[page][number - 1] + code
    for library in ("stable_baselines3", "sb3_contrib", "supersuit", "torchrl"):
        if library in code:
            pytest.importorskip(library)
    for words, library in (("pcs_racing_agents.learning", "torch"), ("import pyspiel", "pyspiel")):
        if words in code:
            pytest.importorskip(library, reason=f"{library} is not installed")
    for long, short in SHORTER.items():
        code = code.replace(long, short)
    monkeypatch.chdir(tmp_path)
    run_block(code)


def command_lines(text: str) -> list[str]:
    """Commands in console blocks, joined where a line goes on, without their comments."""
    blocks = re.findall(r"```(?:console|bash|sh)\n(.*?)```", text, flags=re.DOTALL)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line.removeprefix("$ ").strip() for line in lines if line.strip()]


COMMANDS = [(page, line) for page, text in TEXTS.items() for line in command_lines(text)]


def words(line: str) -> list[str]:
    """Words of a command, without its comment and the part behind a pipe or an ampersand."""
    found = shlex.split(line, comments=True)
    return found[
        : min(
            (found.index(end) for end in ("|", "&", "&&", ">") if end in found), default=len(found)
        )
    ]


def parses(arguments: list[str]) -> bool:
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            return callable(_parser().parse_args(arguments).run)
        except SystemExit as done:
            return done.code == 0  # --help


@pytest.mark.parametrize(
    ("page", "line"),
    [(page, line) for page, line in COMMANDS if re.search(r"(^|/)pcs-racing ", line)],
)
def test_commands_are_those_of_the_command_line(page, line):
    found = words(line)
    program = next(number for number, word in enumerate(found) if word.endswith("pcs-racing"))
    assert parses(found[program + 1 :]), f"{page}: {line}"


def test_commands_within_lines_exist_and_impossible_ones_are_found():
    named = {
        name
        for page, text in TEXTS.items()
        if page != "CHANGELOG.md"  # its commands are of their versions
        for name in re.findall(r"`(?:[\w./]*/)?pcs-racing ([a-z-]+)", text)
    }
    assert {"train", "study", "track"} <= named
    for name in named:
        assert parses([name, "--help"]), name
    assert not parses(["race", "--trak", "Pipkin"])
    assert not parses(["rase"])
    assert words("pcs-racing agents   # all of them") == ["pcs-racing", "agents"]


def test_scripts_and_targets_exist_and_make_help_names_the_targets():
    workflows = [file.read_text("utf-8") for file in (REPOSITORY / ".github").rglob("*.yml")]
    # Pages name the commit of a script that is gone.
    gone = r"commit\s+[0-9a-f]{7}\s+with\s+`python dev/benchmarks/\w+\.py"
    text = re.sub(gone, "", "\n".join([*TEXTS.values(), *workflows]))
    named = set(re.findall(r"\b(?:examples|dev/benchmarks|dev/tools)/\w+\.py\b", text))
    assert len(named) > 15
    assert [name for name in sorted(named) if not (REPOSITORY / name).is_file()] == []
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    targets = {"install", "demo", "quick", "test", "lint", "docs", "release"}
    assert set(re.findall(r"^([a-z-]+):(?!=)", makefile, re.MULTILINE)) == targets | {"help"}
    assert set(re.findall(r'@echo "make ([\w-]+)', makefile)) == targets
    lines = re.findall(r"(?:^|run: |`)make((?: [a-z]+)+)", text, re.MULTILINE)
    assert {word for line in lines for word in line.split()} <= targets | {"help"}
    sessions = re.findall(r"nox -s \"?(\w+)", text)
    noxfile = (REPOSITORY / "noxfile.py").read_text(encoding="utf-8")
    assert [name for name in sessions if f"\ndef {name}(" not in noxfile] == []


@pytest.fixture(scope="module")
def site():
    return load_tool("site_pages", "docs")


@pytest.fixture(scope="module")
def made(site):
    return site.made_pages()


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as GitHub and the site make them."""
    headings = re.findall(
        r"^#+ +(.*?) *$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), flags=re.MULTILINE
    )
    return {
        re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower()).replace(" ", "-")
        for heading in headings
    }


def leads_somewhere(page: str, link: str, made: dict[str, str]) -> bool:
    path, _, anchor = link.partition("#")
    if "generated/" in path:  # made when the site is built
        return path.partition("generated/")[2] in made
    target = ((REPOSITORY / page).parent / path).resolve() if path else REPOSITORY / page
    if not target.exists():
        return False
    return target.suffix != ".md" or not anchor or anchor in anchors(target.read_text("utf-8"))


def test_links_lead_somewhere(made):
    links = [
        (page, link)
        for page, text in TEXTS.items()
        for link in re.findall(
            r"\]\(([^)\s]+)\)", re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)
        )
        if "://" not in link
    ]
    assert len(links) > 100
    assert [link for link in links if not leads_somewhere(*link, made)] == []


def test_every_example_has_one_row_and_says_in_a_line_what_it_does():
    folder = REPOSITORY / "examples"
    rows = re.findall(r"^\| [^|]*\| \[[\w.]+\]\((\S+)\) \| ", TEXTS["examples/README.md"], re.M)
    files = {*folder.glob("*.*"), *folder.glob("clients/*.*"), *folder.glob("*/package.xml")}
    names = {file.relative_to(folder).as_posix() for file in files}
    assert sorted(rows) == sorted(names - {"README.md"})
    for file in folder.rglob("*.py"):
        summary = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))).partition("\n")[0]
        assert len(summary) <= 90, file
        assert summary.endswith("."), file


def test_environment_pages_have_all_headings_and_copied_pages_their_links(site, made):
    for name in site.ENVIRONMENTS:
        page = site.environment_page(name)
        for heading in (
            "Description",
            "Action Space",
            "Observation Space",
            "Rewards",
            "Starting State",
            "Episode End",
            "Arguments",
            "Vectorized environment",
        ):
            assert f"\n## {heading}\n" in page, f"{name}: {heading}"
        assert "``" not in page.replace("```", "")
        assert ":class:" not in page
    assert "- `beams` (int): Beams of the lidar" in site.environment_page("drive")
    for name, row in (
        ("drive", "| 9 + 4 i | line speed # m ahead | m/s | 0 | 20 | speed of the race line # m"),
        ("drive", "| 41 + i | beam # | m | 0 | 30 | range of beam #, counted counter-clockwise |"),
        ("duel", "| 5 + 6 i | seen_# | 1 | 0 | 1 | 1 once step # is over; until then it and the"),
        ("duel", "| 30 | step | 1 | 0 | 1 | share of the moves that have been made |"),
    ):
        assert f"\n{row}" in site.environment_page(name)
    for source in site.COPIES.values():
        for link in re.findall(r"\]\(([^)\s#]+)", site.copied_page(source)):
            if "://" not in link and link not in made:
                assert (DOCS / "generated" / link).resolve().exists(), f"{source}: {link}"


def test_the_reference_has_every_public_module(site):
    known = {module for package in site.packages() for module in site.public_modules(package)}
    for root in ("pcs_racing", "pcs_racing_agents"):
        for file in (REPOSITORY / root).rglob("*.py"):
            module = ".".join(file.relative_to(REPOSITORY).with_suffix("").parts)
            inner = file.stem == "__init__" or ".cli." in module or "__main__" in module
            assert inner or not site.public_names(file) or module in known, (
                f"{module} is not in site_pages.REFERENCE"
            )
    listed = set(re.findall(r"^generated/api/(\S+)$", TEXTS["docs/api.md"], flags=re.MULTILINE))
    assert listed == {*site.packages(), "names"}


def test_the_readme_is_short():
    assert len(TEXTS["README.md"].splitlines()) <= 150


def test_results_name_every_benchmark():
    for script in (REPOSITORY / "dev" / "benchmarks").glob("*.py"):
        assert f"`dev/benchmarks/{script.name}`" in TEXTS["docs/reports/results.md"]


def test_every_figure_of_the_list_of_checks_stands_on_its_page():
    with (DOCS / "figures.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["checked"] for row in rows} <= {"run", "table", "report", "code", "test"}
    drifted = [
        row["figure"] for row in rows if row["figure"] not in " ".join(TEXTS[row["page"]].split())
    ]
    assert not drifted, f"not on their pages: {drifted}; check them again and mend docs/figures.csv"


def test_the_pages_of_circuits_and_the_gallery_are_complete(made):
    page = made["circuits.md"]
    for name in list_tracks():
        assert re.search(
            rf"^\| \[{name}\]\(#{name.lower()}\) \| \d+ m \| \d\.\d m \| ", page, flags=re.MULTILINE
        ), name
        assert f"]({Path('../../maps') / name / name}.png)" in page
    assert "| [Pipkin](#pipkin) | 58 m | 2.2 m | 9.3 s | 4.2 to 8.0 m/s | " in page
    gallery = load_tool("gallery")
    pictures = sorted((DOCS / gallery.FOLDER).glob("*.gif"))
    wanted = {
        f"{kind}-{circuit.lower()}.gif" for kind in gallery.SCENES for circuit in gallery.CIRCUITS
    }
    assert {picture.name for picture in pictures} == wanted, "run: python dev/tools/gallery.py"
    for picture in pictures:
        assert picture.stat().st_size <= gallery.MAX_GIF
        assert f"](../{gallery.FOLDER}/{picture.name})" in made["gallery.md"]
    for scene in gallery.SCENES.values():
        assert scene.rule in made["gallery.md"]
