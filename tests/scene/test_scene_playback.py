"""Play, pause, seek and speed: the state of a playback, and the server on this machine's own address."""

import json
import socket
import struct
import threading
import time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from websockets.sync.client import ClientConnection, connect

from shuttle_marl.scene import SceneError
from shuttle_marl.scene.live import HOST, LiveScene
from shuttle_marl.scene.playback import FASTEST, SLOWEST, Playback, Status

SUBPROTOCOL = "foxglove.sdk.v1"
PLAYBACK_STATE = 5


@pytest.fixture
def playback(reel: Any) -> Playback:
    return Playback(reel.content)


def test_a_new_playback_waits_at_the_start(playback: Playback, reel: Any) -> None:
    assert (playback.status, playback.position) == (Status.PAUSED, reel.messages[0][0])
    assert playback.advance(10) == []
    assert {m.topic for m in playback.latest()} >= {"/scene/court", "/scene/players", "/tf", "/rally/score"}


def test_playing_sends_every_message_once_and_in_order(playback: Playback, reel: Any) -> None:
    first = len([time for time, _, _ in reel.messages if time == playback.start])
    playback.play()
    sent = []
    while playback.status is Status.PLAYING:
        sent += playback.advance(0.37)
    assert playback.status is Status.ENDED
    assert playback.position == playback.end
    assert [(m.time, m.topic) for m in sent] == [(time, topic) for time, topic, _ in reel.messages[first:]]


def test_speed_is_times_real_time(playback: Playback) -> None:
    playback.play()
    playback.set_speed(2.5)
    playback.advance(0.8)
    assert playback.position - playback.start == 2_000_000_000
    for asked, got in ((0.0, SLOWEST), (1e9, FASTEST), (float("nan"), FASTEST)):
        playback.set_speed(asked)
        assert playback.speed == got


def test_a_pause_holds_and_a_play_from_the_end_begins_anew(playback: Playback) -> None:
    playback.play()
    playback.advance(0.5)
    playback.pause()
    assert playback.advance(5) == []
    playback.play()
    playback.advance(1e6)
    assert playback.status is Status.ENDED
    playback.pause()
    assert playback.status is Status.ENDED
    playback.play()
    assert (playback.status, playback.position) == (Status.PLAYING, playback.start)


@settings(max_examples=25, deadline=None)
@given(share=st.floats(-0.5, 1.5), seconds=st.floats(0, 3))
def test_after_a_seek_the_latest_of_every_topic_is_shown(reel: Any, share: float, seconds: float) -> None:
    playback = _cached(reel)
    playback.pause()
    playback.seek(round(playback.start + share * (playback.end - playback.start)))
    assert playback.start <= playback.position <= playback.end
    expected = {topic: (time, topic) for time, topic, _ in reel.messages if time <= playback.position}
    assert {m.topic: (m.time, m.topic) for m in playback.latest()} == expected
    playback.play()
    before = playback.position
    due = playback.advance(seconds)
    assert all(before < m.time <= playback.position for m in due)


_KEPT: dict[int, Playback] = {}


def _cached(reel: Any) -> Playback:
    return _KEPT.setdefault(id(reel), Playback(reel.content))


def test_what_is_no_scene_cannot_be_played() -> None:
    with pytest.raises(SceneError, match="no scene"):
        Playback(b"nothing")


def test_a_taken_port_says_so(reel: Any) -> None:
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        with pytest.raises(SceneError, match=r"in use; choose another with --port"):
            LiveScene(reel.content, other.getsockname()[1])


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


def test_a_viewer_plays_seeks_and_pauses(reel: Any) -> None:
    with LiveScene(reel.content, 0) as live:
        # A clock of its own makes the test independent of how busy the machine is.
        runner = threading.Thread(target=live.run, kwargs={"seconds": 6.0})
        runner.start()
        with connect(f"ws://{HOST}:{live.port}", subprotocols=[SUBPROTOCOL], max_size=None) as socket:
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
            assert viewer.seen.count("/tf") > 20
            assert len(viewer.seen) > shown
            target = (live.playback.start + live.playback.end) // 2
            viewer.control(play=False, speed=1.0, seek=target)
            viewer.listen(0.7)
            assert live.playback.position == target
            assert live.playback.status is Status.PAUSED
            assert viewer.seen[-len(live.playback.topics) :].count("/scene/court") == 1, "all is shown again after a seek"
            assert len(viewer.states) >= 2
        runner.join()
