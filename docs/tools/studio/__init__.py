"""Opens scene files in a headless browser with the last open-source release of Foxglove Studio on the npm registry.

Lichtblick is a fork of the same source. Viewer and browser are installed from the npm registry into a folder (300 MB); neither is
part of this package. Needs Node 20.11 or later.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.scene.write import EPOCH, LAYOUTS

NO_PROBLEMS: Final = "No problems found"
"""Message of Studio for a file without problems."""
_KIT: Final = Path(__file__).parent
_LIMIT: Final = 600
"""Time limit of npm and Node [s]."""


class StudioError(ShuttleError):
    """The viewer cannot be installed or opened."""


def install(folder: Path) -> None:
    """Install viewer and scripts into a folder, unless they are installed; creates the folder.

    Raises:
        StudioError: npm is missing, or the registry cannot be reached.
    """
    # npm writes the second file when the installation is complete.
    locks = [folder / "package-lock.json", folder / "node_modules" / ".package-lock.json"]
    installed = all(lock.is_file() for lock in locks) and locks[0].read_bytes() == (_KIT / locks[0].name).read_bytes()
    shutil.copytree(_KIT, folder, ignore=shutil.ignore_patterns("*.py", "__pycache__"), dirs_exist_ok=True)
    if not installed:
        _call("npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", folder=folder)


def visit(
    folder: Path,
    scene: Path,
    picture: Path,
    seconds: float = 2.0,
    *,
    match: bool = False,
    tabs: Sequence[str] = (),
    scale: float = 1.0,
) -> dict[str, Any]:
    """Open a scene with its layout, take a picture, and play one second.

    Args:
        folder: folder of the viewer.
        scene: file of ``recording scene``.
        picture: PNG file of the window.
        seconds: time of the picture from the start of the scene [s].
        match: use the layout of a match instead of that of a rally.
        tabs: cameras whose 3D panels are saved too, as ``NAME_tab.png`` beside ``picture``.
        scale: scale of the picture relative to the window of 1500 x 1000 pixels; smaller pictures render faster.

    Returns:
        ``problems``: problems of the file, or :data:`NO_PROBLEMS`; ``topics``: number of messages of each topic; ``panels``: text
        of each panel; ``clock``: time of the viewer at the picture and after playing [s]; ``errors``: errors of the page.

    Raises:
        StudioError: the file does not exist, or the viewer does not open.
    """
    if not scene.is_file():
        raise StudioError(
            f"{scene}: no such file; `python -m shuttle_marl.recording scene LOG --match 0 --out {scene}` writes one"
        )
    layout = next(path for path in LAYOUTS if path.name == ("match" if match else "layout") + ".lichtblick.json")
    time = EPOCH // 10**6 + round(1000 * seconds)
    paths = (str(path.resolve()) for path in (scene, layout, picture))
    seen: dict[str, Any] = json.loads(_call("node", "visit.mjs", *paths, str(time), str(scale), *tabs, folder=folder))
    return seen


def _call(program: str, *arguments: str, folder: Path) -> str:
    path = shutil.which(program)
    if path is None:
        raise StudioError(f"{program} is not installed; install Node.js 20.11 or later")
    # The browser is unpacked into the temporary folder and reused from there.
    place = {**os.environ, "TMPDIR": str(folder.resolve())}
    try:
        done = subprocess.run(
            [path, *arguments], cwd=folder, env=place, capture_output=True, text=True, check=False, timeout=_LIMIT
        )
    except subprocess.TimeoutExpired as error:
        raise StudioError(f"{program} did not finish within {_LIMIT} s") from error
    if done.returncode:
        raise StudioError(f"{program} {arguments[0]} failed: {done.stderr[-2000:].strip()}")
    return done.stdout
