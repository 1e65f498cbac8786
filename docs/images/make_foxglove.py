"""Makes foxglove.png: ``python docs/images/make_foxglove.py``.

Two imitated players play a match, all of it becomes a scene file, and Foxglove Studio (:mod:`experiments.studio`) opens it at a
smash in the middle.
"""

import json
import tempfile
from pathlib import Path
from typing import Final

from mcap.reader import make_reader

from experiments.studio import NO_PROBLEMS, install, visit
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.recording.__main__ import main as recording

PICTURE: Final = Path(__file__).with_name("foxglove.png")
PLAYERS: Final = ("bc:viktor-axelsen", "bc:kento-momota")
AFTER: Final = 0.14
"""From the contact to the picture [s]."""


def smash(scene: Path) -> float:
    """When the smash is struck that is nearest to the middle of a scene [s]."""
    with scene.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise SystemExit(f"{scene}: has no summary")
        start, end = summary.statistics.message_start_time, summary.statistics.message_end_time
        struck = [
            m.log_time for _, _, m in reader.iter_messages(topics=["/rally/stroke"]) if json.loads(m.data)["shot"] == "smash"
        ]
    return min(((time - start) / 1e9 for time in struck), key=lambda seconds: abs(seconds - (end - start) / 2e9))


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
