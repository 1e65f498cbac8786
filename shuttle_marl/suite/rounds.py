"""Rounds: code is committed to by its hash, then a public beacon draws games, opponents and luck, and anybody reruns the code.

1. Authors publish commitments (:func:`commit`), for instance in a repository, whose history shows their dates.
2. After a round of the beacon that was announced before, :func:`draw_round` writes the commitments and the randomness to a file.
3. Authors publish their code, and anybody runs it behind a boundary (:func:`rerun`). Who reruns looks the randomness up at the
   beacon, so that an invented one is found.
"""

import dataclasses
import datetime as dt
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import msgspec
from rich.console import Console

from shuttle_marl.base.files import Sha256, content_hash, replace_sealed
from shuttle_marl.suite import apart, store
from shuttle_marl.suite.boundary import find_boundary
from shuttle_marl.suite.options import RerunOptions, Resources, SuiteError, SuiteRun
from shuttle_marl.suite.population import checked_beacon
from shuttle_marl.suite.registry import find_task
from shuttle_marl.suite.remote import RemoteMethod
from shuttle_marl.suite.run import Committed, run_method
from shuttle_marl.suite.store import Card

BEACON: Final = "https://api.drand.sh/52db9ba70e0cc0f6eaf7803dd07447a1f5477735fd3f661792ba94600c84e971/public"
"""Public beacon of randomness: the chain ``quicknet`` of drand (https://drand.love)."""
_GENESIS: Final = 1_692_803_367
_PERIOD: Final = 3
"""Time of its first round, in seconds since 1970, and between rounds."""
_NAME: Final = "^[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}$"
"""Names of authors: letters that look like no others."""
_METHOD: Final = r"^[A-Za-z_][A-Za-z0-9_.]{0,79}:[A-Za-z_][A-Za-z0-9_.]{0,79}$"
_TIME: Final = "%Y-%m-%d %H:%M:%S"
_FILES: Final = 1000
_BYTES: Final = 1 << 30
_LOOKS: Final = str.maketrans("01i5", "olls")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Commitment:
    """Code that an author commits to.

    Attributes:
        date: in UTC, to the second, as the author says.
        hash: SHA-256 of the task, the author, the method and the files. It tells nothing of the code, and that of another author
            differs, so nobody can commit to the code of others.
    """

    task: store.Name
    author: Annotated[str, msgspec.Meta(pattern=_NAME)]
    method: Annotated[str, msgspec.Meta(pattern=_METHOD)]
    date: Annotated[dt.datetime, msgspec.Meta(tz=True)]
    hash: Sha256


@dataclasses.dataclass(frozen=True, kw_only=True)
class Round:
    """Content of the file of a round, sealed.

    Attributes:
        beacon: number of the round of the beacon.
        randomness: what the beacon published, hexadecimal.
        commitments: oldest first.
    """

    beacon: Annotated[int, msgspec.Meta(ge=1, le=1 << 36)]
    randomness: Sha256
    commitments: Sequence[Commitment]

    def entry(self, task: str, author: str) -> Commitment:
        """The commitment of an author.

        Raises:
            SuiteError: there is none.
        """
        for each in self.commitments:
            if (each.task, each.author) == (task, author):
                return each
        there = ", ".join(sorted(each.author for each in self.commitments if each.task == task)) or "none"
        raise SuiteError(f"no entry of {author!r} for {task} in this round; there are: {there}")


def time_of(beacon: int) -> dt.datetime:
    """When a round of the beacon appears."""
    return dt.datetime.fromtimestamp(_GENESIS + _PERIOD * (beacon - 1), dt.UTC)


def commit(folder: Path, *, task: str, method: str, author: str, now: dt.datetime | None = None) -> Commitment:
    """The commitment to the code in a folder.

    Args:
        folder: with everything that the method needs beside Python and installed libraries.
        method: ``MODULE:ATTRIBUTE``, in that folder.
        now: date; None: that of the clock.

    Raises:
        SuiteError: there is no such task, a name is not allowed, or there is a link, no file, or too much.
    """
    if "round" not in find_task(task).splits:
        raise SuiteError(f"{task} has no rounds")
    date = (now or dt.datetime.now(dt.UTC)).replace(microsecond=0)
    if not (files := _files(folder)):
        raise SuiteError(f"{folder}: has no files")
    words = [task, author, method, *(f"{digest} {name}" for name, digest in files.items())]
    found = {"task": task, "author": author, "method": method, "date": date, "hash": content_hash("\n".join(words).encode())}
    try:
        return msgspec.convert(found, Commitment)
    except msgspec.ValidationError as error:
        raise SuiteError(f"no commitment: {error}") from error


def _files(folder: Path) -> dict[str, str]:
    """SHA-256 of each file of a folder by its path; hidden files and those of the interpreter are left out."""
    found: dict[str, str] = {}
    size = 0
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if any(part.startswith(".") or part == "__pycache__" for part in name.parts):
            continue
        if path.is_symlink() or not (path.is_dir() or path.is_file()):
            raise SuiteError(f"{path}: is a link or a device; commit to regular files")
        if path.is_file():
            size += path.stat().st_size
            if len(found) == _FILES or size > _BYTES:
                raise SuiteError(f"{folder}: more than {_FILES} files or {_BYTES:,} bytes")
            found[name.as_posix()] = content_hash(path.read_bytes())
    return found


def draw_round(commitments: Sequence[Path], *, beacon: int, randomness: str, now: dt.datetime | None = None) -> Round:
    """A round from files of commitments.

    Args:
        beacon: number of the round of the beacon, announced before.
        randomness: what it published, 64 hexadecimal digits.
        now: time; None: that of the clock.

    Raises:
        SuiteError: the beacon has not appeared yet, a commitment was made after it, or two are of one author.
    """
    if (drawn := time_of(beacon)) > (now or dt.datetime.now(dt.UTC)):
        raise SuiteError(f"round {beacon} of the beacon appears at {drawn:{_TIME}} UTC")
    found = sorted((store.read(path, Commitment, sealed=True) for path in commitments), key=lambda each: each.date)
    return _checked(Round(beacon=beacon, randomness=checked_beacon(randomness), commitments=found))


def _checked(found: Round) -> Round:
    """A round, which a stranger may have written, if its commitments are possible."""
    drawn, seen = time_of(found.beacon), dict[tuple[str, str], Commitment]()
    for each in found.commitments:
        find_task(each.task)
        if each.date >= drawn:
            raise SuiteError(f"{each.author}: committed at {each.date:{_TIME}}, not before the beacon of {drawn:{_TIME}}")
        if (first := seen.setdefault((each.task, _plain(each.author)), each)) is not each:
            raise SuiteError(f"{each.author}: has the name of {first.author}, who committed first; one entry of an author")
    return found


def _plain(name: str) -> str:
    """A name without what cannot be told apart at a glance."""
    return re.sub("[^a-z0-9]", "", name.casefold().translate(_LOOKS)).replace("rn", "m")


def write(path: Path, found: Commitment | Round) -> None:
    """Write a commitment or a round as a sealed file."""
    replace_sealed(path, msgspec.to_builtins(found))


def rerun(path: Path, folder: Path, asked: RerunOptions, resources: Resources, console: Console | None = None) -> Path:
    """Run committed code on a round, behind a boundary; returns the run folder.

    Args:
        path: file of the round.
        folder: code of the author.

    Raises:
        SuiteError: the round is impossible or has other randomness, the code is not that of the commitment, or there is no
            boundary here.
    """
    found = _checked(store.read(path, Round, sealed=True))
    if found.randomness != checked_beacon(asked.randomness):
        raise SuiteError(f"{path}: its randomness is not that of round {found.beacon} of the beacon, see {BEACON}/{found.beacon}")
    entry = found.entry(asked.task, asked.author)
    if commit(folder, task=entry.task, method=entry.method, author=entry.author).hash != entry.hash:
        raise SuiteError(f"{folder}: is not the code of the commitment of {entry.date:{_TIME}} UTC; a file differs")
    with tempfile.TemporaryDirectory() as place:
        code = Path(place) / "code"
        for name in _files(folder):
            (code / "entry" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / name, code / "entry" / name)
        shutil.copyfile(apart.__file__, code / "apart.py")
        for each in (Path(place), code, *code.rglob("*")):
            each.chmod(0o755 if each.is_dir() else 0o644)
        boundary = find_boundary(code, asked.image)
        committed = Committed(
            hash=entry.hash,
            method=RemoteMethod(entry.method, code, boundary, found.randomness),
            card=Card(method=entry.method, authors=asked.author, access="samples"),
            rerun=store.Rerun(by=asked.by, boundary=boundary.name, round=content_hash(path.read_bytes())),
        )
        options = SuiteRun(
            **dataclasses.asdict(resources), task=asked.task, method=entry.method, split="round", beacon=found.randomness
        )
        return run_method(options, console, committed=committed)
