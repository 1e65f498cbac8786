"""The rally log: every rally played, in one compact file that survives a crash.

``RallyLogWriter`` writes, ``RallyLog`` reads, ``recover`` makes a file whole that a crash cut off, and ``replay`` plays
every stroke again from the recorded seed. ``docs/rally_log.md`` describes the file byte for byte.
"""

from shuttle_marl.recording.header import LogHeader, Player
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.recover import recover
from shuttle_marl.recording.replay import Replay, replay
from shuttle_marl.recording.schema import Rallies, RecordingError
from shuttle_marl.recording.writer import RallyLogWriter

__all__ = ["LogHeader", "Player", "Rallies", "RallyLog", "RallyLogWriter", "RecordingError", "Replay", "recover", "replay"]
