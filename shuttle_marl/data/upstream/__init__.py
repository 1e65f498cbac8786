"""What is known about the published data sets: where they are, the hash of every file, their licence and citations.

Hashes are not data: none of the files themselves comes with this package.
"""

import functools
import hashlib
from importlib.resources import files
from pathlib import PurePosixPath
from typing import Final

REPOSITORY: Final = "wywyWang/CoachAI-Projects"
COMMIT: Final = "39bbf3fd99b0b709ff6d1647383959b6fa5f5b74"
BASE_URL: Final = f"https://raw.githubusercontent.com/{REPOSITORY}/{COMMIT}"
"""Where the files are fetched from; the path of a file below the root is appended."""
SOURCES: Final = {
    "ShuttleSet": PurePosixPath("ShuttleSet/set"),
    "ShuttleSet22": PurePosixPath("CoachAI-Challenge-IJCAI2023/ShuttleSet22/set"),
}
"""Folder of each data set below the root."""
CITATIONS: Final = (
    'Wang et al., "ShuttleSet: A Human-Annotated Stroke-Level Singles Dataset for Badminton Tactical Analysis", '
    "KDD 2023, arXiv 2306.04948",
    'Wang et al., "ShuttleSet22: Benchmarking Stroke Forecasting with Stroke-Level Badminton Dataset", '
    "IT4PSS@IJCAI 2023, arXiv 2306.15664",
)
LICENCE_NOTE: Final = "MIT License, Copyright (c) 2022 Wei-Yao Wang; the notice must stay with every copy of the data."


@functools.cache
def manifest() -> dict[str, str]:
    """SHA-256 (hexadecimal) of every published file by its path below the root, in the order of the paths."""
    lines = files(__name__).joinpath("MANIFEST.sha256").read_text(encoding="utf-8").splitlines()
    pairs = (line.split("  ", maxsplit=1) for line in lines)
    return {path: digest for digest, path in pairs}


def licence() -> str:
    """The licence of the data sets, word for word."""
    return files(__name__).joinpath("LICENSE").read_text(encoding="utf-8")


@functools.cache
def _published() -> frozenset[str]:
    return frozenset(manifest().values())


def is_published(content: bytes) -> bool:
    """Whether these bytes are one of the published files."""
    return hashlib.sha256(content).hexdigest() in _published()


def match_of(path: str) -> str | None:
    """Name of the match to which a file of the manifest belongs, None for the lists."""
    folder = PurePosixPath(path).parent
    return None if folder in SOURCES.values() else folder.name
