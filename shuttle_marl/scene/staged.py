"""A staged rally with its place in the scene, and what sends its messages."""

import dataclasses
from collections.abc import Callable
from typing import Any

from foxglove.messages import Log, LogLevel, SceneEntity, SceneUpdate

from shuttle_marl.scene import topics
from shuttle_marl.scene.drawing import SECOND, stamp, update
from shuttle_marl.scene.report import Story
from shuttle_marl.staging import Motion

Send = Callable[[topics.Topics, int], None]
Timed = tuple[int, Send]
"""A message: when [ns], and what sends it then."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Take:
    """One rally, staged, with its place in the scene.

    Attributes:
        story: what is told.
        motion: what is seen.
        start: when it begins [ns].
    """

    story: Story
    motion: Motion
    start: int

    def at(self, seconds: float) -> int:
        """An instant of the rally in the scene [ns]."""
        return self.start + round(seconds * SECOND)

    @property
    def end(self) -> int:
        """When its last frame is shown [ns]."""
        return self.at(float(self.motion.time[-1]))


def scene(topic: str, entities: Callable[[int], list[SceneEntity]]) -> Send:
    """Sends all that a topic of the 3D panel shows."""

    def send(to: topics.Topics, time: int) -> None:
        message: SceneUpdate = update(time, entities(time))
        to.scenes[topic].log(message, log_time=time)

    return send


def numbers(topic: str, content: dict[str, Any]) -> Send:
    """Sends what a topic of the plots says, without what is None."""
    kept = {name: value for name, value in content.items() if value is not None}

    def send(to: topics.Topics, time: int) -> None:
        to.json[topic].log(kept, log_time=time)

    return send


def line(words: str, name: str) -> Send:
    """Sends a line of the log."""

    def send(to: topics.Topics, time: int) -> None:
        to.log.log(Log(timestamp=stamp(time), level=LogLevel.Info, message=words, name=name), log_time=time)

    return send
