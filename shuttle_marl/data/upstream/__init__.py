"""The published data sets: addresses, hash of every file, licence, citations, players, and the fixed splits.

The package contains the hashes, not the files.

**Splits.** The test split is the twelve matches of ShuttleSet22 in ``splits.json``; nothing is fitted or chosen on them. The
validation split was sampled once from the others, by match: the first of each stratum (data set x discipline) in the order of the
SHA-256 of their names, 14 in all. The training split is the rest.
"""

import functools
import hashlib
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import PurePosixPath
from typing import Final, Literal, get_args

REPOSITORY: Final = "wywyWang/CoachAI-Projects"
COMMIT: Final = "39bbf3fd99b0b709ff6d1647383959b6fa5f5b74"
BASE_URL: Final = f"https://raw.githubusercontent.com/{REPOSITORY}/{COMMIT}"
"""Base URL of the files; the path of a file below the root is appended."""
SOURCES: Final = {
    "ShuttleSet": PurePosixPath("ShuttleSet/set"),
    "ShuttleSet22": PurePosixPath("CoachAI-Challenge-IJCAI2023/ShuttleSet22/set"),
}
"""Folder of each data set below the root."""
Split = Literal["train", "validation", "test"]
SPLITS: Final[tuple[Split, ...]] = get_args(Split)
CITATIONS: Final = (
    'Wang et al., "ShuttleSet: A Human-Annotated Stroke-Level Singles Dataset for Badminton Tactical Analysis", '
    "KDD 2023, arXiv 2306.04948",
    'Wang et al., "ShuttleSet22: Benchmarking Stroke Forecasting with Stroke-Level Badminton Dataset", '
    "IT4PSS@IJCAI 2023, arXiv 2306.15664",
)
LICENCE_NOTE: Final = "MIT License, Copyright (c) 2022 Wei-Yao Wang; the notice must stay with every copy of the data."


@functools.cache
def manifest() -> dict[str, str]:
    """SHA-256 (hexadecimal) of every published file, by its path below the root, ordered by path."""
    lines = files(__name__).joinpath("MANIFEST.sha256").read_text(encoding="utf-8").splitlines()
    pairs = (line.split("  ", maxsplit=1) for line in lines)
    return {path: digest for digest, path in pairs}


def licence() -> str:
    """Text of the licence of the data sets."""
    return files(__name__).joinpath("LICENSE").read_text(encoding="utf-8")


@functools.cache
def _published() -> frozenset[str]:
    return frozenset(manifest().values())


def is_published(content: bytes) -> bool:
    """Whether the content is that of a published file."""
    return hashlib.sha256(content).hexdigest() in _published()


def match_of(path: str) -> str | None:
    """Name of the match of a file of the manifest, None for the lists."""
    folder = PurePosixPath(path).parent
    return None if folder in SOURCES.values() else folder.name


@functools.cache
def _by_match() -> dict[str, Split]:
    names = json.loads(files(__name__).joinpath("splits.json").read_text(encoding="utf-8"))
    return {match: split for split in SPLITS for match in names[split]}


@functools.cache
def players() -> dict[str, str]:
    """Discipline, ``MS`` or ``WS``, of every published player by identifier."""
    names = json.loads(files(__name__).joinpath("players.json").read_text(encoding="utf-8"))
    return {player: kind for kind, group in names.items() for player in group}


def split_of(match: str) -> Split | None:
    """Split of a match, None for an unpublished match."""
    return _by_match().get(match)


def matches_of(split: Split) -> Sequence[str]:
    """Names of the matches of a split."""
    return [match for match, other in _by_match().items() if other == split]


def player_id(name: str) -> str:
    """Identifier of a player: ``chen-yufei`` for ``'CHEN Yufei'`` and ``'Chen Yufei'``."""
    words = name.replace(".", " ").replace("-", " ").lower().split()
    return "-".join(words)


def discipline(player: str) -> str | None:
    """``MS``, ``WS``, or None for an unpublished player."""
    return players().get(player)
