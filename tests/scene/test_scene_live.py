"""The server on this machine's own address: its protocol, who may connect, and how it stops."""

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import foxglove
import pytest
from foxglove.websocket import Capability
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from shuttle_marl.scene import SceneError
from shuttle_marl.scene.admission import HOST, bind, refusal
from shuttle_marl.scene.live import SUBPROTOCOL, LiveScene
from shuttle_marl.scene.playback import Playback, Status

PLAYBACK_STATE = 5
SOON = 4.0
"""Time in which a server stops [s]; a connection without a handshake is waited for no longer than a second."""


@pytest.fixture
def live(reel: Any) -> Iterator[LiveScene]:
    with LiveScene(reel.content, bind(0)) as scene:
        yield scene


def viewer_of(live: LiveScene, **options: Any) -> ClientConnection:
    return connect(f"ws://{HOST}:{live.port}", subprotocols=[SUBPROTOCOL], max_size=None, **options)


class Viewer:
    """A client that speaks as much of the protocol as is needed here."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.channels: dict[int, str] = {}
        self.info: dict[str, Any] = {}
        self.seen: list[str] = []
        self.states: list[tuple[int, float]] = []
        self._topic_of: dict[int, str] = {}

    def listen(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                message = self.socket.recv(timeout=left)
            except TimeoutError:
                return
            if isinstance(message, str):
                self._text(json.loads(message))
            elif message[0] == 1:
                self.seen.append(self._topic_of[struct.unpack_from("<I", message, 1)[0]])
            elif message[0] == PLAYBACK_STATE:
                self.states.append((message[1], struct.unpack_from("<f", message, 10)[0]))

    def _text(self, content: dict[str, Any]) -> None:
        if content["op"] == "serverInfo":
            self.info = content
        elif content["op"] == "advertise":
            self.channels |= {channel["id"]: channel["topic"] for channel in content["channels"]}

    def subscribe(self) -> None:
        self._topic_of = dict(enumerate(self.channels.values()))
        wanted = [{"id": i, "channelId": channel} for i, channel in enumerate(self.channels)]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def control(self, *, play: bool, speed: float = 1.0, seek: int | None = None) -> None:
        """Opcode, command, speed, whether to seek, time, length and text of the request's id."""
        name = b"test"
        self.socket.send(struct.pack("<BBfBQI", 3, 0 if play else 1, speed, seek is not None, seek or 0, len(name)) + name)


def test_a_viewer_plays_seeks_and_pauses(live: LiveScene) -> None:
    with viewer_of(live) as socket:
        viewer = Viewer(socket)
        viewer.listen(0.5)
        assert "playbackControl" in viewer.info["capabilities"]
        assert set(viewer.channels.values()) == set(live.playback.topics)
        viewer.subscribe()
        viewer.listen(0.7)
        assert set(viewer.seen) >= {"/scene/court", "/scene/players", "/tf"}, "shown before it plays"
        shown = len(viewer.seen)
        viewer.control(play=True, speed=4.0)
        viewer.listen(0.7)
        assert live.playback.speed == 4.0
        assert viewer.seen.count("/rally/state") > 20
        assert len(viewer.seen) > shown
        target = (live.playback.start + live.playback.end) // 2
        viewer.control(play=False, speed=1.0, seek=target)
        viewer.listen(0.7)
        assert live.playback.position == target
        assert live.playback.status is Status.PAUSED
        assert viewer.seen[-len(live.playback.topics) :].count("/scene/court") == 1, "all is shown again after a seek"
        assert len(viewer.states) >= 2


def greeting(socket: ClientConnection, topics: int) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Server info, and the advertised channels by topic without their numbers."""
    info: dict[str, Any] = {}
    channels: dict[str, dict[str, Any]] = {}
    while not info or len(channels) < topics:
        message = socket.recv(timeout=10)
        if isinstance(message, str):
            content = json.loads(message)
            info |= content if content["op"] == "serverInfo" else {}
            channels |= {channel.pop("topic"): channel for channel in content.get("channels", ())}
    for channel in channels.values():
        channel.pop("id")
    return info, channels


def test_the_protocol_is_that_of_the_sdk(live: LiveScene, reel: Any) -> None:
    """Foxglove's own server greets a viewer of the same topics with the same words."""
    playback = Playback(reel.content)
    with viewer_of(live) as socket:
        info, channels = greeting(socket, len(playback.topics))
    context = foxglove.Context()
    kept = [
        foxglove.Channel(
            topic.name,
            message_encoding=topic.encoding,
            schema=foxglove.Schema(name=topic.schema.name, encoding=topic.schema.encoding, data=topic.schema.data),
            context=context,
        )
        for topic in playback.topics.values()
    ]
    server = foxglove.start_server(
        name="shuttle_marl",
        host=HOST,
        port=0,
        capabilities=[Capability.PlaybackControl, Capability.Time],
        playback_time_range=(playback.start, playback.end),
        context=context,
    )
    try:
        with connect(f"ws://{HOST}:{server.port}", subprotocols=[SUBPROTOCOL], max_size=None) as socket:
            expected, expected_channels = greeting(socket, len(kept))
    finally:
        server.stop()
    assert channels == expected_channels
    for own in (info, expected):
        del own["metadata"], own["sessionId"]
    assert info == expected


NO_REQUESTS = (
    "",
    "{",
    "[]",
    "3",
    '"x"',
    "[" * 30_000,
    '{"op": "subscribe"}',
    '{"op": "subscribe", "subscriptions": [3]}',
    '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99999}]}',
    '{"op": "subscribe", "subscriptions": [{"id": 1e999, "channelId": 1}]}',
    '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
    '{"op": "unsubscribe", "subscriptionIds": [[]]}',
    b"",
    b"\x09abc",
    b"\x03abc",
    struct.pack("<BBfBQI", 3, 7, 1.0, 0, 0, 0),
    struct.pack("<BBfBQI", 3, 0, 1.0, 0, 0, 9),
)


@pytest.mark.parametrize("message", NO_REQUESTS, ids=range(len(NO_REQUESTS)))
def test_what_is_no_request_is_answered_and_changes_nothing(live: LiveScene, message: str | bytes) -> None:
    with viewer_of(live) as socket:
        greeting(socket, len(live.playback.topics))
        socket.send(message)
        while isinstance(answer := socket.recv(timeout=10), bytes):
            pass
        assert json.loads(answer)["op"] == "status"
        socket.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 1}]}))
        assert isinstance(socket.recv(timeout=10), bytes)
    assert (live.playback.status, live.playback.position) == (Status.PAUSED, live.playback.start)


@contextlib.contextmanager
def silent(port: int) -> Iterator[socket.socket]:
    """A connection without a handshake."""
    with socket.create_connection((HOST, port), timeout=10) as connection:
        yield connection


def test_it_stops_at_once_and_the_port_can_be_taken_again(reel: Any) -> None:
    """Twice, each time with a viewer and a connection without a handshake still open."""
    port = 0
    with contextlib.ExitStack() as kept:
        for _ in range(2):
            with LiveScene(reel.content, bind(port)) as live:
                port = live.port
                kept.enter_context(silent(port))
                greeting(kept.enter_context(viewer_of(live)), len(live.playback.topics))
                begun = time.monotonic()
            assert time.monotonic() - begun < SOON


@pytest.mark.skipif(os.name != "posix", reason="sends an interrupt as a terminal does")
def test_an_interrupt_ends_it_although_a_connection_is_open(scene_file: Path) -> None:
    code = (
        "import pathlib, signal, sys; from shuttle_marl.commands.cli import console\n"
        "from shuttle_marl.scene import admission, live\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored if this runs in the background of a shell\n"
        "live.show_live(pathlib.Path(sys.argv[1]).read_bytes(), admission.bind(0), console())"
    )
    command = [sys.executable, "-c", code, str(scene_file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout is not None
            port = int(program.stdout.readline().split()[0].rpartition(":")[2])
            with silent(port):
                program.send_signal(signal.SIGINT)
                begun = time.monotonic()
                program.wait(30)
                assert time.monotonic() - begun < SOON + 2, "the interpreter needs a moment too"
        finally:
            program.kill()


def test_a_taken_port_says_so() -> None:
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        with pytest.raises(SceneError, match=r"in use; choose another with --port"):
            bind(other.getsockname()[1])


def test_a_port_that_is_taken_before_it_serves(reel: Any) -> None:
    with bind(0) as listener, socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(listener.getsockname())
        other.listen()
        with pytest.raises(SceneError, match="in use"), LiveScene(reel.content, listener):
            pass


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost.evil.example"},
        {"Origin": "https://app.foxglove.dev.evil.example"},
        {"Host": "evil.example"},
        {"Host": "evil.example:8765", "Origin": "https://app.foxglove.dev"},
    ],
    ids=lambda headers: " ".join(headers.values()),
)
def test_pages_of_others_are_refused(reel: Any, headers: dict[str, str]) -> None:
    said: list[str] = []
    with LiveScene(reel.content, bind(0), say=said.append) as live:
        request = {
            "Host": f"{HOST}:{live.port}",
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Protocol": SUBPROTOCOL,
            **headers,
        }
        for _ in range(2):
            with silent(live.port) as connection:
                lines = "".join(f"{name}: {value}\r\n" for name, value in request.items())
                connection.sendall(f"GET / HTTP/1.1\r\n{lines}\r\n".encode())
                assert connection.recv(100).startswith(b"HTTP/1.1 403 ")
    assert len(said) == 1, "said once"


@pytest.mark.parametrize(
    "origin", [None, "https://app.foxglove.dev", "file://", "http://localhost:8080", "http://[::1]", "https://viewer.example.org"]
)
def test_viewers_may_connect(reel: Any, origin: Any) -> None:
    with LiveScene(reel.content, bind(0), origins=("https://viewer.example.org",)) as live:
        with viewer_of(live, origin=origin) as socket:
            greeting(socket, len(live.playback.topics))
        with pytest.raises(InvalidStatus, match="403"):
            viewer_of(live, origin="https://other.example.org")


def test_requests_without_a_host_or_with_several_names_are_refused() -> None:
    assert refusal(["localhost:1"], [], ()) is None
    assert refusal(["[::1]:8765"], [], ()) is None
    for hosts, origins in (
        ([], []),
        (["localhost", "evil.example"], []),
        (["localhost"], ["http://localhost", "null"]),
        (["["], []),
    ):
        assert refusal(hosts, origins, ()) is not None
