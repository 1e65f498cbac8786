"""The games of pairs of players compared with matches that were not used to fit them: log-loss of the results of rallies.

    python -m experiments.pairs --data DATA (--cross 4 | --split test) [--json]

Predictions are a coin, Bradley-Terry, the game of the pair, and the mean of the last two.

**Bradley-Terry.** The log-odds that the server wins a rally are an advantage of the serve, the difference of both players'
ratings, and an effect of the match. Ratings follow a random walk by date (Ingram, J. Quant. Anal. Sports 2019); variances are
estimated as those of the players' skill (:mod:`shuttle_marl.dynamics.skill`).

**Pair.** The probability is exact, in the game of the pair as of the day of the match. Each player is imitated: with the
player's own choices where the model has them, else with those of the average player of the discipline.
"""

import dataclasses
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
import tyro
from scipy.sparse import block_diag, csr_matrix, identity

from experiments.truth.matches import Comparison, Strokes, folds_of, of_splits, report, strokes_of
from experiments.truth.worlds import fingerprint
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import read_matches
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.boosting import fit_hurry
from shuttle_marl.dynamics.choices import player_choices
from shuttle_marl.dynamics.evaluate import difference_by_match, log_losses
from shuttle_marl.dynamics.fit import fit
from shuttle_marl.dynamics.make import save_fit, save_variants
from shuttle_marl.dynamics.models import QUICK, log_odds, sigmoid
from shuttle_marl.dynamics.skill import YEAR, MixedModel, Walks, days_of, fit_variances, slope_on_offset, summary
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import AVERAGE, load_skill, pair_game
from shuttle_marl.game.shipped import CARD, PROFILES, model_folder, variants
from shuttle_marl.policy import baselines
from shuttle_marl.reports.scouting import EARNED, earned

PREDICTIONS: Final = ("coin", "bradley_terry", "pair", "mean")


class Part(NamedTuple):
    """A model in a folder, the strokes that it was fitted to, and others."""

    folder: Path
    seen: Strokes
    unseen: Strokes


def crossed(played: Strokes, sources: Mapping[str, str], count: int, cache: Path, seed: int) -> list[Part]:
    """Models that are each fitted without one part of the matches.

    Args:
        played: strokes of all matches.
        sources: data set of each match by name.
        count: number of parts.
        cache: folder of the models; their names are hashes of the strokes, the seed and the source code of the dynamics.
        seed: of the parts and of the fits.
    """
    fold = folds_of(played, count, seed)
    parts = []
    for k in range(count):
        seen = played.take(fold != k)
        report(f"part {k + 1} of {count}")
        parts.append(Part(_fitted(seen, sources, cache, seed), seen, played.take(fold == k)))
    return parts


def _fitted(seen: Strokes, sources: Mapping[str, str], cache: Path, seed: int) -> Path:
    """Folder of the model that is fitted to some strokes."""
    rows = seen.rows
    folder = cache / fingerprint(json.dumps([seed, torch.__version__, seen.matches]), seen)[:16]
    if not (folder / CARD).is_file():
        hurry = fit_hurry(rows, seed=seed)
        fitted = fit(rows if hurry is None else hurry.marked(rows), None, seed=seed, config=QUICK, report=report)
        report("choices of players")
        choices, _ = player_choices(fitted.models.choosers, rows, None, QUICK.folds)
        fitted = dataclasses.replace(fitted, models=dataclasses.replace(fitted.models, choices=choices))
        # Compared with real strokes and results only: how it is played best does not matter.
        game, variants, skill, *_ = save_fit(folder, fitted, sources, report=report, check=False)
        # The card comes last: a folder with a card is complete.
        save_variants(folder, game, variants, {"name": folder.name, "skill": summary(skill, {})})
    return folder


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
        the pair's shares of rallies and the real ones, over matches, about one half.
    """
    won, match = [], []
    predicted: dict[str, list[F64]] = {name: [] for name in PREDICTIONS}
    for number, part in enumerate(parts):
        rallies = rallies_of(part.unseen)
        of_pair = pair_probabilities(part, rallies)
        ratings = bradley_terry(rallies_of(part.seen), rallies)
        for name, p in zip(PREDICTIONS, (np.full(len(of_pair), 0.5), ratings, of_pair, (ratings + of_pair) / 2), strict=True):
            predicted[name].append(p)
        won.append(rallies.won)
        # With a sign for the player who comes first in the alphabet.
        match.append(np.where(rallies.server < rallies.receiver, 1, -1) * (1 + rallies.match + number * len(rallies.matches)))
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
    }


def pair_probabilities(part: Part, rallies: Rallies) -> F64:
    """``[R]`` probability that the server wins, in the game of the pair."""
    folder = str(part.folder)
    skill, profiled = {*load_skill(part.folder).players}, variants(folder)
    p = np.zeros(len(rallies.won))
    for match in np.unique(rallies.match):
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
    return p


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


def pairs(options: tyro.conf.OmitArgPrefixes[Comparison]) -> None:
    """Compare the games of pairs of players with matches that were not used to fit them.

    Args:
        options: what is compared.
    """
    data = read_matches(options.data)
    every = strokes_of(data)
    if options.cross is not None:
        sources = dict(zip(data["match"].to_pylist(), data["source"].to_pylist(), strict=True))
        parts = crossed(of_splits(every, "train", "validation"), sources, options.cross, options.fits, options.seed)
    else:
        parts = [Part(model_folder(options.game), of_splits(every, "train"), of_splits(every, options.split or "validation"))]
    options.show(results(parts), "pair_results")


main = entry_point(pairs, "python -m experiments.pairs", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
