"""Opens scene files in a real viewer, without a window: the last open-source release of Foxglove Studio on the npm registry.

Lichtblick grew out of the same source. Viewer and browser come from the npm registry into a folder of choice, 300 MB; neither is
part of this package. Node 20.11 or later is needed.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from shuttle_marl.errors import ShuttleError
from shuttle_marl.scene.write import EPOCH, LAYOUTS

NO_PROBLEMS: Final = "No problems found"
"""Studio's message about a file without problems."""
_KIT: Final = Path(__file__).parent
_LIMIT: Final = 600
"""Longest time of npm and Node [s]."""


class StudioError(ShuttleError):
    """The viewer cannot be installed, or does not open."""


def install(folder: Path) -> None:
    """Put the viewer and what visits it into a folder, unless they are there; the folder is made.

    Raises:
        StudioError: there is no npm, or the registry cannot be reached.
    """
    # npm writes the second of these when all is there.
    locks = [folder / "package-lock.json", folder / "node_modules" / ".package-lock.json"]
    there = all(lock.is_file() for lock in locks) and locks[0].read_bytes() == (_KIT / locks[0].name).read_bytes()
    shutil.copytree(_KIT, folder, ignore=shutil.ignore_patterns("*.py", "__pycache__"), dirs_exist_ok=True)
    if not there:
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
    """Open a scene with its layout, take a picture, and play a second.

    Args:
        folder: where the viewer was installed.
        scene: file of ``recording scene``.
        picture: PNG of the window.
        seconds: when it is taken, from the beginning of the scene.
        match: whether the layout of a match is used, not that of a rally.
        tabs: cameras of which a picture of the court alone is taken too, beside ``picture``: ``NAME_tab.png``.
        scale: pixels of the picture for one of the window, which is 1500 wide and 1000 high; less is drawn faster.

    Returns:
        ``problems``: what the viewer says of the file, :data:`NO_PROBLEMS` if nothing; ``topics``: number of messages of each;
        ``panels``: the text of each; ``clock``: what its clock said when the picture was taken, and after it was played [s];
        ``errors``: of the page.

    Raises:
        StudioError: the file is not there, or the viewer does not open.
    """
    if not scene.is_file():
        raise StudioError(
            f"{scene}: no such file; `python -m shuttle_marl.recording scene LOG --match 0 --out {scene}` makes one"
        )
    layout = next(path for path in LAYOUTS if path.name == ("match" if match else "layout") + ".lichtblick.json")
    time = EPOCH // 10**6 + round(1000 * seconds)
    paths = (str(path.resolve()) for path in (scene, layout, picture))
    seen: dict[str, Any] = json.loads(_call("node", "visit.mjs", *paths, str(time), str(scale), *tabs, folder=folder))
    return seen


def _call(program: str, *arguments: str, folder: Path) -> str:
    path = shutil.which(program)
    if path is None:
        raise StudioError(f"{program} is not on this machine; install Node.js 20.11 or later")
    # The browser is unpacked into the folder for temporary files, and looked for there the next time.
    place = {**os.environ, "TMPDIR": str(folder.resolve())}
    try:
        done = subprocess.run(
            [path, *arguments], cwd=folder, env=place, capture_output=True, text=True, check=False, timeout=_LIMIT
        )
    except subprocess.TimeoutExpired as error:
        raise StudioError(f"{program} has not ended after {_LIMIT} s") from error
    if done.returncode:
        raise StudioError(f"{program} {arguments[0]} failed: {done.stderr[-2000:].strip()}")
    return done.stdout
