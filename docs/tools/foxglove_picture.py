"""Makes ``docs/images/foxglove.png``: ``python -m docs.tools.foxglove_picture``.

Two imitated players play a match, all of it becomes a scene file, and Foxglove Studio (:mod:`experiments.studio`) opens it at a
smash in the middle.
"""

import tempfile
from pathlib import Path
from typing import Final

from docs.tools.markdown import IMAGES
from docs.tools.scene_picture import PLAYERS, strokes
from experiments.pictures.scene_file import SceneFile
from experiments.studio import NO_PROBLEMS, install, visit
from shuttle_marl.commands.recording import main as recording
from shuttle_marl.league import LeagueConfig, run_league

PICTURE: Final = IMAGES / "foxglove.png"
AFTER: Final = 0.14
"""From the contact to the picture [s]."""


def smash(scene: Path) -> float:
    """Time of the smash nearest to the middle of a scene [s]."""
    film = SceneFile(scene)
    middle = (film.end - film.start) / 2e9
    return min((seconds for seconds, shot in strokes(scene) if shot == "smash"), key=lambda seconds: abs(seconds - middle))


def main() -> None:
    """Play, stage, look."""
    with tempfile.TemporaryDirectory() as temporary:
        run, scene = Path(temporary) / "run", Path(temporary) / "match.mcap"
        run_league(LeagueConfig(pool=PLAYERS, matches=2, out=run))
        recording(["scene", str(run / "rallies.mcap"), "--match", "0", "--out", str(scene)])
        install(Path(temporary) / "studio")
        seen = visit(Path(temporary) / "studio", scene, PICTURE, smash(scene) + AFTER)
    if seen["problems"] != NO_PROBLEMS or seen["errors"]:
        raise SystemExit(f"{seen['problems']} {seen['errors']}")


if __name__ == "__main__":
    main()
