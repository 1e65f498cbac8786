"""Opens a scene file in Foxglove Studio and prints its messages.

    python -m experiments.studio SCENE [--picture FILE] [--seconds S] [--scale X]

Exits with 1 if the viewer has anything against the file.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import tyro

from experiments.studio import NO_PROBLEMS, StudioError, install, visit
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
    """Open a scene file in Foxglove Studio, take a picture, and print what the viewer says as JSON.

    Args:
        scene: file of `recording scene`.
        picture: where the picture of the window goes.
        seconds: when it is taken, from the beginning of the scene.
        scale: pixels of the picture for one of the window, which is 1500 wide and 1000 high.
        folder: where the viewer is, or is put: 300 MB of the npm registry.
    """
    install(folder)
    seen = visit(folder, scene, picture, seconds, scale=scale)
    print(json.dumps(seen, indent=1, ensure_ascii=False))
    if seen["problems"] != NO_PROBLEMS or seen["errors"]:
        raise StudioError(f"{scene}: {seen['problems']}; errors of the page: {seen['errors'] or 'none'}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(studio, prog="python -m experiments.studio", description=studio.__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
