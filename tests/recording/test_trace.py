"""Rallies of batched environments from the learner's strokes alone."""

import dataclasses
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from shuttle_marl.dynamics import default_game
from shuttle_marl.game.table import TabulatedPolicy, tabulate
from shuttle_marl.kernel import RallyBatch, VersusBatch
from shuttle_marl.kernel.rows import Seen
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import (
    SINGLE_RALLY,
    LogHeader,
    Player,
    Rallies,
    RallyLog,
    RallyLogWriter,
    RecordingError,
)
from shuttle_marl.recording import trace as trace_module
from shuttle_marl.recording.check import check
from shuttle_marl.recording.replay import replay
from shuttle_marl.recording.trace import RallyTrace

GAME = default_game()
NAMES = ("bc", "attacking", "safe")
STEPS = 60


@pytest.fixture(scope="module")
def opponents() -> list[TabulatedPolicy]:
    return [tabulate(resolve(name, GAME), GAME) for name in NAMES]


@dataclasses.dataclass(frozen=True)
class Run:
    """``[B, T]`` what a learner that chooses equally among the legal strokes did, saw and got."""

    stroke: npt.NDArray[np.int64]
    striker: npt.NDArray[np.int8]
    number: npt.NDArray[np.int64]
    observation: npt.NDArray[np.int32]
    reward: npt.NDArray[np.float32]

    def part(self, first: int, last: int) -> "Run":
        return Run(**{f.name: getattr(self, f.name)[:, first:last] for f in dataclasses.fields(Run)})


def play(batch: RallyBatch | VersusBatch, steps: int = STEPS) -> Run:
    rows: list[tuple[npt.NDArray[np.generic], ...]] = []
    size, n = len(batch), GAME.n_strokes
    for _ in range(steps):
        seen = Seen(np.empty((size, 3), np.int32), np.empty((size, n), np.bool_))
        batch.observe(seen)
        stroke, striker, number = batch.random_strokes(), batch.rows.striker.copy(), batch.rows.rally.copy()
        rows.append((stroke, striker, number, seen.tokens, batch.step(stroke)[0]))
    return Run(*(np.stack(column, axis=1) for column in zip(*rows, strict=True)))


def follow(trace: RallyTrace, run: Run, size: int = 9) -> Rallies:
    steps = run.stroke.shape[1]
    parts = [run.part(first, first + size) for first in range(0, steps, size)]
    return Rallies.join([trace.add(part.stroke, part.reward, part.observation) for part in parts])


def header(policies: tuple[str, ...], seed: int, **changes: object) -> LogHeader:
    return LogHeader(
        **{
            "seed": seed,
            "game": GAME.hash,
            "strokes": GAME.catalogue.names,
            "policies": tuple(Player(name=name) for name in policies),
            "rules": SINGLE_RALLY,
            "matches_per_draw": 1,
            "draws": "rally_v0",
            **changes,
        }
    )


def in_order(rallies: Rallies) -> Rallies:
    """By number."""
    order = np.argsort(rallies.match)
    return Rallies.join([rallies.part(int(i), int(i) + 1) for i in order])


def same(a: Rallies, b: Rallies) -> bool:
    fields = [f.name for f in dataclasses.fields(Rallies)]
    return a.columns == b.columns and all(
        np.array_equal(getattr(a, n), getattr(b, n)) for n in fields if getattr(a, n) is not None
    )


@pytest.mark.parametrize("server", [None, 0, 1])
@pytest.mark.parametrize("seat", [0, 1])
@pytest.mark.parametrize("count", [1, 3])
def test_rallies_against_opponents(tmp_path: Path, opponents, server, seat: int, count: int) -> None:
    """Everything that the learner did not see is found, and the log plays again with the opponents' choices."""
    batch = VersusBatch(GAME, 40, opponents=opponents[:count], seed=9, seat=seat, server=server)
    trace = RallyTrace(GAME, 40, opponents=opponents[:count], seed=9, seat=seat, server=server)
    run = play(batch)
    found = follow(trace, run)
    path = tmp_path / "a.mcap"
    with RallyLogWriter(path, header(("learner", *NAMES[:count]), 9), batch_rallies=50) as log:
        log.append(found)
    assert check(path, GAME).problems == ()
    with RallyLog(path) as log:
        assert replay(log, GAME, dict(zip(NAMES, opponents, strict=True))).wrong == ()
    # What the learner was paid, rally by rally, and what it never saw.
    at = np.nonzero(run.reward)
    paid = dict(zip(run.number[at].tolist(), (run.reward[at] > 0).tolist(), strict=True))
    won = dict(zip(found.match.tolist(), (found.winner == seat).tolist(), strict=True))
    assert {number: won[number] for number in paid} == paid
    unseen = [won[number] for number in won if number not in paid]
    assert (sum(unseen), len(unseen) - sum(unseen)) == batch.unseen
    assert (server == seat) == (len(unseen) == 0)
    assert np.array_equal(np.unique(found.policy[:, 1 - seat]), np.arange(1, count + 1))
    assert (found.policy[:, seat] == 0).all()
    assert np.array_equal((found.policy[:, 1 - seat] - 1) % count, found.match % 40 % count)


def test_opponents_that_are_assigned(opponents) -> None:
    batch = VersusBatch(GAME, 30, opponents=opponents, seed=1)
    trace = RallyTrace(GAME, 30, opponents=opponents, seed=1)
    rng = np.random.default_rng(0)
    expected, found = {}, {}
    for _ in range(20):
        assigned = rng.integers(0, 3, 30)
        batch.assign(assigned)
        trace.assign(assigned)
        run = play(batch, 3)
        rallies = follow(trace, run)
        found |= dict(zip(rallies.match.tolist(), rallies.policy[:, 1].tolist(), strict=True))
        expected |= dict(zip(batch.rows.rally.tolist(), (1 + batch.duel.opponent).tolist(), strict=True))
    both = expected.keys() & found.keys()
    assert len(both) > 30
    assert {number: found[number] for number in both} == {number: expected[number] for number in both}


def test_self_play(tmp_path: Path) -> None:
    run = play(RallyBatch(GAME, 50, seed=4))
    trace = RallyTrace(GAME, 50, seed=4)
    parts = [run.part(first, first + 9) for first in range(0, STEPS, 9)]
    with RallyLogWriter(tmp_path / "a.mcap", header(("learner",), 4)) as log:
        log.append(Rallies.join([trace.add(part.stroke, part.reward) for part in parts]))
    assert check(tmp_path / "a.mcap", GAME).problems == ()


def test_blocks_do_not_matter(opponents) -> None:
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))
    wholes = []
    for size in (1, 7, STEPS):
        trace = RallyTrace(GAME, 20, opponents=opponents, seed=2)
        wholes.append(in_order(follow(trace, run, size)))
    assert same(wholes[0], wholes[1])
    assert same(wholes[0], wholes[2])


def test_there_is_always_room(opponents, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rallies longer than the first guess, and more of them than there was room for."""
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))
    whole = follow(RallyTrace(GAME, 20, opponents=opponents, seed=2), run, STEPS)
    monkeypatch.setattr(trace_module, "_LONGEST", 3)
    trace = RallyTrace(GAME, 20, opponents=opponents, seed=2)
    original, rooms = RallyTrace._room, []

    def room(self: RallyTrace, strokes: int, rallies: int) -> object:
        """A twentieth of what was asked for first."""
        rooms.append(rallies)
        return original(self, strokes, rallies) if rooms[1:] else original(self, strokes // 20, rallies // 20)

    monkeypatch.setattr(RallyTrace, "_room", room)
    assert same(follow(trace, run, STEPS), whole)
    assert len(rooms) > 2


def test_what_the_learner_thought_is_kept(opponents) -> None:
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))
    trace = RallyTrace(GAME, 20, opponents=opponents, seed=2, columns=("value", "log_probability", "update"))
    thought = np.arange(run.stroke.size, dtype=np.float32).reshape(run.stroke.shape)
    parts = []
    for first, last in ((0, 25), (25, STEPS)):
        part, mine = run.part(first, last), thought[:, first:last]
        parts.append(trace.add(part.stroke, part.reward, part.observation, value=mine, log_probability=-mine, update=first))
    found = Rallies.join(parts)
    assert found.columns == ("update", "log_probability", "value")
    assert np.array_equal(found.log_probability, -found.value, equal_nan=True)
    assert set(found.update.tolist()) == {0, 25}
    own = ~np.isnan(found.value)
    row = np.repeat(np.arange(len(found)), found.length)
    position = np.arange(len(row)) - found.first_stroke[row]
    assert np.array_equal(own, (found.server[row] + position) % 2 == 0)
    at = np.divmod(found.value[own].astype(int), STEPS)
    assert np.array_equal(run.stroke[at], found.stroke[own])
    assert np.array_equal(run.number[at], found.match[row[own]])


def test_another_seed_begins_anew(opponents) -> None:
    batch, trace = VersusBatch(GAME, 20, opponents=opponents, seed=2), RallyTrace(GAME, 20, opponents=opponents, seed=2)
    follow(trace, play(batch, 7))
    batch.reset(5)
    trace.reset(5)
    run = play(batch)
    assert same(follow(trace, run), follow(RallyTrace(GAME, 20, opponents=opponents, seed=5), run))


def test_what_cannot_be_followed(opponents) -> None:
    run = play(VersusBatch(GAME, 20, opponents=opponents, seed=2))

    def add(seed: int = 2, **changes: object) -> None:
        changed = dataclasses.replace(run, **changes)
        RallyTrace(GAME, 20, opponents=opponents, seed=seed).add(changed.stroke, changed.reward, changed.observation)

    add()
    says = "its strokes do not follow from the seed"
    with pytest.raises(RecordingError, match=says):
        add(seed=3)
    with pytest.raises(RecordingError, match=says):
        add(reward=-run.reward)
    for stroke in (-1, GAME.n_strokes):
        with pytest.raises(RecordingError, match=f"row 0: {says}"):
            add(stroke=np.full_like(run.stroke, stroke))
        with pytest.raises(RecordingError, match=f"row 0: {says}"):
            add(observation=np.full_like(run.observation, 2 * stroke))
    trace = RallyTrace(GAME, 20, opponents=opponents, seed=3)
    for arguments in (
        (run.stroke[:5], run.reward, run.observation),
        (run.stroke, run.reward[:, :5], run.observation),
        (run.stroke, run.reward, None),
    ):
        with pytest.raises(RecordingError, match=r"expected \(20, T\)"):
            trace.add(*arguments)
    with pytest.raises(RecordingError, match=r"expected \(20, T\)"):
        trace.add(run.stroke, run.reward, run.observation, value=run.reward)
