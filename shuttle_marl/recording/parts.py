"""Names of the files of a log: ``NAME.mcap``, and when that is full ``NAME.1.mcap``, ``NAME.2.mcap``, …"""

import re
from pathlib import Path
from typing import Final

SUFFIX: Final = ".mcap"
_UNFINISHED: Final = ".part"
_SET_ASIDE: Final = ".part.old"


def part_path(path: Path, number: int) -> Path:
    """The file of part ``number`` of the log at ``path``."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}") if number else path


def unfinished(path: Path) -> Path:
    """Where a file is written until it is closed."""
    return path.with_name(path.name + _UNFINISHED)


def set_aside(path: Path) -> Path:
    """Where a file stands while a resumed writer copies from it."""
    return path.with_name(path.name + _SET_ASIDE)


def part_number(path: Path, log: Path) -> int | None:
    """Which part of ``log`` this file is, finished or not; None: none of it."""
    name = path.name.removesuffix(_SET_ASIDE).removesuffix(_UNFINISHED)
    if name == log.name:
        return 0
    found = re.fullmatch(re.escape(log.stem) + r"\.([1-9]\d{0,8})" + re.escape(log.suffix), name)
    return int(found[1]) if found and path.parent == log.parent else None


def is_further_part(path: Path) -> bool:
    """Whether a file is named as a part behind the first one is."""
    return re.search(r"\.[1-9]\d{0,8}$", path.stem) is not None


def existing_parts(log: Path) -> list[int]:
    """Numbers of the parts of a log of which there is a file, finished or not."""
    paths = log.parent.iterdir() if log.parent.is_dir() else ()
    return sorted({number for path in paths if (number := part_number(path, log)) is not None})
