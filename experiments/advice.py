"""Evaluation of the advice of scouting reports on matches that were not used to fit the model.

``python -m experiments.advice --data DIR --split validation|test [--json]``

Each player of a match is advised against the other (:mod:`shuttle_marl.reports.advice`), in the game of the pair as of the
day of the match; ``shots`` counts the shot types that are advised. Strokes of the match in the situations of the advice are
compared: those of the advised shot type, and all others. *Promised* is the calibrated advantage of the shot type over what the
player usually plays there, by the areas that the player usually aims at, because the target of a fault is not recorded.
*Realised* is the result of the rally minus the probability of winning it before the stroke. Intervals are 95 % bootstraps over
matches.
"""

import dataclasses
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from docs.tools.results import show
from experiments.truth.matches import Strokes, of_splits, ratio_by_match, states_of, strokes_of
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.base.runs import describe
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import Json
from shuttle_marl.data import Split, read_matches
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.hurried import load_hurry
from shuttle_marl.game.pairs import pair_game, people_of
from shuttle_marl.game.shipped import PROFILES, model_folder
from shuttle_marl.game.skill import AVERAGE, load_skill
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports.advice import Advice, Refitted, advise, refitted
from shuttle_marl.reports.value import Value


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Judged:
    """Strokes in situations of advice, ``[N]`` each.

    Attributes:
        advised: whether the stroke is of the advised shot type.
        promised: calibrated advantage of its shot type, in rallies won.
        realised: result of the rally minus the probability of winning it before the stroke.
        match: number of the match.
    """

    advised: Bools
    promised: F64
    realised: F64
    match: I64

    @classmethod
    def joined(cls, parts: Sequence["Judged"]) -> "Judged":
        """Several of them as one."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in dataclasses.fields(cls)})

    def summary(self) -> dict[str, dict[str, float]]:
        """Number of strokes, mean promised and realised, and its interval; of advised strokes and of the others."""
        out: dict[str, dict[str, float]] = {}
        for name, which in (("advised", self.advised), ("not_advised", ~self.advised)):
            n = int(which.sum())
            if not n:
                out[name] = {"n": 0}
                continue
            found = ratio_by_match(self.realised[which], np.ones(n), self.match[which])
            mean = {"promised": float(self.promised[which].mean()), "realised": found["value"]}
            out[name] = {"n": n, **mean, "low": found["low"], "high": found["high"]}
        return out


def named(found: Refitted, players: tuple[str, str]) -> Refitted:
    """The same games of two players, with other names."""
    people = dataclasses.replace(people_of(found.pair), players=players)
    return dataclasses.replace(found, pair=dataclasses.replace(found.pair, people=people))


def judged(strokes: Strokes, found: Refitted, seat: int, advised: Sequence[Advice], match: int) -> Judged:
    """The strokes of one player of a match in the situations of the advice.

    Args:
        strokes: of the match.
        found: the pair.
        seat: of the player.
        advised: advice to the player.
        match: number of the match.
    """
    policy, value = found.home.policies[seat], found.home.value.striking[seat]
    game, factor = policy.game, 1.0 if found.factor is None else found.factor.value
    state = states_of(game, strokes.rows)
    mine = (strokes.rows.striker == people_of(found.pair).players[seat]) & (state >= 0) & (strokes.result != 0)
    stroke_value, chance = Value(game, found.home.value.striking, seat), policy.block_probabilities(0)
    parts = [Judged(advised=np.zeros(0, np.bool_), promised=np.zeros(0), realised=np.zeros(0), match=np.zeros(0, np.int64))]
    for advice in advised:
        rows = np.flatnonzero(mine & np.isin(game.base(np.maximum(state, 0)), advice.states))
        if not len(rows):
            continue
        shot = strokes.rows.codes["shot"][rows]
        row, pairs = game.pairs(state[rows])
        alike = game.catalogue.shot[game.base_pair_stroke[pairs % game.n_base_pairs]] == shot[row]
        row, pairs = row[alike], pairs[alike]
        weight = chance[pairs % game.n_base_pairs]
        total = np.bincount(row, weight, len(rows))
        with np.errstate(invalid="ignore", divide="ignore"):
            advantage = np.bincount(row, weight * stroke_value.advantage(pairs, state[rows][row]), len(rows)) / total
        known = total > 0
        parts.append(
            Judged(
                advised=(shot == game.catalogue.shot[advice.stroke])[known],
                promised=(factor * advantage)[known],
                realised=((strokes.result[rows] - value[state[rows]]) / 2)[known],
                match=np.full(int(known.sum()), match),
            )
        )
    return Judged.joined(parts)


def advice(
    *, data: Path, split: Split = "validation", model: str = "default", out: Path | None = None, json_output: Json = False
) -> None:
    """Compare promised and realised gains of advised strokes in matches that the model has not seen.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: the matches.
        model: a model by name or folder, fitted to the training matches.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    every = of_splits(strokes_of(read_matches(data)), split).marked(load_hurry(model_folder(model)))
    skill, parts = load_skill(model_folder(model)), []
    shots: Counter[str] = Counter()
    for number, name in enumerate(every.matches):
        match = every.take(every.in_matches([name]))
        people = list(dict.fromkeys(match.rows.striker.tolist()))
        discipline = PROFILES[int(match.rows.codes["discipline"][0])]
        names = [each if each in skill.players else AVERAGE for each in people]
        asked: dict[str, Any] = {"date": date_of(name), "discipline": discipline, "game": model}
        found = refitted(pair_game(names[0], names[1], **asked))
        found = named(found, (people[0], people[1]))
        for seat in (0, 1):
            advised = advise(found, seat)
            shots.update(SHOTS[found.pair.catalogue.shot[one.stroke]] for one in advised)
            parts.append(judged(match, found, seat, advised, number))
        cli.console(stderr=True).print(f"{number + 1} of {len(every.matches)}: {name}", soft_wrap=True)
    about = {"split": split, "matches": len(every.matches), "advice": shots.total(), "shots": dict(shots.most_common())}
    result = {**describe(("numpy",)), **about, **Judged.joined(parts).summary()}
    show(result, "advice_results", as_json=json_output, out=out)


main = cli.entry_point(advice, "python -m experiments.advice", __doc__ or "")

if __name__ == "__main__":
    sys.exit(main())
