"""Rows of strokes for tests in which only some columns matter."""

from typing import Any

import numpy as np

from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.features import MOVEMENT, SLOTS, Rows


def plain_rows(n: int, **known: Any) -> Rows:
    """Returned strokes of two players in one match, about which nothing else is known.

    Args:
        n: number of strokes.
        known: columns by name; ``codes`` are added to zeros.
    """
    zero = np.zeros(n, np.int16)
    columns: dict[str, Any] = {
        "outcome": np.full(n, Outcome.RETURNED, np.int8),
        "reason": np.full(n, REASONS.index("returned"), np.int8),
        "landed": np.full(n, -1, np.int16),
        "next_contact": np.full(n, -1, np.int8),
        "match": np.zeros(n, np.int32),
        "matches": ("match",),
        "striker": np.full(n, "a"),
        "receiver": np.full(n, "b"),
        "stroke": np.full(n, 3, np.int16),
        "points": np.full((n, 2), -1, np.int8),
        **dict.fromkeys(("attacks", "opponent_attacks", "net_run"), zero),
        "movement": np.full((n, len(MOVEMENT)), np.nan, np.float32),
        "hurried": zero.astype(np.int8),
        "next_hurried": np.full(n, -1, np.int8),
        **dict.fromkeys(("waiting", "meeting"), np.full((n, 2), np.nan, np.float32)),
        "hand": zero.astype(np.int8),
        "receiver_hand": zero.astype(np.int8),
    }
    codes = {name: zero.copy() for name in SLOTS} | known.pop("codes", {})
    return Rows(codes=codes, **{**columns, **known})
