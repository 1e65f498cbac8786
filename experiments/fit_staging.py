"""Measure timing and places in annotated matches and write the table of the staging.

    python -m experiments.fit_staging --data FOLDER [--out FILE]

The matches contain the time (video frame) and place of each contact, the positions of the players, and the reasons of faults.
The height of a contact is known only as above or below the net; see
:mod:`shuttle_marl.staging.motions`. Only the training matches are used.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import clean_matches, matches_of
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.data.table import provenance_of
from shuttle_marl.game.court import AREAS, HALF_LENGTH, HALF_WIDTH, N_AREAS
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, N_SHOTS, SHOTS
from shuttle_marl.staging.draw import DISTANCES, FILE, QUANTILES, QUARTILES

_ENOUGH: Final = 40
"""Minimum number of strokes in a cell of a table; cells with fewer use the next coarser cell."""
_LONGEST: Final = 3.5
"""Longest plausible time between two strokes [s]."""
_REACH: Final = 0.45
"""Assumed distance of the contact of a serve in front of the server [m]; not in the data."""


def fit(data: Path, out: Path | None = None) -> dict[str, Any]:
    """Measure the training matches and write the table.

    Args:
        data: folder with the raw files of the matches.
        out: output file; default: the file of the package.

    Returns:
        The table.

    Raises:
        DataError: the folder holds no matches.
        FileWriteError: the file cannot be written.
    """
    cleaned = clean_matches(data)
    strokes = cleaned.strokes
    strokes = strokes.filter(pc.is_in(strokes["match"], pa.array(matches_of("train"))))
    table = {"provenance": {**provenance_of(data, cleaned), "split": "train"}, **measure(strokes)}
    replace_file(out or FILE, (json.dumps(table, indent=1, ensure_ascii=False) + "\n").encode())
    return table


def measure(strokes: pa.Table) -> dict[str, Any]:
    """The tables of :class:`shuttle_marl.staging.draw.Measured` from a stroke table, as JSON."""
    c = {name: strokes[name].to_numpy(zero_copy_only=False) for name in strokes.column_names}
    shot, area = c["shot"].astype(np.int64), np.nan_to_num(c["area"].astype(np.float64), nan=-1).astype(np.int64)
    following = _following(c)
    returned = following & (c["outcome"] == Outcome.RETURNED)
    seconds = np.full(len(shot), np.nan)
    seconds[:-1] = np.diff(c["frame"].astype(np.float64)) / _frames_per_second(c)[:-1]
    seconds[~returned | (seconds <= 0) | (seconds > _LONGEST)] = np.nan
    next_height = np.r_[c["height"][1:], 0].astype(np.int64)
    serve = shot < N_SERVES
    from_x = np.where(serve, c["striker_x"], c["contact_x"]).astype(np.float64)
    from_y = np.where(serve, c["striker_y"] + _REACH, c["contact_y"]).astype(np.float64)
    length = np.hypot(c["landing_x"] - from_x, c["landing_y"] - from_y)
    timed = np.isfinite(seconds) & np.isfinite(length)
    return {
        "strokes": len(shot),
        "matches": len(np.unique(c["match"])),
        "shots": list(SHOTS),
        "areas": list(AREAS),
        "timed": int(timed.sum()),
        "flight_time": {SHOTS[s]: _round(np.quantile(seconds[timed & (shot == s)], QUARTILES)) for s in range(N_SHOTS)},
        "flight_time_by_length": _flight_times(shot[timed], next_height[timed], length[timed], seconds[timed]),
        "places": _places(shot, area, c, returned),
        "base": _bases(shot, area, c, following),
        "faults": _faults(shot, c),
        "out_by": _out_by(c),
        "serve": _serves(shot, c),
    }


def _following(c: dict[str, npt.NDArray[Any]]) -> Bools:
    """``[N]`` whether the next row is the next stroke of the same rally."""
    same = np.ones(len(c["match"]), dtype=bool)
    for name in ("match", "game", "rally"):
        same[:-1] &= c[name][1:] == c[name][:-1]
    same[:-1] &= c["stroke"][1:] == c["stroke"][:-1] + 1
    same[-1] = False
    return same


def _frames_per_second(c: dict[str, npt.NDArray[Any]]) -> F64:
    """``[N]`` frame rate of the video of each row: slope of frame numbers over the clock [Hz]."""
    out = np.full(len(c["match"]), np.nan)
    for match in np.unique(c["match"]):
        rows = np.flatnonzero(c["match"] == match)
        clock, frame = c["clock"][rows].astype(np.float64), c["frame"][rows].astype(np.float64)
        ok = np.isfinite(clock) & np.isfinite(frame)
        out[rows] = np.polyfit(clock[ok], frame[ok], 1)[0]
    return out


def _flight_times(shot: I64, next_height: I64, length: F64, seconds: F64) -> dict[str, Any]:
    """Quartiles by shot type, height of the next contact, and length; sparse cells use coarser ones."""
    bins = np.clip(np.searchsorted(DISTANCES, length, side="right") - 1, 0, len(DISTANCES) - 2)
    out: dict[str, Any] = {}
    for s in range(N_SHOTS):
        mine = shot == s
        out[SHOTS[s]] = {}
        for h, name in enumerate(HEIGHTS):
            met = mine & (next_height == h)
            coarse = seconds[met] if met.sum() >= _ENOUGH else seconds[mine]
            cells = [seconds[met & (bins == k)] for k in range(len(DISTANCES) - 1)]
            out[SHOTS[s]][name] = [_round(np.quantile(c if len(c) >= _ENOUGH else coarse, QUARTILES)) for c in cells]
    return out


def _places(shot: I64, area: I64, c: dict[str, npt.NDArray[Any]], returned: Bools) -> dict[str, Any]:
    """Quantiles of the receiver's contact in the striker's frame, by shot type and area."""
    xy = np.stack([c["landing_x"], c["landing_y"]], axis=1).astype(np.float64)
    ok = returned & np.isfinite(xy).all(axis=1) & c["in_court"].astype(bool)

    def quantiles(s: int, a: int) -> list[list[float]]:
        cell, coarse = ok & (shot == s) & (area == a), ok & (area == a)
        points = xy[cell if cell.sum() >= _ENOUGH else coarse]
        return [_round(np.quantile(points[:, k], QUANTILES)) for k in (0, 1)]

    return _by_shot_and_area(quantiles)


def _bases(shot: I64, area: I64, c: dict[str, npt.NDArray[Any]], following: Bools) -> dict[str, Any]:
    """Median position of a striker in their own frame at the opponent's reply, by their own stroke."""
    rows = np.flatnonzero(following)
    xy = -np.stack([c["receiver_x"], c["receiver_y"]], axis=1).astype(np.float64)[rows + 1]
    ok = np.isfinite(xy).all(axis=1)
    shot, area, xy = shot[rows[ok]], area[rows[ok]], xy[ok]

    def median(s: int, a: int) -> list[float]:
        cell, coarse = (shot == s) & (area == a), shot == s
        return _round(np.median(xy[cell if cell.sum() >= _ENOUGH else coarse], axis=0))

    return _by_shot_and_area(median)


def _by_shot_and_area(of: Callable[[int, int], Any]) -> dict[str, dict[str, Any]]:
    return {SHOTS[s]: {AREAS[a]: of(s, a) for a in range(N_AREAS)} for s in range(N_SHOTS)}


def _faults(shot: I64, c: dict[str, npt.NDArray[Any]]) -> dict[str, float]:
    """Fraction of the faults of each shot type that do not cross the net; the others land out."""
    fault = c["outcome"] == Outcome.FAULT
    net = np.isin(c["reason"], [REASONS.index("net"), REASONS.index("short")])
    out = c["reason"] == REASONS.index("out")
    # Add-one smoothing: rare faults keep both kinds.
    return {
        SHOTS[s]: round(float((1 + (fault & net & (shot == s)).sum()) / (2 + (fault & (net | out) & (shot == s)).sum())), 3)
        for s in range(N_SHOTS)
    }


def _out_by(c: dict[str, npt.NDArray[Any]]) -> dict[str, list[float]]:
    """Quantiles of the distance by which shuttles land out [m]."""
    rows = (c["outcome"] == Outcome.FAULT) & (c["reason"] == REASONS.index("out"))
    side = np.abs(c["landing_x"][rows]) - HALF_WIDTH
    back = c["landing_y"][rows] - HALF_LENGTH
    return {"side": _round(np.quantile(side[side > 0], QUANTILES)), "back": _round(np.quantile(back[back > 0], QUANTILES))}


def _serves(shot: I64, c: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """Quantiles of the positions of server and receiver, ``[|x|, distance to the net]``, by serve."""
    out: dict[str, Any] = {}
    for s in range(N_SERVES):
        rows = (shot == s) & np.isfinite(c["striker_y"].astype(np.float64)) & np.isfinite(c["receiver_y"].astype(np.float64))
        out[SHOTS[s]] = {
            who: [_round(np.quantile(np.abs(c[f"{who}_{axis}"][rows]), QUANTILES)) for axis in "xy"]
            for who in ("striker", "receiver")
        }
    return out


def _round(values: F64) -> list[float]:
    return [round(float(v), 3) for v in values]


def fit_staging(*, data: Path, out: Path | None = None) -> None:
    """Measure flight times and places in the training matches and write the table of the package.

    Args:
        data: folder with the raw files of the matches.
        out: output file; default: the file of the package.
    """
    table = fit(data, out)
    sys.stdout.write(f"{table['timed']:,} timed strokes of {table['matches']} matches written to {out or FILE}\n")


main = entry_point(fit_staging, "python -m experiments.fit_staging", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
