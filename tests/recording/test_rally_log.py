"""Everything written can be read again: by number, by batch, as tables, and by other readers of MCAP."""

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from shuttle_marl.game import default_game
from shuttle_marl.game.stroke import HEIGHTS
from shuttle_marl.kernel import play_rallies
from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter, RecordingError
from shuttle_marl.recording.header import Player
from shuttle_marl.recording.log_file import arrow_schema, from_arrow, to_arrow, unfinished
from shuttle_marl.recording.logs import log_of, play_log
from shuttle_marl.recording.reader import export, is_log
from tests.exact.exact_games import THREE_STROKES, hand_made, random_policy
from tests.recording.conftest import same


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 40), max_size=6), st.integers(1, 50), st.integers(1, 2000), st.integers(0, 99))
def test_what_was_appended_is_read(tmp_path_factory, rallies, header, sizes, batch, n_strokes, seed) -> None:
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    names = default_game().catalogue.names
    strokes = tuple(f"{i}" for i in range(n_strokes)) if n_strokes > len(names) else names[:n_strokes]
    parts = [rallies(size, seed + i, n_strokes) for i, size in enumerate(sizes)]
    with RallyLogWriter(path, dataclasses.replace(header(), strokes=strokes), batch_rallies=batch) as log:
        for part in parts:
            log.append(part)
    assert not unfinished(path).exists()
    if n_strokes > len(names):
        with pytest.raises(RecordingError, match="strokes that this program does not know"):
            RallyLog(path)
        return
    with RallyLog(path) as log:
        read = list(log.batches())
        assert log.n_rallies == sum(sizes)
        assert log.n_strokes == sum(len(part.stroke) for part in parts)
        if read:
            assert same(Rallies.concatenate([batch for _, batch in read]), Rallies.concatenate(parts))
            assert all(len(rallies) == batch for _, rallies in read[:-1])
            assert [first for first, _ in read] == list(range(0, sum(sizes), batch))


def test_strokes_of_a_large_catalogue_take_two_bytes(rallies: Callable[..., Rallies]) -> None:
    for n, kind in ((256, pa.uint8()), (257, pa.uint16())):
        assert arrow_schema(n).field("strokes").type.value_type == kind
        part = rallies(50, n_strokes=n)
        assert same(from_arrow(to_arrow(part, n)), part)


def test_one_rally_by_number(log_file: Path, rallies: Callable[..., Rallies], header) -> None:
    whole = rallies(100)
    with RallyLog(log_file) as log:
        assert log.header == header()
        for number in (0, 15, 16, 57, 99):
            assert same(log.rally(number), whole.slice(number, number + 1))
        for number in (-1, 100, 10**9):
            with pytest.raises(RecordingError, match=f"no rally {number}; they are numbered up to 99"):
                log.rally(number)


def test_tables_hold_every_rally_and_stroke_by_name(log_file: Path, rallies: Callable[..., Rallies]) -> None:
    whole = rallies(100)
    with RallyLog(log_file) as log:
        table, strokes, names = log.rally_table(), log.stroke_table(), log.header.strokes
        catalogue = log.catalogue
    assert table["number"].to_pylist() == list(range(100))
    assert table["length"].to_pylist() == whole.length.tolist()
    assert set(table["policy_0"].to_pylist()) == {"attacking", "ünïcode | name"}
    assert set(table["reason"].to_pylist()) == {"fault", "winner"}
    assert strokes.num_rows == len(whole.stroke)
    assert strokes["stroke"].to_pylist() == [names[i] for i in whole.stroke]
    row, position, seat = whole.row_of_stroke, whole.position, whole.striker
    assert strokes["number"].to_pylist() == row.tolist()
    assert strokes["position"].to_pylist() == position.tolist()
    policy = [("attacking", "ünïcode | name")[whole.policy[r, s]] for r, s in zip(row, seat, strict=True)]
    assert strokes["policy"].to_pylist() == policy
    last = np.r_[position[1:] == 0, True]
    outcome = np.array(strokes["outcome"].to_pylist())
    assert outcome[last].tolist() == [("fault", "winner")[i] for i in whole.reason]
    following = [
        f"returned from {HEIGHTS[catalogue.height[stroke]]}{', hurried' if hurried else ''}"
        for stroke, hurried in zip(whole.stroke[1:][~last[:-1]], whole.hurried[1:][~last[:-1]], strict=True)
    ]
    assert outcome[~last].tolist() == following
    assert strokes["hurried"].to_pylist() == whole.hurried.astype(bool).tolist()
    assert whole.outcome(catalogue).dtype == np.int8


def test_an_empty_log(tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    RallyLogWriter(tmp_path / "a.mcap", header()).close()
    with RallyLog(tmp_path / "a.mcap") as log:
        assert (log.n_rallies, log.n_strokes, list(log.batches())) == (0, 0, [])
        assert log.rally_table().num_rows == log.stroke_table().num_rows == 0
        assert len(log.numbers_of_match(0, 0)) == 0
        with pytest.raises(RecordingError, match="no rally 0; they are numbered up to -1"):
            log.rally(0)


def test_the_official_reader_reads_it(log_file: Path, rallies: Callable[..., Rallies]) -> None:
    whole = rallies(100)
    with log_file.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert (summary.statistics.message_count, summary.statistics.chunk_count) == (7, 7)
        assert [a.name for a in reader.iter_attachments()] == ["rally_index"]
        assert [m.name for m in reader.iter_metadata()] == ["shuttle_marl.rally_log"]
        batches, sequences = [], []
        for schema, channel, message in reader.iter_messages(topics="/rallies"):
            assert (schema.name, schema.encoding, channel.message_encoding) == ("shuttle_marl.Rallies", "arrow", "arrow_stream")
            assert pa.ipc.read_schema(pa.BufferReader(schema.data)).equals(arrow_schema(len(default_game().catalogue)))
            with pa.ipc.open_stream(message.data) as stream:
                batches.append(stream.read_all())
                assert stream.schema.metadata[b"version"] == b"4"
            sequences.append((message.sequence, message.log_time))
        assert sequences == [(i, 16 * i * 1_000_000) for i in range(7)]
        assert pa.concat_tables(batches)["strokes"].combine_chunks().flatten().to_pylist() == whole.stroke.tolist()
        assert pa.concat_tables(batches)["hurried"].combine_chunks().flatten().to_pylist() == whole.hurried.astype(bool).tolist()


def test_the_same_rallies_give_the_same_bytes(tmp_path: Path, rallies: Callable[..., Rallies], header) -> None:
    whole, files = rallies(200), []
    for name, cuts in (("a", [0, 200]), ("b", [0, 1, 50, 51, 130, 200])):
        with RallyLogWriter(tmp_path / f"{name}.mcap", header(), batch_rallies=32) as log:
            for first, last in itertools.pairwise(cuts):
                log.append(whole.slice(first, last))
        files.append((tmp_path / f"{name}.mcap").read_bytes())
    assert files[0] == files[1]


def test_nothing_is_overwritten(log_file: Path, header: Callable[..., LogHeader]) -> None:
    with pytest.raises(RecordingError, match="there is a rally log already"):
        RallyLogWriter(log_file, header())
    log_file.rename(unfinished(log_file))
    with pytest.raises(RecordingError, match=r"unfinished log stands there; .*recover .*rallies.mcap.part"):
        RallyLogWriter(log_file, header())


def test_rallies_of_a_match_are_found_in_the_batches_that_may_hold_them(tmp_path: Path, rallies, header) -> None:
    """Pairings in two files with different numbers, and the least and greatest number of a match."""
    parts = []
    for seed, pairings in enumerate(((11, 12, 13), (13, 14, 12))):
        part = rallies(60, seed)
        match = np.arange(60, dtype=np.uint32) // 4
        match[-1] = 2**32 - 1
        parts.append(dataclasses.replace(part, match=match))
        with RallyLogWriter(tmp_path / f"{seed}.mcap", header(pairings=pairings), batch_rallies=16) as log:
            log.append(parts[-1])
    keys = np.concatenate([np.array(keys)[part.pairing] for keys, part in zip(((11, 12, 13), (13, 14, 12)), parts, strict=True)])
    match = np.concatenate([part.match for part in parts])
    with RallyLog(tmp_path) as log:
        assert log.pairings == (11, 12, 13, 14)
        for pairing, key in enumerate(log.pairings):
            holds = [
                i
                for i in range(8)
                if (keys[60 * (i // 4) + 16 * (i % 4) : 60 * (i // 4) + min(60, 16 * (i % 4) + 16)] == key).any()
            ]
            assert log.batches_of_pairing(pairing).tolist() == holds
            for number in (*range(16), 2**32 - 1):
                expected = np.flatnonzero((keys == key) & (match == number))
                assert log.numbers_of_match(pairing, number).tolist() == expected.tolist()
        for pairing, number in ((-1, 0), (4, 0), (0, -1), (0, 2**32)):
            assert log.numbers_of_match(pairing, number).tolist() == []
        assert [log.file_of(number) for number in (0, 59, 60, 119)] == [0, 0, 1, 1]
        with pytest.raises(RecordingError, match="no rally 120; they are numbered up to 119"):
            log.rally(120)


def test_points_of_games_are_those_after_their_last_rally(tmp_path: Path, rallies, header) -> None:
    score = np.array([[0, 0, 0, 0], [20, 3, 0, 0], [0, 0, 1, 0], [4, 20, 1, 0], [7, 9, 1, 1]], np.uint8)
    some = dataclasses.replace(rallies(5), pairing=np.ones(5, np.uint32), match=np.full(5, 6, np.uint32), score=score)
    some = dataclasses.replace(some, winner=np.array([1, 0, 1, 1, 0], np.uint8))
    with RallyLogWriter(tmp_path / "a.mcap", header()) as log:
        log.append(some)
    with RallyLog(tmp_path / "a.mcap") as log:
        assert log.points_of_games(3) == {0: (21, 3), 1: (4, 21), 2: (8, 9)}


def test_a_log_of_too_many_policies_is_refused(tmp_path: Path, rallies, header) -> None:
    with RallyLogWriter(tmp_path / "a.mcap", header(policies=tuple(Player(name=str(i)) for i in range(65_537)))) as log:
        log.append(rallies(5))
    with pytest.raises(RecordingError, match="65,537 policies, more than 65,536"):
        RallyLog(tmp_path / "a.mcap")


def test_names_of_logs(tmp_path: Path, log_file: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert [is_log(path) for path in (log_file, tmp_path, tmp_path / "empty", tmp_path / "a.txt")] == [True, True, False, False]
    assert is_log(tmp_path / "nothing.mcap")
    with pytest.raises(RecordingError, match=r"table.txt: expected a name that ends in .parquet, .csv, .arrow"):
        export(log_file, tmp_path / "table.txt", "rallies")
    assert not (tmp_path / "table.txt").exists()
    assert export(log_file, tmp_path / "table.csv", "rallies") == 100


SERVE, CLEARED, SMASHED, LIFTED = range(4)
HAND_MADE = hand_made((THREE_STROKES[0], "clear:back-left:above:forehand", *THREE_STROKES[1:]))


def test_a_log_for_learning_has_the_strokes_of_both_and_what_follows_those_of_seat_0() -> None:
    """Of a rally of three strokes that is won, one that the opponent wins, a fault of the opponent, and one of the learner."""
    strokes = [[SERVE, LIFTED, SMASHED], [SERVE, SMASHED], [SERVE], [SERVE, CLEARED]]
    rallies = Rallies(
        pairing=np.zeros(4, np.uint32),
        match=np.zeros(4, np.uint32),
        rally=np.zeros(4, np.uint16),
        policy=np.zeros((4, 2), np.uint16),
        server=np.array([0, 0, 1, 1], np.uint8),
        winner=np.array([0, 1, 0, 1], np.uint8),
        reason=np.array([1, 1, 0, 0], np.uint8),
        score=np.zeros((4, 4), np.uint8),
        length=np.array([len(rally) for rally in strokes], np.int32),
        stroke=np.concatenate(strokes).astype(np.uint8),
        hurried=np.array([0, 0, 1, 0, 0, 0, 0, 0], np.uint8),
    )
    policy = random_policy(HAND_MADE, 0)
    log, states = log_of(HAND_MADE, rallies, policy), rallies.states(HAND_MADE)
    assert len(log) == 8
    own = np.array([True, False, True, True, False, False, False, True])
    assert log.own.tolist() == own.tolist()
    assert log.state.tolist() == states.tolist()
    assert log.stroke.tolist() == rallies.stroke.tolist()
    assert HAND_MADE.pair_stroke[log.pair].tolist() == rallies.stroke.tolist()
    assert log.rally.tolist() == [0, 0, 0, 1, 1, 2, 3, 3]
    assert log.won.tolist() == [True, False, True, False]
    assert log.outcome.tolist() == rallies.outcome(HAND_MADE.catalogue).tolist()
    assert log.probability[own] == pytest.approx(policy.pair_probabilities()[log.pair[own]])
    assert np.isnan(log.probability[~own]).all()
    data = log.transitions
    assert len(data) == 4
    for name in ("state", "pair", "stroke", "probability"):
        assert getattr(data, name).tolist() == getattr(log, name)[own].tolist()
    assert data.reward.tolist() == [0, 1, 0, 0]
    assert data.following.tolist() == [states[2], -1, -1, -1]
    assert data.rally.tolist() == [0, 0, 1, 3]
    assert data.won.tolist() == [True, True, False, False]
    assert data.first.tolist() == [True, False, True, True]
    assert (data.n_rallies, data.idle_wins) == (4, 1)
    names = HAND_MADE.catalogue.names
    table = log.table()
    assert table["stroke"].to_pylist() == [names[stroke] for stroke in rallies.stroke]
    assert table["own_last"].to_pylist() == ["none", "none", names[SERVE], "none", "none", "none", "none", "none"]
    assert table["incoming"].to_pylist() == [
        *("none", names[SERVE], names[LIFTED], "none", names[SERVE], "none", "none", names[SERVE])
    ]
    assert table["contact"].to_pylist() == HAND_MADE.contact(states).tolist()
    assert table["hurried"].to_pylist() == [i == 2 for i in range(8)]
    assert table["won"].to_pylist() == [True] * 3 + [False] * 2 + [True] + [False] * 2
    changed = dataclasses.replace(rallies, winner=np.array([0, 0, 0, 1], np.uint8))
    assert len({log.hash, log_of(HAND_MADE, changed, policy).hash, log_of(HAND_MADE, rallies.slice(0, 3), policy).hash}) == 3
    assert log_of(HAND_MADE, rallies, random_policy(HAND_MADE, 1)).hash == log.hash


@pytest.mark.parametrize("strokes", [1, 150, 151])
def test_a_log_ends_with_the_rally_that_completes_its_strokes(strokes: int) -> None:
    players = random_policy(HAND_MADE, 0), random_policy(HAND_MADE, 1)
    log = play_log(players, strokes, seed=3)
    assert log.own.sum() >= strokes
    assert log.own[log.rally < log.rally[-1]].sum() < strokes
    played = play_rallies(HAND_MADE, players, 1000, seed=3).slice(0, int(log.rally[-1]) + 1)
    assert log.hash == log_of(HAND_MADE, played, players[0]).hash
