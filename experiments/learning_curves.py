"""Learning curves, from the results of experiments.win_rates.

python -m experiments.learning_curves [--results FILE] [--out FILE]
"""

import json
import sys
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands.cli import run

ROOT: Final = Path(__file__).parents[1]
COLOURS: Final = {"a2c": "#4477aa", "ppo": "#ee6677", "sac": "#228833", "ppo, self-play": "#aa3377"}
"""Colours of Paul Tol's palette for colour-blind readers."""
PANELS: Final = {
    "match_win": "probability of winning a match against bc",
    "normalised_score": "normalised score",
    "exploitability": "exploitability",
}


def draw(result: dict[str, Any]) -> bytes:
    """The learning curves as PNG: a panel per figure, a line per agent, and a band over the seeds.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    import matplotlib as mpl  # noqa: PLC0415  an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(10, 3.2), layout="constrained")
        for axes, (name, title) in zip(figure.subplots(1, len(PANELS)), PANELS.items(), strict=True):
            for agent, seeds in result["curves"].items():
                strokes = np.array([point["strokes"] for point in seeds[0]]) / 1e6
                values = np.array([[point[name] for point in seed] for seed in seeds])
                axes.plot(strokes, values.mean(axis=0), color=COLOURS.get(agent), label=agent)
                axes.fill_between(strokes, values.min(axis=0), values.max(axis=0), color=COLOURS.get(agent), alpha=0.2, lw=0)
            level = {"match_win": 0.5, "normalised_score": 0.0, "exploitability": result["exploitability_of_bc"]}[name]
            axes.axhline(level, color="0.4", lw=1, ls="--")
            axes.annotate("bc", (1, level), xycoords=("axes fraction", "data"), ha="right", va="bottom", color="0.4")
            axes.set(title=title, xlabel="million strokes of the learner", xlim=(0, None), ylim=(min(0, level), None))
        figure.axes[1].legend(frameon=False, loc="lower right")
        with BytesIO() as buffer:
            figure.savefig(buffer, dpi=150)
            return buffer.getvalue()


def learning_curves(
    results: Path = ROOT / "experiments" / "results" / "win_rates.json",
    out: Path = ROOT / "docs" / "images" / "learning_curves.png",
) -> None:
    """Draw the learning curves.

    Args:
        results: file written by `experiments.win_rates --json`.
        out: picture to write.
    """
    try:
        result = json.loads(results.read_text(encoding="utf-8"))
        result["curves"], result["exploitability_of_bc"]
    except (OSError, ValueError, KeyError) as error:
        raise ShuttleError(f"{results}: no results of experiments.win_rates ({error!r}); it writes them with --json") from error
    replace_file(out, draw(result))
    sys.stdout.write(f"{out}\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run(learning_curves, prog="experiments.learning_curves", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
