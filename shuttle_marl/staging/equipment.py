"""Racket and shuttle in numbers, for all that draw them; the court's are in :mod:`shuttle_marl.game.court`."""

from typing import Final

RACKET_LENGTH: Final = 0.675
"""Length of a racket (BWF Law 4: at most 0.680 m) [m]."""
RACKET_BUTT: Final = -0.10
"""Its lower end along its shaft, seen from the middle of the grip [m]."""
SWEET_SPOT: Final = 0.45
"""Distance from the middle of the grip to the middle of the strings, where the shuttle is struck [m]."""
RACKET_HEAD: Final = (RACKET_LENGTH + RACKET_BUTT - SWEET_SPOT, 0.105)
"""Half the length and half the width of the strung head (at most 0.14 m and 0.11 m) [m]."""

SHUTTLE_SCALE: Final = 1.9
"""Scale at which a shuttle is drawn: at its true size it cannot be seen across the court."""
CORK: Final = 0.0131
"""Radius of the cork (Law 2: 25 to 28 mm across) [m]."""
FEATHERS: Final = 16
FEATHER: Final = ((0.012, 0.0015, 0.013), (0.032, 0.0075, 0.076))
"""Both ends of a feather (62 to 70 mm long, 58 to 68 mm across their tips): distance from the axis, half the width of the vane,
distance behind the middle of the cork [m]."""
