"""Builds the tables of a game: its states from who may answer what, its thresholds from probabilities."""

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.rally import ONE, GameError, Ints, UInts
from shuttle_marl.game.stroke import Catalogue


def layout(catalogue: Catalogue, replies: npt.NDArray[np.bool_]) -> dict[str, Ints]:
    """The index tables of a game from who may answer what.

    Args:
        catalogue: the n strokes.
        replies: ``[n + 1, n]`` whether stroke z may answer stroke y (row n: at the start of a rally). The contact height
            of z is the contact from which it is legal.

    Returns:
        ``edge_own``, ``edge_incoming``, ``reply_start``, ``reply_count``, ``pair_start`` of :class:`Game`. Only strokes
        that can be reached from the serve get edges.

    Raises:
        GameError: a reachable stroke has no legal reply from one of the contacts, or a serve is no serve.
    """
    n = len(catalogue)
    if (replies[n] != catalogue.is_serve).any() or replies[:n, catalogue.is_serve].any():
        raise GameError("exactly the serves must be legal at the start, and only there")
    reachable = np.zeros(n + 1, dtype=bool)
    frontier = [n]
    while frontier:
        y = frontier.pop()
        if reachable[y]:
            continue
        reachable[y] = True
        frontier.extend(np.flatnonzero(replies[y]).tolist())
    own, incoming = [n], [n]
    reply_start = np.zeros((n + 1, 2), dtype=np.int32)
    reply_count = np.zeros((n + 1, 2), dtype=np.int32)
    for y in [n, *np.flatnonzero(reachable[:n]).tolist()]:
        for contact in (0, 1):
            strokes = np.flatnonzero(replies[y] & (catalogue.height == contact))
            if not len(strokes) and y != n:
                raise GameError(f"no legal reply to {catalogue.names[y]} from contact {contact}")
            reply_start[y, contact], reply_count[y, contact] = len(own), len(strokes)
            own.extend([y] * len(strokes))
            incoming.extend(strokes.tolist())
    edge_incoming = np.array(incoming, dtype=np.int32)
    counts = reply_count[edge_incoming].ravel()
    return {
        "edge_own": np.array(own, dtype=np.int32),
        "edge_incoming": edge_incoming,
        "reply_start": reply_start,
        "reply_count": reply_count,
        "pair_start": np.r_[0, np.cumsum(counts)].astype(np.int32),
    }


def thresholds(p_good: npt.NDArray[np.float64], p_returned: npt.NDArray[np.float64], p_above: npt.NDArray[np.float64]) -> UInts:
    """Fixed-point thresholds ``[P, 3]`` from the three probabilities, each rounded to the nearest 1/65536.

    The first three outcomes together never reach 1, so the last one keeps at least 1/65536.
    """
    fault = 1 - p_good
    winner = fault + p_good * (1 - p_returned)
    below = winner + p_good * p_returned * (1 - p_above)
    cumulative = np.rint(np.stack([fault, winner, below], axis=-1) * ONE)
    if not np.isfinite(cumulative).all():
        raise GameError("a probability of the dynamics is not a number; the model is damaged")
    return np.clip(cumulative, 0, ONE - 1).astype(np.uint16)
