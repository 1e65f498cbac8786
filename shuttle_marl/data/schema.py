"""The one schema of annotated strokes: every reader writes it, everything else reads it.

One row is one stroke that passed cleaning. Coordinates are egocentric metres (see :mod:`shuttle_marl.game.court`): origin
on the floor under the middle of the net, ``y`` from the striker towards the opponent, ``x`` to the striker's right.
"""

from typing import Final

import pyarrow as pa

OUTCOMES: Final = ("returned", "fault", "winner", "unknown")
"""What became of a stroke: the opponent hit it, the striker lost the rally, the striker won it, not recorded."""
RETURNED, FAULT, WINNER, UNKNOWN = range(4)

REASONS: Final = ("returned", "out", "net", "short", "foul", "landed", "misjudged", "unknown")
"""How: out of court, into the net, short of the net, a foul; landed in court, left by a misjudging opponent."""

SOURCES: Final = ("ShuttleSet", "ShuttleSet22", "simulated")
DISCIPLINES: Final = ("MS", "WS")
"""Men's singles, women's singles."""

REACH_OVER: Final = 0.5
"""A contact point lies at most this far beyond the net [m]: players may reach over it, and points are marked by hand."""

_FIELDS: Final[tuple[tuple[str, pa.DataType, bool, str], ...]] = (
    ("match", pa.string(), False, "Name of the match, the folder name of the data set."),
    ("source", pa.string(), False, "Data set: ShuttleSet, ShuttleSet22, or simulated."),
    ("discipline", pa.string(), False, "MS (men's singles) or WS (women's singles)."),
    ("game", pa.int8(), False, "Game within the match, from 1."),
    ("rally", pa.int16(), False, "Rally within the game, as numbered by the annotators."),
    ("stroke", pa.int16(), False, "Stroke within the rally, the serve is 1. Dropped strokes leave a gap."),
    ("player", pa.string(), False, "The striker's identifier, e.g. viktor-axelsen."),
    ("opponent", pa.string(), False, "The receiver's identifier."),
    ("shot", pa.int8(), False, "Shot type, index into shuttle_marl.game.stroke.SHOTS."),
    ("height", pa.int8(), False, "Contact height: 0 below, 1 above the net."),
    ("technique", pa.int8(), False, "0 forehand, 1 backhand, 2 around the head."),
    ("area", pa.int8(), True, "Area of the landing point recomputed from it (nearest area if outside the court), index "
     "into shuttle_marl.game.court.AREAS. Of a returned stroke the landing is where the receiver met the shuttle. Of a "
     "fault it is where the shuttle came down, NOT the target. Null if no landing was recorded."),
    ("in_court", pa.bool_(), True, "Whether the landing point lies in the opponent's singles court."),
    ("landing_x", pa.float32(), True, "Landing point [m]."),
    ("landing_y", pa.float32(), True, "Landing point [m], positive beyond the net."),
    ("contact_x", pa.float32(), True, "Where the striker met the shuttle [m]; null for serves."),
    ("contact_y", pa.float32(), True, "Where the striker met the shuttle [m], negative."),
    ("striker_x", pa.float32(), True, "Position of the striker at contact [m]."),
    ("striker_y", pa.float32(), True, "Position of the striker at contact [m], negative."),
    ("receiver_x", pa.float32(), True, "Position of the receiver at contact [m]."),
    ("receiver_y", pa.float32(), True, "Position of the receiver at contact [m], positive."),
    ("clock", pa.int32(), True, "Time in the video [s], never falling in a rally; null where it does not fit."),
    ("frame", pa.int32(), True, "Frame in the video, rising in a rally; null where it does not fit."),
    ("outcome", pa.int8(), False, "Index into OUTCOMES."),
    ("reason", pa.int8(), False, "Index into REASONS."),
    ("points", pa.int8(), True, "Points of the striker in this game AFTER the rally."),
    ("points_opponent", pa.int8(), True, "Points of the receiver in this game AFTER the rally."),
    ("label_area", pa.int8(), True, "The annotators' area label of the landing, corrected for the mirrored matches; "
     "same index as area, null where they put it outside the court, and in simulated tables."),
)  # fmt: skip

STROKES: Final = pa.schema(
    [pa.field(name, kind, nullable, metadata={"description": text}) for name, kind, nullable, text in _FIELDS],
    metadata={"schema": "shuttle_marl.strokes", "version": "1"},
)
"""Arrow schema of a stroke table."""
