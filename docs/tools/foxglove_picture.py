"""Makes ``docs/images/foxglove.png`` and the court by each of its cameras: ``python -m docs.tools.foxglove_picture``.

A lively rally of two imitated players becomes a scene file, and Foxglove Studio (:mod:`experiments.studio`) opens it at its last
stroke, a smash.
"""

import tempfile
from pathlib import Path
from typing import Final

from docs.tools.markdown import IMAGES
from docs.tools.scene_picture import PLAYERS, lively, strokes
from experiments.studio import NO_PROBLEMS, install, visit
from shuttle_marl.commands.recording import main as recording
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.recording import RallyLog
from shuttle_marl.scene.cameras import CAMERAS

PICTURE: Final = IMAGES / "foxglove.png"
AFTER: Final = 0.06
"""From the contact to the picture [s]."""


def main() -> None:
    """Play, stage, look."""
    with tempfile.TemporaryDirectory() as temporary:
        run, scene = Path(temporary) / "run", Path(temporary) / "rally.mcap"
        run_league(LeagueConfig(pool=PLAYERS, matches=10, out=run))
        log = run / "rallies.mcap"
        with RallyLog(log) as opened:
            number = lively(opened)
        recording(["scene", str(log), "--rally", str(number), "--out", str(scene)])
        install(Path(temporary) / "studio")
        at = strokes(scene)[-1][0] + AFTER
        seen = visit(Path(temporary) / "studio", scene, PICTURE, at, tabs=[camera.title for camera in CAMERAS])
    if seen["problems"] != NO_PROBLEMS or seen["errors"]:
        raise SystemExit(f"{seen['problems']} {seen['errors']}")


if __name__ == "__main__":
    main()
