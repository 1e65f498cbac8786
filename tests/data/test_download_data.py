"""Download against a server on this machine: resume, corruption, errors, kills."""

import hashlib
import http.server
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import pytest

from shuttle_marl.base.files import FileWriteError
from shuttle_marl.commands.data import main
from shuttle_marl.data import upstream
from shuttle_marl.data.upstream import DownloadError, download

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
