"""Atomic writes, hashes of content, safe opening of regular files, and bounds of numbers in files and settings."""

import collections
import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import secrets
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Final, TypeVar, get_args, get_type_hints

import msgspec

from shuttle_marl.base.errors import ShuttleError

NO_ROOM: Final = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)  # lack of space
MAX_JSON: Final = 1 << 24
MAX_LINES: Final = 1 << 25
T = TypeVar("T")
StoredCount = Annotated[int, msgspec.Meta(ge=0, le=1 << 62)]
Count = Annotated[int, msgspec.Meta(ge=1, le=10**15)]
CountOrZero = Annotated[int, msgspec.Meta(ge=0, le=10**15)]
# PyTorch rounds smaller numbers to 0 and larger ones to infinity.
Positive = Annotated[float, msgspec.Meta(ge=1e-30, le=1e30)]
Fraction = Annotated[float, msgspec.Meta(ge=1e-30, le=1)]
FractionOrZero = Annotated[float, msgspec.Meta(ge=0, le=1)]
Weight = Annotated[float, msgspec.Meta(ge=0, le=10)]
Seed = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
Sha256 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
_KINDS: Final = {stat.S_IFDIR: "a folder", stat.S_IFLNK: "a symbolic link", stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket"}
_SEAL: Final = "checksum"
_HASHES: Final = "sha256"


class FileWriteError(ShuttleError):
    """A file could not be written; an existing file is unchanged."""


def replace_file(path: Path, content: bytes, *, new: bool = False) -> None:
    """Write ``content`` to ``path`` atomically, with permissions by the umask; creates the folder.

    Args:
        new: replace no file, not even one that another program wrote meanwhile.

    Raises:
        FileWriteError: the file cannot be written, or ``path`` is neither absent nor a regular file; it is unchanged.
    """
    with replacing(path, new=new) as file:
        file.write(content)


@contextlib.contextmanager
def replacing(path: Path, *, new: bool = False) -> Iterator[BinaryIO]:
    """Open a temporary file that becomes ``path`` at the end, or is deleted after an error; creates the folder.

    Raises:
        FileWriteError: as :func:`replace_file`. Other errors than an OSError of the block pass through.
    """
    check_replaceable(path)
    # A part of the name, because the temporary name must not exceed the limit of the file system.
    temporary = path.parent / f".{path.name[:32]}.{secrets.token_hex(6)}.part"
    with _unwritable(path, OSError, ValueError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        with _unwritable(path, OSError), os.fdopen(handle, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        with _unwritable(path, OSError, ValueError):
            if new:
                os.close(os.open(path, os.O_CREAT | os.O_EXCL, 0o666))  # claims the name: of two programs at once one is refused
            os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def check_replaceable(path: Path) -> None:
    """Raise a FileWriteError where something else than a regular file is: a link, a FIFO, a device or a folder."""
    with contextlib.suppress(OSError, ValueError):  # absent or impossible names, which fail when they are written
        mode = os.lstat(path).st_mode
        if not stat.S_ISREG(mode):
            kind = _KINDS.get(stat.S_IFMT(mode), "a device")
            raise FileWriteError(f"{path}: cannot be written: it is {kind}; name a regular file, or one that does not exist")


@contextlib.contextmanager
def _unwritable(path: Path, *errors: type[Exception]) -> Iterator[None]:
    try:
        yield
    except errors as error:
        raise FileWriteError(f"{path}: cannot be written ({problem(error)}); no file was changed") from error


def open_file(path: Path) -> BinaryIO:
    """Open a regular file for reading; never blocks on a FIFO. Raises OSError: it cannot be opened, or is not a regular file."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return os.fdopen(handle, "rb")


def read_file(path: Path, limit: int | None = None) -> bytes:
    """Content of a regular file.

    Args:
        limit: maximum size [bytes]; None: no limit.

    Raises:
        OSError: it cannot be opened, is not a regular file, or is larger than ``limit``.
    """
    with open_file(path) as file:
        if limit is not None and os.fstat(file.fileno()).st_size > limit:
            raise OSError(errno.EFBIG, f"larger than {limit / 2**20:g} MB", str(path))
        return file.read()


def problem(error: BaseException) -> str:
    """Reason of an error without the file name: the message of the operating system, if there is one."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


class FileReadError(ShuttleError):
    """A file cannot be read, or was changed."""


def content_hash(*parts: bytes) -> str:
    """The SHA-256 by which content, in one part or several, is known to be unchanged; hexadecimal."""
    return hash_of(parts)


def hash_of(parts: Iterable[bytes]) -> str:
    """:func:`content_hash` of parts that are not all in memory."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def verify(known: object, parts: Iterable[bytes]) -> None:
    """Check content by its :func:`content_hash`, as all that this package wrote but MCAP. Raises ValueError: it was changed."""
    if hash_of(parts) != known:
        raise ValueError("it was changed after it was written: its checksum does not match")


def seal(fields: dict[str, Any], indent: int | None = 2) -> bytes:
    """A JSON object with the hash of its other entries, which :func:`unsealed` verifies."""
    content = json.dumps({**fields, _SEAL: content_hash(_canonical(fields))}, indent=indent, ensure_ascii=False)
    return (content + "\n").encode(errors="backslashreplace")


def unsealed(content: bytes) -> dict[str, Any]:
    """The fields of :func:`seal`. Raises ValueError: not a JSON object, or changed after it was written."""
    fields = parsed(content.decode())
    if not isinstance(fields, dict):
        raise ValueError("not a JSON object")
    verify(fields.pop(_SEAL, None), [_canonical(fields)])
    return fields


def replace_sealed(path: Path, fields: dict[str, Any]) -> None:
    """Write the content of :func:`seal` atomically. Raises FileWriteError: as :func:`replace_file`."""
    replace_file(path, seal(fields))


def replace_with_card(card: Path, fields: dict[str, Any], content: dict[str, bytes]) -> None:
    """Write files, and then a card beside them with their hashes, so that a folder with a card is complete.

    Args:
        content: of the files, by name.

    Raises:
        FileWriteError: as :func:`replace_file`.
    """
    for name, part in content.items():
        replace_file(card.parent / name, part)
    replace_sealed(card, with_hashes(fields, content))


def with_hashes(fields: dict[str, Any], content: dict[str, bytes]) -> dict[str, Any]:
    """The fields of a card with the hashes of files."""
    return {**fields, _HASHES: {name: content_hash(part) for name, part in content.items()}}


def hash_in(card: dict[str, Any], name: str) -> str:
    """The hash of a file in its card. Raises ValueError: the card does not hold it."""
    hashes = card.get(_HASHES)
    found = hashes.get(name) if isinstance(hashes, dict) else None
    if not isinstance(found, str):
        raise ValueError(f"the card does not hold the hash of {name}")
    return found


def read_hashed(path: Path, known: str, limit: int | None = None) -> bytes:
    """Content of a regular file whose hash is known. Raises OSError: as :func:`read_file`; ValueError: it has another hash."""
    content = read_file(path, limit)
    verify(known, [content])
    return content


def read_json(path: Path, kind: type[T], *, sealed: bool = False, limit: int = MAX_JSON) -> T:
    """Read a JSON file as a type.

    Args:
        kind: type of the content, such as a dataclass; entries that it does not have are ignored.
        sealed: the file has the content of :func:`seal`, which is verified.
        limit: maximum size [bytes].

    Raises:
        FileReadError: it is missing, not JSON of this type, larger than ``limit``, or was changed; the message is only the
            reason.
    """
    try:
        content = read_file(path, limit)
        return msgspec.convert(unsealed(content) if sealed else parsed(content.decode()), kind)
    except (OSError, ValueError, msgspec.ValidationError) as error:
        raise FileReadError(problem(error)) from error


def check_bounds(settings: Any, error: type[ShuttleError]) -> None:
    """Check that the fields of a dataclass have their types and are within their bounds, which are annotated by ``msgspec.Meta``.

    A string becomes a path where a path is expected, and the only item where a tuple of strings is.

    Raises:
        error: a field is not.
    """
    hints = get_type_hints(type(settings), include_extras=True)
    for name in (field.name for field in dataclasses.fields(settings)):
        value, hint = getattr(settings, name), hints[name]
        if isinstance(value, str) and tuple[str, ...] in (hint, *get_args(hint)):
            value = (value,)
        try:
            plain = value.item() if hasattr(value, "item") else value  # of NumPy
            object.__setattr__(settings, name, msgspec.convert(plain, hint, dec_hook=lambda kind, given: kind(given)))
        except msgspec.ValidationError as problem:
            expected = str(problem)
            raise error(f"--{name.replace('_', '-')} {value}: {expected[0].lower()}{expected[1:]}") from problem


def parsed(text: str, *, finite: bool = False) -> Any:
    """Parse JSON text, such as metadata of a file; ``finite``: without NaN and infinity, which are no JSON.

    Raises:
        ValueError: the text is not JSON, is nested too deeply, or has an entry twice, of which one would be lost.
    """
    try:
        return json.loads(text, object_pairs_hook=_once, parse_constant=_refused if finite else None)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        [(name, _)] = collections.Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"the entry {name!r:.100} stands there twice")
    return fields


def _refused(constant: str) -> None:
    raise ValueError(f"{constant} is no number")


def read_sealed(path: Path) -> dict[str, Any]:
    """Read a file with the content of :func:`seal`, as by :func:`read_json`."""
    return read_json(path, dict[str, Any], sealed=True)


def _canonical(fields: dict[str, Any]) -> bytes:
    return json.dumps(fields, sort_keys=True).encode()
