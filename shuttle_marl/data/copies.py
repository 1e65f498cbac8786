"""Games that stand in a table twice, under other names of the match or the players, or other numbers."""

import collections
from typing import Final

import numpy as np
import pyarrow as pa

_LEAST: Final = 10
"""Strokes in equal rallies that show a copy."""
_SHARE: Final = 0.5
"""Least share of them in the shorter of the two games."""


def copies(strokes: pa.Table) -> list[str]:
    """Sentences on pairs of games of which half of the strokes stand in equal rallies: in the same order, of the same kinds."""
    names = strokes["match"].combine_chunks().dictionary_encode()
    match, names = names.indices.to_numpy(), names.dictionary.to_pylist()
    game, rally = (strokes[name].to_numpy() for name in ("game", "rally"))
    codes = np.stack([strokes[name].fill_null(-1).to_numpy() for name in ("shot", "technique", "area")], axis=1).astype(np.int8)
    begins = np.flatnonzero(np.r_[True, (np.diff(match) != 0) | (np.diff(game) != 0) | (np.diff(rally) != 0)][: len(match)])
    owner: dict[bytes, tuple[int, int]] = {}
    total, shared = collections.Counter[tuple[int, int]](), collections.Counter[tuple[tuple[int, int], tuple[int, int]]]()
    for begin, end in zip(begins.tolist(), np.r_[begins[1:], len(match)][: len(begins)].tolist(), strict=True):
        unit = int(match[begin]), int(game[begin])
        first = owner.setdefault(codes[begin:end].tobytes(), unit)
        total[unit] += end - begin
        shared[first, unit] += end - begin
    return [
        f"game {unit[1]} of {names[unit[0]]!r} has the strokes of game {first[1]} of {names[first[0]]!r}: are they one?"
        for (first, unit), count in shared.items()
        if first != unit and count >= max(_LEAST, _SHARE * min(total[first], total[unit]))
    ]
