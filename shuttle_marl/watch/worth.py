"""The worth of strokes: exact values when both players continue as they do, and regret against perfect play.

Probabilities of winning are ``(1 + value) / 2``. The regret of a stroke is what it gives away to the best one in its state when
both play perfectly from then on, as a probability of winning the rally; see :mod:`shuttle_marl.exact.optimal`.
"""

import dataclasses
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import F64, Ints
from shuttle_marl.exact import ProfileValue
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.scoring import match_win_probability
from shuttle_marl.game.shipped import real_strokes
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.watch.match import Rally, Score
from shuttle_marl.watch.plan import Side
from shuttle_marl.watch.tables import Kept, Tables
from shuttle_marl.watch.telling import rounded, stroke_facts

SHOWN: Final = 8
"""Strokes that are listed for each decision."""
ELITE: Final = Side(policy="bc")
"""Imitated elite players, with whom everyone is compared."""
_POOR, _BAD = 0.10, 0.15
"""Regrets from which a stroke is marked ``?!`` and ``?``."""
_FINE, _RARE, _VERY_RARE = 0.002, 0.05, 0.01
"""A stroke of no more regret than the first is marked ``!`` or ``!!`` if elite players choose it more seldom than the others."""
_THIN, _SOME = 20, 100
"""Real strokes behind a probability, below which it says little, and below which it says something."""
_MOST_STYLES: Final = 64


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """The strokes between which a player chooses in a state.

    Attributes:
        strokes: ``[K]`` catalogue indices of the legal ones.
        pairs: ``[K]`` their legal pairs.
        probability: ``[K]`` with which the striker's policy chooses each.
        win: ``[K]`` probability that the striker wins with each if both continue as they do.
        best: ``[K]`` the same if both play perfectly from then on.
    """

    strokes: Ints
    pairs: Ints
    probability: F64
    win: F64
    best: F64

    @property
    def regret(self) -> F64:
        """``[K]`` what each gives away to the best one."""
        return np.asarray(self.best.max() - self.best)


class Worth:
    """Values of the strokes of one game.

    Args:
        tables: policies, their values and the solved game.
    """

    def __init__(self, tables: Tables) -> None:
        self._tables, self._game = tables, tables.game
        self._styles = Kept(_MOST_STYLES)

    def decision(self, state: int, seat: int, players: "Players") -> Decision:
        """The choice in a state.

        Args:
            state: of the striker.
            seat: of the striker.
            players: who plays.
        """
        game = self._game
        strokes = game.legal_strokes(state)
        pairs = game.pair_at(state, np.arange(len(strokes)))
        after = self._tables.solution.value[1]
        return Decision(
            strokes=strokes,
            pairs=pairs,
            probability=players.tables[seat].probability_of(pairs),
            win=(1 + game.stroke_values(players.value.striking[1 - seat], pairs)) / 2,
            best=(1 + game.stroke_values(after, pairs)) / 2,
        )

    def players(self, sides: tuple[Side, Side]) -> "Players":
        """Two who play against each other.

        Raises:
            PolicyError: a policy cannot be made.
        """
        first, second = (self._tables.of(side) for side in sides)
        return Players(tables=(first, second), value=self._tables.values(sides))

    def analysis(self, rally: Rally, players: "Players") -> dict[str, Any]:
        """Worth of every stroke of a rally; see ``docs/watch.md``."""
        strokes, landings = [], []
        shares: tuple[list[float], list[float]] = ([], [])
        odds = match_odds(players.value, rally.score)
        for i, (state, stroke) in enumerate(zip(rally.state, rally.stroke, strict=True)):
            seat = rally.striker(i)
            decision = self.decision(state, seat, players)
            rank = int(self._game.rank(state, stroke))
            spread = float(np.ptp(decision.best))
            shares[seat].append(1 - float(decision.regret[rank]) / spread if spread > 0 else 1.0)
            strokes.append(self._stroke(decision, rank, state, seat, players, odds))
            landings.append([_aims(self._game, decision) if other == seat else None for other in (0, 1)])
        winner = rally.winner
        return {
            "number": rally.number,
            "strokes": strokes,
            "landings": landings,
            "win_after": None if winner is None else float(winner == 0),
            "match_after": None if winner is None else odds[winner],
            "accuracy": [round(float(np.mean(share)), 4) if share else None for share in shares],
        }

    def _stroke(
        self, decision: Decision, rank: int, state: int, seat: int, players: "Players", odds: tuple[float, float]
    ) -> dict[str, Any]:
        win, chosen = (1 + float(players.value.striking[seat][state])) / 2, float(decision.win[rank])
        first = win if seat == 0 else 1 - win
        regret = float(decision.regret[rank])
        better = int(np.argmax(decision.best))
        return {
            "win": rounded(first),
            "chosen": rounded(chosen if seat == 0 else 1 - chosen),
            "match": rounded(odds[1] + first * (odds[0] - odds[1])),
            "probability": rounded(decision.probability[rank]),
            "regret": rounded(regret),
            "mark": self._mark(regret, int(decision.pairs[rank])),
            "better": int(decision.strokes[better]),
            "options": self.options(decision, seat, always=(rank, better)),
            "sure": _sure(self._support(decision.pairs[[rank, better]])),
        }

    def options(self, decision: Decision, seat: int, *, always: tuple[int, ...] = (), most: int = SHOWN) -> list[dict[str, Any]]:
        """The strokes of a decision, likeliest first.

        Args:
            decision: between which strokes.
            seat: of the striker.
            always: positions that are listed in any case.
            most: how many are listed.
        """
        order = np.argsort(-decision.probability, kind="stable").tolist()
        kept = list(dict.fromkeys([*order[: most - len(always)], *always, *order]))[:most]
        good, returned, _ = self._game.stroke_probabilities(decision.pairs)
        support = self._support(decision.pairs)
        return [
            {
                **stroke_facts(self._game, int(decision.strokes[k]), seat),
                "p_succ": rounded(good[k]),
                "p_ret": rounded(returned[k]),
                "support": None if support is None else round(float(support[k]), 1),
                "probability": rounded(decision.probability[k]),
                "win": rounded(decision.win[k]),
                "best": rounded(decision.best[k]),
                "regret": rounded(decision.regret[k]),
            }
            for k in sorted(kept, key=order.index)
        ]

    def styles(self, sides: tuple[Side, Side]) -> dict[str, Any]:
        """Exact play of two against each other, beside imitated elite players against each other."""
        return self._styles.get(sides, lambda: self._styles_of(sides))

    def _styles_of(self, sides: tuple[Side, Side]) -> dict[str, Any]:
        counted, elite = self._tables.visits(sides), self._tables.visits((ELITE, ELITE))
        odds = self._tables.values(sides).odds()
        mixes, reference = [counted.shot_mix(seat) for seat in (0, 1)], elite.shot_mix(0)
        shares, among = (
            [_shares(counted.endings(), counted.states, seat) for seat in (0, 1)],
            _shares(elite.endings(), elite.states, 0),
        )
        figures: list[dict[str, Any]] = [
            {"name": "rallies won", "values": [odds.rally, 1 - odds.rally], "reference": None, "unit": "%"},
            {"name": "matches won", "values": [odds.match(), 1 - odds.match()], "reference": None, "unit": "%"},
        ]
        for name, shots in (
            ("attack", ("smash", "half-smash", "net-kill")),
            ("net play", ("net-shot", "cross-court-net-shot", "block")),
        ):
            index = [SHOTS.index(shot) for shot in shots]
            share = [float(mix[index].sum()) for mix in mixes]
            figures.append({"name": name, "values": share, "reference": float(reference[index].sum()), "unit": "%"})
        figures += [
            {"name": name, "values": [share[name] for share in shares], "reference": among[name], "unit": "%"} for name in among
        ]
        shown = np.argsort(-np.maximum(mixes[0], mixes[1]), kind="stable")
        return {
            "figures": figures,
            "shots": [
                {"name": SHOTS[k], "values": [float(mix[k]) for mix in mixes], "reference": float(reference[k])} for k in shown
            ],
        }

    def _mark(self, regret: float, pair: int) -> str:
        if regret >= _POOR:
            return "?" if regret >= _BAD else "?!"
        usual = float(self._tables.of(ELITE).probability_of(np.array([pair]))[0])
        if regret <= _FINE and usual < _RARE:
            return "!!" if usual < _VERY_RARE else "!"
        return ""

    def _support(self, pairs: Ints) -> F64 | None:
        found = real_strokes(self._game)
        return None if found is None else found[self._game.base_pair_edge[pairs % self._game.n_base_pairs]]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Players:
    """Two policies and their values against each other."""

    tables: tuple[TabulatedPolicy, TabulatedPolicy]
    value: ProfileValue


def match_odds(value: ProfileValue, score: Score) -> tuple[float, float]:
    """Probability that seat 0 wins the match if it wins the next rally, and if it loses it."""
    odds = value.odds(0)
    out = []
    for winner in (0, 1):
        after = score.after(winner)
        if after.over:
            out.append(float(winner == 0))
            continue
        probability = match_win_probability(
            odds.serving, odds.receiving, first_server=winner, games=after.games, points=after.points, rules=score.rules
        )
        out.append(float(probability))
    return out[0], out[1]


def _aims(game: Game, decision: Decision) -> list[float]:
    """``[9]`` how likely the policy aims at each area."""
    areas = game.catalogue.area[decision.strokes]
    return [round(float(p), 4) for p in np.bincount(areas, decision.probability, N_AREAS)]


def _shares(endings: dict[str, float], states: tuple[F64, F64], seat: int) -> dict[str, float]:
    """Shares of a player's strokes that are faults and winners; the serve is a stroke."""
    strokes = float(states[seat].sum())
    return {
        "faults": endings[f"fault of player {seat}"] / strokes,
        "winners": endings[f"winner of player {seat}"] / strokes,
    }


def _sure(support: F64 | None) -> str:
    """Amount of real data behind the comparison of two strokes, in a sentence."""
    if support is None:
        return "How many real strokes stand behind this is not known."
    least = round(float(support.min()))
    real = f"Behind the rarer of this stroke and the best one: {least:,} real stroke{'' if least == 1 else 's'}"
    if least < _THIN:
        return f"{real}; the models are not sure of this."
    return f"{real}; the models are fairly sure of this." if least < _SOME else f"{real}; the models are sure of this."
