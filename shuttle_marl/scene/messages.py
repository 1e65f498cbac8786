"""Messages of scenes: short ways to make them, and to send them later."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from foxglove.messages import (
    Color,
    CubePrimitive,
    Log,
    LogLevel,
    ModelPrimitive,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from shuttle_marl.scene import topics
from shuttle_marl.scene.mesh import Mesh, glb
from shuttle_marl.scene.report import SECOND

Vector = npt.NDArray[np.floating] | tuple[float, float, float]
Send = Callable[[topics.Topics, int], None]
Timed = tuple[int, Send]
"""A message: when [ns], and what sends it then."""
_UPRIGHT: Final = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def stamp(nanoseconds: int) -> Timestamp:
    """An instant."""
    return Timestamp(sec=nanoseconds // SECOND, nsec=nanoseconds % SECOND)


def colour(red: float, green: float, blue: float, alpha: float = 1.0) -> Color:
    """A colour, as it is seen on a screen, 0 to 1."""
    return Color(r=red, g=green, b=blue, a=alpha)


def point(v: Vector) -> Point3:
    """A point [m]."""
    return Point3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def vector(v: Vector) -> Vector3:
    """A vector [m]."""
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def at(v: Vector) -> Pose:
    """A place, not turned."""
    return Pose(position=vector(v), orientation=_UPRIGHT)


def box(centre: Vector, size: Vector, shade: Color) -> CubePrimitive:
    """A box along the axes [m]."""
    return CubePrimitive(pose=at(centre), size=vector(size), color=shade)


def text(words: str, place: Vector, size: float, shade: Color) -> TextPrimitive:
    """Words that always face the viewer, ``size`` metres high."""
    return TextPrimitive(pose=at(place), billboard=True, font_size=size, scale_invariant=False, color=shade, text=words)


def model(meshes: list[Mesh]) -> ModelPrimitive:
    """Meshes as a model."""
    return ModelPrimitive(
        pose=at((0, 0, 0)),
        scale=vector((1, 1, 1)),
        color=colour(1, 1, 1),
        override_color=False,
        media_type="model/gltf-binary",
        data=glb(meshes),
    )


def update(nanoseconds: int, entities: list[SceneEntity]) -> SceneUpdate:
    """All that a topic shows from this time: earlier entities are deleted, so that the message stands for itself after a seek."""
    everything = SceneEntityDeletion(timestamp=stamp(nanoseconds), type=SceneEntityDeletionType.All, id="")
    return SceneUpdate(deletions=[everything], entities=entities)


def entities_on(topic: str, entities: Callable[[int], list[SceneEntity]]) -> Send:
    """Send all that a topic of the 3D panel shows."""

    def send(to: topics.Topics, time: int) -> None:
        message: SceneUpdate = update(time, entities(time))
        to.scenes[topic].log(message, log_time=time)

    return send


def numbers_on(topic: str, content: dict[str, Any]) -> Send:
    """Send numbers and words on a topic of the plots, without what is None."""
    kept = {name: value for name, value in content.items() if value is not None}

    def send(to: topics.Topics, time: int) -> None:
        to.json[topic].log(kept, log_time=time)

    return send


def log_line(words: str, name: str) -> Send:
    """Send a line of the log."""

    def send(to: topics.Topics, time: int) -> None:
        to.log.log(Log(timestamp=stamp(time), level=LogLevel.Info, message=words, name=name), log_time=time)

    return send
