"""Playback: play, pause, seek and speed over the messages of a scene, without any network."""

import bisect
import dataclasses
import enum
import io
import math
import struct
from collections.abc import Iterator
from typing import Final

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Schema

from shuttle_marl.scene import SceneError

SLOWEST, FASTEST = 0.01, 100.0
"""Range of speeds; 1 is real time."""
_NOTHING: Final = Schema(id=0, name="", encoding="", data=b"")


class Status(enum.Enum):
    """State of a playback."""

    PLAYING = enum.auto()
    PAUSED = enum.auto()
    ENDED = enum.auto()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Topic:
    """A topic of a scene.

    Attributes:
        name: of the topic.
        encoding: of its messages.
        schema: of their content.
    """

    name: str
    encoding: str
    schema: Schema


@dataclasses.dataclass(frozen=True, kw_only=True)
class Message:
    """A message of a scene.

    Attributes:
        time: when it is due [ns].
        topic: its topic.
        data: its content.
    """

    time: int
    topic: str
    data: bytes


class Playback:
    """A position in a scene that moves with time.

    Args:
        content: a scene file.

    Attributes:
        topics: all topics.
        start: time of the first message [ns].
        end: time of the last message [ns].
        position: time that is shown [ns].
        speed: times real time.
        status: a new one is paused at the start.

    Raises:
        SceneError: the file is no MCAP file or holds no messages.
    """

    def __init__(self, content: bytes) -> None:
        self.topics: dict[str, Topic] = {}
        self._messages: list[Message] = []
        try:
            for schema, channel, read in make_reader(io.BytesIO(content)).iter_messages():
                topic = Topic(name=channel.topic, encoding=channel.message_encoding, schema=schema or _NOTHING)
                self.topics.setdefault(channel.topic, topic)
                self._messages.append(Message(time=read.log_time, topic=channel.topic, data=read.data))
        except (McapError, struct.error) as error:
            raise SceneError(f"no scene that can be played: {error}") from error
        if not self._messages:
            raise SceneError("a scene without messages; there is nothing to play")
        self._times = [message.time for message in self._messages]
        self._of_topic: dict[str, list[int]] = {topic: [] for topic in self.topics}
        for i, message in enumerate(self._messages):
            self._of_topic[message.topic].append(i)
        self.start, self.end = self._times[0], self._times[-1]
        self.position, self.speed, self.status = self.start, 1.0, Status.PAUSED
        self._next = bisect.bisect_right(self._times, self.start)

    def play(self) -> None:
        """Continue; from the end, begin again."""
        if self.status is Status.ENDED:
            self.seek(self.start)
        self.status = Status.PLAYING

    def pause(self) -> None:
        """Stop where it is."""
        if self.status is Status.PLAYING:
            self.status = Status.PAUSED

    def seek(self, time: int) -> None:
        """Go to a time [ns]; times outside the scene stand for its ends. Show :meth:`latest` then."""
        self.position = min(max(time, self.start), self.end)
        self._next = bisect.bisect_right(self._times, self.position)
        if self.status is Status.ENDED:
            self.status = Status.PAUSED

    def set_speed(self, speed: float) -> None:
        """Set the speed; what lies outside the range is brought into it, and a speed that is no number changes nothing."""
        if not math.isnan(speed):
            self.speed = min(max(speed, SLOWEST), FASTEST)

    def advance(self, seconds: float) -> list[Message]:
        """Let time pass.

        Args:
            seconds: of the clock on the wall, not negative.

        Returns:
            The messages that became due, in order.
        """
        if self.status is not Status.PLAYING:
            return []
        self.position = min(self.end, self.position + round(seconds * 1e9 * self.speed))
        last = bisect.bisect_right(self._times, self.position)
        due = self._messages[self._next : last]
        self._next = last
        if self._next == len(self._messages):
            self.status = Status.ENDED
        return due

    def latest(self) -> Iterator[Message]:
        """The newest message of every topic at the position: all that is shown there."""
        for rows in self._of_topic.values():
            i = bisect.bisect_left(rows, self._next) - 1
            if i >= 0:
                yield self._messages[rows[i]]
