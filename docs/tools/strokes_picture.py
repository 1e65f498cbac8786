"""Draws ``docs/images/strokes.png``: every kind of stroke motion at six instants around the contact, from staged rallies.

python -m docs.tools.strokes_picture [OUT.png] [--hand left] [--seed N]
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from docs.tools.markdown import IMAGES
from experiments.pictures.raster import Camera, Canvas
from shuttle_marl.game import default_game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.scene import models
from shuttle_marl.staging import Motion, play_rallies, stage
from shuttle_marl.staging.motions import MOTIONS
from shuttle_marl.staging.rotation import matrix, unit
from shuttle_marl.staging.skeleton import BONE
from shuttle_marl.staging.trajectory import facing

INSTANTS = (-0.50, -0.28, -0.12, 0.0, 0.12, 0.35)
SIZE = 170
CLOTH = ((0.70, 0.04, 0.05), (0.03, 0.03, 0.05))


def draw(motion: Motion, seat: int, frame: int, centre: np.ndarray) -> np.ndarray:
    """The player from diagonally ahead on the racket side."""
    right = motion.handedness[seat] == "right"
    ahead, aside = facing(seat), facing(seat) * (1 if right else -1)
    camera = Camera(
        place=(float(centre[0] + 2.9 * aside), float(centre[1] + 3.3 * ahead), 1.9),
        target=(float(centre[0]), float(centre[1]), 1.15),
        field=37,
    )
    canvas = Canvas(SIZE, SIZE, camera, (0.80, 0.83, 0.85))
    ground = np.array([*np.round(centre[:2]), 0.0])
    for k in range(-6, 7):
        for line in ([(k / 2, -3, 0), (k / 2, 3, 0)], [(-3, k / 2, 0), (3, k / 2, 0)]):
            canvas.line(np.linspace(line[0], line[1], 30) + ground, np.tile([0.5, 0.55, 0.55, 1.0], (30, 1)), 1.0)
    meshes = models.athlete(motion.skeletons[seat].name, right_handed=right, shirt=CLOTH[0], shorts=CLOTH[1])
    meshes = {**meshes, "Racket": models.racket(*motion.racket(seat))}
    for bone, group in meshes.items():
        turn = matrix(motion.rotation[frame, seat, BONE[bone]])
        place = motion.position[frame, seat, BONE[bone]].astype(float)
        for mesh in group:
            canvas.triangles(mesh.vertices @ turn.T + place, mesh.normals @ turn.T, mesh.triangles, np.array([*mesh.colour, 1.0]))
    way = unit(motion.shuttle_velocity[frame].astype(float) + 1e-6)
    turn = np.stack([unit(np.cross([0.01, 1, 0.3], way)), np.cross(way, unit(np.cross([0.01, 1, 0.3], way))), way], axis=1)
    for mesh in models.shuttle():
        place = motion.shuttle[frame].astype(float)
        canvas.triangles(mesh.vertices @ turn.T + place, mesh.normals @ turn.T, mesh.triangles, np.array([*mesh.colour, 1.0]))
    return canvas.image()


def main() -> None:
    """Draw one row a kind of motion."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=IMAGES / "strokes.png")
    parser.add_argument("--hand", choices=("right", "left"), default="right")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    game = default_game()
    policy = resolve("bc", game)
    random = resolve("random", game)
    rows: dict[int, np.ndarray] = {}
    played = play_rallies(game, (policy, policy), 120, seed=args.seed) + play_rallies(game, (random, policy), 120, seed=args.seed)
    for i, rally in enumerate(played):
        motion = stage(rally, seed=i, handedness=(args.hand, args.hand), athletes=("male", "female"))
        for k, stance in enumerate(motion.trajectory.stance):
            at, seat = int(motion.contact_frame[k]), int(rally.striker[k])
            frames = [at + round(seconds * motion.fps) for seconds in INSTANTS]
            if stance.motion in rows or frames[0] < 0:
                continue
            centre = motion.position[at, seat, 0].astype(float)
            rows[stance.motion] = np.concatenate([draw(motion, seat, frame, centre) for frame in frames], axis=1)
        if len(rows) == len(MOTIONS):
            break
    figure, axes = plt.subplots(len(rows), 1, figsize=(SIZE * len(INSTANTS) / 100, SIZE * len(rows) / 100), dpi=100)
    for axis, kind in zip(axes, sorted(rows), strict=True):
        axis.imshow(rows[kind], interpolation="nearest", aspect="auto")
        axis.set_axis_off()
        axis.text(6, 18, MOTIONS[kind], fontsize=9, weight="bold")
        for n, seconds in enumerate(INSTANTS):
            axis.text(SIZE * n + SIZE - 6, SIZE - 8, f"{seconds:+.2f} s", fontsize=7, ha="right")
    figure.subplots_adjust(0, 0, 1, 1, 0, 0.01)
    figure.savefig(args.out)


if __name__ == "__main__":
    main()
