"""The published data sets: where they are, the hash of every file, licence, citations, players, and the fixed splits.

Hashes are not data: none of the files themselves comes with this package.

**Splits.** Test is the twelve matches of ShuttleSet22 named in ``splits.json``; nothing is fitted or chosen on them. Validation
was drawn once, by match, from the rest: within each stratum (data set x discipline) the matches were ordered by the SHA-256
of their names and the first of them taken, 14 in all. Train is what remains.
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
"""Address from which the files are fetched; the path of a file below the root is appended."""
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

WOMEN: Final = frozenset(
    {
        "aakarshi-kashyap",
        "akane-yamaguchi",
        "an-se-young",
        "busanan-ongbamrungphan",
        "carolina-marin",
        "chen-yufei",
        "evgeniya-kosetskaya",
        "gregoria-mariska-tunjung",
        "he-bingjiao",
        "mia-blichfeldt",
        "michelle-li",
        "neslihan-yigit",
        "pornpawee-chochuwong",
        "pusarla-v-sindhu",
        "ratchanok-intanon",
        "supanida-katethong",
        "wang-zhi-yi",
    }
)
"""Identifiers of the players of women's singles."""

MEN: Final = frozenset(
    {
        "anders-antonsen",
        "anthony-sinisuka-ginting",
        "chen-long",
        "chico-aura-dwi-wardoyo",
        "chou-tien-chen",
        "hans-kristian-solberg-vittinghus",
        "jonatan-christie",
        "kenta-nishimoto",
        "kento-momota",
        "kidambi-srikanth",
        "kodai-naraoka",
        "kunlavut-vitidsarn",
        "lakshya-sen",
        "lee-cheuk-yiu",
        "lee-zii-jia",
        "li-shi-feng",
        "liew-daren",
        "loh-kean-yew",
        "lu-guang-zu",
        "ng-ka-long-angus",
        "prannoy-h-s",
        "rasmus-gemke",
        "sameer-verma",
        "shi-yuqi",
        "viktor-axelsen",
        "zhao-jun-peng",
    }
)
"""Identifiers of the players of men's singles."""


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
    """Test whether these bytes are one of the published files."""
    return hashlib.sha256(content).hexdigest() in _published()


def match_of(path: str) -> str | None:
    """Name of the match to which a file of the manifest belongs, None for the lists."""
    folder = PurePosixPath(path).parent
    return None if folder in SOURCES.values() else folder.name


@functools.cache
def _by_match() -> dict[str, Split]:
    names = json.loads(files(__name__).joinpath("splits.json").read_text(encoding="utf-8"))
    return {match: split for split in SPLITS for match in names[split]}


def split_of(match: str) -> Split | None:
    """Split of a match, None for a match that is in neither data set."""
    return _by_match().get(match)


def matches_of(split: Split) -> Sequence[str]:
    """Names of the matches of a split."""
    return [match for match, other in _by_match().items() if other == split]


def player_id(name: str) -> str:
    """Identifier of a player as the data sets spell them: ``'CHEN Yufei'`` and ``'Chen Yufei'`` give ``chen-yufei``."""
    words = name.replace(".", " ").replace("-", " ").lower().split()
    return "-".join(words)


def discipline(player: str) -> str | None:
    """``MS``, ``WS``, or None for a player of neither list."""
    if player in WOMEN:
        return "WS"
    return "MS" if player in MEN else None
