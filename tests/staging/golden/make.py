"""Writes the packed rally and what a reader has to find in it, here: ``python -m tests.staging.golden.make``.

Only for a new version of the format; the committed files show that packed motions of today can be read tomorrow.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np

from shuttle_marl.court.staging import BONES, stage
from tests.staging.played import self_play_rallies
from tests.staging.reader import read

FOLDER = Path(__file__).parent


def main() -> None:
    rally = next(rally for rally in self_play_rallies("bc", 40, seed=11) if len(rally) == 4)
    motion = stage(dataclasses.replace(rally, hands=("right", "left")), seed=5, athletes=("male", "female"))
    packed = motion.pack()
    seen = read(packed)
    rows = sorted({0, len(motion.time) - 1, *motion.contact_frame.tolist(), *range(7, len(motion.time), 41)})
    found = {
        "fps": motion.fps,
        "frames": len(motion.time),
        "players": [{"athlete": motion.skeletons[k].name, "hand": motion.hands[k]} for k in (0, 1)],
        "strokes": [motion.trajectory.rally.catalogue.names[k] for k in motion.trajectory.rally.stroke],
        "contact_frames": motion.contact_frame.tolist(),
        "bones": list(BONES),
        "parents": [motion.parents(seat).tolist() for seat in (0, 1)],
        "rest": [np.round(motion.rest(seat), 6).tolist() for seat in (0, 1)],
        "at": [
            {
                "frame": row,
                "shuttle": np.round(seen.shuttle[row], 5).tolist(),
                "planted": seen.planted[row].tolist(),
                "position": np.round(seen.position[row], 5).tolist(),
                "rotation": np.round(seen.rotation[row], 6).tolist(),
            }
            for row in rows
        ],
    }
    (FOLDER / "rally.smot").write_bytes(packed)
    (FOLDER / "rally.json").write_text(json.dumps(found, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
