"""Rallies of a rally log as what is staged."""

import numpy as np

from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.schema import Rallies
from shuttle_marl.staging.rally import PlayedRally


def recorded_rally(log: RallyLog, number: int) -> PlayedRally:
    """One rally of a log by its number.

    Raises:
        RecordingError: there is no such rally, or the log is damaged.
        StagingError: its strokes make no rally.
    """
    return rally_of(log, log.rally(number))


def rally_of(log: RallyLog, rally: Rallies) -> PlayedRally:
    """A rally that was read from a log.

    Args:
        log: where it was read.
        rally: the one rally.

    Raises:
        StagingError: its strokes make no rally.
    """
    return PlayedRally(
        catalogue=log.catalogue,
        server=int(rally.server[0]),
        stroke=rally.stroke.astype(np.int64),
        ending=int(rally.reason[0]),
    ).checked()
