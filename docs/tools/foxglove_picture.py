"""Takes ``docs/images/foxglove.png`` and pictures of every camera: ``python -m docs.tools.foxglove_picture``.

Foxglove Studio (:mod:`docs.tools.studio`) opens the scene of a varied rally of two imitated players at its last stroke, a smash,
and the scene of the whole match at a smash in its middle (``foxglove_match.png``).
"""

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mcap.reader import make_reader

from docs.tools.markdown import IMAGES
from docs.tools.studio import NO_PROBLEMS, install, visit
from shuttle_marl.commands.recording import main as recording
from shuttle_marl.game.rules import WINNER
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.recording import RallyLog
from shuttle_marl.scene.board import CAMERAS
from shuttle_marl.scene.write import EPOCH

PLAYERS: Final = ("bc:viktor-axelsen", "bc:kento-momota")
PICTURE: Final = IMAGES / "foxglove.png"
MATCH: Final = IMAGES / "foxglove_match.png"
AFTER: Final = 0.06
"""Time from the contact to the picture [s]."""
_SMASH: Final = SHOTS.index("smash")


def lively(log: RallyLog) -> int:
    """Number of the first varied rally that a smash wins in a close deciding game."""
    for first, rallies in log.batches():
        for row in range(len(rallies)):
            rally = rallies.slice(row, row + 1)
            shots = log.catalogue.shot[rally.stroke]
            close = rally.score[0, :2].min() >= 8 and (rally.score[0, 2:] == 1).all()
            if close and rally.reason[0] == WINNER and shots[-1] == _SMASH and len(set(shots.tolist())) >= 8:
                return first + row
    raise SystemExit("no lively rally: play more matches")


def strokes(path: Path) -> list[tuple[float, str]]:
    """Time from the start [s] and shot of every stroke of a scene."""
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages(topics=["/rally/stroke"])
        return [((message.log_time - EPOCH) / 1e9, json.loads(message.data)["shot"]) for _, _, message in messages]


def main() -> None:
    """Record, stage, and take the pictures."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, run = Path(temporary), Path(temporary) / "run"
        run_league(LeagueConfig(pool=PLAYERS, matches=10, out=run))
        log = run / "rallies.mcap"
        with RallyLog(log) as opened:
            number = lively(opened)
            match = int(opened.rally(number).match[0])
        install(folder / "studio")
        scene = folder / "rally.mcap"
        recording(["scene", str(log), "--rally", str(number), "--out", str(scene)])
        take_picture(folder / "studio", scene, PICTURE, strokes(scene)[-1][0], tabs=[camera.title for camera in CAMERAS])
        scene = folder / "match.mcap"
        recording(["scene", str(log), "--match", str(match), "--out", str(scene)])
        struck = strokes(scene)
        middle = next(seconds for seconds, shot in struck[len(struck) // 2 :] if shot == "smash")
        take_picture(folder / "studio", scene, MATCH, middle, match=True)


def take_picture(
    studio: Path, scene: Path, picture: Path, contact: float, *, match: bool = False, tabs: Sequence[str] = ()
) -> None:
    """Take a picture of a scene just after a contact; ``contact`` is its time from the start [s]."""
    seen = visit(studio, scene, picture, contact + AFTER, match=match, tabs=tabs)
    if seen["problems"] != NO_PROBLEMS or seen["errors"]:
        raise SystemExit(f"{seen['problems']} {seen['errors']}")


if __name__ == "__main__":
    main()
