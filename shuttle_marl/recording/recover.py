"""Makes rally logs whole that were cut off or damaged."""

import dataclasses
from pathlib import Path

from shuttle_marl.recording.container import damage
from shuttle_marl.recording.file_writer import LogFileWriter
from shuttle_marl.recording.parts import SUFFIX, existing_parts, part_path, unfinished
from shuttle_marl.recording.salvage import salvage
from shuttle_marl.recording.schema import RecordingError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recovery:
    """What :func:`recover` found.

    Attributes:
        path: the new file.
        rallies: number of rallies saved.
        strokes: number of strokes saved.
        lost: number of rallies known to be lost between those that were saved; what was cut off behind them is unknown.
    """

    path: Path
    rallies: int
    strokes: int
    lost: int


def recover(source: Path, target: Path | None = None) -> Recovery:
    """Write a whole file of every batch that can be read from a damaged or unfinished one; ``source`` stays as it is.

    Args:
        source: a file of a log in any condition, ``FILE.part`` included.
        target: the new file; must not exist. Default: ``FILE`` for ``FILE.part``, else ``NAME.recovered.mcap`` beside it.

    Raises:
        RecordingError: the source is no rally log or its header is damaged, or the target exists or cannot be written.
    """
    if target is None:
        target = source.with_suffix("") if source.suffix == ".part" else source.with_name(f"{source.stem}.recovered.mcap")
    header, batches = salvage(source)
    # Written under a name of its own, because ``target.part`` may be the source.
    making = target.with_name(target.name + ".recovering")
    if target.exists():
        raise RecordingError(f"{target}: exists already; name another file for the recovered log")
    for left_by_a_kill in (making, unfinished(making)):
        left_by_a_kill.unlink(missing_ok=True)
    saved = strokes = lost = 0
    writer = LogFileWriter(making, header, fsync_seconds=60)
    try:
        for first, data, rallies in batches:
            lost += first - writer.rallies
            writer.write(first, data, rallies)
            saved, strokes = saved + len(rallies), strokes + len(rallies.stroke)
        writer.close()
    finally:
        writer.abort()
    with damage(target):
        making.replace(target)
    return Recovery(path=target, rallies=saved, strokes=strokes, lost=lost)


def recover_folder(folder: Path) -> list[Recovery]:
    """Recover every unfinished log of a folder that is not there in whole; the unfinished files stay as they are.

    Raises:
        RecordingError: there is none, or one cannot be recovered.
    """
    left = [path for path in unfinished_files(folder) if not path.with_suffix("").exists()]
    if not left:
        raise RecordingError(f"{folder}: holds no unfinished rally log; name a damaged file to recover that")
    return [recover(path) for path in left]


def unfinished_files(path: Path) -> list[Path]:
    """The files of the logs in a folder, or of the log at a path, that were not closed."""
    if path.is_dir():
        return sorted(path.glob(f"*{unfinished(Path(SUFFIX)).name}"))
    parts = [unfinished(part_path(path, number)) for number in existing_parts(path)]
    return [part for part in parts if part.exists()]
