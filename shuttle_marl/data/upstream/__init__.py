"""The published data sets: download, hash of every file, licence, citations, players, and the fixed splits.

The package contains the hashes, not the files. A download checks every file, and resumes if it was interrupted.

**Splits.** The test split is the twelve matches of ShuttleSet22 in ``splits.json``; nothing is fitted or chosen on them. The
validation split was sampled once from the others, by match: the first of each stratum (data set x discipline) in the order of the
SHA-256 of their names, 14 in all. The training split is the rest.
"""

import concurrent.futures
import contextlib
import datetime
import functools
import itertools
import json
import re
import threading
import unicodedata
import urllib.parse
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path, PurePosixPath
from typing import Final, Literal, cast, get_args

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash, hash_of, replace_file

REPOSITORY: Final = "wywyWang/CoachAI-Projects"
COMMIT: Final = "39bbf3fd99b0b709ff6d1647383959b6fa5f5b74"
BASE_URL: Final = f"https://raw.githubusercontent.com/{REPOSITORY}/{COMMIT}"
"""Base URL of the files; the path of a file below the root is appended."""
SOURCES: Final = {  # folder of each data set below the root
    "ShuttleSet": PurePosixPath("ShuttleSet/set"),
    "ShuttleSet22": PurePosixPath("CoachAI-Challenge-IJCAI2023/ShuttleSet22/set"),
}
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
    pairs = (line.split("  ", maxsplit=1) for line in _text("MANIFEST.sha256").splitlines())
    return {path: digest for digest, path in pairs}


def _text(name: str) -> str:
    return files(__name__).joinpath(name).read_text(encoding="utf-8")


@functools.cache
def _by_key(name: str) -> dict[str, str]:
    return {key: group for group, keys in json.loads(_text(name)).items() for key in keys}


def sha256_of(path: Path) -> str:
    """SHA-256 of the content of a file, hexadecimal."""
    with path.open("rb") as file:
        return hash_of(iter(lambda: file.read(1 << 20), b""))


def is_published(content: bytes) -> bool:
    """Whether the content is that of a published file."""
    return content_hash(content) in manifest().values()


def match_of(path: str) -> str | None:
    """Name of the match of a file of the manifest, None for the lists."""
    folder = PurePosixPath(path).parent
    return None if folder in SOURCES.values() else folder.name


def split_of(match: str) -> Split | None:
    """Split of a match, None for an unpublished match."""
    return cast(Split | None, _by_key("splits.json").get(match))


def matches_of(split: Split) -> Sequence[str]:
    """Names of the matches of a split."""
    return [match for match, other in _by_key("splits.json").items() if other == split]


def discipline(player: str) -> str | None:
    """``MS``, ``WS``, or None for an unpublished player."""
    return _by_key("players.json").get(player)


_MONTHS: Final = 12


@functools.cache
def _dates() -> dict[str, datetime.date]:
    return {match: datetime.date.fromisoformat(date) for match, date in json.loads(_text("dates.json")).items()}


_YEAR: Final = r"((?:19|20)\d\d)"
_DATE: Final = re.compile(rf"(?<!\d)(?:{_YEAR}([-./_ ]?)(\d\d)\2(\d\d)|(\d\d?)([-./_])(\d\d?)\6{_YEAR})(?!\d)")


def date_of(match: str) -> datetime.date | None:
    """Date of a match: of a published one as listed, of another that in its name; None without one. Forms are ``2025-03-01``,
    ``20250301``, ``01.03.2025``, and ``31/03/2025`` where the day cannot be a month."""
    if match in _dates():
        return _dates()[match]
    for found in _DATE.finditer(match):
        year, month, day = found.group(1, 3, 4) if found[1] else found.group(8, 7, 5)
        if not found[1] and found[6] != "." and int(month) > _MONTHS:
            month, day = day, month
        elif not found[1] and found[6] != "." and month != day and int(day) <= _MONTHS:
            continue  # day and month cannot be told apart
        with contextlib.suppress(ValueError):  # not a day of the calendar
            return datetime.date(int(year), int(month), int(day))
    return None


def player_id(name: str) -> str:
    """Identifier of a player: ``chen-yufei`` for ``'CHEN Yufei'`` and ``'Chen, Yufei'``; without separators of command lines."""
    return "-".join(re.split(r"[\s.:@,=-]+", unicodedata.normalize("NFC", name.lower()).strip(" .:@,=-")))


_TIMEOUT: Final = (10.0, 30.0)
_TRANSIENT: Final = frozenset({408, 425, 429, 500, 502, 503, 504})
_PART, _PARTS = 1 << 16, 512  # bytes of a part of a file, and parts read: 32 MB, far more than a published file has
_RESUME: Final = "complete files are kept: run the same command again to continue"


class DownloadError(ShuttleError):
    """A file that cannot be downloaded."""


def download(
    out: Path,
    *,
    base_url: str = BASE_URL,
    hashes: Mapping[str, str] | None = None,
    jobs: int = 8,
    retries: int = 3,
    pause: float = 1.0,
    on_file: Callable[[int, int], None] | None = None,
) -> int:
    """Download every file of the manifest that is missing or has another hash.

    A file is written when it is complete and has the right hash, so a killed download leaves no incomplete file.

    Args:
        hashes: SHA-256 by path; None: that of the published data.
        retries: retries after a broken connection, a busy server or a wrong hash.
        pause: seconds before the first retry; doubled each time.
        on_file: called with (number of complete files, number of files) after each file.

    Returns:
        Number of downloaded files.

    Raises:
        DownloadError: no connection, an HTTP error, or a wrong hash after all retries.
        FileWriteError: a file cannot be written.
    """
    files = dict(manifest() if hashes is None else hashes)
    stop = threading.Event()

    def ensure_file(path: str) -> bool:
        target = out / path
        if stop.is_set() or (target.is_file() and sha256_of(target) == files[path]):
            return False
        url = f"{base_url.rstrip('/')}/{urllib.parse.quote(path)}"
        for attempt in range(retries + 1):
            content, failure = _fetched(url, files[path])
            if not failure:
                replace_file(target, content)
                return True
            # After a stop, the error of the file that failed is reported instead.
            if attempt == retries or stop.wait(pause * 2**attempt):
                break
        raise DownloadError(f"{failure}; gave up after {attempt + 1} tries; {_RESUME}")

    fetched = 0
    with concurrent.futures.ThreadPoolExecutor(max(1, jobs)) as pool:
        futures = [pool.submit(ensure_file, path) for path in files]
        try:
            for done, future in enumerate(concurrent.futures.as_completed(futures), start=1):
                fetched += future.result()
                if on_file is not None:
                    on_file(done, len(files))
        except BaseException:
            stop.set()
            pool.shutdown(cancel_futures=True)
            raise
    replace_file(out / "LICENSE", _text("LICENSE").encode())
    return fetched


def _fetched(url: str, digest: str) -> tuple[bytes, str]:
    """Content of a file, and a failure that may be transient; empty if it has the right hash."""
    import requests  # noqa: PLC0415  slow to import

    try:
        with requests.get(url, timeout=_TIMEOUT, stream=True) as response:
            response.raise_for_status()
            content = b"".join(itertools.islice(response.iter_content(_PART), _PARTS))
    except requests.HTTPError as error:
        if response.status_code in _TRANSIENT:
            return b"", f"{url}: {error}"
        raise DownloadError(f"{url}: {error}; is --base-url right? {_RESUME}") from error
    except requests.RequestException as error:
        return b"", f"{url}: no answer ({_cause(error)}); is this machine online?"
    got = content_hash(content)
    return content, "" if got == digest else f"{url}: SHA-256 is {got}, expected {digest}: the file was altered in transit"


def _cause(error: BaseException) -> str:
    """The innermost cause of a network error, the most specific one."""
    while error.__cause__ or error.__context__:
        error = error.__cause__ or error.__context__ or error
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
