"""Curves between key poses. What the numbers mean stands in :mod:`shuttle_marl.staging.curves`."""

from shuttle_marl.arrays import F64, I64
from shuttle_marl.kernel.compiling import compiled


@compiled
def _at_end(near: float, far: float, chord: float, next_chord: float) -> float:
    """Slope at an end of a curve, from the lengths and the chords of the two intervals next to it."""
    slope = ((2 * near + far) * chord - near * next_chord) / (near + far)
    if slope * chord <= 0:
        return 0.0
    if chord * next_chord <= 0 and abs(slope) > 3 * abs(chord):
        return 3 * chord
    return slope


@compiled
def monotone_slopes(frame: I64, pose: F64, out: F64) -> None:
    """Slopes ``[K, C]`` of C curves through ``[K, C]`` values, at least two, such that cubics never overshoot."""
    k, c = pose.shape
    for j in range(c):
        for i in range(k):
            left = float(frame[i] - frame[i - 1]) if i else 0.0
            right = float(frame[i + 1] - frame[i]) if i + 1 < k else 0.0
            before = (pose[i, j] - pose[i - 1, j]) / left if i else 0.0
            after = (pose[i + 1, j] - pose[i, j]) / right if i + 1 < k else 0.0
            if k == 2:
                out[i, j] = after if i == 0 else before
            elif i == 0:
                further = float(frame[2] - frame[1])
                out[i, j] = _at_end(right, further, after, (pose[2, j] - pose[1, j]) / further)
            elif i == k - 1:
                further = float(frame[i - 1] - frame[i - 2])
                out[i, j] = _at_end(left, further, before, (pose[i - 1, j] - pose[i - 2, j]) / further)
            elif before * after <= 0:
                out[i, j] = 0.0
            else:
                first, second = 2 * right + left, right + 2 * left
                out[i, j] = (first + second) / (first / before + second / after)


@compiled
def run_between(frame: I64, pose: F64, slope: F64, out: F64) -> None:
    """Cubics through ``[K, C]`` values with given slopes, in every frame ``[F, C]``; held before the first and after the last."""
    last, c = len(frame) - 1, pose.shape[1]
    k = 0
    for f in range(len(out)):
        if f <= frame[0] or f >= frame[last]:
            row = 0 if f <= frame[0] else last
            for j in range(c):
                out[f, j] = pose[row, j]
            continue
        while frame[k + 1] <= f:
            k += 1
        h = float(frame[k + 1] - frame[k])
        u = (f - frame[k]) / h
        for j in range(c):
            chord = pose[k + 1, j] - pose[k, j]
            a, b = h * slope[k, j] - chord, chord - h * slope[k + 1, j]
            out[f, j] = pose[k, j] + u * chord + u * (1 - u) * ((1 - u) * a + u * b)
