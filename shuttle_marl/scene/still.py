"""Messages of what does not move by itself: the court, the net, and the models that follow their frames of reference."""

from typing import Final

import numpy as np
from foxglove.messages import LinePrimitive, LinePrimitiveLineType, ModelPrimitive, SceneEntity, TextPrimitive

from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, LENGTH, NET_HEIGHT, SHORT_SERVICE, WIDTH
from shuttle_marl.scene import models
from shuttle_marl.scene.messages import at, box, colour, model, point, stamp, text
from shuttle_marl.scene.poses import SHUTTLE, WORLD, bone_frame, name_frame
from shuttle_marl.staging import Motion
from shuttle_marl.staging.trajectory import net_height

KITS: Final[tuple[tuple[models.Colour, models.Colour], ...]] = (
    ((0.70, 0.04, 0.05), (0.03, 0.03, 0.05)),
    ((0.03, 0.16, 0.62), (0.80, 0.80, 0.82)),
)
"""Shirt and shorts of seats 0 and 1, linear."""
NAME_COLOURS: Final = (colour(1.0, 0.55, 0.50), colour(0.55, 0.75, 1.0))

_LINE: Final = 0.04
"""Width of the lines (BWF Law 1.3) [m]."""
_LONG_SERVICE_DOUBLES: Final = 0.76
_NET_DEPTH: Final = 0.76
_TAPE: Final = 0.075
_FLOOR, _MAT = colour(0.10, 0.16, 0.24), colour(0.06, 0.42, 0.30)
_WHITE: Final = colour(0.96, 0.96, 0.94)


def court(time: int) -> list[SceneEntity]:
    """Court and net as the laws draw them (BWF Laws 1.1 to 1.10)."""
    edge_x, edge_y = WIDTH / 2, HALF_LENGTH
    boxes = [
        box((0, 0, -0.065), (WIDTH + 4, LENGTH + 4, 0.1), _FLOOR),
        box((0, 0, -0.0075), (WIDTH + 1, LENGTH + 1.2, 0.015), _MAT),
    ]

    def line(x0: float, y0: float, x1: float, y1: float) -> None:
        size = (max(abs(x1 - x0), _LINE), max(abs(y1 - y0), _LINE), 0.003)
        boxes.append(box(((x0 + x1) / 2, (y0 + y1) / 2, 0.0015), size, _WHITE))

    half = _LINE / 2
    for side in (-1, 1):
        for x in (edge_x, HALF_WIDTH):
            line(side * (x - half), -edge_y, side * (x - half), edge_y)
        for y in (edge_y - half, edge_y - _LONG_SERVICE_DOUBLES, SHORT_SERVICE + half):
            line(-edge_x, side * y, edge_x, side * y)
        line(0, side * SHORT_SERVICE, 0, side * edge_y)
    ground = SceneEntity(id="court", timestamp=stamp(time), frame_id=WORLD, frame_locked=True, cubes=boxes)
    return [ground, _net(time)]


def _net(time: int) -> SceneEntity:
    across = np.linspace(-WIDTH / 2, WIDTH / 2, 82)
    top = net_height(across)
    strands = [p for x, z in zip(across, top, strict=True) for p in ((x, 0, z), (x, 0, z - _NET_DEPTH))]
    for drop in np.linspace(0, _NET_DEPTH, 11):
        for a, b in zip(range(0, 81, 9), range(9, 82, 9), strict=True):
            strands += [(across[a], 0, top[a] - drop), (across[b], 0, top[b] - drop)]
    mesh = LinePrimitive(
        type=LinePrimitiveLineType.LineList,
        pose=at((0, 0, 0)),
        thickness=1.0,
        scale_invariant=True,
        points=[point(p) for p in strands],
        color=colour(0.75, 0.78, 0.80, 0.55),
    )
    tape = []
    for a, b in zip(range(0, 81, 9), range(9, 82, 9), strict=True):
        middle = ((across[a] + across[b]) / 2, 0, (top[a] + top[b] - _TAPE) / 2)
        tape.append(box(middle, (across[b] - across[a] + 0.002, 0.02, _TAPE), _WHITE))
    posts = [box((side * WIDTH / 2, 0, NET_HEIGHT / 2), (0.04, 0.04, NET_HEIGHT), colour(0.8, 0.8, 0.82)) for side in (-1, 1)]
    return SceneEntity(id="net", timestamp=stamp(time), frame_id=WORLD, frame_locked=True, lines=[mesh], cubes=tape + posts)


def players(time: int, motion: Motion, names: tuple[str, str]) -> list[SceneEntity]:
    """Models that follow the bones of both players and the shuttle, and the names over their heads."""
    out = [_carried(time, SHUTTLE, models=[model(models.shuttle())])]
    for seat in (0, 1):
        right = motion.handedness[seat] == "right"
        shirt, shorts = KITS[seat]
        found = models.athlete(motion.skeletons[seat].name, right_handed=right, shirt=shirt, shorts=shorts)
        found = {**found, "Racket": models.racket(*motion.racket(seat))}
        out += [_carried(time, bone_frame(seat, bone), models=[model(meshes)]) for bone, meshes in found.items()]
        out.append(_carried(time, name_frame(seat), texts=[text(names[seat], (0, 0, 0), 0.20, NAME_COLOURS[seat])]))
    return out


def _carried(
    time: int, frame: str, *, models: list[ModelPrimitive] | None = None, texts: list[TextPrimitive] | None = None
) -> SceneEntity:
    return SceneEntity(
        id=frame,
        timestamp=stamp(time),
        frame_id=frame,
        frame_locked=True,
        models=models or [],
        texts=texts or [],
    )
