"""Strokes that people played and the game forbids, and the error of V where that was frequent."""

from typing import Any, Final

import numpy as np

from experiments.truth.decisions import Promises
from experiments.truth.matches import Strokes, ratio_by_match
from shuttle_marl.base.arrays import Bools
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.reports.value import strokes_before

_DROP: Final = SHOTS.index("drop")


def judged_strokes(game: Game, strokes: Strokes) -> tuple[Bools, Bools]:
    """``[N]`` whether the incoming stroke is in the catalogue, and whether the reply is then illegal.

    A reply is illegal if no legal stroke has its shot type, height and technique: the target of a fault is unknown, so the area
    does not count.
    """
    catalogue, rows = game.catalogue, strokes.rows
    incoming = strokes_before(rows, "incoming", catalogue.by_parts, game.n_strokes)
    legal = np.zeros((game.n_strokes + 1, N_SHOTS, 2, N_TECHNIQUES), dtype=bool)
    reply, stroke = np.nonzero(game.reply_mask.any(axis=1))
    legal[reply, catalogue.shot[stroke], catalogue.height[stroke], catalogue.technique[stroke]] = True
    known = incoming >= 0
    style = tuple(rows.codes[name].astype(np.int64) for name in ("shot", "contact", "technique"))
    return known, known & ~legal[(np.maximum(incoming, 0), *style)]


def after_drop_above(strokes: Strokes) -> Bools:
    """``[N]`` replies to a drop that is met above the net."""
    return np.asarray((strokes.rows.codes["incoming_shot"] == _DROP) & (strokes.rows.codes["contact"] == 1))


def illegal(strokes: Strokes, promised: Promises, known: Bools, forbidden: Bools) -> dict[str, Any]:
    """Fraction of illegal strokes among the real ones.

    Args:
        strokes: N strokes.
        promised: their promises.
        known, forbidden: ``[N]``, see :func:`judged_strokes`.

    Returns:
        ``share``, ``shots`` (the part of each shot type in these strokes), ``after_drop_above`` (the share among replies to
        drops met above the net), and ``value_error``: points (per cent of rallies) won above V there, with a 95 % interval by
        matches.
    """
    drop, shot = after_drop_above(strokes), strokes.rows.codes["shot"]
    used = drop & np.isfinite(promised.value) & (strokes.result != 0)
    error = ratio_by_match(50 * (strokes.result - promised.value)[used], np.ones(int(used.sum())), strokes.rows.match[used])
    return {
        "share": float(forbidden.sum() / known.sum()),
        "shots": {name: float((shot[forbidden] == i).mean()) for i, name in enumerate(SHOTS)},
        "after_drop_above": float(forbidden[drop].sum() / max(1, known[drop].sum())),
        "value_error": {"points": error["value"], "low": error["low"], "high": error["high"], "n": int(used.sum())},
    }
