"""The pages of the documentation: links lead somewhere, and code blocks are of a kind that is run."""

import functools
import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from markdown_it import MarkdownIt
from markdown_it.token import Token

MARKDOWN = MarkdownIt("commonmark").enable("table")
ROOT = Path(__file__).parents[2]
FOLDERS = ("docs", "benchmarks", "experiments", "datasets")
PAGES = sorted([*ROOT.glob("*.md"), *(page for folder in FOLDERS for page in ROOT.glob(f"{folder}/**/*.md"))])


def tokens(text: str) -> Iterator[Token]:
    for token in MARKDOWN.parse(text):
        yield token
        yield from token.children or ()


def targets(page: Path) -> list[str]:
    text = page.read_text(encoding="utf-8")
    found = [t.attrGet("href") or t.attrGet("src") for t in tokens(text) if t.type in ("link_open", "image")]
    return [str(target) for target in found] + re.findall(r'<(?:img|a)\b[^>]*\b(?:src|href)="([^"]+)"', text)


@functools.cache
def anchors(page: Path) -> set[str]:
    """Names of the headings of a page, made as GitHub makes them."""
    found: set[str] = set()
    heading = False
    for token in MARKDOWN.parse(page.read_text(encoding="utf-8")):
        if heading:
            text = "".join(t.content for t in token.children or () if t.type in ("text", "code_inline"))
            slug = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
            number = sum(other == slug or re.fullmatch(rf"{re.escape(slug)}-\d+", other) is not None for other in found)
            found.add(f"{slug}-{number}" if number else slug)
        heading = token.type == "heading_open"
    return found


def broken(page: Path) -> list[str]:
    wrong = []
    for target in targets(page):
        parts = urlsplit(target)
        if parts.scheme:
            continue
        file = (page.parent / unquote(parts.path)).resolve() if parts.path else page
        missing_heading = file.suffix == ".md" and parts.fragment and file.is_file() and parts.fragment not in anchors(file)
        if not file.exists() or missing_heading:
            wrong.append(target)
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_relative_links_and_images_exist(page: Path) -> None:
    assert broken(page) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_python_block_escapes_the_runner(page: Path) -> None:
    languages = [t.info for t in tokens(page.read_text(encoding="utf-8")) if t.type == "fence"]
    assert [
        info
        for info in languages
        if info.lower().startswith(("py", "bash run")) and info not in ("python", "python recipe", "bash run")
    ] == []


def test_the_runner_runs_python_and_marked_bash(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text((ROOT / "conftest.py").read_text(encoding="utf-8"), encoding="utf-8")
    good = "```python\n# written.py\nx = 1\n```\n```bash run\ncat written.py | grep 'x = 1'\n```\n```bash\nfalse\n```\n"
    pages = {
        "good.md": good + "```python\nassert x == 1\n```\n",
        "python.md": "```python\nassert 1\n```\n\n```python\nassert 0, 'wrong'\n```\n",
        "bash.md": "```bash run\ntrue\n```\n\n```bash run\nfalse\n```\n",
        "text.md": "No code.\n",
    }
    for name, text in pages.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *pages]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "2 failed, 1 passed" in done.stdout, done.stdout
    assert "python.md:6: AssertionError" in done.stdout
    assert "line 5: exit status 1 of:" in done.stdout


COMMAND = re.compile(r"(?:python -m shuttle_marl[. ]|shuttle-marl )([a-z]\w+)([^\n`#|]*)")


def test_every_option_that_pages_name_exists() -> None:
    """The help of each command is a page of its own."""
    helps = {page.stem: "".join(page.read_text().split("```text")[1:]) for page in ROOT.glob("docs/commands/*.md")}
    known = {command: set(re.findall(r"--[a-z][a-z-]*", text)) for command, text in helps.items()}
    found = [(page, *match) for page in PAGES for match in COMMAND.findall(page.read_text().replace("\\\n", " "))]
    assert len(found) > 150
    unknown = [
        f"{page.relative_to(ROOT)}: {command} {option}"
        for page, command, words in found
        for option in re.findall(r"(?<=\s)--[a-z][a-z-]*", words)
        if option not in known[command] | {"--help"}
    ]
    assert unknown == []


REFERENCE = re.compile(r":\w+:`~?(shuttle_marl[\w.]*)`|(?:from|import) (shuttle_marl[\w.]*)|``(shuttle_marl(?:\.\w+)+)``")
REFERRING = ("shuttle_marl", "docs", "benchmarks", "experiments")


def leads_somewhere(reference: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one at any depth."""
    parts = reference.rstrip(".").split(".")
    for depth in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:depth]))
        except ModuleNotFoundError:
            continue
        for name in parts[depth:]:
            if not hasattr(found, name) and name not in getattr(found, "__annotations__", {}):
                return False
            found = getattr(found, name, None)
        return True
    return False


def test_references_lead_somewhere() -> None:
    files = [path for folder in REFERRING for path in sorted((ROOT / folder).rglob("*")) if path.suffix in (".py", ".md")]
    found = {(name, path) for path in files for match in REFERENCE.finditer(path.read_text()) for name in match.groups() if name}
    missing = [f"{path.relative_to(ROOT)}: {name}" for name, path in sorted(found) if not leads_somewhere(name)]
    assert not missing, "\n".join(missing)
