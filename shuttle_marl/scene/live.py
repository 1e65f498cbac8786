"""Serves a scene through Foxglove's WebSocket protocol (``foxglove.sdk.v1``), with the controls of its playback bar.

The server of Foxglove's SDK cannot check who connects, so the protocol, as far as a scene needs it, stands here on top of
:mod:`websockets`; :mod:`shuttle_marl.scene.admission` says who may connect.
"""

import asyncio
import base64
import collections
import contextlib
import http
import json
import logging
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

from rich.console import Console
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from shuttle_marl.scene import SceneError
from shuttle_marl.scene.admission import HOST, ORIGINS, refusal
from shuttle_marl.scene.playback import Message, Playback, Status, Topic

SUBPROTOCOL: Final = Subprotocol("foxglove.sdk.v1")

_SECOND: Final = 1_000_000_000
_TICK: Final = 0.01
_BACKLOG: Final = 8192
"""Messages that wait for a slow viewer; older ones are dropped."""
_LARGEST: Final = 1 << 16
"""Bytes of a message from a viewer."""
_HANDSHAKE: Final = 5.0
"""Time that a connection has for its handshake [s]."""
_FAREWELL: Final = 1.0
"""Time that viewers have to close their connections when the server stops [s]."""
_MOST_REASONS: Final = 16
"""Different refusals that are reported; a page could send any number."""
_MESSAGE, _TIME, _STATE = 1, 2, 5
"""First bytes of binary messages to viewers."""
_CONTROL: Final = 3
"""First byte of a request to play, pause, seek or change the speed."""
_REQUEST: Final = struct.Struct("<BfBQI")
"""Command (0 play, 1 pause), speed, whether to seek, where to [ns], length of the name of the request."""
_ERROR: Final = 2
_STATUS: Final = {Status.PLAYING: 0, Status.PAUSED: 1, Status.ENDED: 3}

_LOGGER: Final = logging.getLogger(__name__)
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.propagate = False


class LiveScene:
    """A scene that is being served; a context manager that serves it, in a thread of its own, until it is left.

    Args:
        content: a scene file.
        listener: from :func:`~shuttle_marl.scene.admission.bind`; closed in the end.
        origins: further pages that may connect, such as ``https://viewer.example.org``.
        say: called with the reason of a refusal, once for each reason.

    Attributes:
        playback: where the scene is.
        port: on which it is served.

    Raises:
        SceneError: the file holds no scene; on entering, that another program took the port.
    """

    def __init__(
        self, content: bytes, listener: socket.socket, *, origins: Sequence[str] = (), say: Callable[[str], None] | None = None
    ) -> None:
        self.playback = Playback(content)
        self.port = int(listener.getsockname()[1])
        self._listener, self._origins, self._say = listener, (*ORIGINS, *origins), say
        self._topics = dict(enumerate(self.playback.topics.values(), start=1))
        self._number = {topic.name: number for number, topic in self._topics.items()}
        self._viewers: set[_Viewer] = set()
        self._refused: set[str] = set()
        self._ready, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._main, name="live scene", daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._failure: OSError | None = None

    def __enter__(self) -> "LiveScene":
        self._thread.start()
        self._ready.wait()
        if self._failure is not None:
            raise SceneError(f"port {self.port}: {self._failure.strerror}; choose another with --port") from self._failure
        return self

    def __exit__(self, *_: object) -> None:
        if self._loop is not None and not self._ended.is_set():
            with contextlib.suppress(RuntimeError):  # it has just ended by itself
                self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()

    def run(self, seconds: float | None = None) -> None:
        """Wait while the scene is served.

        Args:
            seconds: for how long; by default until an interrupt.
        """
        self._ended.wait(seconds)

    def _main(self) -> None:
        try:
            asyncio.run(self._serve())
        except OSError as error:
            self._failure = error
        finally:
            self._listener.close()
            self._ended.set()
            self._ready.set()

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        server = await serve(
            self._attend,
            sock=self._listener,
            process_request=self._admit,
            subprotocols=[SUBPROTOCOL],
            compression=None,
            max_size=_LARGEST,
            open_timeout=_HANDSHAKE,
            close_timeout=_FAREWELL,
            logger=_LOGGER,
        )
        clock = asyncio.create_task(self._play())
        self._ready.set()
        await self._stop.wait()
        clock.cancel()
        server.close()
        # A connection that never said anything is not waited for: it is cut off with what is left of the loop.
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(server.wait_closed(), _FAREWELL)

    async def _play(self) -> None:
        """Play by the clock on the wall."""
        last = asyncio.get_running_loop().time()
        while True:
            await asyncio.sleep(_TICK)
            now = asyncio.get_running_loop().time()
            self._step(now - last)
            last = now

    def _step(self, seconds: float) -> None:
        playing = self.playback.status is Status.PLAYING
        due = self.playback.advance(seconds)
        for viewer in self._viewers:
            self._send(viewer, due)
            if playing:
                viewer.send(struct.pack("<BQ", _TIME, self.playback.position))
                if self.playback.status is Status.ENDED:
                    viewer.send(self._state())

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse all but viewers of this machine."""
        reason = refusal(request.headers.get_all("Host"), request.headers.get_all("Origin"), self._origins)
        if reason is None:
            return None
        if self._say is not None and reason not in self._refused and len(self._refused) < _MOST_REASONS:
            self._refused.add(reason)
            self._say(reason)
        return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")

    async def _attend(self, connection: ServerConnection) -> None:
        """Talk to one viewer until it leaves."""
        viewer = _Viewer()
        viewer.send(self._info())
        viewer.send(json.dumps({"op": "advertise", "channels": [_channel(n, topic) for n, topic in self._topics.items()]}))
        viewer.send(self._state())
        self._viewers.add(viewer)
        sender = asyncio.create_task(viewer.deliver(connection))
        try:
            async for message in connection:
                try:
                    self._answer(viewer, message)
                except (ValueError, ArithmeticError, LookupError, TypeError, struct.error, RecursionError) as error:
                    words = f"this message is not understood ({type(error).__name__})"
                    viewer.send(json.dumps({"op": "status", "level": _ERROR, "message": words}))
        except ConnectionClosed:
            pass
        finally:
            self._viewers.discard(viewer)
            sender.cancel()

    def _answer(self, viewer: "_Viewer", message: str | bytes) -> None:
        """Do what a viewer asks for; raises one of the errors above for a malformed request."""
        if isinstance(message, bytes):
            if message[0] != _CONTROL:
                raise ValueError(message[0])
            self._control(message[1:])
            return
        request = json.loads(message)
        if request["op"] == "subscribe":
            wanted = {int(entry["channelId"]): int(entry["id"]) for entry in request["subscriptions"]}
            if not wanted.keys() <= self._topics.keys() or any(not 0 <= number < 1 << 32 for number in wanted.values()):
                raise ValueError(wanted)
            viewer.subscriptions |= wanted
            # A new viewer is shown the present state.
            self._send(viewer, (m for m in self.playback.latest() if self._number[m.topic] in wanted))
        elif request["op"] == "unsubscribe":
            gone = set(request["subscriptionIds"])
            viewer.subscriptions = {k: v for k, v in viewer.subscriptions.items() if v not in gone}

    def _control(self, request: bytes) -> None:
        """Play, pause, seek or change the speed."""
        command, speed, seeks, time, length = _REQUEST.unpack_from(request)
        name = request[_REQUEST.size :]
        if command not in (0, 1) or len(name) != length:
            raise ValueError(command)
        self.playback.set_speed(speed)
        again = bool(seeks)
        if seeks:
            self.playback.seek(time)
        if command == 0:
            again |= self.playback.status is Status.ENDED
            self.playback.play()
        else:
            self.playback.pause()
        shown = list(self.playback.latest()) if again else []
        for viewer in self._viewers:
            viewer.send(self._state(did_seek=bool(seeks), name=name))
            self._send(viewer, shown)

    def _send(self, viewer: "_Viewer", messages: Iterable[Message]) -> None:
        for message in messages:
            subscription = viewer.subscriptions.get(self._number[message.topic])
            if subscription is not None:
                viewer.send(struct.pack("<BIQ", _MESSAGE, subscription, message.time) + message.data)

    def _info(self) -> str:
        start, end = ({"sec": time // _SECOND, "nsec": time % _SECOND} for time in (self.playback.start, self.playback.end))
        info = {
            "op": "serverInfo",
            "name": "shuttle_marl",
            "capabilities": ["playbackControl", "time"],
            "metadata": {},
            # A viewer that connects again after the server was started again must forget the old scene.
            "sessionId": f"{os.getpid()}-{id(self):x}",
            "dataStartTime": start,
            "dataEndTime": end,
        }
        return json.dumps(info)

    def _state(self, *, did_seek: bool = False, name: bytes = b"") -> bytes:
        status, play = _STATUS[self.playback.status], self.playback
        return struct.pack("<BBQfBI", _STATE, status, play.position, play.speed, did_seek, len(name)) + name


class _Viewer:
    """Subscriptions of a viewer, and messages on their way to it."""

    def __init__(self) -> None:
        self.subscriptions: dict[int, int] = {}
        self._waiting: collections.deque[str | bytes] = collections.deque(maxlen=_BACKLOG)
        self._more = asyncio.Event()

    def send(self, message: str | bytes) -> None:
        """Send a message as soon as those before it are sent."""
        self._waiting.append(message)
        self._more.set()

    async def deliver(self, connection: ServerConnection) -> None:
        """Send what waits, until the connection is closed."""
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self._more.wait()
                self._more.clear()
                while self._waiting:
                    await connection.send(self._waiting.popleft())


def _channel(number: int, topic: Topic) -> dict[str, Any]:
    """A topic as it is advertised: schemas that are no text are encoded as base64."""
    schema = topic.schema
    binary = schema.encoding == "protobuf"
    return {
        "id": number,
        "topic": topic.name,
        "encoding": topic.encoding,
        "schemaName": schema.name,
        "schemaEncoding": schema.encoding,
        "schema": base64.b64encode(schema.data).decode() if binary else schema.data.decode(),
    }


def show_live(content: bytes, listener: socket.socket, console: Console, *, origins: Sequence[str] = ()) -> None:
    """Serve a scene until an interrupt.

    Args:
        content: a scene file.
        listener: from :func:`~shuttle_marl.scene.admission.bind`.
        console: says where it is to be seen, and who is refused; one that reads no markup.
        origins: further pages that may connect.
    """
    live = LiveScene(content, listener, origins=origins, say=lambda words: console.print(words, soft_wrap=True))
    live.playback.play()
    with live:
        address = f"ws://{HOST}:{live.port}"
        console.print(f"{address} serves the scene: open this connection in Foxglove; Ctrl-C ends it", soft_wrap=True)
        live.run()
