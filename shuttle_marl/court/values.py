"""Facts about hall, rallies and strokes, and values of strokes, as pages receive them."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from shuttle_marl.court import messages, staging
from shuttle_marl.court.match import CourtRally, PolicyTables
from shuttle_marl.court.plan import Side
from shuttle_marl.court.staging import skeleton as body
from shuttle_marl.game import court
from shuttle_marl.game.pairs import seat_names
from shuttle_marl.game.policy import position_shares
from shuttle_marl.game.rally import Rally, stepper_of, waited_at
from shuttle_marl.game.recovery import position_box
from shuttle_marl.game.rules import OUTCOMES, RETURNED_BELOW
from shuttle_marl.game.shipped import RELIABLE, factor_of, real_strokes, waiting_places
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.baselines import imitation
from shuttle_marl.reports.rally import Decision, Players, analyse_rally
from shuttle_marl.reports.rating import Rated, places_of, rater_of


def hall_facts() -> messages.HallFacts:
    """Dimensions of court, equipment and athletes, and the vocabulary of strokes."""
    return messages.HallFacts(
        court=messages.CourtFacts(*(getattr(court, name.upper()) for name in messages.CourtFacts.__struct_fields__)),
        areas=[messages.AreaFacts(name=name, box=court.area_box(i)) for i, name in enumerate(court.AREAS)],
        positions=[
            messages.PositionFacts(box=position_box(i), place=(round(x, 4), round(-y, 4)))
            for i, (x, y) in enumerate(waiting_places().tolist())
        ],
        racket=messages.RacketFacts(sweet_spot=body.SWEET_SPOT, butt=body.RACKET_BUTT, head=body.RACKET_HEAD),
        shuttle=messages.ShuttleFacts(scale=body.SHUTTLE_SCALE, cork=body.CORK, feathers=body.FEATHERS, feather=body.FEATHER),
        bones=list(body.BONES),
        athletes={name: {hand: _athlete(name, hand == "right") for hand in court.HANDS} for name in body.ATHLETES},
        shots=list(SHOTS),
        heights=list(HEIGHTS),
        techniques=list(TECHNIQUES),
    )


def _athlete(name: str, right_handed: bool) -> messages.AthleteFacts:
    skeleton, fingers = body.load_skeleton(name), body.finger_pose(name, right_handed=right_handed)
    axis, normal = skeleton.racket(right_handed=right_handed)
    return messages.AthleteFacts(
        height=skeleton.height,
        parents=skeleton.parents(right_handed=right_handed).tolist(),
        rest=np.round(skeleton.rest_pose(right_handed=right_handed), 6).tolist(),
        shaft=np.round(axis, 6).tolist(),
        strings=np.round(normal, 6).tolist(),
        fingers={bone: np.round(turn, 6).tolist() for bone, turn in fingers.items()},
    )


def rounded(value: float) -> float:
    """A probability rounded to seven decimals."""
    return round(float(value), 7)


def stroke_facts(rally: Rally, stroke: int, seat: int) -> dict[str, Any]:
    """Fields of :class:`~shuttle_marl.court.messages.StrokeFacts` for a stroke with which a seat aims at an area in a rally."""
    catalogue, sign = rally.catalogue, rally.facing(seat)
    (x0, x1), (y0, y1) = rally.aim_box(seat, stroke)
    xs, ys = sorted((sign * x0, sign * x1)), sorted((sign * y0, sign * y1))
    return {
        "stroke": stroke,
        "seat": seat,
        "shot": SHOTS[catalogue.shot[stroke]],
        "area": court.AREAS[rally.target(seat, stroke)],
        "height": HEIGHTS[catalogue.height[stroke]],
        "technique": TECHNIQUES[catalogue.technique[stroke]],
        "box": (*xs, *ys),
    }


def rally_facts(game: Game, rally: CourtRally, motion: staging.Motion) -> messages.RallyFacts:
    """A rally without its motion: score, strokes with their probabilities, positions and times, and a person's turn."""
    (first, second), winner, result = motion.skeletons, rally.winner, None
    if winner is not None:
        after = rally.score.after(winner)
        game_won = len(after.finished) > len(rally.score.finished)
        points = after.finished[-1] if game_won else after.points
        result = messages.ScoreFacts(points, after.games, after.over, game_won)
    named = ("number", "server", "from_right", "ends_changed", "points", "games")
    return messages.RallyFacts(
        **{name: getattr(rally, name) for name in named},
        skill=None if game.people is None else str(game.people.date or ""),
        names=seat_names(game, rally.names),
        before=rally.score.break_before,
        finished=list(rally.score.finished),
        winner=winner,
        reason=None if rally.open else OUTCOMES[rally.ending],
        after=result,
        strokes=[_stroke(game, rally, motion, i, int(state)) for i, state in enumerate(rally.states(game))],
        turn=_turn(game, rally, rally.turn) if rally.turn is not None and rally.chooses(game) else None,
        players=(messages.PlayerFacts(first.name, motion.hands[0]), messages.PlayerFacts(second.name, motion.hands[1])),
    )


def _turn(game: Game, rally: CourtRally, state: int) -> messages.Turn:
    seat = rally.chooser
    about = seat, len(rally), HEIGHTS[int(game.contact(state))], bool(game.hurried(state))
    if rally.receives:
        return messages.Turn(*about, strokes=[], positions=[rounded(p) for p in game.people_positions(state)])
    game = game.seats[seat]
    strokes = game.legal_strokes(state).tolist()
    pairs = game.pair_at(state, np.arange(len(strokes)))
    good, returned, _ = game.stroke_probabilities(pairs)
    legal = [
        messages.TurnStroke(
            **stroke_facts(rally, stroke, seat),
            p_succ=rounded(good[k]),
            p_ret=rounded(returned[k]),
            support=_support(game, int(pairs[k])),
        )
        for k, stroke in enumerate(strokes)
        if rally.as_named(seat, stroke)
    ]
    return messages.Turn(*about, strokes=legal, positions=[])


def _stroke(game: Game, rally: CourtRally, motion: staging.Motion, i: int, state: int) -> messages.Stroke:
    trajectory, stroke, game = motion.trajectory, int(rally.stroke[i]), game.seats[int(rally.striker[i])]
    pair = int(game.pair(state, stroke))
    good, returned, _ = (rounded(float(p)) for p in game.stroke_probabilities(pair))
    return messages.Stroke(
        **stroke_facts(rally, stroke, int(rally.striker[i])),
        state=state,
        p_succ=good,
        p_ret=returned,
        person=i in rally.chosen,
        hurried=bool(rally.hurried[i]),
        waited=waited_at(rally, game, i, state),
        effort=int(game.effort(state)) if game.levels > 1 else None,
        support=_support(game, pair),
        time=round(float(trajectory.time[i]), 4),
        contact=np.round(trajectory.contact[i], 4).tolist(),
        end=staging.ENDS[trajectory.end[i]],
        end_time=round(float(trajectory.end_time[i]), 4),
        end_point=np.round(trajectory.end_point[i], 4).tolist(),
        speed=round(float(trajectory.flight.launch_speed[i]), 2),
    )


def _support(game: Game, pair: int) -> float | None:
    real = real_strokes(game)
    return None if real is None else round(float(real[game.base_pair_edge[pair % game.n_base_pairs]]), 1)


def arrivals(pairs: dict[int, float], game: Game) -> dict[int, float]:
    """Weights of the states in which returned strokes arrive, from those of legal pairs."""
    following: dict[int, float] = {}
    for pair, weight in pairs.items():
        one = np.array([pair])
        returned = weight * game.outcome_probabilities(one)[0, RETURNED_BELOW:]
        for arrival, mass in zip(game.arrivals(one)[0].tolist(), returned.tolist(), strict=True):
            following[arrival] = following.get(arrival, 0.0) + mass
    return following


ELITE: Final = Side(policy="bc")  # the imitated average elite player, the reference of all comparisons
SHOWN, OPEN = 8, 0.01  # number of strokes listed for each decision, and gain of a stroke from which a side is open, in rallies
_GROUPS: Final = {  # shot types of a figure of style
    "attack": [SHOTS.index(shot) for shot in ("smash", "half-smash", "net-kill")],
    "net play": [SHOTS.index(shot) for shot in ("net-shot", "cross-court-net-shot", "block")],
}


class StrokeValues:
    """Values of the strokes of the game of some policies."""

    def __init__(self, policies: PolicyTables) -> None:
        self.policies, self.game = policies, policies.game
        self._factor = factor_of(policies.game.seats[0])

    def players(self, sides: tuple[Side, Side]) -> Players:
        """Two policies and their values against each other. Raises PolicyError: a policy cannot be loaded."""
        first, second = (self.policies.table(side, seat) for seat, side in enumerate(sides))
        return Players(tables=(first, second), value=self.policies.values(sides))

    def imitated(self) -> Players:
        """The imitated people of a pair, or two average elite players."""
        if self.game.people is None:
            return self.players((ELITE, ELITE))
        first, second = map(imitation, self.game.people.players, self.game.seats)
        return self.players((Side(policy=first), Side(policy=second)))

    def analysis(self, rally: CourtRally, players: Players) -> messages.Analysis:
        """Values of every stroke of a rally."""
        found = analyse_rally(rally, self.game, players, rules=rally.score.rules)
        strokes = zip(found.decisions, found.rank.tolist(), found.match_win.tolist(), strict=False)
        over, factor = rally.winner is not None, self._factor
        return messages.Analysis(
            number=rally.number,
            factor=None if factor is None else (factor.value, factor.low, factor.high),
            strokes=[self._stroke(rally, i, *about) for i, about in enumerate(strokes)],
            win_after=float(found.rally_win[-1]) if over else None,
        )

    def _stroke(self, rally: Rally, number: int, choice: Decision, rank: int, match_win: float) -> messages.StrokeValue:
        win, chosen = choice.value, float(choice.win[rank])
        rated = rater_of(self.game).rated(np.array([choice.state]))
        loss, question = float(rated.loss[rank]), None
        better = int(rated.best[0]) if loss > 0 else rank
        always, real = [rank, better], choice.support[[rank, better]]
        if (asked := rated.question(rank)) is not None:
            right, wrong = asked
            always += [right, *wrong]
            question = messages.Question(right=int(choice.stroke[right]), wrong=[int(choice.stroke[k]) for k in wrong])
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
            support=None if np.isnan(real).any() else round(float(real.min())),
            **self._waiting(rally, number, choice, rank),
        )

    def _waiting(self, rally: Rally, number: int, choice: Decision, rank: int) -> dict[str, Any]:
        """What the receiver of a stroke could do, and what the striker gains by it."""
        chooses = stepper_of(self.game).chooses_position(choice.state)
        found = places_of(self.game, choice.state, choice.seat, self.policies.solution) if chooses else None
        if found is None:
            return {"places": None, "open": None, "wait": False}
        columns = found.position, found.people, found.perfect, found.loss, found.win[rank]
        places = [messages.Place(int(p), *map(rounded, rest)) for p, *rest in zip(*columns, strict=True)]
        waited = waited_at(rally, self.game, number, choice.state)
        side = None
        if waited is not None and waited in found.position:
            gain = np.where(choice.support >= RELIABLE, found.gain[:, found.position == waited].ravel(), -np.inf)
            best = int(gain.argmax())
            if gain[best] >= OPEN:
                side = messages.OpenSide(**stroke_facts(rally, int(choice.stroke[best]), choice.seat), gain=rounded(gain[best]))
        return {"places": places, "open": side, "wait": waited is not None and found.asks(waited)}

    def positions(self, state: int, receiver: int) -> list[float]:
        """Probabilities with which perfect play waits where the opponent is in a state; empty: a receiver has no choice there."""
        if not stepper_of(self.game).chooses_position(state):
            return []
        return [rounded(p) for p in position_shares(self.policies.solution.policy[receiver].waiting_table[state])]

    def options(
        self, rally: Rally, choice: Decision, rated: Rated | None = None, *, always: tuple[int, ...] = (), limit: int = SHOWN
    ) -> list[messages.Option]:
        """The strokes of a decision, most probable first; those at positions ``always`` are listed."""
        usual = np.argsort(-choice.probability, kind="stable").tolist()
        order = [k for k in usual if rally.as_named(choice.seat, int(choice.stroke[k]))]
        order += [k for k in always if k not in order]
        listed = list(dict.fromkeys([*order[: limit - len(always)], *always, *order]))[:limit]
        best = (rated or rater_of(self.game).rated(np.array([choice.state]))).win
        return [
            messages.Option(
                **stroke_facts(rally, int(choice.stroke[k]), choice.seat),
                p_succ=rounded(choice.p_succ[k]),
                p_ret=rounded(choice.p_ret[k]),
                support=None if np.isnan(choice.support[k]) else round(float(choice.support[k]), 1),
                win=rounded(choice.win[k]),
                best=rounded(best[k]),
                probability=rounded(choice.probability[k]),
            )
            for k in sorted(listed, key=order.index)
        ]

    def styles(self, sides: tuple[Side, Side]) -> messages.Styles:
        """Exact statistics of two players against each other, beside those of two imitated elite players."""
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
