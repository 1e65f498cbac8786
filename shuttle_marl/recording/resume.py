"""Goes on with a rally log that a killed process left unfinished."""

import os
from pathlib import Path

from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.recover import salvage
from shuttle_marl.recording.schema import RecordingError
from shuttle_marl.recording.writer import BATCH_RALLIES, RallyLogWriter, part_of


def resume(path: Path, header: LogHeader, rallies: int, *, batch_rallies: int = BATCH_RALLIES) -> RallyLogWriter:
    """Keep the first rallies of ``path.part`` and return a writer that goes on behind them.

    The batches that are kept are the same bytes, so the finished log is the one that an undisturbed process would have
    written, provided that it flushed after as many rallies and with the same number to a batch.

    Args:
        path: where the finished log goes.
        header: of the run; the unfinished log must have the same.
        rallies: how many to keep; a batch must end there.
        batch_rallies: rallies to a batch from there on.

    Raises:
        RecordingError: the unfinished log has another header or fewer rallies, is damaged before that, or cannot be written.
    """
    part = part_of(path)
    old = part.with_name(part.name + ".old")
    if old.exists():
        part.unlink(missing_ok=True)  # a copy that was killed; the original is still whole
    elif part.exists():
        os.replace(part, old)
    elif rallies:
        raise RecordingError(f"{part}: is gone, with the {rallies} rallies that were played; start anew")
    if not rallies:
        old.unlink(missing_ok=True)
        return RallyLogWriter(path, header, batch_rallies=batch_rallies)
    before, batches = salvage(old)
    if before != header:
        raise RecordingError(f"{old}: another game, other policies or another seed than this run has; start anew")
    writer = RallyLogWriter(path, header, batch_rallies=batch_rallies)
    for first, data, batch in batches:
        if writer.rallies == rallies or first != writer.rallies:
            break
        writer.write_message(first, data, batch)
    if writer.rallies != rallies:
        writer.abort()
        raise RecordingError(f"{old}: {rallies} rallies were played, {writer.rallies} are whole; start anew")
    writer.flush()
    old.unlink()
    return writer
