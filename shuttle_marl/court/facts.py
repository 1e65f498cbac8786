"""Facts about hall, strokes and rallies that pages receive."""

from typing import Any

import numpy as np

from shuttle_marl.court import messages, staging
from shuttle_marl.court.match import CourtRally
from shuttle_marl.game import court
from shuttle_marl.game.pairs import seat_names
from shuttle_marl.game.rally import Rally, waited_at
from shuttle_marl.game.recovery import position_box
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.shipped import real_strokes, waiting_places
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game


def hall_facts() -> messages.HallFacts:
    """Dimensions of court, equipment and athletes, and the vocabulary of strokes."""
    return messages.HallFacts(
        court=messages.CourtFacts(*(getattr(court, name.upper()) for name in messages.CourtFacts.__struct_fields__)),
        areas=[messages.AreaFacts(name=name, box=court.area_box(i)) for i, name in enumerate(court.AREAS)],
        positions=[
            messages.PositionFacts(box=position_box(i), place=(round(x, 4), round(-y, 4)))
            for i, (x, y) in enumerate(waiting_places().tolist())
        ],
        racket=messages.RacketFacts(
            length=staging.RACKET_LENGTH, sweet_spot=staging.SWEET_SPOT, butt=staging.RACKET_BUTT, head=staging.RACKET_HEAD
        ),
        shuttle=messages.ShuttleFacts(
            scale=staging.SHUTTLE_SCALE, cork=staging.CORK, feathers=staging.FEATHERS, feather=staging.FEATHER
        ),
        bones=list(staging.BONES),
        athletes={name: {hand: _athlete(name, hand == "right") for hand in ("right", "left")} for name in staging.ATHLETES},
        shots=list(SHOTS),
        heights=list(HEIGHTS),
        techniques=list(TECHNIQUES),
    )


def _athlete(name: str, right_handed: bool) -> messages.AthleteFacts:
    skeleton = staging.load_skeleton(name)
    axis, normal = skeleton.racket(right_handed=right_handed)
    fingers = staging.finger_pose(name, right_handed=right_handed)
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
    winner, result = rally.winner, None
    if winner is not None:
        after = rally.score.after(winner)
        game_won = len(after.finished) > len(rally.score.finished)
        points = after.finished[-1] if game_won else after.points
        result = messages.ScoreFacts(points, after.games, after.over, game_won, after.changes_ends)
    return messages.RallyFacts(
        number=rally.number,
        skill=None if game.people is None else str(game.people.date or ""),
        names=seat_names(game, rally.names),
        server=rally.server,
        from_right=rally.from_right,
        ends_changed=rally.ends_changed,
        before=rally.score.break_before,
        points=rally.points,
        games=rally.games,
        finished=list(rally.score.finished),
        winner=winner,
        reason=None if rally.open else OUTCOMES[rally.ending],
        after=result,
        strokes=[_stroke(game, rally, motion, i, int(state)) for i, state in enumerate(rally.states(game))],
        turn=_turn(game, rally, rally.turn) if rally.turn is not None and rally.chooses(game) else None,
        players=(_player(motion, 0), _player(motion, 1)),
    )


def _player(motion: staging.Motion, seat: int) -> messages.PlayerFacts:
    return messages.PlayerFacts(athlete=motion.skeletons[seat].name, hand=motion.hands[seat])


def _turn(game: Game, rally: CourtRally, state: int) -> messages.Turn:
    height, hurried = HEIGHTS[int(game.contact(state))], bool(game.hurried(state))
    seat, number = rally.chooser, len(rally)
    if rally.receives:
        positions = [rounded(p) for p in game.people_positions(state)]
        return messages.Turn(seat=seat, number=number, height=height, hurried=hurried, strokes=[], positions=positions)
    game = game.seats[seat]
    strokes = game.legal_strokes(state).tolist()
    good, returned, _ = game.stroke_probabilities(game.pair_at(state, np.arange(len(strokes))))
    legal = [
        messages.TurnStroke(**stroke_facts(rally, stroke, seat), p_succ=rounded(good[k]), p_ret=rounded(returned[k]))
        for k, stroke in enumerate(strokes)
        if rally.as_named(seat, stroke)
    ]
    return messages.Turn(seat=seat, number=number, height=height, hurried=hurried, strokes=legal, positions=[])


def _stroke(game: Game, rally: CourtRally, motion: staging.Motion, i: int, state: int) -> messages.Stroke:
    trajectory, stroke, game = motion.trajectory, int(rally.stroke[i]), game.seats[int(rally.striker[i])]
    pair = int(game.pair(state, stroke))
    good, returned, _ = (rounded(float(p)) for p in game.stroke_probabilities(pair))
    real = real_strokes(game)
    return messages.Stroke(
        **stroke_facts(rally, stroke, int(rally.striker[i])),
        state=state,
        p_succ=good,
        p_ret=returned,
        person=i in rally.chosen,
        hurried=bool(rally.hurried[i]),
        waited=waited_at(rally, game, i, state),
        effort=int(game.effort(state)) if game.levels > 1 else None,
        opponent_effort=int(game.opponent_effort(state)) if game.levels > 1 else None,
        duel=int(game.duel(state)) if game.counts_duels else None,
        support=None if real is None else round(float(real[game.base_pair_edge[pair % game.n_base_pairs]]), 1),
        time=round(float(trajectory.time[i]), 4),
        frame=int(motion.contact_frame[i]),
        contact=np.round(trajectory.contact[i], 4).tolist(),
        end=staging.ENDS[trajectory.end[i]],
        end_time=round(float(trajectory.end_time[i]), 4),
        end_point=np.round(trajectory.end_point[i], 4).tolist(),
        speed=round(float(trajectory.flight.launch_speed[i]), 2),
    )
