"""Rally logs: all rallies of a program, in compact files that survive a crash.

``RallyRecorder`` writes rallies in a background thread, by way of ``RallyLogWriter``. ``RallyLog`` reads a file or a folder,
``recover`` repairs a truncated file, and ``replay`` verifies every stroke from the recorded seed. ``docs/rally_log.md`` specifies
the format.
"""

from shuttle_marl.game.rally import Rallies
from shuttle_marl.recording.header import SINGLE_RALLY, LogHeader, Pair, Player, RecordingError
from shuttle_marl.recording.log_file import recover
from shuttle_marl.recording.reader import RallyLog, export, replay
from shuttle_marl.recording.recorder import RallyLogWriter, RallyRecorder

__all__ = [
    "SINGLE_RALLY",
    "LogHeader",
    "Pair",
    "Player",
    "Rallies",
    "RallyLog",
    "RallyLogWriter",
    "RallyRecorder",
    "RecordingError",
    "export",
    "recover",
    "replay",
]
