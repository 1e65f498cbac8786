"""Values of the strokes of a game, as pages receive them."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.court import messages
from shuttle_marl.court.facts import rounded, stroke_facts
from shuttle_marl.court.match import CourtRally, seed_of_line
from shuttle_marl.court.openings import Opening, opening
from shuttle_marl.court.plan import Side
from shuttle_marl.court.policies import OnceCache, PolicyTables
from shuttle_marl.game import court
from shuttle_marl.game.pairs import looks_of
from shuttle_marl.game.policy import position_shares
from shuttle_marl.game.rally import Rally, stepper_of, waited_at
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.shipped import RELIABLE, factor_of
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports.rally import Decision, Players, analyse_rally
from shuttle_marl.reports.rally import decision as analyse_decision
from shuttle_marl.reports.rating import Rated, places_of, rater_of, theme_of, usual_of

SHOWN: Final = 8
"""Number of strokes listed for each decision."""
ELITE: Final = Side(policy="bc")
"""The imitated average elite player, the reference of all comparisons."""
OPEN: Final = 0.01
"""Gain of a stroke from which a side is open, in rallies."""
_MAX_STYLES: Final = 64
_GROUPS: Final = {
    "attack": [SHOTS.index(shot) for shot in ("smash", "half-smash", "net-kill")],
    "net play": [SHOTS.index(shot) for shot in ("net-shot", "cross-court-net-shot", "block")],
}
"""Shot types of a figure of style."""


class StrokeValues:
    """Values of the strokes of one game.

    Attributes:
        policies: of that game.
    """

    def __init__(self, policies: PolicyTables) -> None:
        self.policies, self.game = policies, policies.game
        self._styles = OnceCache(_MAX_STYLES)
        self._factor = factor_of(policies.game.seats[0])

    def players(self, sides: tuple[Side, Side]) -> Players:
        """Two policies and their values against each other.

        Raises:
            PolicyError: a policy cannot be loaded.
        """
        first, second = (self.policies.table(side, seat) for seat, side in enumerate(sides))
        return Players(tables=(first, second), value=self.policies.values(sides))

    def decision(self, state: int, seat: int, players: Players) -> Decision:
        """The decision of a seat in a state."""
        return analyse_decision(self.game, state, seat, players)

    def rated(self, choice: Decision) -> Rated:
        """The strokes of a decision with the ratings that people see, in the same order."""
        return rater_of(self.game).rated(np.array([choice.state]))

    def analysis(self, rally: CourtRally, players: Players) -> messages.Analysis:
        """Values of every stroke of a rally."""
        found = analyse_rally(rally, self.game, players, rules=rally.score.rules)
        strokes = zip(found.decisions, found.rank.tolist(), found.match_win.tolist(), strict=False)
        over, factor = rally.winner is not None, self._factor
        return messages.Analysis(
            number=rally.number,
            factor=None if factor is None else (factor.value, factor.low, factor.high),
            strokes=[self._stroke(rally, i, *about) for i, about in enumerate(strokes)],
            landings=[_landings(rally.aim[choice.seat], choice) for choice in found.decisions],
            win_after=float(found.rally_win[-1]) if over else None,
            match_after=float(found.match_win[-1]) if over else None,
        )

    def _stroke(self, rally: Rally, number: int, choice: Decision, rank: int, match_win: float) -> messages.StrokeValue:
        win, chosen = choice.value, float(choice.win[rank])
        rated = self.rated(choice)
        loss, asked = float(rated.loss[rank]), rated.question(rank)
        better = int(rated.best[0]) if loss > 0 else rank
        question = None
        if asked is not None:
            right, wrong = asked
            share = rounded(rated.share[right])
            question = messages.Question(
                int(choice.stroke[right]),
                [int(choice.stroke[k]) for k in wrong],
                share,
                theme_of(rally, number, above=bool(self.game.contact(choice.state))),
                usual_of(SHOTS[rated.shot[right]]),
            )
        always = (rank, better, *(() if asked is None else (asked[0], *asked[1])))
        return messages.StrokeValue(
            win=rounded(win if choice.seat == 0 else 1 - win),
            chosen=rounded(chosen if choice.seat == 0 else 1 - chosen),
            match=rounded(match_win),
            probability=rounded(choice.probability[rank]),
            change=rounded(rated.change[rank]) if rated.known[rank] else None,
            quality=rounded(rated.quality[rank]) if rated.known[rank] else None,
            loss=rounded(loss),
            mark=rated.marks[rank],
            better=int(choice.stroke[better]),
            question=question,
            options=self.options(rally, choice, rated, always=tuple(dict.fromkeys(always))),
            support=_least(choice.support[[rank, better]]),
            **self._waiting(rally, number, choice, rank),
        )

    def _waiting(self, rally: Rally, number: int, choice: Decision, rank: int) -> dict[str, Any]:
        """What the receiver of a stroke could do, and what the striker gains by it."""
        found = places_of(self.game, choice.state, choice.seat, self.policies.solution) if self.game.recovery else None
        if found is None:
            return {"places": None, "open": None, "wait": None}
        columns = found.position, found.people, found.perfect, found.loss, found.win[rank]
        places = [messages.Place(int(p), *map(rounded, rest)) for p, *rest in zip(*columns, strict=True)]
        waited = waited_at(rally, self.game, number, choice.state)
        side = None
        if waited is not None and waited in found.position:
            gain = np.where(choice.support >= RELIABLE, found.gain[:, found.position == waited].ravel(), -np.inf)
            best = int(gain.argmax())
            if gain[best] >= OPEN:
                side = messages.OpenSide(**stroke_facts(rally, int(choice.stroke[best]), choice.seat), gain=rounded(gain[best]))
        asked = None if waited is None else found.question(waited)
        return {"places": places, "open": side, "wait": asked}

    def positions(self, state: int, receiver: int) -> list[float]:
        """Probabilities with which perfect play waits where the opponent is in a state; empty: a receiver has no choice there."""
        if not stepper_of(self.game).chooses_position(state):
            return []
        return [rounded(p) for p in position_shares(self.policies.solution.policy[receiver].waiting_table[state])]

    def options(
        self, rally: Rally, choice: Decision, rated: Rated | None = None, *, always: tuple[int, ...] = (), limit: int = SHOWN
    ) -> list[messages.Option]:
        """The strokes of a decision, most probable first.

        Args:
            rated: ratings of its strokes; None: computed.
            always: positions that are always listed.
        """
        order = [
            k
            for k in np.argsort(-choice.probability, kind="stable").tolist()
            if rally.as_named(choice.seat, int(choice.stroke[k]))
        ]
        order += [k for k in always if k not in order]
        listed = list(dict.fromkeys([*order[: limit - len(always)], *always, *order]))[:limit]
        best = (rated or self.rated(choice)).win
        return [
            messages.Option(**self._valued(rally, choice, k, best), probability=rounded(choice.probability[k]))
            for k in sorted(listed, key=order.index)
        ]

    def opening(self, line: tuple[int, ...], players: Players) -> messages.OpeningReply:
        """The strokes that follow the first strokes of a rally that seat 0 serves.

        Args:
            line: catalogue indices of the first strokes.

        Raises:
            IllegalStrokeError: a stroke of the line is not legal there.
        """
        found = opening(self.game, line, players, self.policies.solution)
        none = np.zeros(0, np.int64)
        hands = looks_of(self.game, (ELITE.policy, ELITE.policy)).hands
        begun = Rally(catalogue=self.game.catalogue, server=0, stroke=none, hurried=none > 0, ending=RETURNED_BELOW, hands=hands)
        return messages.OpeningReply(
            strokes=[
                messages.OpeningStroke(
                    **self._valued(begun, found, k, found.optimal)
                    | {"area": court.AREAS[self.game.catalogue.area[found.stroke[k]]]},
                    available=rounded(found.available[k]),
                    share=rounded(found.share[k]),
                )
                for k in range(len(found.stroke))
            ],
            seed=seed_of_line(self.game, line) if line else None,
        )

    def _valued(self, rally: Rally, choice: Decision | Opening, k: int, best: F64) -> dict[str, Any]:
        """Fields of :class:`~shuttle_marl.court.messages.ValuedStroke` of the k-th stroke."""
        return {
            **stroke_facts(rally, int(choice.stroke[k]), choice.seat),
            "p_succ": rounded(choice.p_succ[k]),
            "p_ret": rounded(choice.p_ret[k]),
            "support": None if np.isnan(choice.support[k]) else round(float(choice.support[k]), 1),
            "win": rounded(choice.win[k]),
            "best": rounded(best[k]),
        }

    def styles(self, sides: tuple[Side, Side]) -> messages.Styles:
        """Exact statistics of two players against each other, beside those of two imitated elite players."""
        return self._styles.get(sides, lambda: self._styles_of(sides))

    def _styles_of(self, sides: tuple[Side, Side]) -> messages.Styles:
        visits, elite = self.policies.visits(sides), self.policies.visits((ELITE, ELITE))
        odds, seen = self.policies.values(sides).odds(), ((visits, 0), (visits, 1), (elite, 0))
        mixes = np.array([each.shot_mix(seat) for each, seat in seen])
        endings = [(each.endings(), seat, float(each.states[seat].sum())) for each, seat in seen]

        def figure(name: str, values: Iterable[float]) -> messages.StyleFigure:
            first, second, reference = map(float, values)
            return messages.StyleFigure(name, (first, second), reference)

        figures = [
            messages.StyleFigure("rallies won", (odds.rally, 1 - odds.rally), None),
            messages.StyleFigure("matches won", (odds.match(), 1 - odds.match()), None),
            *(figure(name, (mix[index].sum() for mix in mixes)) for name, index in _GROUPS.items()),
            # Fractions of the strokes of each player, serves included.
            *(
                figure(f"{end}s", (ends[f"{end} of player {seat}"] / n for ends, seat, n in endings))
                for end in ("fault", "winner")
            ),
        ]
        order = np.argsort(-mixes[:2].max(axis=0), kind="stable")
        first = self.policies.values((sides[0], ELITE)).odds().rally
        second = 1 - self.policies.values((ELITE, sides[1])).odds().rally
        shots = [figure(SHOTS[k], mixes[:, k]) for k in order]
        return messages.Styles(figures=figures, shots=shots, strength=(rounded(first), rounded(second)))


def _landings(area: np.ndarray, choice: Decision) -> tuple[list[float] | None, list[float] | None]:
    """Probability with which the striker's policy aims at each area, ``[9]``; None for the receiver."""
    aims = [round(float(p), 4) for p in np.bincount(area[choice.stroke], choice.probability, court.N_AREAS)]
    return (aims, None) if choice.seat == 0 else (None, aims)


def _least(support: F64) -> int | None:
    """The smaller number of real strokes; None if one is unknown."""
    return None if np.isnan(support).any() else round(float(support.min()))
