"""Rallies as a page is told of them: strokes, places, times and probabilities as JSON, motion as numbers."""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

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
from shuttle_marl.watch.match import Rally


def hall_facts() -> dict[str, Any]:
    """All that a page has to know of court, equipment and athletes to draw them; lengths in metres."""
    return {
        "court": {
            "length": LENGTH,
            "width": WIDTH,
            "half_length": HALF_LENGTH,
            "half_width": HALF_WIDTH,
            "short_service": SHORT_SERVICE,
            "long_service_doubles": LONG_SERVICE,
            "net": NET_HEIGHT,
            "net_centre": NET_HEIGHT_CENTRE,
            "net_depth": NET_DEPTH,
            "tape": TAPE,
            "line": LINE,
        },
        "areas": [{"name": name, "box": area_box(i)} for i, name in enumerate(AREAS)],
        "racket": {"length": RACKET_LENGTH, "sweet_spot": SWEET_SPOT, "butt": RACKET_BUTT, "head": RACKET_HEAD},
        "shuttle": {"scale": SHUTTLE_SCALE, "cork": CORK, "feathers": FEATHERS, "feather": FEATHER},
        "bones": BONES,
        "athletes": {name: {hand: _athlete(name, hand == "right") for hand in ("right", "left")} for name in ATHLETES},
        "shots": SHOTS,
        "heights": HEIGHTS,
        "techniques": TECHNIQUES,
    }


def _athlete(name: str, right_handed: bool) -> dict[str, Any]:
    skeleton = load_skeleton(name)
    axis, normal = skeleton.racket(right_handed=right_handed)
    fingers = finger_pose(name, right_handed=right_handed)
    return {
        "height": skeleton.height,
        "parents": skeleton.parents(right_handed=right_handed).tolist(),
        "rest": np.round(skeleton.rest_pose(right_handed=right_handed), 6).tolist(),
        "shaft": np.round(axis, 6).tolist(),
        "strings": np.round(normal, 6).tolist(),
        "fingers": {bone: np.round(turn, 6).tolist() for bone, turn in fingers.items()},
    }


def rounded(value: float) -> float:
    """A probability as it is sent: of seven digits, which is closer than anyone can tell apart."""
    return round(float(value), 7)


def stroke_facts(game: Game, stroke: int, seat: int) -> dict[str, Any]:
    """Words for a stroke of the catalogue, and the area on the court that it is meant for: ``[x0, x1, y0, y1]`` [m]."""
    catalogue, sign = game.catalogue, facing(seat)
    (x0, x1), (y0, y1) = area_box(int(catalogue.area[stroke]), serve=bool(catalogue.is_serve[stroke]))
    xs, ys = sorted((sign * x0, sign * x1)), sorted((sign * y0, sign * y1))
    return {
        "stroke": stroke,
        "seat": seat,
        "shot": SHOTS[catalogue.shot[stroke]],
        "area": AREAS[catalogue.area[stroke]],
        "height": HEIGHTS[catalogue.height[stroke]],
        "technique": TECHNIQUES[catalogue.technique[stroke]],
        "box": [*xs, *ys],
    }


def rally_facts(game: Game, rally: Rally, motion: Motion) -> dict[str, Any]:
    """A rally without its motion: score, strokes with their probabilities, places and times, and a person's turn."""
    return {
        "number": rally.number,
        "names": rally.names,
        "server": rally.server,
        "points": rally.score.points,
        "games": rally.score.games,
        "finished": rally.score.finished,
        "winner": rally.winner,
        "reason": None if rally.ending is None else OUTCOMES[rally.ending],
        "after": None if rally.winner is None else _score_facts(rally),
        "strokes": [_stroke(game, rally, motion, i) for i in range(len(rally.stroke))],
        "turn": None if rally.turn is None else _turn(game, rally, rally.turn),
        "players": [{"athlete": motion.skeletons[seat].name, "hand": motion.handedness[seat]} for seat in (0, 1)],
    }


def _turn(game: Game, rally: Rally, state: int) -> dict[str, Any]:
    seat = rally.striker(len(rally.stroke))
    strokes = game.legal_strokes(state)
    good, returned, _ = game.stroke_probabilities(game.pair_at(state, np.arange(len(strokes))))
    legal = [
        {**stroke_facts(game, stroke, seat), "p_succ": rounded(good[k]), "p_ret": rounded(returned[k])}
        for k, stroke in enumerate(strokes.tolist())
    ]
    return {"seat": seat, "number": len(rally.stroke), "height": HEIGHTS[int(game.contact(state))], "strokes": legal}


def _score_facts(rally: Rally) -> dict[str, Any]:
    assert rally.winner is not None
    after = rally.score.after(rally.winner)
    shown = after.finished[-1] if len(after.finished) > len(rally.score.finished) else after.points
    return {"points": shown, "games": after.games, "over": after.over, "game_won": shown is not after.points}


def _stroke(game: Game, rally: Rally, motion: Motion, i: int) -> dict[str, Any]:
    trajectory, state, seat = motion.trajectory, rally.state[i], rally.striker(i)
    pair = int(game.pair(state, rally.stroke[i]))
    good, returned, _ = (rounded(float(p)) for p in game.stroke_probabilities(pair))
    own, other = int(game.effort(state)), int(game.opponent_effort(state))
    return {
        **stroke_facts(game, rally.stroke[i], seat),
        "state": state,
        "p_succ": good,
        "p_ret": returned,
        "person": i in rally.chosen,
        "effort": own if game.levels > 1 else None,
        "opponent_effort": other if game.levels > 1 else None,
        "duel": int(game.duel(state)) if game.counts_duels else None,
        "support": _support(game, pair),
        "time": round(float(trajectory.time[i]), 4),
        "frame": int(motion.contact_frame[i]),
        "contact": np.round(trajectory.contact[i], 4).tolist(),
        "end": ENDS[trajectory.end[i]],
        "end_time": round(float(trajectory.end_time[i]), 4),
        "end_point": np.round(trajectory.end_point[i], 4).tolist(),
        "speed": round(float(trajectory.flight.launch_speed[i]), 2),
    }


def _support(game: Game, pair: int) -> float | None:
    """Real strokes that stand behind the probabilities of a legal pair; None: not known."""
    found = real_strokes(game)
    return None if found is None else round(float(found[game.base_pair_edge[pair % game.n_base_pairs]]), 1)


def message(facts: dict[str, Any], parts: Sequence[bytes] = ()) -> bytes:
    """A binary message: length of the JSON as 32 bits, little-endian, then the JSON, then the parts one after the other."""
    text = json.dumps(facts, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)  # so that the numbers behind it are aligned
    return struct.pack("<I", len(text)) + text + b"".join(parts)
