"""The badminton court in metres, and the nine target areas of a half.

Frame ("egocentric metres"): the origin lies on the floor under the middle of the net; ``y`` points from the striker
to the opponent, ``x`` to the striker's right. So the striker stands at ``y < 0`` and a stroke lands at ``y > 0``.
Lengths follow the BWF Laws of Badminton (13.40 m x 6.10 m, singles width 5.18 m, net 1.55 m at the posts).
The cuts between the areas are those with which ShuttleSet was annotated (Wang et al., KDD 2023).
"""

from typing import Final, TypeVar

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I64, Bools, Floats, Ints

LENGTH: Final = 13.40  # length of the court [m]
WIDTH: Final = 6.10  # width of the court between the doubles side lines [m]
SINGLES_WIDTH: Final = 5.18  # width between the singles side lines [m]
NET_HEIGHT: Final = 1.55  # height of the net at the posts [m]
NET_HEIGHT_CENTRE: Final = 1.524  # height of the net in the middle [m]
SHORT_SERVICE: Final = 1.98  # distance of the short service line from the net [m]
LONG_SERVICE: Final = 0.76  # distance of the long service line of doubles from the back line [m]
LINE: Final = 0.04  # width of the lines [m]
NET_DEPTH: Final = 0.76  # from the top of the net to its lower edge [m]
TAPE: Final = 0.075  # height of the tape along the top of the net [m]

HALF_LENGTH: Final = LENGTH / 2
HALF_WIDTH: Final = SINGLES_WIDTH / 2
SIDE_CUT: Final = 73.5 * LENGTH / 660  # |x| beyond which an area is a side area [m] (73.5 of the data's 660 length units)
MIDDLE_CUT: Final = 114 * LENGTH / 660  # distance from the net where the front areas end and the middle ones begin [m]
BACK_CUT: Final = 276 * LENGTH / 660  # distance from the net where the middle areas end and the back ones begin [m]

AREAS: Final = (
    "front-right",
    "front-centre",
    "front-left",
    "middle-right",
    "middle-centre",
    "middle-left",
    "back-right",
    "back-centre",
    "back-left",
)
"""The nine areas of the receiver's half, right and left as the receiver sees them; index = 3 * depth + side.

The strokes of a game name areas as a right-handed receiver sees them: *right* is the forehand side. For a left-handed receiver
they are mirrored (:func:`mirrored`)."""
HANDS: Final = ("right", "left")  # hands with which players hold the racket; their numbers are 0 and 1
Hands = tuple[str, str]  # hands of seats 0 and 1
N_AREAS: Final = len(AREAS)
AREA_WORDS: Final = tuple(area.replace("right", "forehand").replace("left", "backhand").replace("-", " ") for area in AREAS)
"""The areas in words for people, as a right-handed receiver sees them; ``short_areas`` of the catalogues of languages."""
AreaT = TypeVar("AreaT", int, Ints)
N_SIDES: Final = 3  # right, centre and left of a half, numbers 0 to 2
FOREHAND: Final = 0  # number of the forehand side of a right-handed receiver
N_THIRDS: Final = 3  # front, middle and back third of a half, numbers 0 to 2 of `third_of`
BACK: Final = 2  # number of the back third


def third_of(area: AreaT) -> AreaT:
    """Third of the half in which areas lie, any shape: 0 front, 1 middle, 2 back."""
    return area // N_SIDES


def mirrored(area: AreaT) -> AreaT:
    """Areas with right and left exchanged, any shape."""
    return area + 2 - 2 * (area % N_SIDES)


def seen_by(hand: str | None, area: AreaT) -> AreaT:
    """Areas of the strokes of a game as a receiver of a hand sees them (None: unknown, as right-handed), and back, any shape."""
    return mirrored(area) if hand == "left" else area


def steps_between(a: Ints, b: Ints | int) -> Ints:
    """Steps across and along the court from areas to others, broadcast."""
    return np.abs(a // 3 - b // 3) + np.abs(a % 3 - b % 3)


def area_of(x: Floats, y: Floats) -> I8:
    """The area of a landing point, the nearest one for points outside the court.

    Args:
        x: metres to the striker's right, any shape.
        y: metres beyond the net, same shape; values below zero (the striker's own half) count as the front.

    Returns:
        Index into :data:`AREAS`, same shape; -1 where a coordinate is NaN.
    """
    x, y = np.asarray(x), np.asarray(y)
    # The receiver looks the other way, so the striker's left (x < 0) is the receiver's right (side 0).
    side = 1 + (x > SIDE_CUT).astype(np.int8) - (x < -SIDE_CUT).astype(np.int8)
    depth = (y > MIDDLE_CUT).astype(np.int8) + (y > BACK_CUT).astype(np.int8)
    area = (3 * depth + side).astype(np.int8)
    return np.where(np.isnan(x) | np.isnan(y), np.int8(-1), area)


def in_court(x: Floats, y: Floats, margin: float = 0.0) -> Bools:
    """Whether a point lies in the opponent's singles court, lines widened by ``margin`` metres; False for NaN."""
    x, y = np.asarray(x), np.asarray(y)
    inside: Bools = (np.abs(x) <= HALF_WIDTH + margin) & (y >= -margin) & (y <= HALF_LENGTH + margin)
    return inside


def area_centre(area: Ints) -> F64:
    """Centres of areas in the striker's frame, shape ``area.shape + (2,)`` [m]."""
    area = np.asarray(area)
    xs = np.array([-(SIDE_CUT + HALF_WIDTH) / 2, 0.0, (SIDE_CUT + HALF_WIDTH) / 2])
    ys = np.array([MIDDLE_CUT / 2, (MIDDLE_CUT + BACK_CUT) / 2, (BACK_CUT + HALF_LENGTH) / 2])
    return np.stack([xs[area % 3], ys[area // 3]], axis=-1)


def service_area(area: Ints, from_right: bool) -> I64:
    """Areas at which a serve from the right or left service court aims, any shape: diagonally, so to the side of the server."""
    return np.where(area % N_SIDES == (2 if from_right else 0), mirrored(area), area).astype(np.int64)


def area_box(area: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Extent of an area across and along the court, in the striker's frame [m]."""
    depth, side = divmod(area, N_SIDES)
    across = ((-HALF_WIDTH, -SIDE_CUT), (-SIDE_CUT, SIDE_CUT), (SIDE_CUT, HALF_WIDTH))[side]
    along = ((0.0, MIDDLE_CUT), (MIDDLE_CUT, BACK_CUT), (BACK_CUT, HALF_LENGTH))[depth]
    return across, along


def service_box(area: int, from_right: bool) -> tuple[tuple[float, float], tuple[float, float]]:
    """Part of :func:`area_box` within the service court into which a serve flies [m]."""
    (x0, x1), (y0, y1) = area_box(int(service_area(np.array(area), from_right)))
    return (x0, min(x1, 0.0)) if from_right else (max(x0, 0.0), x1), (max(y0, SHORT_SERVICE), y1)
