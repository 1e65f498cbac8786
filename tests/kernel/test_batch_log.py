"""Rallies that a batch plays and keeps, also those strokes of which the learner knows nothing."""

import dataclasses
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from shuttle_marl.game.rules import IllegalStrokeError
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import BatchLog, KernelError, RallyBatch, SingleRallies, VersusBatch, batch_log
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, RallyLog, RallyLogWriter
from shuttle_marl.recording.check import check
from shuttle_marl.recording.kernel_rallies import single_rallies_of
from shuttle_marl.recording.replay import replay
from tests.kernel.episodes import compare_with_rally_v0
from tests.reduced import reduced_game

GAME = reduced_game()
NAMES = ("bc", "attacking", "safe")
STEPS = 60


@pytest.fixture(scope="module")
def opponents() -> list[TabulatedPolicy]:
    return [tabulate(resolve(name, GAME), GAME) for name in NAMES]


@dataclasses.dataclass(frozen=True)
class Run:
    """``[B, T]`` what a learner that chooses equally among the legal strokes did, in which rally, and got."""

    stroke: npt.NDArray[np.int64]
    number: npt.NDArray[np.int64]
    reward: npt.NDArray[np.float32]


def play(batch: RallyBatch | VersusBatch, steps: int = STEPS) -> Run:
    """As a collector plays: the next rallies begin in the same call."""
    rows: list[tuple[npt.NDArray[np.generic], ...]] = []
    for _ in range(steps):
        stroke, number = batch.random_strokes(), batch.rows.rally.copy()
        rows.append((stroke, number, batch.step(stroke)[0]))
    return Run(*(np.stack(column, axis=1) for column in zip(*rows, strict=True)))


def kept(log: BatchLog, run: Run, size: int = 9) -> list[SingleRallies]:
    """Rallies that a log plays given the strokes of a run, block after block."""
    found = []
    for first in range(0, run.stroke.shape[1], size):
        part = slice(first, first + size)
        assert np.array_equal(log.play(run.stroke[:, part]), run.reward[:, part])
        found.append(log.take())
    return found


def join(parts: list[SingleRallies]) -> SingleRallies:
    return SingleRallies(
        **{f.name: np.concatenate([getattr(part, f.name) for part in parts], axis=-1) for f in dataclasses.fields(SingleRallies)}
    )


def by_number(rallies: SingleRallies) -> dict[int, tuple[object, ...]]:
    strokes = np.split(rallies.stroke, np.cumsum(rallies.length)[:-1])
    columns = (rallies.opponent, rallies.server, rallies.winner, rallies.reason, rallies.length)
    rows = zip(rallies.rally.tolist(), *(column.tolist() for column in columns), strokes, strict=True)
    return {number: (*rest, stroke.tolist()) for number, *rest, stroke in rows}


@pytest.mark.parametrize(("server", "seat", "count"), [(None, 0, 3), (None, 1, 1), (0, 1, 3), (1, 0, 1), (0, 0, 1), (1, 1, 3)])
def test_rallies_against_opponents(tmp_path: Path, opponents, server, seat: int, count: int) -> None:
    """All that the learner did not see is there, as the environment plays it, and the log plays again."""
    some = opponents[:count]
    batch = VersusBatch(GAME, 40, opponents=some, seed=9, seat=seat, server=server)
    run = play(batch)
    log = BatchLog(VersusBatch(GAME, 40, opponents=some, seat=seat, server=server), seed=9)
    found = join([log.take(), *kept(log, run)])
    single = {name: getattr(found, name) for name in ("server", "winner", "reason", "length", "stroke")}
    compare_with_rally_v0(9, found.rally, **single, serves=server, game=GAME)
    header = LogHeader(
        seed=9,
        game=GAME.hash,
        strokes=GAME.catalogue.names,
        policies=tuple(Player(name=name) for name in ("learner", *NAMES[:count])),
        rules=SINGLE_RALLY,
        matches_per_draw=1,
        draws="rally_v0",
    )
    with RallyLogWriter(tmp_path / "a.mcap", header) as writer:
        writer.append(single_rallies_of(found, seat=seat))
    assert check(tmp_path / "a.mcap", GAME).problems == ()
    with RallyLog(tmp_path / "a.mcap") as written:
        assert replay(written, GAME, dict(zip(NAMES, opponents, strict=True))).wrong == ()
    # Also what the learner was paid, rally by rally, and what it never saw.
    at = np.nonzero(run.reward)
    paid = dict(zip(run.number[at].tolist(), (run.reward[at] > 0).tolist(), strict=True))
    won = dict(zip(found.rally.tolist(), (found.winner == seat).tolist(), strict=True))
    assert {number: won[number] for number in paid} == paid
    unseen = [won[number] for number in won if number not in paid]
    assert (sum(unseen), len(unseen) - sum(unseen)) == batch.unseen == log.batch.unseen
    assert (server == seat) == (len(unseen) == 0)
    assert np.array_equal(found.opponent, found.rally % 40 % count)


def test_self_play() -> None:
    run = play(RallyBatch(GAME, 50, seed=4))
    found = join(kept(BatchLog(RallyBatch(GAME, 50), seed=4), run))
    single = {name: getattr(found, name) for name in ("server", "winner", "reason", "length", "stroke")}
    compare_with_rally_v0(4, found.rally, **single, game=GAME)
    assert len(found.rally) == np.count_nonzero(run.reward)
    assert not found.opponent.any()


def test_opponents_that_are_assigned(opponents) -> None:
    batch, log = VersusBatch(GAME, 30, opponents=opponents, seed=1), BatchLog(VersusBatch(GAME, 30, opponents=opponents), seed=1)
    rng = np.random.default_rng(0)
    expected, found = {}, {}
    for _ in range(20):
        assigned = rng.integers(0, 3, 30)
        for each in (batch, log.batch):
            each.assign(assigned)
        rallies = join(kept(log, play(batch, 3)))
        found |= dict(zip(rallies.rally.tolist(), rallies.opponent.tolist(), strict=True))
        expected |= dict(zip(batch.rows.rally.tolist(), batch.opponents.opponent.tolist(), strict=True))
    both = expected.keys() & found.keys()
    assert len(both) > 30
    assert {number: found[number] for number in both} == {number: expected[number] for number in both}


def test_neither_blocks_nor_room_matter(opponents, monkeypatch: pytest.MonkeyPatch) -> None:
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))

    def whole(size: int) -> dict[int, tuple[object, ...]]:
        log = BatchLog(VersusBatch(GAME, 20, opponents=opponents), seed=2)
        return by_number(join([log.take(), *kept(log, run, size)]))

    expected = whole(STEPS)
    assert whole(1) == expected
    monkeypatch.setattr(batch_log, "_ROOM", 1)
    assert whole(7) == expected
    assert whole(STEPS) == expected


def test_rallies_come_row_after_row(opponents) -> None:
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))
    (found,) = kept(BatchLog(VersusBatch(GAME, 20, opponents=opponents), seed=2), run, STEPS)
    assert (np.diff(found.rally % 20) >= 0).all()
    assert (np.diff(found.rally)[np.diff(found.rally % 20) == 0] == 20).all()


def test_what_is_given_with_the_strokes_is_kept(opponents) -> None:
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))
    log = BatchLog(VersusBatch(GAME, 20, opponents=opponents), seed=2, extra=2)
    given = np.arange(run.stroke.size, dtype=np.float32).reshape(run.stroke.shape)
    parts = [log.take()]
    for part in (slice(0, 25), slice(25, STEPS)):
        log.play(run.stroke[:, part], np.stack([given, -given])[:, :, part])
        parts.append(log.take())
    found = join(parts)
    assert np.array_equal(found.extra[0], -found.extra[1], equal_nan=True)
    own = ~np.isnan(found.extra[0])
    row = np.repeat(np.arange(len(found.length)), found.length)
    position = np.arange(len(row)) - (np.cumsum(found.length) - found.length)[row]
    assert np.array_equal(own, (found.server[row] + position) % 2 == 0)
    at = np.divmod(found.extra[0, own].astype(int), STEPS)
    assert np.array_equal(run.stroke[at], found.stroke[own])
    assert np.array_equal(run.number[at], found.rally[row[own]])


def test_another_seed_begins_again(opponents) -> None:
    batch, log = VersusBatch(GAME, 20, opponents=opponents, seed=2), BatchLog(VersusBatch(GAME, 20, opponents=opponents), seed=2)
    log.play(play(batch, 7).stroke)
    batch.reset(5)
    log.reset(5)
    run, other = play(batch), BatchLog(VersusBatch(GAME, 20, opponents=opponents), seed=5)
    assert by_number(join([log.take(), *kept(log, run)])) == by_number(join([other.take(), *kept(other, run)]))


def test_what_cannot_be_played(opponents) -> None:
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))
    log = BatchLog(VersusBatch(GAME, 20, opponents=opponents), seed=3, extra=1)
    with pytest.raises(IllegalStrokeError):
        log.play(run.stroke, run.reward[None])
    for stroke, extra in (
        (run.stroke, None),
        (run.stroke, run.reward),
        (run.stroke[:5], run.reward[None]),
        (run.stroke[0], None),
    ):
        with pytest.raises(KernelError, match=r"expected \(20, T\) and \(1, 20, T\)"):
            log.play(stroke, extra)


def test_a_batch_that_is_played_past_its_log_is_found_out(opponents) -> None:
    for steps in (1, 70):
        log = BatchLog(VersusBatch(GAME, 20, opponents=opponents), seed=2)
        play(log.batch, steps)
        with pytest.raises(KernelError, match="was played past its log"):
            log.play(log.batch.random_strokes()[:, None])


def test_policies_choose_as_the_batch_that_plays_by_itself(opponents) -> None:
    from shuttle_marl.kernel import pack

    alone, batch = RallyBatch(GAME, 30, seed=7), RallyBatch(GAME, 30, seed=7)
    alone.run(50, (opponents[0], opponents[1]))
    players = pack(opponents[:2], GAME)
    for _ in range(50):
        batch.step(batch.policy_strokes(players))
    assert np.array_equal(alone.rows.state, batch.rows.state)
    assert np.array_equal(alone.rows.rally, batch.rows.rally)
    with pytest.raises(KernelError, match=r"packed policies: uint16 of shape \(3, \d+\); expected uint16 of shape \(2, \d+\)"):
        batch.policy_strokes(pack(opponents, GAME))
