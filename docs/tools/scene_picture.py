"""Draws ``docs/images/scene.png``, ``moments.png`` and ``film.webp``: ``python -m docs.tools.scene_picture``.

Two imitated players play ten matches. The first varied rally of a deciding game that ends with a smash becomes a scene file, and
:mod:`docs.tools.scene_file` draws it without a viewer.
"""

import json
import tempfile
from pathlib import Path
from typing import Final

import matplotlib.pyplot as plt
import numpy as np
from mcap.reader import make_reader
from PIL import Image

from docs.tools.markdown import IMAGES
from docs.tools.raster import Camera
from docs.tools.scene_file import SceneFile
from shuttle_marl.commands.recording import main as recording
from shuttle_marl.game.rules import WINNER
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.recording import RallyLog

PLAYERS: Final = ("bc:viktor-axelsen", "bc:kento-momota")
SMASH: Final = SHOTS.index("smash")
BESIDE: Final = Camera(place=(10.4, -4.0, 3.0), target=(0.0, 0.45, 1.35), field=38)
"""A camera that shows both players from the side."""
_EVERY: Final = 0.08
"""Time between frames of the film: four frames of the staging [s]."""
_AROUND: Final = (0.7, 1.3)
"""Time from the start of the film to the serve, and from the last contact to the end [s]."""
_QUALITY: Final = 55


def lively(log: RallyLog) -> int:
    """Number of the first varied rally that a smash wins in a close deciding game."""
    for first, rallies in log.batches():
        for row in range(len(rallies)):
            rally = rallies.slice(row, row + 1)
            shots = log.catalogue.shot[rally.stroke]
            close = rally.score[0, :2].min() >= 8 and (rally.score[0, 2:] == 1).all()
            if close and rally.reason[0] == WINNER and shots[-1] == SMASH and len(set(shots.tolist())) >= 8:
                return first + row
    raise SystemExit("no lively rally: play more matches")


def strokes(path: Path) -> list[tuple[float, str]]:
    """Time from the start [s] and shot of every stroke of a scene."""
    with path.open("rb") as file:
        found = [
            (m.log_time, json.loads(m.data)["shot"]) for _, _, m in make_reader(file).iter_messages(topics=["/rally/stroke"])
        ]
    start = SceneFile(path).start
    return [((time - start) / 1e9, shot) for time, shot in found]


def film_of(scene: SceneFile, struck: list[tuple[float, str]], path: Path) -> None:
    """Write a film of a rally."""
    begin, end = struck[0][0] - _AROUND[0], struck[-1][0] + _AROUND[1]
    seconds = np.arange(max(begin, 0.0), end, _EVERY).tolist()
    first, *others = (Image.fromarray(scene.picture(at, camera=BESIDE, width=640, height=300)) for at in seconds)
    first.save(path, save_all=True, append_images=others, duration=round(1000 * _EVERY), loop=0, quality=_QUALITY, method=4)


def main() -> None:
    """Record, stage, and draw."""
    with tempfile.TemporaryDirectory() as temporary:
        run, path = Path(temporary) / "run", Path(temporary) / "rally.mcap"
        run_league(LeagueConfig(pool=PLAYERS, matches=10, out=run))
        log = run / "rallies.mcap"
        with RallyLog(log) as opened:
            number = lively(opened)
        recording(["scene", str(log), "--rally", str(number), "--out", str(path)])
        film, struck = SceneFile(path), strokes(path)
        last = struck[-1][0]
        film_of(film, struck, IMAGES / "film.webp")
        film.save(IMAGES / "scene.png", last + 0.06, camera=Camera(place=(7.6, -9.4, 3.2), target=(0.0, 0.2, 1.3), field=36))
        figure, axes = plt.subplots(2, 2, figsize=(12.8, 7.2), dpi=100)
        behind = Camera(place=(2.4, -11.6, 3.9), target=(0.0, 0.4, 1.0), field=34)
        low = Camera(place=(9.2, -2.6, 1.9), target=(0.0, -0.3, 1.3), field=42)
        end = Camera(place=(3.6, 11.2, 2.6), target=(0.0, 1.4, 1.2), field=36)
        views = ((struck[0][0] + 0.1, behind), (struck[len(struck) // 3][0], low), (struck[-2][0], end), (last, behind))
        for axis, (seconds, camera) in zip(axes.ravel(), views, strict=True):
            axis.imshow(np.asarray(film.picture(seconds, camera=camera, width=640, height=360)), interpolation="nearest")
            axis.set_axis_off()
        figure.subplots_adjust(0, 0, 1, 1, 0.004, 0.007)
        figure.savefig(IMAGES / "moments.png")


if __name__ == "__main__":
    main()
