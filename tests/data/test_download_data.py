"""Download against a server on this machine, the fixed splits, the datasheet, and the simulated sample of the repository."""

import hashlib
import http.server
import json
import runpy
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import pyarrow.parquet as pq
import pytest

from shuttle_marl.base.files import FileWriteError
from shuttle_marl.commands.data import main
from shuttle_marl.data import matches_of, read_matches, upstream
from shuttle_marl.data.schema import DROP_REASONS, STROKES
from shuttle_marl.data.table import load_counted
from shuttle_marl.data.upstream import SPLITS, DownloadError, discipline, download, player_id

CONTENT = {
    "ShuttleSet/set/match.csv": b"id,video\n",
    "ShuttleSet/set/A_B_Open_2022 _Finals/set1.csv": b"rally\n" + b"1\n" * 5000,
    "ShuttleSet/set/A_B_Group D#1/set2.csv": "發短球\n".encode() * 3000,
}
MANIFEST = {path: hashlib.sha256(content).hexdigest() for path, content in CONTENT.items()}
FIRST, SPACED, HASHED = CONTENT


class Server(http.server.ThreadingHTTPServer):
    """Serves CONTENT; ``plan`` holds what to do instead with the next requests for a path."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.asked: Counter[str] = Counter()
        self.plan: dict[str, list[str]] = {}
        self.content = dict(CONTENT)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/root"


class Handler(http.server.BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        path = unquote(self.path).removeprefix("/root/")
        self.server.asked[path] += 1
        steps = self.server.plan.get(path, [])
        step = steps.pop(0) if steps else ""
        content = self.server.content.get(path)
        if step.isdigit() or content is None:
            self.send_error(int(step or 404))
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if step == "drop":
            self.wfile.write(content[:100])
            self.wfile.flush()
            self.connection.close()
        else:
            self.wfile.write(content[::-1] if step == "corrupt" else content)

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with Server() as serving:
        thread = threading.Thread(target=serving.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield serving
        serving.shutdown()
        thread.join(timeout=5)


def fetch(server: Server, out: Path, **options: object) -> int:
    settings: dict[str, Any] = {"base_url": server.url, "hashes": MANIFEST, "pause": 0.01, **options}
    return download(out, **settings)


def files(out: Path) -> dict[str, bytes]:
    """Everything below a folder but the licence."""
    found = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    found.pop("LICENSE", None)
    return found


def test_fetches_everything(server: Server, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    assert fetch(server, tmp_path, on_file=lambda done, total: seen.append((done, total))) == 3
    assert files(tmp_path) == CONTENT
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert (tmp_path / "LICENSE").read_text().startswith("MIT License\n\nCopyright (c) 2022 Wei-Yao Wang")


def test_whole_files_are_not_fetched_again(server: Server, tmp_path: Path) -> None:
    fetch(server, tmp_path)
    server.asked.clear()
    assert fetch(server, tmp_path) == 0
    assert not server.asked
    (tmp_path / SPACED).write_bytes(b"altered")
    (tmp_path / FIRST).unlink()
    assert fetch(server, tmp_path) == 2
    assert server.asked == {SPACED: 1, FIRST: 1}
    assert files(tmp_path) == CONTENT


WRONG = hashlib.sha256(CONTENT[SPACED][::-1]).hexdigest()


@pytest.mark.parametrize(("failure", "told"), [
    ("drop", "no answer ("), ("503", "503 Server Error"), ("corrupt", f"SHA-256 is {WRONG}, expected {MANIFEST[SPACED]}"),
])  # fmt: skip
def test_failures_are_tried_again_some_times(server: Server, tmp_path: Path, failure: str, told: str) -> None:
    server.plan[SPACED] = [failure] * 3
    with pytest.raises(DownloadError) as caught:
        fetch(server, tmp_path, retries=2)
    assert server.asked[SPACED] == 3
    assert quote(SPACED) in str(caught.value)
    assert told in str(caught.value)
    assert "gave up after 3 tries; complete files are kept" in str(caught.value)
    assert SPACED not in files(tmp_path)
    assert not [name for name in files(tmp_path) if name.endswith(".part")]
    server.plan[SPACED] = [failure] * 2
    fetch(server, tmp_path, retries=2)
    assert files(tmp_path) == CONTENT


def test_offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as closed:
        port = closed.server_port
    with pytest.raises(DownloadError, match=r"ConnectionRefusedError.*is this machine online\?"):
        download(tmp_path, base_url=f"http://127.0.0.1:{port}", hashes=MANIFEST, retries=1, pause=0.01)
    assert files(tmp_path) == {}


def test_unwritable_file_is_named(server: Server, tmp_path: Path) -> None:
    (tmp_path / SPACED).mkdir(parents=True)
    with pytest.raises(FileWriteError, match=r"set1\.csv: cannot be written"):
        fetch(server, tmp_path, hashes={SPACED: MANIFEST[SPACED]})
    assert files(tmp_path) == {}


def test_command(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(upstream, "manifest", lambda: MANIFEST)
    assert main(["download", "--out", str(tmp_path), "--base-url", server.url]) == 0
    out = capsys.readouterr().out
    assert f"{tmp_path}: 3 files, all as published (3 downloaded, 0 present already)" in out
    assert "MIT License" in out
    assert "KDD 2023" in out
    assert "2306.15664" in out
    del server.content[SPACED]
    (tmp_path / SPACED).unlink()
    assert main(["download", "--out", str(tmp_path), "--base-url", server.url]) == 1
    assert "404" in capsys.readouterr().err


DATASETS = Path(__file__).parents[2] / "datasets"
SAMPLE = DATASETS / "sample" / "strokes.parquet"
SCRIPT = runpy.run_path(str(DATASETS / "make_sample.py"))


def test_the_sample_is_sound(capsys: pytest.CaptureFixture[str]) -> None:
    assert SAMPLE.stat().st_size < 1_000_000
    assert main(["validate", str(SAMPLE)]) == 0
    assert main(["summary", str(SAMPLE), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["strokes"]["kept"] == read_matches(SAMPLE).num_rows > 3000
    assert summary["area_agreement"] is None
    assert set(read_matches(SAMPLE)["source"].to_pylist()) == {"simulated"}


def test_the_card_tells_of_this_sample() -> None:
    provenance = json.loads(pq.read_schema(SAMPLE).metadata[b"shuttle_marl.provenance"])
    text = SCRIPT["card"](read_matches(SAMPLE), load_counted(SAMPLE)[1], provenance, size=SAMPLE.stat().st_size)
    assert (SAMPLE.parent / "CARD.md").read_text(encoding="utf-8") == text


def test_a_small_one_can_be_drawn_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "again"):
        SCRIPT["make_sample"](players=("random", "safe"), matches=1, seed=3, out=tmp_path / name / "strokes.parquet")
    assert (tmp_path / "one/strokes.parquet").read_bytes() == (tmp_path / "again/strokes.parquet").read_bytes()
    assert main(["validate", str(tmp_path / "one/strokes.parquet")]) == 0
    assert "1 matches" in (tmp_path / "one/CARD.md").read_text(encoding="utf-8")
    assert set(read_matches(tmp_path / "one/strokes.parquet")["player"].to_pylist()) == {"random", "safe"}


DATASHEET = Path(__file__).parents[2] / "docs" / "datasheet.md"
LINES = DATASHEET.read_text(encoding="utf-8").splitlines()


def test_fields() -> None:
    expected = [
        f"| `{f.name}` | {f.type} | {'yes' if f.nullable else 'no'} | {f.metadata[b'description'].decode()} |" for f in STROKES
    ]
    start = LINES.index("| field | type | null | meaning |") + 2
    assert LINES[start : start + len(expected) + 1] == [*expected, ""]


def test_drop_reasons() -> None:
    start = LINES.index("| dropped because | rows | that is |") + 2
    rows = [line.split(" | ") for line in LINES[start : LINES.index("", start)]]
    assert [(row[0].removeprefix("| "), row[2].removesuffix(" |")) for row in rows] == list(DROP_REASONS.items())


def test_every_published_match_is_in_exactly_one_split() -> None:
    published = {upstream.match_of(path) for path in upstream.manifest()} - {None}
    by_split = [set(matches_of(split)) for split in SPLITS]
    assert [len(names) for names in by_split] == [68, 14, 12]
    assert set.union(*by_split) == published
    assert sum(map(len, by_split)) == len(published) == 94


@pytest.mark.parametrize(("name", "identifier", "kind"), [
    ("CHEN Yufei", "chen-yufei", "WS"), ("Chen Yufei", "chen-yufei", "WS"), ("HE Bingjiao", "he-bingjiao", "WS"),
    ("PUSARLA V. Sindhu", "pusarla-v-sindhu", "WS"), ("PRANNOY H. S.", "prannoy-h-s", "MS"),
    ("Hans-Kristian Solberg VITTINGHUS", "hans-kristian-solberg-vittinghus", "MS"), ("Nobody", "nobody", None),
])  # fmt: skip
def test_players(name: str, identifier: str, kind: str | None) -> None:
    assert player_id(name) == identifier
    assert discipline(identifier) == kind
