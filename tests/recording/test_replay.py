"""Recorded rallies played again, logs in which something is wrong, and ``python -m shuttle_marl.recording``."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from shuttle_marl.commands.league import main as league
from shuttle_marl.commands.recording import main
from shuttle_marl.game import default_game
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.stroke import parse
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter, RecordingError, replay
from shuttle_marl.recording.replay import check
from tests.recording.conftest import read_rallies

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
    played = ["--pool", "bc", "minimax", "--matches", "2", "--game", "default:recovery", "--out", str(tmp_path / "run")]
    assert league(played) == 0
    path, game = tmp_path / "run" / "rallies.mcap", load_game("default:recovery")
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
    rows = range(3, len(rallies), len(rallies) // 8)
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
        assert problems[0] == f"rally {row} does not follow from the score of the rally before it"


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
    with (
        RallyLog(tmp_path / "other.mcap") as log,
        pytest.raises(RecordingError, match="played on game 000000000000, not on"),
    ):
        replay(log, GAME)


def test_arbitrary_rallies_are_wrong_but_never_an_error(log_file: Path) -> None:
    with RallyLog(log_file) as log:
        assert len(replay(log, GAME).wrong) > 90
    assert len(check(log_file, GAME).problems) >= 2


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
