"""Compile functions with numba, and cache the machine code on disk.

numba's cache does not notice changes of functions that are inlined from other files, so their digest is added to its stamp. The
stamp is private, so ``pyproject.toml`` has an upper bound of numba's version, which a test compares with the installed one.
"""

# mypy: allow-untyped-calls

import functools
import hashlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

_LOG: Final = logging.getLogger(__name__)


def cached(function: F, **options: Any) -> F:
    """``numba.njit(**options)`` of a function, with its machine code cached on disk."""
    try:
        dispatcher = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no writable folder
        _warn()
        return cast(F, numba.njit(**options)(function))
    if not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]  # set from the environment
        index = dispatcher._cache._cache_file
        index._source_stamp = (index._source_stamp, _sources(Path(function.__code__.co_filename).parent))
    return cast(F, dispatcher)


def compiled(function: F) -> F:
    """Compile in nopython mode without the GIL, and cache the machine code on disk."""
    return cached(function, nogil=True, error_model="numpy")


def inlined(function: F) -> F:
    """Compile a function that LLVM inlines into its callers."""
    return cached(function, nogil=True, error_model="numpy", forceinline=True)


@functools.cache
def _warn() -> None:
    _LOG.warning(
        "neither the folder of the package nor that of the user's caches is writable: the kernel is compiled again in every "
        "process; set NUMBA_CACHE_DIR to a folder that is"
    )


@functools.cache
def _sources(folder: Path) -> str:
    """Digest of all sources that may be inlined into a compiled function: its folder, the kernel, the draws and the scoring."""
    package = Path(__file__).parents[1]
    rules = [Path(__file__), package / "game" / "draws.py", package / "game" / "scoring.py"]
    files = [*rules, *sorted((package / "kernel").glob("*.py")), *sorted(folder.glob("*.py"))]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
