"""Draws ``docs/images/strokes.png``: every kind of stroke motion at six instants around the contact, from staged rallies;
with ``--film`` every shot type with every technique at thirteen instants, as ``docs/images/filmstrips.png``.

python -m docs.tools.strokes_picture [OUT.png] [--film] [--hand left] [--seed N]
"""

import argparse
import dataclasses
import io
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from benchmarks.staging import self_play_rallies
from docs.tools.markdown import IMAGES
from docs.tools.raster import Camera, Canvas
from shuttle_marl.game import default_game
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, SHOTS, TECHNIQUES
from shuttle_marl.scene import models
from shuttle_marl.staging import Motion, stage
from shuttle_marl.staging.motions import MOTIONS
from shuttle_marl.staging.rotation import matrix, unit
from shuttle_marl.staging.skeleton import BONE

INSTANTS = (-0.50, -0.28, -0.12, 0.0, 0.12, 0.35)
FILM = (-0.36, -0.24, -0.16, -0.10, -0.06, -0.02, 0.0, 0.02, 0.06, 0.12, 0.20, 0.32, 0.48)
SIZE = 170
_COLOURS = 96
CLOTH = ((0.70, 0.04, 0.05), (0.03, 0.03, 0.05))


def draw(motion: Motion, seat: int, frame: int, centre: np.ndarray, size: int) -> np.ndarray:
    """The player from diagonally ahead on the racket side."""
    right = motion.hands[seat] == "right"
    ahead = motion.trajectory.rally.facing(seat)
    aside = ahead if right else -ahead
    camera = Camera(
        place=(float(centre[0] + 2.9 * aside), float(centre[1] + 3.3 * ahead), 1.9),
        target=(float(centre[0]), float(centre[1]), 1.15),
        field=37,
    )
    canvas = Canvas(size, size, camera, (0.80, 0.83, 0.85))
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


def kind_of_motion(motion: Motion, stroke: int) -> int:
    """Kind of motion of a stroke."""
    return motion.trajectory.stance[stroke].motion


def kind_of_stroke(motion: Motion, stroke: int) -> int:
    """Shot type and technique of a stroke, as one number."""
    rally = motion.trajectory.rally
    index = rally.stroke[stroke]
    return N_TECHNIQUES * int(rally.catalogue.shot[index]) + int(rally.catalogue.technique[index])


def main() -> None:
    """Draw one row a kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", nargs="?", type=Path)
    parser.add_argument("--film", action="store_true")
    parser.add_argument("--hand", choices=("right", "left"), default="right")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    out = args.out or IMAGES / ("filmstrips.png" if args.film else "strokes.png")
    game = default_game()
    instants: tuple[float, ...]
    if args.film:
        names = {N_TECHNIQUES * k + t: f"{SHOTS[k]}, {TECHNIQUES[t]}" for k in range(N_SHOTS) for t in range(N_TECHNIQUES)}
        played = set((N_TECHNIQUES * game.catalogue.shot + game.catalogue.technique).tolist())
        kinds, kind, instants, size = {k: names[k] for k in sorted(played)}, kind_of_stroke, FILM, 130
    else:
        kinds, kind, instants, size = dict(enumerate(MOTIONS)), kind_of_motion, INSTANTS, SIZE
    rows = strips(kinds, kind, instants, (args.hand, args.seed), size)
    figure, axes = plt.subplots(len(rows), 1, figsize=(size * len(instants) / 100, size * len(rows) / 100), dpi=100)
    for axis, row in zip(axes, sorted(rows), strict=True):
        axis.imshow(rows[row], interpolation="nearest", aspect="auto")
        axis.set_axis_off()
        axis.text(6, 18, kinds[row], fontsize=9, weight="bold")
        for n, seconds in enumerate(instants):
            axis.text(size * n + size - 6, size - 8, f"{seconds:+.2f} s", fontsize=7, ha="right")
    figure.subplots_adjust(0, 0, 1, 1, 0, 0.01)
    with io.BytesIO() as buffer:
        figure.savefig(buffer, format="png")
        # Few colours: a third of the size, and no difference to be seen.
        Image.open(buffer).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(out, optimize=True)


def strips(
    kinds: dict[int, str],
    kind: Callable[[Motion, int], int],
    instants: tuple[float, ...],
    player: tuple[str, int],
    size: int,
) -> dict[int, np.ndarray]:
    """One row of pictures for each kind of stroke that is played."""
    hand, seed = player
    rows: dict[int, np.ndarray] = {}
    played = self_play_rallies("bc", 120, seed=seed) + self_play_rallies("random", 400, seed=seed)
    for i, rally in enumerate(played):
        motion = None
        for k in range(len(rally)):
            catalogue = rally.catalogue
            stroke = N_TECHNIQUES * int(catalogue.shot[rally.stroke[k]]) + int(catalogue.technique[rally.stroke[k]])
            if kind is kind_of_stroke and stroke in rows:
                continue
            motion = motion or stage(dataclasses.replace(rally, hands=(hand, hand)), seed=i, athletes=("male", "female"))
            at, seat, what = int(motion.contact_frame[k]), int(rally.striker[k]), kind(motion, k)
            frames = [at + round(seconds * motion.fps) for seconds in instants]
            if what in rows or frames[0] < 0:
                continue
            centre = motion.position[at, seat, 0].astype(float)
            rows[what] = np.concatenate([draw(motion, seat, frame, centre, size) for frame in frames], axis=1)
        if len(rows) == len(kinds):
            break
    return rows


if __name__ == "__main__":
    main()
