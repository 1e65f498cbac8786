"""Choice of the instants at which a scene tells where something is: between two of them, viewers interpolate."""

import numpy as np

from shuttle_marl.arrays import F64, Bools
from shuttle_marl.kernel.compiling import compiled


@compiled
def _off(a: F64, b: F64, share: float, value: F64) -> float:
    """Distance of a value from the interpolated one: metres for places ``[3]``, radians for quaternions ``[4]``."""
    width = len(a)
    here, there = 1 - share, share
    if width == 4:
        cosine = 0.0
        for k in range(width):
            cosine += a[k] * b[k]
        sign = 1.0 if cosine >= 0 else -1.0
        cosine = min(abs(cosine), 1.0)
        there *= sign
        if cosine < 0.9999:
            angle = np.arccos(cosine)
            here, there = np.sin((1 - share) * angle) / np.sin(angle), sign * np.sin(share * angle) / np.sin(angle)
    same, opposite = 0.0, 0.0
    for k in range(width):
        found = here * a[k] + there * b[k]
        same += (found - value[k]) ** 2
        opposite += (found + value[k]) ** 2
    # A quaternion and its negative are one rotation, and its angle is twice that between them.
    return 2 * np.sqrt(min(same, opposite)) if width == 4 else np.sqrt(same)


@compiled
def choose_instants(values: F64, tolerance: float, exact: Bools, packet: int, told: Bools) -> None:
    """Mark instants from which everything between them can be interpolated.

    Args:
        values: ``[F, 3]`` places or ``[F, 4]`` quaternions.
        tolerance: how far an interpolated one may be off [m] or [rad].
        exact: ``[F]`` instants that are told in any case.
        packet: every so many instants one is told, for a message that begins there.
        told: ``[F]`` is filled.
    """
    last = len(values) - 1
    told[:] = False
    told[0] = True
    first = 0
    while first < last:
        until, chosen = min((first // packet + 1) * packet, last), first + 1
        while chosen < until and not exact[chosen]:
            for between in range(first + 1, chosen + 1):
                share = (between - first) / (chosen + 1 - first)
                if _off(values[first], values[chosen + 1], share, values[between]) > tolerance:
                    break
            else:
                chosen += 1
                continue
            break
        first = chosen
        told[first] = True
