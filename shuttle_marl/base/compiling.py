"""Compile functions with numba, and cache the machine code on disk.

numba's own cache raises an error if neither the package nor the home directory is writable, writes to a folder ``~`` in the
working folder if there is no home, fails on damaged files, and does not notice changes of inlined functions. The subclasses here
fix these defects. They override private methods of numba, so ``pyproject.toml`` has an upper bound of its version, which a test
compares with the installed one.
"""

# mypy: allow-untyped-calls

import functools
import hashlib
import logging
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba
from numba.core import caching

F = TypeVar("F", bound=Callable[..., Any])

_LOG: Final = logging.getLogger(__name__)


def cached(function: F, **options: Any) -> F:
    """``numba.njit(**options)`` of a function, with its machine code cached on disk."""
    dispatcher = numba.njit(**options)(function)
    dispatcher._cache = _cache_of(function)
    return cast(F, dispatcher)


def compiled(function: F) -> F:
    """Compile in nopython mode without the GIL, and cache the machine code on disk."""
    return cached(function, nogil=True, error_model="numpy")


def inlined(function: F) -> F:
    """Compile a function that LLVM inlines into its callers."""
    return cached(function, nogil=True, error_model="numpy", forceinline=True)


def _cache_of(function: Callable[..., Any]) -> Any:
    try:
        return _Cache(function)
    except RuntimeError:  # numba found no writable folder
        if _temporary_folder() is None:
            return caching.NullCache()
        return _Cache(function)


@functools.cache
def _temporary_folder() -> "tempfile.TemporaryDirectory[str] | None":
    """Folder for the machine code of this process, removed at its end; None if no folder is writable."""
    try:
        folder = tempfile.TemporaryDirectory(prefix="shuttle_marl-compiled-", ignore_cleanup_errors=True)
    except OSError:
        _LOG.warning("no folder is writable: the kernel is compiled again in every process; set NUMBA_CACHE_DIR to one that is")
        return None
    numba.config.CACHE_DIR = folder.name  # type: ignore[attr-defined]
    _LOG.warning(
        "neither the folder of the user's caches nor that of the package is writable: the kernel is compiled for this process "
        "alone, in %s; set NUMBA_CACHE_DIR to a writable folder to keep it", folder.name,
    )  # fmt: skip
    return folder


@functools.cache
def _sources(folder: Path) -> str:
    """Digest of all sources that may be inlined into a compiled function: its folder, the kernel, the draws and the scoring."""
    package = Path(__file__).parents[1]
    rules = [Path(__file__), package / "game" / "draws.py", package / "game" / "scoring.py"]
    files = [*rules, *sorted((package / "kernel").glob("*.py")), *sorted(folder.glob("*.py"))]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


class _HomeLocator(caching.UserWideCacheLocator):
    """numba's folder for all functions of a user, refused where the user has no home."""

    def ensure_cache_path(self) -> None:
        if not Path(self.get_cache_path()).is_absolute():
            raise OSError("no home folder")
        super().ensure_cache_path()


class _Folders(caching.CompileResultCacheImpl):
    """numba's choice of a folder, with that of the package last: an uninstalled package leaves no files behind."""

    _locator_classes = sorted(
        (
            _HomeLocator if kind is caching.UserWideCacheLocator else kind
            for kind in caching.CompileResultCacheImpl._locator_classes
        ),
        key=lambda locator: locator.__name__.endswith("InTreeCacheLocator"),
    )


class _Cache(caching.FunctionCache):
    """numba's cache of one function; unreadable entries are recompiled."""

    _impl_class = _Folders

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = caching.IndexDataCacheFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), _sources(Path(function.__code__.co_filename).parent)),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The machine code for a signature; None if there is none or it is damaged."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # damaged pickles raise errors of all kinds
            _LOG.debug("%s: compiled again (%s)", self._name, error)
            self._try(self.flush)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write machine code, unless the disk fails."""
        self._try(lambda: super(_Cache, self).save_overload(sig, data))

    def _try(self, write: Callable[[], Any]) -> None:
        try:
            write()
        except OSError as error:
            _LOG.debug("%s: not kept (%s)", self._name, error)
            self.disable()
