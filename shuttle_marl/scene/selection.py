"""Which rallies of a log a scene shows."""

import numpy as np

from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.scene.errors import SceneError


def select(log: RallyLog, *, rally: int | None, match: int | None, pairing: int, best: int | None) -> list[int]:
    """Numbers of the rallies, in the order in which they are shown.

    Args:
        log: the log.
        rally: number of one rally.
        match: number of a match of the pairing: all its rallies.
        pairing: number of the pairing.
        best: that many of the longest rallies, the longest last.

    Raises:
        SceneError: not exactly one of rally, match and best; or the log has no such match.
        RecordingError: the log is damaged.
    """
    if sum(choice is not None for choice in (rally, match, best)) != 1:
        raise SceneError("say which rallies: one of --rally NUMBER, --match NUMBER, --best COUNT")
    if rally is not None:
        return [rally]
    if match is not None:
        numbers = log.numbers_of_match(pairing, match)
        if not len(numbers):
            raise SceneError(f"{log.path}: no match {match} of pairing {pairing}; see `info` for how many pairings there are")
        return [int(number) for number in numbers]
    if best is None or best < 1:
        raise SceneError(f"--best {best}: expected 1 or more")
    found: list[tuple[int, int]] = []
    for first, rallies in log.batches():
        longest = np.argsort(-rallies.length, kind="stable")[:best]
        found += [(int(rallies.length[row]), first + int(row)) for row in longest]
        found = sorted(found, key=lambda entry: (-entry[0], entry[1]))[:best]
    return [number for _, number in reversed(found)]
