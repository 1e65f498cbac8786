"""What people play, in the figures of :mod:`shuttle_marl.exact.play`, for the model card."""

from typing import Any

import numpy as np

from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.exact.play import in_cross_court_runs, mix


def play_of_people(rows: Rows) -> dict[str, Any]:
    """The play of people.

    Args:
        rows: strokes of whole matches in playing order. A dropped stroke ends a run of net shots.

    Returns:
        The figures of :func:`shuttle_marl.exact.play.mix`, targets without those of faults, and ``length``: mean number of
        strokes of the rallies whose end is known, 0 without any.
    """
    code = {name: rows.codes[name].astype(np.int64) for name in ("shot", "area", "incoming_shot")}
    follows = (np.diff(rows.stroke, prepend=0) == 1) & (np.diff(rows.match, prepend=-1) == 0)
    fault = rows.outcome == Outcome.FAULT
    ends = rows.stroke[fault | (rows.outcome == Outcome.WINNER)]
    figures = mix(
        code["shot"],
        np.where(fault, -1, code["area"]),
        code["incoming_shot"],
        rows.codes["contact"] == 1,
        np.ones(len(rows)),
        float(in_cross_court_runs(code["shot"], follows).sum()),
    )
    return {**figures, "length": float(ends.mean()) if len(ends) else 0.0}
