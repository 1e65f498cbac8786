"""Figures of the staging's benchmark that are not of one motion: sizes and times, on cases built by hand."""

import dataclasses
import io
import types

import numpy as np
import pytest
from rich.console import Console

from benchmarks import staging
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.staging import Motion, stage

QUIET = Console(file=io.StringIO())


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


def test_a_rally_is_continued_as_in_play(rally: Rally) -> None:
    open_ended = [staging.first_strokes(rally, k) for k in range(len(rally))]
    assert [len(part) for part in open_ended] == [0, 1, 2, 3]
    assert all(part.open for part in open_ended)
    assert staging.first_strokes(rally, len(rally)) is rally


def test_slow_staging_and_fat_packing_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter(np.arange(0.0, 1e6, 0.2).tolist())
    monkeypatch.setattr(staging, "time", types.SimpleNamespace(process_time=lambda: next(ticks)))
    pack = Motion.pack
    monkeypatch.setattr(Motion, "pack", lambda motion: pack(motion) + bytes(10**6))
    found = staging.run(2, 0, QUIET)
    assert found["continue_ms"] == pytest.approx(200)
    assert found["realtime"] == pytest.approx(found["seconds"] / 0.4)
    assert found["pack_kb_per_s"] > 50
    assert found["rallies"] == 2
