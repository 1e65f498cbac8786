"""The rally log: every rally played, in compact files that survive a crash.

``RallyRecorder`` records what a program plays, from a thread of its own; ``RallyLogWriter`` is what writes below it.
``RallyLog`` reads a file or a folder, ``recover`` saves a file that a crash cut off, and ``replay`` plays every stroke
again from the recorded seed. ``docs/rally_log.md`` describes the file byte for byte.
"""

from shuttle_marl.rally.record import Rallies
from shuttle_marl.recording.export import Derived
from shuttle_marl.recording.header import SINGLE_RALLY, LogHeader, Player, RecordingError, Sampling
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.recorder import RallyLogWriter, RallyRecorder
from shuttle_marl.recording.recover import recover
from shuttle_marl.recording.replay import Replay, replay

__all__ = [
    "SINGLE_RALLY",
    "Derived",
    "LogHeader",
    "Player",
    "Rallies",
    "RallyLog",
    "RallyLogWriter",
    "RallyRecorder",
    "RecordingError",
    "Replay",
    "Sampling",
    "recover",
    "replay",
]
