"""Recorded rallies played again, logs in which something is wrong, and ``python -m shuttle_marl.recording``."""

import dataclasses
import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from shuttle_marl.commands.league import main as league
from shuttle_marl.commands.recording import main
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.stroke import parse
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter, RecordingError, replay
from shuttle_marl.recording.reader import Replay, check
from shuttle_marl.reports.coach import log_strokes
from tests.recording.conftest import read_rallies
from tests.reduced import reduced_model

GAME = default_game()


@pytest.fixture
def whole(played: Path) -> tuple[LogHeader, Rallies]:
    with RallyLog(played) as log:
        return log.header, read_rallies(played)


@pytest.fixture
def written(tmp_path: Path) -> Callable[[LogHeader, Rallies], Path]:
    def write(header: LogHeader, rallies: Rallies) -> Path:
        path = tmp_path / "changed.mcap"
        path.unlink(missing_ok=True)
        with RallyLogWriter(path, header, batch_rallies=100) as log:
            log.append(rallies)
        return path

    return write


def test_a_log_plays_again_bit_for_bit(played: Path) -> None:
    with RallyLog(played) as log:
        found = replay(log, GAME)
        assert (found.rallies, found.strokes, found.wrong) == (log.n_rallies, log.n_strokes, ())
    assert check(played, GAME).problems == ()


def test_positions_of_receivers_are_recorded_and_replayed(tmp_path: Path, written: Callable[[LogHeader, Rallies], Path]) -> None:
    """One that was changed is found by the choice of its policy; one that is not feasible, without the policies too."""
    model = f"{reduced_model()}:recovery"
    played = ["--pool", "bc", "minimax", "--matches", "2", "--game", model, "--no-exact", "--out", str(tmp_path / "run")]
    assert league(played) == 0
    path, game = tmp_path / "run" / "rallies.mcap", load_game(model)
    assert check(path, game).problems == ()
    with RallyLog(path) as log:
        header, rallies = log.header, read_rallies(path)
        policies = {player.name: tabulate(resolve(player.name, game), game) for player in log.policies}
        assert replay(log, game, policies).wrong == ()
    assert rallies.waited is not None
    assert len(np.unique(rallies.waited)) > 4
    feasible = game.waiting.mask(game.base(rallies.states(game)))
    free = np.flatnonzero(feasible.sum(axis=1) > 1)
    other = rallies.waited.copy()
    other[free[5]] = np.flatnonzero(feasible[free[5]] & (np.arange(9) != other[free[5]]))[0]
    with RallyLog(written(header, dataclasses.replace(rallies, waited=other))) as log:
        assert replay(log, game, policies).wrong == (rallies.row_of_stroke[free[5]],)
    other = rallies.waited.copy()
    other[free[7]] = np.flatnonzero(~feasible[free[7]])[0]
    assert check(written(header, dataclasses.replace(rallies, waited=other)), game).problems
    other[free[7]] = 9
    with pytest.raises(RecordingError, match="position 9"):
        check(written(header, dataclasses.replace(rallies, waited=other)), game)


@pytest.mark.parametrize("column", ["winner", "server", "reason", "rally", "match", "pairing"])
def test_a_changed_number_is_found(whole: tuple[LogHeader, Rallies], written, column: str) -> None:
    """Each number of a rally names its draws or says what they led to, so a wrong one shows sooner or later."""
    header, rallies = whole
    found = 0
    rows = range(3, len(rallies), len(rallies) // 4)
    for row in rows:
        values = getattr(rallies, column).copy()
        values[row] = {"match": values[row] + 2, "pairing": (values[row] + 1) % 3}.get(column, values[row] ^ 1)
        path = written(header, dataclasses.replace(rallies, **{column: values}))
        problems = check(path, GAME).problems
        assert problems, "a rally is out of order"
        with RallyLog(path) as log:
            found += row in replay(log, GAME).wrong
    assert found >= (len(rows) if column in ("winner", "reason") else len(rows) / 2)


def test_a_changed_score_is_found_without_the_game(whole: tuple[LogHeader, Rallies], written) -> None:
    header, rallies = whole
    for row, place in ((1, 0), (50, 1), (99, 2), (100, 3), (len(rallies) - 1, 0)):
        score = rallies.score.copy()
        score[row, place] += 1
        problems = check(written(header, dataclasses.replace(rallies, score=score))).problems
        assert problems[0] == f"rally {row} does not follow from the rally before it"


def test_a_log_of_unknown_draws_is_checked_for_its_winners_and_legal_strokes(whole: tuple[LogHeader, Rallies], written) -> None:
    header, rallies = whole
    some, about = rallies.slice(0, 40), dataclasses.replace(header, draws="unknown")
    with RallyLog(written(about, some)) as log:
        assert replay(log, GAME) == Replay(rallies=40, strokes=len(some.stroke), wrong=())
    winner, stroke = some.winner.copy(), some.stroke.copy()
    for reason in (0, 1):
        winner[np.flatnonzero(some.reason == reason)[2]] ^= 1
    others = [row for row in range(40) if winner[row] == some.winner[row]]
    illegal = others[7]
    at = int(some.first_stroke[illegal])
    stroke[at] = np.flatnonzero(~GAME.catalogue.is_serve)[0]
    wrong = sorted([*np.flatnonzero(winner != some.winner).tolist(), illegal])
    with RallyLog(written(about, dataclasses.replace(some, winner=winner, stroke=stroke))) as log:
        assert replay(log, GAME).wrong == tuple(wrong)


def test_a_report_of_rallies_that_do_not_follow_says_so(whole: tuple[LogHeader, Rallies], written) -> None:
    header, rallies = whole
    score, winner = rallies.score.copy(), rallies.winner.copy()
    score[5, 0] += 1
    winner[5] ^= 1
    policy, stroke = rallies.policy.copy(), rallies.stroke.copy()
    policy[5] = policy[5][::-1]
    stroke[rallies.first_stroke[5]] = np.flatnonzero(~GAME.catalogue.is_serve)[0]
    others = (
        dataclasses.replace(rallies, score=score),
        dataclasses.replace(rallies, policy=policy),
        dataclasses.replace(rallies, stroke=stroke),
        dataclasses.replace(rallies, winner=winner),
        rallies.select(np.arange(len(rallies)) != 5),
        Rallies.concatenate([rallies.slice(0, 6), rallies.slice(5, len(rallies))]),
    )
    assert check(written(header, others[1])).problems  # another policy within a match
    first = int(rallies.pairing[0]), int(rallies.match[0])
    for changed in others:
        with RallyLog(written(header, changed)) as log, pytest.warns(UserWarning, match="rally [56] does not follow"):
            log_strokes(log, *first)
    with RallyLog(written(header, rallies)) as log, warnings.catch_warnings():
        warnings.simplefilter("error")
        log_strokes(log, *first)


def test_choices_of_another_policy_are_found(whole: tuple[LogHeader, Rallies], written) -> None:
    """Only in the rallies of the policy that is compared."""
    header, rallies = whole
    names = [player.name for player in header.policies]
    safe, random = (tabulate(resolve(name, GAME), GAME) for name in ("safe", "random"))
    mine = (rallies.policy == names.index("safe")).any(axis=1)
    with RallyLog(written(header, rallies)) as log:
        assert replay(log, GAME, {"safe": safe, "random": random}).wrong == ()
        assert replay(log, GAME, {"nobody": safe}).wrong == ()
        found = np.array(replay(log, GAME, {"safe": random}).wrong)
    assert mine[found].all()
    assert len(found) > 0.8 * mine.sum()


RULES = Rules(points=2, clear=1, cap=2, games=2)
WON_IN_THREE_GAMES = (
    *((0, 1, (0, 0, 0, 0)), (1, 1, (0, 1, 0, 0)), (1, 0, (0, 0, 0, 1)), (0, 1, (1, 0, 0, 1)), (1, 0, (1, 1, 0, 1))),
    *((0, 0, (0, 0, 1, 1)), (0, 0, (1, 0, 1, 1))),
)
"""Server, winner, and score before each rally, of a match that player 0 wins in three games of two points."""


def rallies_of(rows: Sequence[Sequence[Any]]) -> Rallies:
    """Rallies of pairing, match, number, server, winner and score before."""
    n = len(rows)
    pairing, match, rally, server, winner, score = zip(*rows, strict=True)
    return Rallies(
        pairing=np.array(pairing, np.uint32),
        match=np.array(match, np.uint32),
        rally=np.array(rally, np.uint16),
        policy=np.zeros((n, 2), np.uint16),
        server=np.array(server, np.uint8),
        winner=np.array(winner, np.uint8),
        reason=np.ones(n, np.uint8),
        score=np.array(score, np.uint8),
        length=np.ones(n, np.int32),
        stroke=np.zeros(n, np.uint8),
        hurried=np.zeros(n, np.uint8),
    )


def match_of(pairing: int, match: int, length: int = 7) -> list[tuple[Any, ...]]:
    return [(pairing, match, rally, *row) for rally, row in enumerate(WON_IN_THREE_GAMES[:length])]


@pytest.mark.parametrize("batch", [1, 5, 9, 10, 100])
@pytest.mark.parametrize(("column", "value"), [(2, 4), (3, None), (5, 0), (5, 1), (5, 2), (5, 3)])
def test_rallies_that_do_not_follow_are_named(
    batch: int, column: int, value: int, tmp_path: Path, header: Callable[..., LogHeader]
) -> None:
    """The number of a rally, its server, or a part of the score before it is another one."""
    rows = [list(row) for row in (*match_of(0, 0), *match_of(0, 1))]
    for name, says in (("good", ()), ("bad", ("rally 10 does not follow from the rally before it",))):
        with RallyLogWriter(tmp_path / f"{name}.mcap", header(rules=RULES), batch_rallies=batch) as log:
            log.append(rallies_of(rows))
        assert check(tmp_path / f"{name}.mcap").problems[:1] == says
        of_10 = rows[10][column]
        rows[10][column] = (
            value if column == 2 else of_10 ^ 1 if column == 3 else tuple(n + (i == value) for i, n in enumerate(of_10))
        )


@pytest.mark.parametrize(
    "wrong", [(0, 0, 1, 0, 1, (0, 0, 0, 0)), *((0, 0, 0, 0, 1, (i == 0, i == 1, i == 2, 0)) for i in range(3))]
)
def test_matches_begin_with_rally_0_at_love_all(wrong: Any, tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    with RallyLogWriter(tmp_path / "a.mcap", header(rules=RULES)) as log:
        log.append(rallies_of([wrong]))
    assert check(tmp_path / "a.mcap").problems == ("rally 0 does not follow from the rally before it",)


@pytest.mark.parametrize("batch", [7, 100])
def test_a_rally_after_the_end_of_its_match_does_not_follow(batch: int, tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    with RallyLogWriter(tmp_path / "a.mcap", header(rules=RULES), batch_rallies=batch) as log:
        log.append(rallies_of([*match_of(0, 0), (0, 0, 7, 0, 1, (0, 0, 2, 1))]))
    assert check(tmp_path / "a.mcap").problems[:1] == ("rally 7 does not follow from the rally before it",)


def test_matches_may_be_interleaved(tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    rows = [row for pair in zip(match_of(1, 5), match_of(0, 6), strict=True) for row in pair]
    with RallyLogWriter(tmp_path / "a.mcap", header(rules=RULES), batch_rallies=3) as log:
        log.append(rallies_of(rows[:-1]))
    assert check(tmp_path / "a.mcap").problems == ()


def test_a_match_that_breaks_off_is_found_unless_it_is_the_last(tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    for name, lengths, says in (("a", (3, 7, 3), "match 0 of pairing 1 breaks off"), ("b", (7, 7, 3), ""), ("c", (7, 7, 7), "")):
        rows = [row for match, length in enumerate(lengths) for row in match_of(1, match, length)]
        with RallyLogWriter(tmp_path / f"{name}.mcap", header(rules=RULES), batch_rallies=4) as log:
            log.append(rallies_of(rows))
        found = check(tmp_path / f"{name}.mcap")
        assert found.problems == ((says,) if says else ())
        assert (found.rallies, found.strokes, found.replayed) == (len(rows), len(rows), False)


def test_changed_strokes_are_found(whole: tuple[LogHeader, Rallies], written) -> None:
    header, rallies = whole
    row = rallies.row_of_stroke
    rng = np.random.default_rng(0)
    at = rng.choice(len(row), 20, replace=False)
    found = 0
    for i in at:
        stroke = rallies.stroke.copy()
        stroke[i] = (stroke[i] + 1 + rng.integers(len(GAME.catalogue) - 1)) % len(GAME.catalogue)
        with RallyLog(written(header, dataclasses.replace(rallies, stroke=stroke))) as log:
            wrong = replay(log, GAME).wrong
            assert set(wrong) <= {int(row[i])}
            found += len(wrong)
    # Whether a striker was hurried follows from the draw of the stroke before, so every wrong bit shows.
    for i in rng.choice(np.flatnonzero(rallies.position), 10, replace=False):
        hurried = rallies.hurried.copy()
        hurried[i] ^= 1
        with RallyLog(written(header, dataclasses.replace(rallies, hurried=hurried))) as log:
            assert replay(log, GAME).wrong == (row[i],)
    with RallyLog(written(dataclasses.replace(header, seed=1), rallies)) as log:
        assert len(replay(log, GAME).wrong) > len(rallies) / 4, "another seed does not fit"
    # A stroke that is legal there and has nearly the same probabilities may do as well; the policies would tell.
    assert found > 15


def test_another_game_is_refused(log_file: Path, header, tmp_path: Path) -> None:
    RallyLogWriter(tmp_path / "other.mcap", header(game="0" * 64)).close()
    with RallyLog(tmp_path / "other.mcap") as log, pytest.raises(RecordingError, match="played on game 000000000000, not on"):
        replay(log, GAME)


def test_arbitrary_rallies_are_wrong_but_never_an_error(log_file: Path) -> None:
    with RallyLog(log_file) as log:
        assert len(replay(log, GAME).wrong) > 90
    assert len(check(log_file, GAME).problems) >= 2


def test_a_match_that_is_there_twice_is_noticed(played: Path, tmp_path: Path) -> None:
    with RallyLog(played) as log, RallyLogWriter(tmp_path / "twice.mcap", log.header) as twice:
        for _ in range(2):
            twice.append(log.batch(0)[1])
    assert "match 0 of pairing 0 begins 2 times" in check(tmp_path / "twice.mcap").problems


def test_check_and_recover(played: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(played)]) == 0
    assert "replayed with equal outcomes" in capsys.readouterr().out
    assert main(["check", str(played), "--no-replay"]) == 0
    assert "not replayed" in capsys.readouterr().out
    part = tmp_path / "a.mcap.part"
    part.write_bytes(played.read_bytes()[:-2000])
    assert main(["check", str(part)]) == 1
    advice = re.search(r"recover ([^`]+)`", capsys.readouterr().err)
    assert main(["recover", advice[1]]) == 0
    assert "recovered" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "a.mcap")]) == 0
    assert main(["recover", str(part)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert main(["recover", str(part), "--out", str(tmp_path / "b.mcap")]) == 0


@pytest.mark.parametrize("rows", ["rallies", "strokes"])
def test_export(played: Path, tmp_path: Path, rows: str, capsys: pytest.CaptureFixture[str]) -> None:
    for suffix in ("parquet", "csv", "arrow"):
        assert main(["export", str(played), str(tmp_path / f"t.{suffix}"), "--rows", rows]) == 0
    with RallyLog(played) as log:
        expected = log.rally_table() if rows == "rallies" else log.stroke_table()
    parquet = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    arrow = pa.ipc.open_file(tmp_path / "t.arrow").read_all()
    csv = pyarrow.csv.read_csv(tmp_path / "t.csv")
    assert parquet.num_rows == arrow.num_rows == csv.num_rows == expected.num_rows
    for name in expected.column_names:
        values = expected[name].to_pylist()
        assert parquet[name].to_pylist() == arrow[name].to_pylist() == values
        if name == "strokes":
            names = expected["length"].to_pylist()
            assert [len([parse(s) for s in text.split()]) for text in csv[name].to_pylist()] == names
        elif name == "hurried" and rows == "rallies":
            assert [text.split() for text in csv[name].to_pylist()] == [[str(each).lower() for each in row] for row in values]
        else:
            assert csv[name].to_pylist() == values
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.arrow", "t.csv", "t.parquet"]
    assert f"{expected.num_rows:,} rows" in capsys.readouterr().out


def test_show_a_rally(played: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with RallyLog(played) as log:
        rally = log.rally(70)
        names = [log.header.policies[i].name for i in rally.policy[0]]
    assert main(["show", str(played), "--rally", "70"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"rally 70: {names[0]} v {names[1]}, match {rally.match[0]}, rally {rally.rally[0]}, ")
    assert len(lines) == len(rally.stroke) + 2
    assert "-serve to " in lines[1]
    assert lines[1].split()[1] == names[rally.server[0]]
    assert lines[-1].strip().startswith(f"{names[rally.winner[0]]} wins the rally")


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ([], "either --rally NUMBER or --match NUMBER"),
        (["--rally", "1", "--match", "1"], "either --rally NUMBER or --match NUMBER"),
        (["--rally", "99999999"], "no rally 99999999"),
        (["--match", "77"], "no match 77 of pairing 0"),
    ],
)
def test_show_what_is_not_there(played: Path, flags: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(played), *flags]) == 1
    assert says in capsys.readouterr().err
