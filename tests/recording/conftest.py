"""Logs for the tests of the recorder."""

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from shuttle_marl.game import default_game
from shuttle_marl.recording import LogHeader, Player, Rallies, RallyLog, RallyLogWriter


def a_header(n_strokes: int | None = None, **changes: Any) -> LogHeader:
    names = default_game().catalogue.names
    return LogHeader(
        **{
            "seed": 7,
            "game": default_game().hash,
            "strokes": names[:n_strokes],
            "policies": (Player(name="attacking", hash="a" * 64), Player(name="ünïcode | name")),
            "pairings": (3, 2**63 - 1, 2**64 - 1),
            **changes,
        }
    )


def some_rallies(count: int, seed: int = 0, n_strokes: int | None = None, longest: int = 30) -> Rallies:
    """Rallies with arbitrary numbers: what a log has to keep, whether or not it makes sense."""
    rng = np.random.default_rng(seed)
    length = rng.integers(1, longest + 1, count).astype(np.int32)
    n = n_strokes or default_game().n_strokes
    order = np.sort(rng.integers(0, 3, count))
    hurried = rng.integers(0, 2, int(length.sum())).astype(np.uint8)
    hurried[np.cumsum(length) - length] = 0  # no server is
    return Rallies(
        pairing=order.astype(np.uint32),
        match=np.arange(count, dtype=np.uint32),
        rally=rng.integers(0, 2**16, count).astype(np.uint16),
        policy=rng.integers(0, 2, (count, 2)).astype(np.uint16),
        server=rng.integers(0, 2, count).astype(np.uint8),
        winner=rng.integers(0, 2, count).astype(np.uint8),
        reason=rng.integers(0, 2, count).astype(np.uint8),
        score=rng.integers(0, 256, (count, 4)).astype(np.uint8),
        length=length,
        stroke=rng.integers(0, n, int(length.sum())).astype(np.uint8 if n <= 256 else np.uint16),
        hurried=hurried,
    )


def read_rallies(path: Path) -> Rallies:
    """All rallies of a log."""
    with RallyLog(path) as log:
        return Rallies.concatenate([*(batch for _, batch in log.batches())] or [some_rallies(0)])


def read_all(path: Path) -> int:
    """Number of rallies, after everything that can be asked of a log was asked."""
    with RallyLog(path) as log:
        for _ in log.batches():
            pass
        log.rally_table()
        log.stroke_table()
        if log.n_rallies:
            log.rally(int(log.first_rally[-1]))
        log.numbers_of_match(0, 7)
        return log.n_rallies


def chunks_of(path: Path) -> list[tuple[int, int]]:
    """First and last byte plus one of every batch of a finished log, by the official reader."""
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    return [(each.chunk_start_offset, each.chunk_start_offset + each.chunk_length) for each in chunks]


def same(a: Rallies, b: Rallies) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(Rallies))


@pytest.fixture(scope="module", autouse=True)
def no_waiting_for_the_disk() -> Iterator[None]:
    """No test cuts the power, and waiting for the disk is most of what writing a small log takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session")
def header() -> Callable[..., LogHeader]:
    return a_header


@pytest.fixture(scope="session")
def rallies() -> Callable[..., Rallies]:
    return some_rallies


@pytest.fixture
def log_file(tmp_path: Path) -> Path:
    """A log of 100 rallies in batches of 16."""
    path = tmp_path / "rallies.mcap"
    with RallyLogWriter(path, a_header(), batch_rallies=16) as log:
        log.append(some_rallies(100))
    return path


@pytest.fixture(scope="session")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a little tournament; look, do not touch."""
    from shuttle_marl.league import LeagueConfig
    from tests.tournaments import play_league

    out = tmp_path_factory.mktemp("played") / "run"
    play_league(LeagueConfig(pool=("attacking", "safe", "random"), matches=6, out=out))
    return out / "rallies.mcap"
