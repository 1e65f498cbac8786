"""Facts of the hall and of rallies for the page: words, positions, times and probabilities."""

import numpy as np
from msgspec.structs import asdict

from shuttle_marl.game.court import (
    AREAS,
    HALF_LENGTH,
    HALF_WIDTH,
    LENGTH,
    LINE,
    LONG_SERVICE,
    NET_DEPTH,
    NET_HEIGHT,
    NET_HEIGHT_CENTRE,
    SHORT_SERVICE,
    TAPE,
    WIDTH,
    area_box,
)
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.shipped import real_strokes
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.staging import (
    ATHLETES,
    BONES,
    CORK,
    ENDS,
    FEATHER,
    FEATHERS,
    RACKET_BUTT,
    RACKET_HEAD,
    RACKET_LENGTH,
    SHUTTLE_SCALE,
    SWEET_SPOT,
    Motion,
    finger_pose,
    load_skeleton,
)
from shuttle_marl.staging.trajectory import facing
from shuttle_marl.watch.match import CourtRally
from shuttle_marl.watch.messages import (
    AreaFacts,
    AthleteFacts,
    CourtFacts,
    HallFacts,
    PlayerFacts,
    RacketFacts,
    RallyFacts,
    ScoreFacts,
    ShuttleFacts,
    Stroke,
    StrokeFacts,
    Turn,
    TurnStroke,
)


def hall_facts() -> HallFacts:
    """Dimensions of court, equipment and athletes, and the vocabulary of strokes."""
    return HallFacts(
        court=CourtFacts(
            length=LENGTH,
            width=WIDTH,
            half_length=HALF_LENGTH,
            half_width=HALF_WIDTH,
            short_service=SHORT_SERVICE,
            long_service_doubles=LONG_SERVICE,
            net=NET_HEIGHT,
            net_centre=NET_HEIGHT_CENTRE,
            net_depth=NET_DEPTH,
            tape=TAPE,
            line=LINE,
        ),
        areas=[AreaFacts(name=name, box=area_box(i)) for i, name in enumerate(AREAS)],
        racket=RacketFacts(length=RACKET_LENGTH, sweet_spot=SWEET_SPOT, butt=RACKET_BUTT, head=RACKET_HEAD),
        shuttle=ShuttleFacts(scale=SHUTTLE_SCALE, cork=CORK, feathers=FEATHERS, feather=FEATHER),
        bones=list(BONES),
        athletes={name: {hand: _athlete(name, hand == "right") for hand in ("right", "left")} for name in ATHLETES},
        shots=list(SHOTS),
        heights=list(HEIGHTS),
        techniques=list(TECHNIQUES),
    )


def _athlete(name: str, right_handed: bool) -> AthleteFacts:
    skeleton = load_skeleton(name)
    axis, normal = skeleton.racket(right_handed=right_handed)
    fingers = finger_pose(name, right_handed=right_handed)
    return AthleteFacts(
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


def stroke_facts(game: Game, stroke: int, seat: int) -> StrokeFacts:
    """Words of a stroke of the catalogue, and the area at which a seat aims with it."""
    catalogue, sign = game.catalogue, facing(seat)
    (x0, x1), (y0, y1) = area_box(int(catalogue.area[stroke]), serve=bool(catalogue.is_serve[stroke]))
    xs, ys = sorted((sign * x0, sign * x1)), sorted((sign * y0, sign * y1))
    return StrokeFacts(
        stroke=stroke,
        seat=seat,
        shot=SHOTS[catalogue.shot[stroke]],
        area=AREAS[catalogue.area[stroke]],
        height=HEIGHTS[catalogue.height[stroke]],
        technique=TECHNIQUES[catalogue.technique[stroke]],
        box=(xs[0], xs[1], ys[0], ys[1]),
    )


def rally_facts(game: Game, rally: CourtRally, motion: Motion) -> RallyFacts:
    """A rally without its motion: score, strokes with their probabilities, positions and times, and a person's turn."""
    winner = rally.winner
    return RallyFacts(
        number=rally.number,
        names=rally.names,
        server=rally.server,
        points=rally.points,
        games=rally.games,
        finished=list(rally.score.finished),
        winner=winner,
        reason=None if rally.open else OUTCOMES[rally.ending],
        after=None if winner is None else _score_after(rally, winner),
        strokes=[_stroke(game, rally, motion, i, int(state)) for i, state in enumerate(rally.states(game))],
        turn=None if rally.turn is None else _turn(game, rally, rally.turn),
        players=(_player(motion, 0), _player(motion, 1)),
    )


def _player(motion: Motion, seat: int) -> PlayerFacts:
    return PlayerFacts(athlete=motion.skeletons[seat].name, hand=motion.handedness[seat])


def _turn(game: Game, rally: CourtRally, state: int) -> Turn:
    seat = (rally.server + len(rally)) % 2
    strokes = game.legal_strokes(state).tolist()
    good, returned, _ = game.stroke_probabilities(game.pair_at(state, np.arange(len(strokes))))
    legal = [
        TurnStroke(**asdict(stroke_facts(game, stroke, seat)), p_succ=rounded(good[k]), p_ret=rounded(returned[k]))
        for k, stroke in enumerate(strokes)
    ]
    return Turn(seat=seat, number=len(rally), height=HEIGHTS[int(game.contact(state))], strokes=legal)


def _score_after(rally: CourtRally, winner: int) -> ScoreFacts:
    after = rally.score.after(winner)
    game_won = len(after.finished) > len(rally.score.finished)
    points = after.finished[-1] if game_won else after.points
    return ScoreFacts(points=points, games=after.games, over=after.over, game_won=game_won)


def _stroke(game: Game, rally: CourtRally, motion: Motion, i: int, state: int) -> Stroke:
    trajectory, stroke = motion.trajectory, int(rally.stroke[i])
    pair = int(game.pair(state, stroke))
    good, returned, _ = (rounded(float(p)) for p in game.stroke_probabilities(pair))
    real = real_strokes(game)
    return Stroke(
        **asdict(stroke_facts(game, stroke, int(rally.striker[i]))),
        state=state,
        p_succ=good,
        p_ret=returned,
        person=i in rally.chosen,
        effort=int(game.effort(state)) if game.levels > 1 else None,
        opponent_effort=int(game.opponent_effort(state)) if game.levels > 1 else None,
        duel=int(game.duel(state)) if game.counts_duels else None,
        support=None if real is None else round(float(real[game.base_pair_edge[pair % game.n_base_pairs]]), 1),
        time=round(float(trajectory.time[i]), 4),
        frame=int(motion.contact_frame[i]),
        contact=np.round(trajectory.contact[i], 4).tolist(),
        end=ENDS[trajectory.end[i]],
        end_time=round(float(trajectory.end_time[i]), 4),
        end_point=np.round(trajectory.end_point[i], 4).tolist(),
        speed=round(float(trajectory.flight.launch_speed[i]), 2),
    )
