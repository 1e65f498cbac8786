"""Everything one needs to know to get the same run again."""

import importlib.metadata
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import shuttle_marl
from shuttle_marl.league.config import LeagueConfig
from shuttle_marl.league.entrants import Entrant
from shuttle_marl.rally import Game

_PACKAGES: Final = ("numpy", "scipy", "numba", "pyarrow", "mcap", "zstandard")
"""Packages whose versions can change a file of the run."""


def manifest(config: LeagueConfig, game: Game, entrants: Sequence[Entrant], command: Sequence[str]) -> dict[str, Any]:
    """The manifest of a run that starts now."""
    return {
        "status": "running",
        "command": list(command),
        "seed": config.seed,
        "shuttle_marl": shuttle_marl.__version__,
        "git": _git(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: importlib.metadata.version(name) for name in _PACKAGES},
        "game": {"model": config.game, "hash": game.hash, "catalogue": game.catalogue.version},
        "policies": {entrant.name: entrant.hash for entrant in entrants},
    }


def _git() -> dict[str, Any] | None:
    """Commit of the checkout that this package is part of, and whether files of it were changed; None outside of one."""
    here = Path(shuttle_marl.__file__).parent
    try:
        # An installed package may lie inside somebody's checkout without being a part of it.
        _run_git(here, "ls-files", "--error-unmatch", "__init__.py")
        commit = _run_git(here, "rev-parse", "HEAD")
        return {"commit": commit, "changed": bool(_run_git(here, "status", "--porcelain", "--untracked-files=no", "."))}
    except (OSError, subprocess.SubprocessError):
        return None


def _run_git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()


def command_line() -> list[str]:
    """The command that this process was started with."""
    return ["python", *sys.orig_argv[1:]]
