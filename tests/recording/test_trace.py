"""Rallies of batched environments, from the learner's strokes alone or put together from all strokes."""

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
    RallyAssembler,
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


def test_self_play_by_trace_and_by_assembler(tmp_path: Path) -> None:
    """Two ways to the same rallies: following the draws, and putting together what the environment reported."""
    run = play(RallyBatch(GAME, 50, seed=4))
    trace, assembler = RallyTrace(GAME, 50, seed=4), RallyAssembler(50, GAME.n_strokes)
    followed, assembled = [], []
    for part in (run.part(first, first + 9) for first in range(0, STEPS, 9)):
        followed.append(trace.add(part.stroke, part.reward))
        assembled.append(assembler.add(stroke=part.stroke, striker=part.striker, reward=part.reward, match=part.number))
    assert same(Rallies.join(followed), Rallies.join(assembled))
    with RallyLogWriter(tmp_path / "a.mcap", header(("learner",), 4)) as log:
        log.append(Rallies.join(followed))
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


class TestAssembler:
    """What any environment reports, against a plain loop."""

    @pytest.mark.parametrize("seed", range(5))
    def test_rows_with_gaps(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        batch = int(rng.integers(1, 9))
        assembler = RallyAssembler(batch, GAME.n_strokes, ("value",))
        going: list[list[int]] = [[] for _ in range(batch)]
        for _ in range(20):
            shape = (batch, int(rng.integers(0, 6)))
            stroke, striker = rng.integers(0, 100, shape), rng.integers(0, 2, shape)
            reward = rng.choice([0.0, 0.0, 0.0, 1.0, -1.0], shape)
            match, rally = rng.integers(0, 2**32, shape), rng.integers(0, 100, shape)
            score, policy = rng.integers(0, 30, (*shape, 4)), rng.integers(0, 9, (batch, 2))
            played = rng.random(shape) < 0.7
            found = assembler.add(
                stroke=stroke, striker=striker, reward=reward, match=match, rally=rally, score=score, policy=policy,
                pairing=np.arange(batch), played=played, value=stroke / 2,
            )  # fmt: skip
            expected = []
            for b in range(batch):
                for t in range(shape[1]):
                    if played[b, t]:
                        going[b].append(int(stroke[b, t]))
                        if reward[b, t]:
                            expected.append((b, t, going[b]))
                            going[b] = []
            assert found.length.tolist() == [len(strokes) for _, _, strokes in expected]
            assert found.stroke.tolist() == [s for _, _, strokes in expected for s in strokes]
            assert found.value.tolist() == [s / 2 for _, _, strokes in expected for s in strokes]
            for i, (b, t, strokes) in enumerate(expected):
                won, seat = reward[b, t] > 0, striker[b, t]
                assert (found.winner[i], found.reason[i]) == (seat if won else 1 - seat, won)
                assert found.server[i] == (seat + len(strokes) - 1) % 2
                assert (found.match[i], found.rally[i], found.pairing[i]) == (match[b, t], rally[b, t], b)
                assert found.score[i].tolist() == score[b, t].tolist()
                assert found.policy[i].tolist() == policy[b].tolist()

    def test_rows_that_were_reset(self) -> None:
        assembler = RallyAssembler(3, GAME.n_strokes)
        seat = np.zeros((3, 1), dtype=int)

        def add(strokes: list[int], reward: float) -> Rallies:
            return assembler.add(stroke=np.array([strokes]).T, striker=seat, reward=np.full((3, 1), reward), match=seat)

        assert len(add([1, 2, 3], 0)) == 0
        assembler.forget(np.array([True, False, True]))
        assert add([4, 5, 6], 1).stroke.tolist() == [4, 2, 5, 6]
        add([1, 2, 3], 0)
        assembler.forget()
        assert add([4, 5, 6], 1).stroke.tolist() == [4, 5, 6]

    def test_what_does_not_fit(self) -> None:
        assembler, some = RallyAssembler(3, GAME.n_strokes, ("value",)), np.zeros((3, 2))
        with pytest.raises(RecordingError, match=r"columns \(\): expected \('value',\)"):
            assembler.add(stroke=some, striker=some, reward=some, match=some)
        with pytest.raises(RecordingError, match=r"reward of shape \(3, 1\): expected \(3, 2\)"):
            assembler.add(stroke=some, striker=some, reward=some[:, :1], match=some, value=some)

    def test_updates_are_noted(self) -> None:
        assembler, one = RallyAssembler(2, 300, ("update",)), np.ones((2, 1), dtype=int)
        found = assembler.add(stroke=299 * one, striker=one, reward=one, match=one, update=7)
        assert found.update.tolist() == [7, 7]
        assert found.stroke.dtype == np.uint16
        assert found.stroke.tolist() == [299, 299]
