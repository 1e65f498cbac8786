"""The site: navigation, reference, pages of commands and of rallies, and the description of the sample."""

import ast
import gzip
import json
import re
from pathlib import Path

import pytest

import shuttle_marl
from docs.tools import command_reference, croissant, live_pages, notebooks, site
from docs.tools.markdown import ROOT
from shuttle_marl.staging import model_file
from shuttle_marl.watch.messages import Request
from shuttle_marl.watch.plan import Plan


def test_every_page_of_the_site_is_in_the_navigation() -> None:
    found = {page for _, pages in site.sections((ROOT / "docs/index.md").read_text()) for page in pages}
    paths = {(ROOT / "docs" / f"{page}.md").resolve() for page in found}
    pages = {path for pattern in site.PAGES for path in ROOT.glob(pattern) if path.suffix == ".md"}
    assert pages - paths == {ROOT / "docs/index.md"}
    assert paths <= pages


def test_the_reference_has_every_public_name() -> None:
    """Sphinx reads the module that defines a name, and the name is in ``__all__`` of a package below the top."""
    unread = set(site.unpublished())
    exported = set()
    for path in (ROOT / "shuttle_marl").glob("*/**/*.py"):
        text = path.read_text(encoding="utf-8")
        if str(path) not in unread and "\n__all__" in text:
            (names,) = (
                ast.literal_eval(node.value)
                for node in ast.parse(text).body
                if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
            )
            exported |= set(names)
    batched = ROOT / "shuttle_marl/env/batched.py"
    assert str(batched) not in unread
    own = {node.name for node in ast.parse(batched.read_text()).body if isinstance(node, ast.ClassDef)}
    assert set(shuttle_marl.__all__) - {"__version__"} <= exported | own
    assert str(ROOT / "shuttle_marl/commands/cli.py") in unread


def test_every_public_name_has_an_example() -> None:
    pages = [*ROOT.glob("docs/**/*.md"), ROOT / "README.md"]
    blocks = [
        block
        for page in pages
        for block in re.findall(r"^```python[^\n]*\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    ]
    used = set(re.findall(r"\w+", "\n".join(blocks)))
    assert set(shuttle_marl.__all__) - {"__version__"} - used == set()


def test_the_page_of_commands_is_their_help() -> None:
    command_reference.main(check=True)


def test_the_sample_is_described() -> None:
    croissant.main(check=True)


def decoded(text: str) -> bytes:
    """Decodes basE91 as ``watch/page/src/base91.ts`` does."""
    letters = [chr(code) for code in range(33, 127) if chr(code) not in '"\\<']
    out, rest, bits, first = bytearray(), 0, 0, -1
    for letter in text:
        value = letters.index(letter)
        if first < 0:
            first = value
            continue
        pair, first = first + 91 * value, -1
        rest |= pair << bits
        bits += 14 if pair & 8191 <= 88 else 13
        while bits > 7:
            out.append(rest & 255)
            rest >>= 8
            bits -= 8
    if first >= 0:
        out.append((rest | first << bits) & 255)
    return bytes(out)


def test_a_page_with_rallies_holds_the_replies_of_the_server(tmp_path: Path) -> None:
    """As ``watch/page/src/main.ts`` reads them."""
    (tmp_path / "watch.css").write_text("a::after { content: '</style>' }")
    (tmp_path / "watch.js").write_text("'</script><!--'")
    plan = Plan.parse({"seed": 3, "sides": [{"policy": "a<b"}, {"policy": "c"}]})

    def answers(request: Request) -> bytes:
        return f"{type(request).__name__} {getattr(request, 'rally', '')}".strip().encode()

    page = live_pages.saved_page(answers, plan, [2, 3], tmp_path)
    (text,) = re.findall(r'<script type="application/json" id="shared">(.*?)</script>', page)
    shared = json.loads(text)
    unpacked = {key: gzip.decompress(decoded(value)).decode() for key, value in shared["replies"].items()}
    assert unpacked == {
        "styles": "StylesRequest 2",
        "rally 2": "RallyRequest 2",
        "analysis 2": "AnalysisRequest 2",
        "rally 3": "RallyRequest 3",
        "analysis 3": "AnalysisRequest 3",
        "match": "MatchRequest 3",
    }
    assert gzip.decompress(decoded(shared["hello"])) == b"HelloRequest"
    assert gzip.decompress(decoded(shared["models"]["male"])) == model_file("male").read_bytes()
    assert '"#seed=3&a=a\\u003cb&b=c&rally=3&stroke=1"' in page
    assert "<title>a&lt;b against c</title>" in page
    assert page.count("</style>") == 1
    assert page.count("</script>") == 3
    assert "connect-src data: blob:" in page


@pytest.mark.parametrize("name", notebooks.NAMES)
def test_tutorials_are_notebooks(name: str) -> None:
    text = notebooks.text_form(name)
    assert text.startswith("---\njupyter:")
    assert "bash run" not in text
    links = re.findall(r"\]\(([^)#]+\.md)", text)
    assert all((ROOT / "docs/notebooks" / link).resolve().is_file() for link in links if not link.startswith("http"))
