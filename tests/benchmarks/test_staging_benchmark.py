"""Figures of the staging's benchmark that are not of one motion: sizes and times, on cases built by hand."""

import dataclasses

import pytest

from benchmarks import staging
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.staging import Motion, stage


@pytest.fixture(scope="module")
def rally() -> Rally:
    return next(rally for rally in staging.self_play_rallies("bc", 40, seed=11) if len(rally) == 4)


def test_what_is_lost_in_packing_is_found(rally: Rally) -> None:
    motion = stage(rally, seed=0)
    assert staging.pack_error(motion, Motion.unpack(motion.pack())) < 0.002
    for name in ("position", "shuttle"):
        moved = getattr(motion, name).copy()
        moved[7] += 0.05
        assert staging.pack_error(motion, dataclasses.replace(motion, **{name: moved})) > 0.04
    rotation = motion.rotation.copy()
    rotation[7] = rotation[7, :, ::-1]
    assert staging.pack_error(motion, dataclasses.replace(motion, rotation=rotation)) > 0.04, "rackets are somewhere else"
