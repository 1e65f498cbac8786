"""Log-loss of results of rallies in unseen matches: a coin, Bradley-Terry, the game of the pair, and the mean of the last two.

**Bradley-Terry.** The log-odds that the server wins a rally are an advantage of the serve, the difference of both players'
ratings, and an effect of the match. Ratings follow a random walk by date (Ingram, J. Quant. Anal. Sports 2019); variances are
estimated as those of the players' skill (:mod:`shuttle_marl.dynamics.mixed`).

**Pair.** The probability is exact, in the game of the pair as of the day of the match. Each player is imitated: with the
player's own choices where the model has them, else with those of the average player of the discipline.
"""

import dataclasses
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import block_diag, csr_matrix, identity

from experiments.pairs.parts import Part
from experiments.truth.matches import Strokes
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.evaluate import difference_by_match, log_losses
from shuttle_marl.dynamics.mixed import MixedModel, Walks, fit_variances
from shuttle_marl.dynamics.models import log_odds, sigmoid
from shuttle_marl.dynamics.skill import YEAR, days_of, slope_on_offset
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.shipped import PROFILES, variants
from shuttle_marl.game.skill import AVERAGE, load_skill
from shuttle_marl.policy import baselines
from shuttle_marl.reports.scouting import EARNED, earned

PREDICTIONS: Final = ("coin", "bradley_terry", "pair", "mean")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rallies:
    """R rallies of known result.

    Attributes:
        server, receiver: ``[R]`` identifiers.
        won: ``[R]`` whether the server won.
        match: ``[R]`` index into ``matches``.
        day: ``[R]`` day of the match.
        discipline: ``[R]`` index into :data:`~shuttle_marl.game.shipped.PROFILES`.
        matches: names of the matches.
    """

    server: npt.NDArray[np.str_]
    receiver: npt.NDArray[np.str_]
    won: Bools
    match: I64
    day: I64
    discipline: I64
    matches: tuple[str, ...]


def rallies_of(strokes: Strokes) -> Rallies:
    """Rallies from their first strokes in the data; the first of a rally may be missing."""
    begins = np.r_[True, np.diff(strokes.rally) != 0] & (strokes.result != 0)
    rows, serves = strokes.rows.take(begins), strokes.number[begins] % 2 == 1
    match = rows.match.astype(np.int64)
    return Rallies(
        server=np.where(serves, rows.striker, rows.receiver),
        receiver=np.where(serves, rows.receiver, rows.striker),
        won=np.where(serves, 1, -1) * strokes.result[begins] == 1,
        match=match,
        day=days_of(rows)[match],
        discipline=rows.codes["discipline"].astype(np.int64),
        matches=rows.matches,
    )


def results(parts: Sequence[Part]) -> dict[str, Any]:
    """Scores of the predictions of the unseen rallies of all parts.

    Returns:
        ``results``: log-loss of each prediction; ``difference``: from the coin, with intervals by match; ``calibration``: slope
        of the results on the log-odds of the game of the pair; ``forecast``: log-loss of the share of rallies that reports print,
        that of a coin, and the slope of the results on its log-odds, below 1 if it is larger than earned; ``correlation``: of
        the pair's shares of rallies and the real ones, over matches, about one half; ``seconds`` for each pair.
    """
    won, match = [], []
    predicted: dict[str, list[F64]] = {name: [] for name in PREDICTIONS}
    pairs, seconds = 0, 0.0
    for number, part in enumerate(parts):
        rallies = rallies_of(part.unseen.strokes)
        started = time.monotonic()
        of_pair, count = pair_probabilities(part, rallies)
        seconds += time.monotonic() - started
        ratings = bradley_terry(rallies_of(part.seen.strokes), rallies)
        for name, p in zip(PREDICTIONS, (np.full(len(of_pair), 0.5), ratings, of_pair, (ratings + of_pair) / 2), strict=True):
            predicted[name].append(p)
        won.append(rallies.won)
        # With a sign for the player who comes first in the alphabet.
        match.append(np.where(rallies.server < rallies.receiver, 1, -1) * (1 + rallies.match + number * len(rallies.matches)))
        pairs += count
    label, signed = np.concatenate(won), np.concatenate(match)
    index, side = np.abs(signed), np.sign(signed)
    joined = {name: np.concatenate(values) for name, values in predicted.items()}
    losses = {name: log_losses(label, values) for name, values in joined.items()}
    games = np.unique(index, return_inverse=True)[1]
    shares = [
        np.bincount(games, side * (values - 0.5)) / np.bincount(games) for values in (joined["pair"], label.astype(np.float64))
    ]
    printed = log_losses(label, earned(joined["pair"]))
    slope = slope_on_offset(np.zeros(len(label)), log_odds(joined["pair"]), label, index)
    return {
        "rallies": len(label),
        "matches": int(games.max()) + 1,
        "results": {name: float(values.mean()) for name, values in losses.items()},
        "difference": {name: difference_by_match(losses[name], losses["coin"], index) for name in PREDICTIONS[1:]},
        "calibration": slope,
        "forecast": {
            "log_loss": float(printed.mean()),
            "coin": float(losses["coin"].mean()),
            "calibration": {end: slope[end] / EARNED for end in ("low", "high")},
        },
        "correlation": float(shares[0] @ shares[1] / np.sqrt((shares[0] @ shares[0]) * (shares[1] @ shares[1]))),
        "seconds": seconds / max(1, pairs),
    }


def pair_probabilities(part: Part, rallies: Rallies) -> tuple[F64, int]:
    """``[R]`` probability that the server wins, in the game of the pair, and the number of games that were evaluated."""
    folder = str(part.folder)
    skill, profiled = {*load_skill(part.folder).players}, variants(folder)
    p = np.zeros(len(rallies.won))
    matches = np.unique(rallies.match)
    for match in matches:
        rows = np.flatnonzero(rallies.match == match)
        names = np.unique([*rallies.server[rows], *rallies.receiver[rows]]).tolist()
        profile = PROFILES[rallies.discipline[rows[0]]]
        pair = pair_game(
            *(name if name in skill else AVERAGE for name in names),
            date=date_of(rallies.matches[match]),
            discipline=profile if profile in profiled else None,
            game=folder,
        )
        players = [
            baselines.load(name if name in baselines.players(seat) else None, seat)
            for name, seat in zip(names, pair.seats, strict=True)
        ]
        odds = evaluate(*players).odds(0)
        first = rallies.server[rows] == names[0]
        p[rows] = np.where(first, odds.serving, 1 - odds.receiving)
    return p, len(matches)


def bradley_terry(seen: Rallies, unseen: Rallies) -> F64:
    """``[R]`` probability that the server of an unseen rally wins, by ratings from the results of seen ones."""
    players = np.unique(np.concatenate([seen.server, seen.receiver]))

    def number(names: npt.NDArray[np.str_]) -> I64:
        index = np.minimum(np.searchsorted(players, names), len(players) - 1)
        return np.where(players[index] == names, index, -1)

    server, receiver = number(seen.server), number(seen.receiver)
    walks = Walks.of(np.concatenate([server, receiver]), np.concatenate([seen.day, seen.day]))
    side = np.where(server < receiver, 1.0, -1.0)
    match = np.unique(seen.match, return_inverse=True)[1]
    k = len(walks)
    columns = np.stack(
        [walks.index(server, seen.day), walks.index(receiver, seen.day), k + match, k + match.max() + 1 + seen.discipline], axis=1
    )
    values = np.stack([np.ones(len(side)), -np.ones(len(side)), side, np.ones(len(side))], axis=1)
    distinct, row = np.unique(np.concatenate([columns, values], axis=1), axis=0, return_inverse=True)
    width, effects = columns.shape[1], k + int(match.max()) + 1 + len(PROFILES)
    x = csr_matrix(
        (distinct[:, width:].ravel(), distinct[:, :width].astype(np.int64).ravel(), np.arange(0, distinct.size // 2 + 1, width)),
        shape=(len(distinct), effects),
    )
    walk, first, years = walks.innovations()
    others = effects - k
    found = fit_variances(
        MixedModel(
            x=x,
            row=row.ravel(),
            offset=np.zeros(len(side)),
            label=seen.won,
            difference=csr_matrix(block_diag([walk, identity(others)])),
            component=np.r_[np.where(first, 0, 1), np.full(others - len(PROFILES), 2), np.full(len(PROFILES), 3)],
            scale=np.r_[years, np.ones(others)],
        ),
        np.array([np.nan, YEAR, np.nan, np.nan]),
    ).mode

    def rating(names: npt.NDArray[np.str_]) -> F64:
        knot = walks.index(number(names), unseen.day)
        return np.where(knot < 0, 0.0, found[knot])

    return sigmoid(rating(unseen.server) - rating(unseen.receiver) + found[effects - len(PROFILES) + unseen.discipline])
