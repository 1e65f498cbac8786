"""Opens a scene file in Foxglove Studio and prints the viewer's report.

    python -m docs.tools.studio SCENE [--picture FILE] [--seconds S] [--scale X]

The exit status is 1 if the viewer reports problems.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import tyro

from docs.tools.studio import NO_PROBLEMS, StudioError, install, visit
from shuttle_marl.commands.cli import run

_FOLDER: Final = Path("runs") / "studio"


def studio(
    scene: Annotated[Path, tyro.conf.Positional],
    *,
    picture: Path = Path("studio.png"),
    seconds: float = 2.0,
    scale: float = 1.0,
    folder: Path = _FOLDER,
) -> None:
    """Open a scene file in Foxglove Studio, take a picture, and print the viewer's report as JSON.

    Args:
        scene: file of `recording scene`.
        picture: PNG file of the window.
        seconds: time of the picture from the start of the scene.
        scale: scale of the picture relative to the window of 1500 x 1000 pixels.
        folder: folder of the viewer, which is installed there if missing (300 MB).
    """
    install(folder)
    seen = visit(folder, scene, picture, seconds, scale=scale)
    sys.stdout.write(f"{json.dumps(seen, indent=1, ensure_ascii=False)}\n")
    if seen["problems"] != NO_PROBLEMS or seen["errors"]:
        raise StudioError(f"{scene}: {seen['problems']}; errors of the page: {seen['errors'] or 'none'}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(studio, prog="python -m docs.tools.studio", description=studio.__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
