"""The server against strangers: who may connect, what they may send, its messages, and how it stops."""

import contextlib
import json
import random
import signal
import socket
import struct
import time
import urllib.parse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from docs.tools.wire_types import TARGET, wire_types
from shuttle_marl.court import WatchError
from shuttle_marl.court.messages import OptionsReply, RallyRequest, decode_request, encode_reply, request_id
from shuttle_marl.court.server import MAX_MESSAGE, bind, hosts_of, in_language, refusal
from shuttle_marl.reports.languages import current
from tests.staging.reader import from_parents
from tests.watch.conftest import Served, get, run_script, running, serving

PLAN = {"seed": 1, "sides": [{"policy": "bc"}, {"policy": "random"}]}


def port_of(served: Served) -> int:
    return int(served.address.rstrip("/").rpartition(":")[2])


def connected(port: int, **options: Any) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{port}/ws", max_size=None, proxy=None, **options)


def asked(socket: ClientConnection, request: object) -> tuple[dict[str, Any], bytes]:
    socket.send(request if isinstance(request, str) else json.dumps(request))
    return parsed(socket.recv(timeout=60))


def parsed(message: str | bytes) -> tuple[dict[str, Any], bytes]:
    assert isinstance(message, bytes)
    (length,) = struct.unpack_from("<I", message)
    return json.loads(message[4 : 4 + length]), message[4 + length :]


@pytest.mark.parametrize(
    ("hosts", "origins", "allowed"),
    [
        (["localhost:80"], [], True),
        (["127.0.0.1:8090"], ["http://127.0.0.1:8090"], True),
        (["127.0.0.1:8090"], ["http://localhost:8090"], False),
        (["127.0.0.1:8090"], ["http://127.0.0.1:8090", "http://evil.example"], False),
        (["127.0.0.1.evil.example:8090"], [], False),
        (["127.0.0.1", "127.0.0.1"], [], False),
        (["[::1"], [], False),
        (["127.0.0.1:8090"], ["http://["], False),
    ],
)
def test_only_the_page_of_this_server_may_connect(hosts: list[str], origins: list[str], allowed: bool) -> None:
    assert (refusal(hosts, origins, hosts_of("127.0.0.1")) is None) == allowed


@pytest.mark.parametrize("name", ["DESKTOP-AB12", "Annas-MacBook-Pro.local"])
@pytest.mark.parametrize("everywhere", [True, False])
def test_names_of_machines_are_compared_without_case(name: str, everywhere: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: name)
    allowed = hosts_of("0.0.0.0" if everywhere else name)
    for sent in (name, name.lower()):  # browsers send the latter
        assert refusal([f"{sent}:8090"], [f"http://{name.lower()}:8090"], allowed) is None


def test_a_server_on_all_interfaces_or_behind_a_proxy() -> None:
    everywhere = hosts_of("0.0.0.0")
    assert refusal(["192.0.2.7:8090"], [], everywhere) is None
    assert refusal(["evil.example:8090"], [], everywhere) is not None
    proxies, allowed = ("court.example",), hosts_of("127.0.0.1")
    assert "--allowed-hosts" in str(refusal(["court.example"], ["https://court.example"], allowed))
    for host in ("court.example", "Court.Example:443", "127.0.0.1:8090"):
        assert refusal([host], ["https://court.example"], allowed, proxies) is None
    assert refusal(["court.example"], ["https://evil.example"], allowed, proxies) is not None
    assert refusal(["evil.example"], ["https://court.example"], allowed, proxies) is not None


def test_an_index_speaks_the_language_of_the_server() -> None:
    index = b'<!doctype html><html lang="en"><p><html lang="en">'
    assert in_language(index, "id") == b'<!doctype html><html lang="id"><p><html lang="en">'


def test_a_port_in_use_is_replaced_and_a_host_that_is_not_here_refused() -> None:
    with contextlib.closing(bind("127.0.0.1", 0)) as first:
        port = first.getsockname()[1]
        with contextlib.closing(bind("127.0.0.1", port)) as second:
            assert second.getsockname()[1] not in (0, port)
    for host in ("192.0.2.1", "no host"):
        with pytest.raises(WatchError, match=f"--host {host}: .*; give an address of this machine"):
            bind(host, 0)


def test_a_connection_that_asks_too_fast_has_to_wait(tmp_path: Path) -> None:
    asked_for = 200
    with running(tmp_path) as (_, port), connected(port) as hasty:
        begun = time.monotonic()
        for _ in range(asked_for):
            hasty.send("no request")
        for _ in range(asked_for):
            assert parsed(hasty.recv(timeout=60))[0]["error"]
        # 120 at once, and then 40 a second.
        assert time.monotonic() - begun > 0.9 * (asked_for - 120) / 40


@pytest.mark.slow
def test_files_are_served_and_nothing_else(served: Served) -> None:
    for path, kind in {"/": "text/html", "/watch.js": "text/javascript", "/watch.css": "text/css", "/male.glb": "model/"}.items():
        status, _, told = get(port_of(served), path)
        assert status == 200
        assert told["content-type"].startswith(kind)
        assert "default-src 'none'" in told["content-security-policy"]
    for path in (
        "/../pyproject.toml",
        "/..%2f..%2fpyproject.toml",
        "//etc/passwd",
        "/male.glb/../skeletons.json",
        "/built/index.html",
    ):
        assert get(port_of(served), path)[0] == 404
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "http://["}):
        status, _, told = get(port_of(served), "/", **headers)
        assert status == 403
        assert "default-src 'none'" in told["content-security-policy"]
        assert told["x-content-type-options"] == "nosniff"
        assert told["cross-origin-resource-policy"] == "same-origin"
    with pytest.raises(InvalidStatus):
        connected(port_of(served), origin="http://evil.example")


@pytest.mark.slow
def test_malformed_messages_are_answered_and_others_served(served: Served) -> None:
    drawn = random.Random(0)
    words = ["rally", "analysis", "hello", "styles", "x", ""]
    pieces: list[Any] = [None, -1, 1.5, "a", [], {}, True, PLAN, {**PLAN, "seed": "x"}, {"seat": 3, "rally": 0, "stroke": 0}]
    requests = ["", "[" * 5000, "x" * 1000]
    while len(requests) < 1_000:
        fields = {"id": drawn.choice([1, -1, "1", None]), "op": drawn.choice(words)}
        fields |= {drawn.choice(["plan", "rally", "person", "z"]): drawn.choice(pieces) for _ in range(3)}
        if fields["op"] in ("hello", "") or (fields.get("plan") == PLAN and fields.get("rally") == 0):
            continue  # these are well-formed
        requests.append(json.dumps(fields))
    with connected(port_of(served)) as other:
        for start in range(0, len(requests), 100):
            # A connection may send a hundred at once, and then has to wait.
            with connected(port_of(served)) as stranger:
                for request in requests[start : start + 100]:
                    stranger.send(request)
                for _ in requests[start : start + 100]:
                    assert parsed(stranger.recv(timeout=60))[0]["error"]
        facts, motion = asked(other, {"id": 7, "op": "rally", "plan": PLAN, "rally": 0, "person": None})
    assert facts["id"] == 7
    assert motion[:4] == b"SMOT"
    for content in ("x" * (MAX_MESSAGE + 1), b"\x00" * 10):
        with connected(port_of(served)) as stranger, contextlib.suppress(ConnectionClosed):
            stranger.send(content)
            with pytest.raises(ConnectionClosed):
                stranger.recv(timeout=20)


@pytest.mark.slow
def test_disconnected_or_stalled_clients_do_not_block_others(served: Served) -> None:
    request = json.dumps({"id": 1, "op": "rally", "plan": PLAN, "rally": 0, "person": None})
    with contextlib.ExitStack() as stack:
        readers = [stack.enter_context(connected(port_of(served), max_queue=1)) for _ in range(5)]
        for reader in readers:
            for _ in range(60):
                reader.send(request)
        for _ in range(20):
            with connected(port_of(served)) as stranger:
                stranger.send(request)
                stranger.socket.shutdown(socket.SHUT_RDWR)
        began = time.monotonic()
        with connected(port_of(served)) as other:
            facts, _ = asked(other, {"id": 9, "op": "rally", "plan": PLAN, "rally": 0, "person": None})
        assert facts["id"] == 9
        assert time.monotonic() - began < 10
        for reader in readers:
            reader.socket.shutdown(socket.SHUT_RDWR)


@pytest.mark.slow
def test_server_stops_immediately_and_frees_its_port(page_folder: Any) -> None:
    with serving() as first, contextlib.ExitStack() as stack:
        port = port_of(first)
        open_ones = [stack.enter_context(connected(port)) for _ in range(3)]
        first.process.send_signal(signal.SIGINT)
        began = time.monotonic()
        first.process.wait(10)
        assert time.monotonic() - began < 5
        assert first.process.returncode == 0
        for each in open_ones:
            with contextlib.suppress(ConnectionClosed):
                each.recv(timeout=5)
        with serving("--port", str(port)) as second:
            assert port_of(second) == port
            with serving("--port", str(port)) as third:
                assert port_of(third) != port


@pytest.mark.slow
@pytest.mark.slow
def test_two_named_players_are_served(page_folder: Any) -> None:
    with serving("--players", "viktor-axelsen", "kento-momota") as server:
        assert get(port_of(server), "/")[0] == 200


def test_invalid_utf_8_ends_the_connection_without_a_traceback(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with running(tmp_path) as address, connect(f"ws://127.0.0.1:{address[1]}/ws", proxy=None) as client:
        client.send(b"\xff\xfe", text=True)
        with pytest.raises(ConnectionClosed):
            client.recv(timeout=60)
    assert "Invalid UTF-8" not in caplog.text


def test_the_report_of_a_recorded_match(tmp_path: Path) -> None:
    def report(number: int) -> bytes:
        if number > 9:
            raise WatchError("no rally 100: there are 10")
        return f"<p>the match of rally {number}, {current()}</p>".encode()

    with running(tmp_path, downloads={("report", "text/html"): report}) as address:
        found = {}
        wrong = ("rally=3&language=fr", "rally=x", "rally=\N{SUPERSCRIPT TWO}", "rally=1000000000000", "")
        for query in ("rally=3", "rally=3&language=id", "rally=100", *wrong):
            status, content, told = get(address[1], f"/report?{urllib.parse.quote(query, safe='=&')}")
            found[query] = status, content
            if status == 200:
                assert told["content-security-policy"] == "frame-ancestors 'none'"
                assert told["x-content-type-options"] == "nosniff"
    assert found.pop("rally=3") == (200, b"<p>the match of rally 2, en</p>")
    assert found.pop("rally=3&language=id") == (200, b"<p>the match of rally 2, id</p>")
    assert found.pop("rally=100") == (404, b"no rally 100: there are 10\n")
    assert all(status == 400 for status, _ in found.values())


RALLY = {"id": 3, "op": "rally", "plan": PLAN, "rally": 0}


def test_the_types_of_the_page_are_those_of_the_server() -> None:
    assert TARGET.read_text(encoding="utf-8") == wire_types(), "run python -m docs.tools.wire_types"


@pytest.mark.parametrize("text", ["", "{", "[" * 5000, "null", '{"id": 1e999}', "\ud800"])
def test_text_that_is_not_a_request_is_refused(text: str) -> None:
    found = decode_request(json.dumps({**RALLY, "person": {"seat": 1, "rally": 0, "stroke": 2}}))
    assert isinstance(found, RallyRequest)
    assert (found.id, found.rally, found.person.seat) == (3, 0, 1)
    assert request_id(text) is None
    with pytest.raises(WatchError):
        decode_request(text)


def test_a_reply_is_aligned_and_has_the_number_of_its_request() -> None:
    content = encode_reply(7, OptionsReply([], []), [b"abc", b"d"])
    length = int.from_bytes(content[:4], "little")
    assert length % 4 == 0
    assert json.loads(content[4 : 4 + length]) == {"id": 7, "options": [], "positions": []}
    assert content[4 + length :] == b"abcd"
    assert json.loads(encode_reply(None, "<b>")[4:]) == {"id": None, "error": "<b>"}


GOLDEN = Path(__file__).parents[1] / "staging" / "golden"


@pytest.mark.slow
def test_the_golden_motion_is_read_as_it_was_written(page_folder: Path) -> None:
    wanted = json.loads((GOLDEN / "rally.json").read_text(encoding="utf-8"))
    frames = [str(row["frame"]) for row in wanted["at"]]
    found = json.loads(run_script("read.ts", str(GOLDEN / "rally.smot"), *frames))
    assert (found["fps"], found["frames"], found["players"]) == (wanted["fps"], wanted["frames"], wanted["players"])
    for row, seen in zip(wanted["at"], found["at"], strict=True):
        assert np.abs(np.array(seen["shuttle"]) - row["shuttle"]).max() < 1e-4
        for seat in (0, 1):
            me = seen["seats"][seat]
            assert me["planted"] == row["planted"][seat]
            local = np.array(me["local"]).reshape(1, -1, 4)
            turn, place = from_parents(
                np.array([me["hips"]]), local, np.array(wanted["parents"][seat]), np.array(wanted["rest"][seat])
            )
            assert np.abs(place[0] - row["position"][seat]).max() < 1e-4
            assert np.abs(np.abs((turn[0] * row["rotation"][seat]).sum(axis=-1)) - 1).max() < 1e-5
