"""Breaches of the Laws of Badminton in staged rallies, counted from the frames alone.

The umpire counts points, games and ends of a match by the Laws (7, 8 and 9), without the scoring of the game, and looks at
where players, rackets and shuttle are in the frames, without the choices of the staging.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging import Motion
from shuttle_marl.game.court import HALF_WIDTH, NET_HEIGHT, NET_HEIGHT_CENTRE, SHORT_SERVICE, WIDTH

_FROM_NET: Final = 2.5
"""Distance from the net beyond which no shot is a net kill [m]."""
_FINE: Final = 50
"""Points between two frames at which the height over the net is looked up."""


@dataclasses.dataclass(kw_only=True)
class Umpire:
    """Scoreboard of a match: best of three games to 21, two clear points, the 30th decides.

    Attributes:
        server: seat that serves next.
        points: of seats 0 and 1 in the current game.
        games: won by seats 0 and 1.
        swapped: whether the players are at other ends than in the first rally.
    """

    server: int
    points: list[int] = dataclasses.field(default_factory=lambda: [0, 0])
    games: list[int] = dataclasses.field(default_factory=lambda: [0, 0])
    swapped: bool = False

    def award(self, winner: int) -> None:
        """Count a rally that a seat won."""
        self.server = winner
        self.points[winner] += 1
        own, other = self.points[winner], self.points[1 - winner]
        if self.games == [1, 1] and own == 11 and other < 11:
            self.swapped = not self.swapped
        if own == 30 or (own >= 21 and own - other >= 2):
            self.games[winner] += 1
            self.points, self.swapped = [0, 0], not self.swapped


@dataclasses.dataclass(kw_only=True)
class Breaches:
    """Number of breaches.

    Attributes:
        wrong_service_court: rallies in which server or receiver stand in, or the serve flies to, the court that the server's
            score does not give.
        wrong_end: rallies in which a player is on the half of the opponent.
        kill_beyond_front: net kills struck more than 2.5 m from the net.
        low_net_crossings: flights that pass the net below its top.
        double_hits: strokes whose player also played the one before.
    """

    wrong_service_court: int = 0
    wrong_end: int = 0
    kill_beyond_front: int = 0
    low_net_crossings: int = 0
    double_hits: int = 0

    def look(self, motion: Motion, umpire: Umpire) -> None:
        """Count the breaches of a finished rally, before the umpire has awarded it."""
        shuttle, hits = motion.shuttle.astype(np.float64), motion.contact_frame
        hips = motion.position[:, :, 0].astype(np.float64)
        # Seat 0 begins the match in front of the net.
        half = np.array([1.0, -1.0]) if umpire.swapped else np.array([-1.0, 1.0])
        self.wrong_end += bool((hips[:, :, 1] * half <= 0).any())
        # Players look to the net: the right of who stands at y < 0 is x > 0.
        right = 1.0 if umpire.points[umpire.server] % 2 == 0 else -1.0
        standing = hips[hits[0]] * np.stack([-half, half, np.ones(2)], axis=1)
        inside = (right * standing[:, 0] > 0) & (np.abs(standing[:, 0]) < HALF_WIDTH) & (standing[:, 1] > SHORT_SERVICE)
        crosses = len(hits) == 1 or -half[1 - umpire.server] * right * shuttle[hits[1], 0] > 0
        self.wrong_service_court += not (inside.all() and crosses)
        names = motion.trajectory.rally.catalogue.names
        kills = [name.startswith("net-kill") for name in (names[k] for k in motion.trajectory.rally.stroke)]
        self.kill_beyond_front += int((np.abs(shuttle[hits[kills], 1]) > _FROM_NET).sum())
        struck = np.linalg.norm(motion.sweet_spot[hits] - shuttle[hits, None], axis=2).argmin(axis=1)
        self.double_hits += int((np.diff(struck) == 0).sum())
        self.low_net_crossings += int((_heights_at_net(motion) < 0).sum())


def _heights_at_net(motion: Motion) -> F64:
    """Height over the top of the net wherever the shuttle passes from one half to the other [m]."""
    place, velocity = motion.shuttle.astype(np.float64), motion.shuttle_velocity.astype(np.float64)
    # The rally is over when the shuttle is in the net or on the floor, under which it may roll to the other half.
    over = int(np.rint(motion.trajectory.end_time[-1] * motion.fps))
    found = []
    for i in np.flatnonzero(place[:over, 1] * place[1 : over + 1, 1] < 0):
        u, h = np.linspace(0, 1, _FINE)[:, None], 1 / motion.fps
        a, b, v, w = place[i], place[i + 1], velocity[i], velocity[i + 1]
        if i + 1 in motion.contact_frame:  # the velocity there is that of the next flight
            w = 2 * (b - a) / h - v
        path = (2 * u**3 - 3 * u**2 + 1) * a + (3 * u**2 - 2 * u**3) * b + h * ((u**3 - 2 * u**2 + u) * v + (u**3 - u**2) * w)
        x, _, z = path[np.abs(path[:, 1]).argmin()]
        found.append(z - (NET_HEIGHT_CENTRE + (NET_HEIGHT - NET_HEIGHT_CENTRE) * (2 * x / WIDTH) ** 2))
    return np.array(found)
