"""Racket and shuttle as meshes."""

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.scene.mesh import Mesh, joined, lathe, moved, normals_of, tube
from shuttle_marl.staging import RACKET_LENGTH, SWEET_SPOT
from shuttle_marl.staging.rotation import frame

Floats = npt.NDArray[np.float64]

SHUTTLE_SCALE: Final = 1.9
"""How much larger than it is a shuttle is drawn: at its true size it cannot be seen across the court."""

_BUTT: Final = -0.10
_HEAD: Final = (RACKET_LENGTH + _BUTT - SWEET_SPOT, 0.105)
"""Half the length and half the width of the strung head [m]."""
_GRIP: Final = (0.03, 0.03, 0.035)
_FRAME: Final = (0.55, 0.02, 0.02)
_STRING: Final = (0.85, 0.85, 0.80)
_CORK: Final = (0.90, 0.88, 0.80)
_BAND: Final = (0.02, 0.25, 0.08)
_FEATHER: Final = (0.95, 0.95, 0.95)


def racket(shaft: Floats, normal: Floats) -> list[Mesh]:
    """A racket, its origin in the middle of the grip.

    Args:
        shaft: ``[3]`` unit direction of the shaft.
        normal: ``[3]`` unit normal of the strings.
    """
    meshes = [
        lathe([(0.0, _BUTT), (0.016, _BUTT), (0.013, -0.02), (0.012, 0.09), (0.006, 0.11), (0.0, 0.11)], _GRIP, 10),
        lathe([(0.0, 0.10), (0.0042, 0.10), (0.0042, SWEET_SPOT - _HEAD[0]), (0.0, SWEET_SPOT - _HEAD[0])], _GRIP, 8),
    ]
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([_HEAD[1] * np.sin(angle), np.zeros(41), SWEET_SPOT - _HEAD[0] * np.cos(angle)], axis=-1)
    meshes.append(tube(ring, 0.006, _FRAME))
    for along, (reach, width) in enumerate((_HEAD, _HEAD[::-1])):
        for at in np.linspace(-0.86, 0.86, 11) * width:
            half = reach * np.sqrt(1 - (at / width) ** 2)
            ends = np.array([[at, 0.0, -half], [at, 0.0, half]]) if along == 0 else np.array([[-half, 0.0, at], [half, 0.0, at]])
            meshes.append(tube(ends + np.array([0, 0, SWEET_SPOT]), 0.0009, _STRING, 4))
    # Here the shaft is z and the normal y.
    axes = frame(shaft, normal)
    turn = np.stack([np.cross(axes[:, 1], axes[:, 0]), axes[:, 1], axes[:, 0]], axis=1)
    return [moved(mesh, turn, np.zeros(3)) for mesh in joined(meshes)]


def shuttle() -> list[Mesh]:
    """A feather shuttle (BWF Law 2: cork of 25 to 28 mm, feathers of 62 to 70 mm, 58 to 68 mm wide) flying along +z.

    The origin lies in the cork; it is :data:`SHUTTLE_SCALE` times as large as a real one.
    """
    bow = [(0.0131 * np.sin(a), 0.012 - 0.0131 * (1 - np.cos(a))) for a in np.linspace(np.pi / 2, 0, 6)]
    meshes = [lathe([(0.0131, -0.013), *bow], _CORK, 14), lathe([(0.0134, -0.014), (0.0134, -0.010)], _BAND, 14)]
    for angle in np.arange(16) * 2 * np.pi / 16:
        vane = np.array([[0.012, -0.0015, -0.013], [0.012, 0.0015, -0.013], [0.032, 0.0075, -0.076], [0.032, -0.0075, -0.076]])
        c, s = np.cos(angle), np.sin(angle)
        vertices = vane @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        triangles = np.array([[0, 2, 1], [0, 3, 2]])
        normals = normals_of(vertices, triangles)
        meshes.append(Mesh(vertices=vertices, normals=normals, triangles=triangles, colour=_FEATHER, two_sided=True))
    return [dataclasses.replace(mesh, vertices=SHUTTLE_SCALE * mesh.vertices) for mesh in joined(meshes)]
