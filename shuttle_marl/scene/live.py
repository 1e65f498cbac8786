"""Serves a scene through Foxglove's WebSocket protocol, with the controls of its playback bar."""

import socket
import threading
import time
from typing import Final

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    PlaybackCommand,
    PlaybackControlRequest,
    PlaybackState,
    PlaybackStatus,
    ServerListener,
    WebSocketServer,
)
from rich.console import Console

from shuttle_marl.scene import SceneError
from shuttle_marl.scene.playback import Message, Playback, Status

HOST: Final = "127.0.0.1"
"""Scenes are served to this machine only."""
_TICK: Final = 0.01
_BACKLOG: Final = 8192
_STATUS: Final = {
    Status.PLAYING: PlaybackStatus.Playing,
    Status.PAUSED: PlaybackStatus.Paused,
    Status.ENDED: PlaybackStatus.Ended,
}


class LiveScene(ServerListener):
    """A scene that is being served; a context manager that stops it.

    Args:
        content: a scene file.
        port: to serve on; 0 takes a free one.

    Attributes:
        playback: where the scene is.
        port: on which it is served.

    Raises:
        SceneError: the port is taken or cannot be used, or the file holds no scene.
    """

    def __init__(self, content: bytes, port: int) -> None:
        self.playback = Playback(content)
        self._lock = threading.Lock()
        self._show = threading.Event()
        self._context = Context()
        self._channels = {
            topic.name: Channel(
                topic.name,
                message_encoding=topic.encoding,
                schema=Schema(name=topic.schema.name, encoding=topic.schema.encoding, data=topic.schema.data),
                context=self._context,
            )
            for topic in self.playback.topics.values()
        }
        check_port(port)
        try:
            self._server: WebSocketServer = foxglove.start_server(
                name="shuttle_marl",
                host=HOST,
                port=port,
                server_listener=self,
                capabilities=[Capability.PlaybackControl, Capability.Time],
                playback_time_range=(self.playback.start, self.playback.end),
                message_backlog_size=_BACKLOG,
                context=self._context,
            )
        except (OSError, RuntimeError, ValueError) as error:
            raise SceneError(f"port {port}: cannot be served on ({error}); choose another with --port") from error
        self.port = self._server.port

    def __enter__(self) -> "LiveScene":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002  the protocol of the listener
        """Show a new viewer what is there; the next step does, because nothing may be sent from in here."""
        self._show.set()

    def on_playback_control_request(self, request: PlaybackControlRequest) -> PlaybackState:
        """Play, pause, seek or change the speed."""
        with self._lock:
            self.playback.set_speed(request.playback_speed)
            if request.seek_time is not None:
                self.playback.seek(request.seek_time)
                self._show.set()
            if request.playback_command == PlaybackCommand.Play:
                if self.playback.status is Status.ENDED:
                    self._show.set()
                self.playback.play()
            else:
                self.playback.pause()
            return self._state(did_seek=request.seek_time is not None, request_id=request.request_id)

    def step(self, seconds: float) -> None:
        """Let time pass and send what is due.

        Args:
            seconds: of the clock on the wall.
        """
        with self._lock:
            before = self.playback.status
            if self._show.is_set():
                self._show.clear()
                self._send(list(self.playback.latest()))
            self._send(self.playback.advance(seconds))
            if before is Status.PLAYING:
                self._server.broadcast_time(self.playback.position)
            ended = before is Status.PLAYING and self.playback.status is Status.ENDED
            state = self._state(did_seek=False, request_id=None) if ended else None
        if state is not None:
            self._server.broadcast_playback_state(state)

    def run(self, seconds: float = float("inf")) -> None:
        """Play by the clock on the wall.

        Args:
            seconds: for how long; by default until an interrupt.
        """
        begun = last = time.monotonic()
        while last - begun < seconds:
            time.sleep(_TICK)
            now = time.monotonic()
            self.step(now - last)
            last = now

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            self._channels[message.topic].log(message.data, log_time=message.time)

    def _state(self, *, did_seek: bool, request_id: str | None) -> PlaybackState:
        return PlaybackState(
            status=_STATUS[self.playback.status],
            current_time=self.playback.position,
            playback_speed=self.playback.speed,
            did_seek=did_seek,
            request_id=request_id,
        )


def serve(content: bytes, port: int, console: Console) -> None:
    """Serve a scene until an interrupt.

    Args:
        content: a scene file.
        port: to serve on.
        console: says where it is to be seen.

    Raises:
        SceneError: the port is taken or cannot be used.
    """
    with LiveScene(content, port) as live:
        live.playback.play()
        console.print(
            f"ws://{HOST}:{live.port} serves the scene: open this connection in Foxglove; Ctrl-C ends it", highlight=False
        )
        live.run()


def check_port(port: int) -> None:
    """Refuse a port before any work is done; the server's own message would not say why.

    Raises:
        SceneError: it is taken, or cannot be served on.
    """
    if not 0 <= port < 1 << 16:
        raise SceneError(f"port {port}: expected 0 (any free one) to 65535")
    with socket.socket() as probe:
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise SceneError(f"port {port}: {error.strerror}; choose another with --port, or 0 for any free one") from error
