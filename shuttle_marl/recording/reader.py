"""Read rally logs: a file, or all logs of a folder, as one log or as tables, also in files; check them."""

import contextlib
import dataclasses
import functools
import itertools
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final, Literal, Self

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from shuttle_marl.base.arrays import I64, Bools, Ints, UInts
from shuttle_marl.base.errors import counted, printable
from shuttle_marl.base.files import problem, replacing
from shuttle_marl.base.table_files import PARQUET, seal_parquet, without_formulas
from shuttle_marl.game import draws
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rally import PER_STROKE, Rallies
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.rules import OUTCOMES, REASONS, WINNER
from shuttle_marl.game.scoring import Rules, count_rally, is_over
from shuttle_marl.game.stroke import Catalogue, UnknownStrokeError
from shuttle_marl.game.tables import Game
from shuttle_marl.recording.header import LogHeader, OtherFileError, Player, RecordingError
from shuttle_marl.recording.log_file import SUFFIX, LogFile, arrow_schema, from_arrow, to_arrow

_MOST_POLICIES: Final = 1 << 16
_ENOUGH: Final = 20  # rallies that two files share if they hold the same ones
_WRITERS: Final[dict[str, Callable[[BinaryIO, pa.Schema], Any]]] = {
    ".parquet": lambda file, schema: pyarrow.parquet.ParquetWriter(file, schema, **PARQUET),
    ".csv": pyarrow.csv.CSVWriter,
    ".arrow": pa.ipc.new_file,
}


def is_log(path: Path) -> bool:
    """Whether a path is a rally log or a folder of them, by its name."""
    return path.suffix == SUFFIX or (path.is_dir() and any(path.glob(f"*{SUFFIX}")))


class RallyLog:
    """All rallies of a file or a folder; a context manager that closes the files.

    A folder includes every rally log directly in it, in the order of their names: rallies are numbered consecutively, and
    policies and pairings are merged. Of two logs that hold the same rallies the larger one is read, with a warning. Unfinished
    files (``.part``) are ignored. A batch that does not match its checksum or the index is a :class:`DamagedLogError` where it is
    read.

    Attributes:
        files: all files, in order.
        offsets: what is added to the numbers of the rallies of each file.
        policies: policies, by number.
        pairings: keys of the pairings, by number.
        catalogue: strokes, by number.
        size: size of all files [bytes].
        first_rally: ``[B]`` number of the first rally of each batch.
        rallies, strokes: ``[B]`` numbers of them in each batch; ``n_rallies``, ``n_strokes``: in all.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a log.

        Raises:
            RecordingError: a file cannot be read or is not a rally log of this version, or a folder holds none, or logs of
                different games.
            DamagedLogError: a file is truncated or damaged.
        """
        self.path = path = Path(path)
        with contextlib.ExitStack() as opened:
            try:
                files = _open_folder(path, opened) if path.is_dir() else [opened.enter_context(contextlib.closing(LogFile(path)))]
            except OSError as error:
                raise RecordingError(f"{path}: cannot be read ({problem(error)})") from error
            self.files, self.offsets = tuple(files), [*itertools.accumulate([0, *(file.end for file in files[:-1])])]
            self._merge()
            self.close = opened.pop_all().close

    @property
    def header(self) -> LogHeader:
        """Properties that all rallies share, with the policies and pairings of all files.

        Raises:
            RecordingError: the files come from several runs; see the headers of :attr:`files`.
        """
        first, *others = (dataclasses.replace(file.header, policies=(), pairings=()) for file in self.files)
        if any(header != first for header in others):
            raise RecordingError(f"{self.path}: logs of several runs, which share no header; read them one by one")
        return dataclasses.replace(first, policies=self.policies, pairings=self.pairings)

    def batches(self) -> Iterator[tuple[int, Rallies]]:
        """Number of the first rally, and the rallies, of each batch in order."""
        for i in range(len(self.first_rally)):
            yield self.batch(i)

    def batch(self, i: int) -> tuple[int, Rallies]:
        """Number of the first rally, and the rallies, of the i-th batch."""
        at = int(np.searchsorted(self._first_batch, i, side="right")) - 1
        first, rallies = self.files[at].batch(i - int(self._first_batch[at]))
        policy, pairing = self._policy[at][rallies.policy], self._pairing[at][rallies.pairing]
        return first + self.offsets[at], dataclasses.replace(rallies, policy=policy, pairing=pairing)

    def rally(self, number: int) -> Rallies:
        """One rally by its number, as a single row. Raises RecordingError: the log has no such rally."""
        i = int(np.searchsorted(self.first_rally, number, side="right")) - 1
        if i < 0 or number >= self.first_rally[i] + self.rallies[i]:
            last = self.first_rally[-1] + self.rallies[-1] - 1 if len(self.first_rally) else -1
            raise RecordingError(f"{self.path}: no rally {number}; they are numbered up to {last}")
        first, rallies = self.batch(i)
        return rallies.slice(number - first, number - first + 1)

    def file_of(self, number: int) -> int:
        """Index into :attr:`files` of the file with a rally."""
        i = int(np.searchsorted(self.first_rally, number, side="right")) - 1
        return int(np.searchsorted(self._first_batch, max(i, 0), side="right")) - 1

    def numbers_of_match(self, pairing: int, match: int, rally: int | None = None) -> I64:
        """Numbers of the rallies of one match, in order; of several logs in that of ``rally``; empty if there are none.

        Raises:
            RecordingError: several logs have such a match, and no rally is named.
        """
        found: dict[int, list[I64]] = {}
        if 0 <= pairing < len(self.pairings) and 0 <= match < 1 << 32:
            for i in self.batches_of_pairing(pairing, match, match).tolist():
                first, rallies = self.batch(i)
                if len(rows := np.flatnonzero((rallies.pairing == pairing) & (rallies.match == match))):
                    found.setdefault(self.file_of(first), []).append(first + rows)
        if rally is not None:
            found = {file: parts for file, parts in found.items() if file == self.file_of(rally)}
        if len(found) > 1:
            files = ", ".join(self.files[file].path.name for file in found)
            raise RecordingError(f"{self.path}: {files} have a match {match} of pairing {pairing} each; name one of these files")
        return np.concatenate([np.empty(0, dtype=np.int64), *itertools.chain(*found.values())])

    def points_of_games(self, rally: int) -> dict[int, tuple[int, int]]:
        """Points of both seats after the last recorded rally of every game of a rally's match, by the number of the game."""
        row, out = self.rally(rally), dict[int, tuple[int, int]]()
        for number in self.numbers_of_match(int(row.pairing[0]), int(row.match[0]), rally).tolist():
            row = self.rally(number)
            first, second, *games = row.score[0].tolist()
            out[sum(games)] = (first + int(row.winner[0] == 0), second + int(row.winner[0] == 1))
        return out

    def batches_of_pairing(self, pairing: int, low: int = 0, high: int = (1 << 32) - 1) -> I64:
        """Numbers of the batches that may hold rallies of a pairing, in matches from ``low`` to ``high``, ascending."""
        found = [np.empty(0, dtype=np.int64)]
        for at, file in enumerate(self.files):
            if self.pairings[pairing] in file.header.pairings:
                own = file.header.pairings.index(self.pairings[pairing]) << 32
                rows = np.flatnonzero((file.first_match <= np.uint64(own | high)) & (np.uint64(own | low) <= file.last_match))
                found.append(self._first_batch[at] + rows)
        return np.concatenate(found)

    def rally_table(self) -> pa.Table:
        """All rallies as one table, see :func:`rally_rows`."""
        return self._table(rally_rows)

    def stroke_table(self) -> pa.Table:
        """All strokes as one table, see :func:`stroke_rows`."""
        return self._table(stroke_rows)

    def _table(self, rows: "Callable[[RallyLog, int, Rallies], pa.Table]") -> pa.Table:
        batches = self.batches() if len(self.first_rally) else [(0, self.no_rallies())]
        return pa.concat_tables([rows(self, *batch) for batch in batches])

    def no_rallies(self) -> Rallies:
        """An empty batch with the columns of this log."""
        header = self.files[0].header
        return from_arrow(pa.RecordBatch.from_pylist([], schema=arrow_schema(len(header.strokes), header.columns)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _merge(self) -> None:
        first = self.files[0].header
        for file in self.files[1:]:
            for what in ("game", "strokes", "columns"):
                if getattr(file.header, what) != getattr(first, what):
                    raise RecordingError(f"{file.path}: other {what} than {self.files[0].path} has; read them one by one")
        try:
            self.catalogue = Catalogue.from_names(first.strokes)
        except UnknownStrokeError as error:
            raise RecordingError(f"{self.files[0].path}: strokes that this program does not know: {error}") from error
        self.policies: tuple[Player, ...] = tuple(dict.fromkeys(p for file in self.files for p in file.header.policies))
        if len(self.policies) > _MOST_POLICIES:
            raise RecordingError(
                f"{self.path}: {len(self.policies):,} policies, more than {_MOST_POLICIES:,}; read fewer logs at once"
            )
        self.pairings: tuple[int, ...] = tuple(dict.fromkeys(k for file in self.files for k in file.header.pairings))
        self.size = sum(file.size for file in self.files)
        self.first_rally = np.concatenate([file.first_rally + at for file, at in zip(self.files, self.offsets, strict=True)])
        self.rallies = np.concatenate([file.rallies for file in self.files])
        self.strokes = np.concatenate([file.strokes for file in self.files])
        self.n_rallies, self.n_strokes = int(self.rallies.sum()), int(self.strokes.sum())
        self._first_batch = np.cumsum([0, *(len(file.rallies) for file in self.files)])[:-1]
        self._policy = [_numbers(file.header.policies, self.policies, np.uint16) for file in self.files]
        self._pairing = [_numbers(file.header.pairings, self.pairings, np.uint32) for file in self.files]


def _numbers(own: Sequence[object], merged: Sequence[object], kind: type[np.unsignedinteger]) -> UInts:
    place = {entry: i for i, entry in enumerate(merged)}
    return np.array([place[entry] for entry in own], dtype=kind)


def _open_folder(folder: Path, opened: contextlib.ExitStack) -> list[LogFile]:
    logs: list[LogFile] = []
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        with contextlib.suppress(OtherFileError):  # such as a scene
            logs.append(opened.enter_context(contextlib.closing(LogFile(path))))
            for log in logs[:-1]:
                shared = _shared(log, logs[-1]), _shared(logs[-1], log)
                if any(each and all(each) for each in shared):
                    left, kept = sorted((logs[-1], log), key=lambda file: int(file.rallies.sum()))
                    warnings.warn(f"{left.path}: left out, because it holds the rallies of {kept.path.name}", stacklevel=3)
                    logs.remove(left)
                    break
                if any(map(any, shared)):
                    both = f"{log.path.name} and {path.name}"
                    raise RecordingError(f"{folder}: {both} share some of their rallies; read them one by one")
    if not logs:
        raise RecordingError(f"{folder}: holds no rally log; name a file or a folder that does, or recover FILE.part")
    return logs


def _shared(one: LogFile, other: LogFile) -> list[bool]:
    """For each pairing of a file, whether its first rallies there are in another one; empty if seed, game or form differ."""
    alike = ("seed", "game", "strokes", "rules", "draws", "columns")
    if any(getattr(one.header, name) != getattr(other.header, name) for name in alike):
        return []
    rows = functools.cache(_told_apart)
    keys = {key: number << 32 for number, key in enumerate(one.header.pairings)}
    found: list[bool] = []
    for number, key in enumerate(other.header.pairings):
        held = (other.first_match < np.uint64(number + 1 << 32)) & (np.uint64(number << 32) <= other.last_match)
        first = [row for row in (rows(other, int(held.argmax())) if held.any() else ()) if row[0] == key][:_ENOUGH]
        places = np.array([keys[key] | match for _, match, *_ in first if key in keys], np.uint64)[:, None]
        batches = np.flatnonzero(((one.first_match <= places) & (places <= one.last_match)).any(axis=0)).tolist()
        found += [{*first} <= set().union(*(rows(one, i) for i in batches))] * bool(first)
    return found


def _told_apart(file: LogFile, i: int) -> list[tuple[Any, ...]]:
    """What tells each rally of a batch from others: pairing, match, number, policies, and strokes."""
    rallies, header = file.batch(i)[1], file.header
    strokes = np.split(rallies.stroke, rallies.first_stroke[1:-1])
    numbers = (getattr(rallies, name).tolist() for name in ("pairing", "match", "rally", "policy"))
    return [
        (header.pairings[pairing], match, rally, *(header.policies[each] for each in policies), played.tobytes())
        for pairing, match, rally, policies, played in zip(*numbers, strokes, strict=True)
    ]


def rally_rows(log: RallyLog, first: int, rallies: Rallies) -> pa.Table:
    """A batch as a table of rallies.

    Returns:
        Columns ``number`` (uint64, the rally's number in the log), ``file`` (dictionary) and ``seed`` (uint64) of the file
        it stands in, or its own, the columns of the log with the names of the policies (dictionary) in ``policy_0`` and
        ``policy_1``, ``reason`` in words (dictionary), and ``length`` (int32) before ``strokes``.
    """
    table = pa.Table.from_batches([to_arrow(rallies, len(log.catalogue))])
    names = [player.name for player in log.policies]
    words = {f"policy_{seat}": _words(rallies.policy[:, seat], names) for seat in (0, 1)}
    for name, column in {**words, "reason": _words(rallies.reason, REASONS)}.items():
        table = table.set_column(table.schema.get_field_index(name), name, column)
    table = table.add_column(table.schema.get_field_index("strokes"), "length", pa.array(rallies.length))
    file = np.full(len(rallies), log.file_of(first))
    seeds = np.array([file.header.seed % 2**64 for file in log.files], dtype=np.uint64)
    if rallies.seed is None:
        table = table.add_column(0, "seed", pa.array(seeds[file]))
    table = table.add_column(0, "file", _words(file, [file.path.name for file in log.files]))
    return table.add_column(0, "number", pa.array(np.arange(first, first + len(rallies), dtype=np.uint64)))


def stroke_rows(log: RallyLog, first: int, rallies: Rallies) -> pa.Table:
    """A batch as a table of strokes.

    Returns:
        Columns ``number`` (uint64, of the rally), ``position`` (int32, from 0), ``seat`` (uint8), and as dictionaries
        ``policy`` and ``stroke`` (its name), ``hurried`` (bool, the striker), and ``outcome``, a dictionary; then those that the
        log has of ``waited`` (the position of the receiver), ``log_probability`` and ``value``.
    """
    row, seat = rallies.row_of_stroke, rallies.striker
    further = {name: getattr(rallies, name) for name in rallies.optional_columns if name in PER_STROKE}
    if "waited" in further:
        further["waited"] = _words(rallies.places, POSITIONS)
    return pa.table(
        {
            "number": (first + row).astype(np.uint64),
            "position": rallies.position.astype(np.int32),
            "seat": seat.astype(np.uint8),
            "policy": _words(rallies.policy[row, seat], [player.name for player in log.policies]),
            "stroke": _words(rallies.stroke, log.catalogue.names),
            "hurried": rallies.hurried.astype(np.bool_),
            "outcome": _words(rallies.outcome(log.catalogue), OUTCOMES),
            **further,
        }
    )


def _words(numbers: Ints, words: Sequence[str]) -> pa.DictionaryArray:
    unique = list(dict.fromkeys(words))
    if len(unique) < len(words):  # policies of several runs that differ in more than their names
        numbers = np.array([unique.index(word) for word in words], dtype=np.int32)[numbers]
    return pa.DictionaryArray.from_arrays(pa.array(numbers.astype(np.int32)), pa.array(unique, pa.string()))


def require_game(log: RallyLog, game: Game) -> None:
    """Check that a log was played on a game."""
    played, pair = log.files[0].header.game, log.files[0].header.pair
    if played != game.hash:
        of = "" if pair is None else f" of {printable(' against '.join(pair.players))}"
        told = f"{log.path}: played on game {played[:12]}{of}, not on {game.hash[:12]}"
        raise RecordingError(f"{told}; name its model with --game (and --profile)")


def export(source: Path, target: Path, rows: Literal["rallies", "strokes"]) -> int:
    """Write a log as a table, complete or not at all.

    Args:
        target: replaced if it exists. Ends in ``.parquet`` (with checksums, see :mod:`shuttle_marl.base.table_files`), ``.csv``
            (lists as texts with spaces between their items; names that a spreadsheet would take for formulas begin with an
            apostrophe) or ``.arrow``.
        rows: one row a rally or a stroke, with the columns of :func:`rally_rows` or :func:`stroke_rows`.

    Returns:
        The number of rows.

    Raises:
        RecordingError: an unknown suffix, or a log that cannot be read.
        FileWriteError: the table cannot be written.
    """
    open_writer = _WRITERS.get(target.suffix)
    if open_writer is None:
        raise RecordingError(f"{target}: expected a name that ends in {', '.join(_WRITERS)}")
    count = 0
    with RallyLog(source) as log:

        def rows_of(first: int, rallies: Rallies) -> pa.Table:
            table = rally_rows(log, first, rallies) if rows == "rallies" else stroke_rows(log, first, rallies)
            return _flat(table, log) if target.suffix == ".csv" else table

        with replacing(target) as file:
            with open_writer(file, rows_of(0, log.no_rallies()).schema) as writer:
                for batch in log.batches():
                    table = rows_of(*batch)
                    writer.write_table(table)
                    count += table.num_rows
            if target.suffix == ".parquet":
                seal_parquet(file)
    return count


def _flat(table: pa.Table, log: RallyLog) -> pa.Table:
    """A table without lists, which become texts with spaces between their items, and without formulas."""
    table = without_formulas(table)
    for at, field in enumerate(table.schema):
        if pa.types.is_list(field.type):
            column, names = table.column(at).combine_chunks(), pa.array(log.catalogue.names)
            words = names.take(column.values) if field.name == "strokes" else column.values.cast(pa.string())
            table = table.set_column(at, field.name, pa.compute.binary_join(pa.ListArray.from_arrays(column.offsets, words), " "))
    return table


@dataclasses.dataclass(frozen=True, kw_only=True)
class Replay:
    """Result of :func:`replay`."""

    rallies: int
    strokes: int
    wrong: tuple[int, ...]  # numbers of the rallies with an illegal stroke, or another outcome, winner or choice than the replay


def replay(log: RallyLog, game: Game, policies: Mapping[str, TabulatedPolicy] | None = None) -> Replay:
    """Replay every rally of a log from its draws.

    If the draws are unknown, only the legality of the strokes and the winners are checked.

    Args:
        policies: tabulated policies by name, whose choices are compared too.

    Raises:
        RecordingError: the log was played on another game; or it is damaged.
    """
    require_game(log, game)
    rallies = strokes = 0
    wrong: list[int] = []
    for file, offset in zip(log.files, log.offsets, strict=True):
        names = [player.name for player in file.header.policies]
        chosen = {i: policies[name] for i, name in enumerate(names) if policies and name in policies}
        for i in range(len(file.rallies)):
            first, batch = file.batch(i)
            rallies, strokes = rallies + len(batch), strokes + len(batch.stroke)
            bad = _wrong_strokes(file.header, game, batch, chosen)
            wrong.extend((offset + first + np.unique(np.r_[batch.row_of_stroke[bad], _won_by_another(batch)])).tolist())
    return Replay(rallies=rallies, strokes=strokes, wrong=tuple(wrong))


def _won_by_another(rallies: Rallies) -> I64:
    """Indices of the rallies whose winner contradicts the last stroke: its striker wins by a winner and loses by a fault."""
    last = (rallies.server + rallies.length - 1) & 1
    return np.flatnonzero(rallies.finished & (rallies.winner != np.where(rallies.reason == WINNER, last, 1 - last)))


def breaks(rallies: Rallies, rules: Rules, catalogue: Catalogue) -> I64:
    """Indices of the rallies of a match, in order, that do not follow from the score of the one before or from their strokes.

    The first stroke and no other is a serve.
    """
    serves = catalogue.is_serve[rallies.stroke] != (rallies.position == 0)
    odd = np.flatnonzero(_Matches(rules).breaks(rallies)), _won_by_another(rallies), rallies.row_of_stroke[serves]
    return np.unique(np.concatenate(odd))


def _wrong_strokes(header: LogHeader, game: Game, rallies: Rallies, policies: Mapping[int, TabulatedPolicy]) -> Bools:
    """``[N]`` whether a stroke is illegal, or differs in its outcome or its policy's choice from the replay."""
    if header.draws == "unknown":
        return rallies.legal(game)[0] < 0
    from shuttle_marl.kernel import wrong_outcomes  # noqa: PLC0415  numba is slow to import

    key = header.rally_key(rallies)
    wrong = wrong_outcomes(rallies, game, key)
    if not policies:
        return wrong
    state, k = rallies.legal(game)
    row, striker = rallies.row_of_stroke, rallies.striker
    for i, table in policies.items():
        mine = np.flatnonzero((rallies.policy[row, striker] == i) & (state >= 0))
        u = draws.choice_draw(draws.draw(key[row[mine]], rallies.position[mine]))
        wrong[mine] |= table.choose(state[mine], u) != k[mine]
        theirs = np.flatnonzero((rallies.policy[row, 1 - striker] == i) & (state >= 0) & game.chooses(state))
        u = draws.position_draw(draws.draw(key[row[theirs]], rallies.position[theirs]))
        wrong[theirs] |= table.choose_position(state[theirs], u) != rallies.places[theirs]
    return wrong


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checked:
    """Result of :func:`check`."""

    rallies: int
    strokes: int
    replayed: bool
    problems: tuple[str, ...]  # descriptions of the problems; empty for a correct log


def check(path: Path, game: Game | None = None) -> Checked:
    """Check a log.

    Args:
        game: the game of the log, to replay every stroke; None: no replay.

    Raises:
        RecordingError: not a rally log, a damaged one, or one of another game.
    """
    with RallyLog(path) as log:
        problems: list[str] = []
        for file, offset in zip(log.files, log.offsets, strict=True):
            file.check_data()
            problems += _check_matches(file, offset)
        if game is not None:
            wrong = replay(log, game).wrong
            if wrong:
                found = counted(len(wrong), "rally does not follow", "rallies do not follow")
                problems.append(f"{found} from the seed and the rules, first: {wrong[0]}")
        return Checked(rallies=log.n_rallies, strokes=log.n_strokes, replayed=game is not None, problems=tuple(problems))


def _check_matches(file: LogFile, offset: int) -> list[str]:
    """Check that every rally follows from the previous rally of its match."""
    header, problems, number = file.header, list[str](), 0
    matches = _Matches(header.rules)
    begun = [np.empty(0, np.uint64)]
    for i in range(len(file.rallies)):
        first, rallies = file.batch(i)
        if first != number:
            missing = f"{offset + number} to {offset + first - 1}"
            problems.append(f"rallies {missing} are missing, before others of {file.path.name}")
            # Later ones may belong to matches whose start was not seen.
            matches.open_, matches.all_known = matches.open_[:0], False
        number = first + len(rallies)
        starts = rallies.rally == 0
        begun.append(rallies.pairing[starts].astype(np.uint64) << np.uint64(32) | rallies.match[starts])
        bad = np.flatnonzero(matches.breaks(rallies))
        if len(bad):
            problems.append(f"rally {offset + first + int(bad[0])} does not follow from the rally before it")
    again, times = np.unique(np.concatenate(begun), return_counts=True)
    if (times > 1).any() and "seed" not in header.columns:
        pairing, match = divmod(int(again[times.argmax()]), 1 << 32)
        problems.append(f"match {match} of pairing {pairing} begins {times.max()} times")
    if matches.in_order and len(matches.open_) > 1 and "seed" not in header.columns:
        pairing, match = matches.open_[0, :2]
        problems.append(f"match {match} of pairing {pairing} breaks off")
    return problems


class _Matches:
    """Scores of the matches of a log; matches may be interleaved."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.all_known = True
        self._last = np.full(2, -1, dtype=np.int64)
        self.open_ = np.empty((0, 11), dtype=np.int64)  # last rally so far of every unfinished match, see `_rows`
        self.in_order = True  # whether each match ended before the next one started

    def breaks(self, rallies: Rallies) -> Bools:
        """``[R]`` whether a rally contradicts the rallies before it."""
        new = _rows(rallies)
        rows = np.concatenate([self.open_, new])
        order = np.lexsort((rows[:, 1], rows[:, 0]))  # stable, so the rallies of a match stay in their order
        rows, is_new = rows[order], (order >= len(self.open_))
        over, after, server = self._after(rows)
        same = (rows[1:, :2] == rows[:-1, :2]).all(axis=1)
        continues = (rows[1:, 2] == rows[:-1, 2] + 1) & (rows[1:, 3] == server[:-1]) & (rows[1:, 5:9] == after[:-1]).all(axis=1)
        continues &= (rows[1:, 9:] == rows[:-1, 9:]).all(axis=1)
        starts = (rows[:, 2] == 0) & (rows[:, 5:9] == 0).all(axis=1)
        good = starts | (not self.all_known)
        good[1:] = np.where(same, continues & ~over[:-1], good[1:])
        in_order = np.r_[[self._last], new[:, :2]]
        step = np.diff(in_order, axis=0)
        self.in_order &= bool(((step[:, 0] > 0) | ((step[:, 0] == 0) & (step[:, 1] >= 0))).all())
        self._last = in_order[-1]
        self.open_ = rows[np.r_[~same, True] & ~over]
        breaks = np.zeros(len(order), dtype=np.bool_)
        breaks[order] = ~good & is_new
        return breaks[len(breaks) - len(new) :]

    def _after(self, rows: I64) -> tuple[Bools, I64, I64]:
        """After each rally: whether the match is over, the score, and the next server."""
        row, winner = np.arange(len(rows)), rows[:, 4]
        after = rows[:, 5:9].copy()
        counted = count_rally(after[row, winner], after[row, winner ^ 1], after[row, 2 + winner], self._rules)
        after[row, winner], after[row, 2 + winner] = counted.points, counted.games
        after[counted.game_won, :2] = 0
        return is_over(after[:, 2:], self._rules) | (winner < 0), after, winner


def _rows(rallies: Rallies) -> I64:
    """``[R, 11]`` pairing, match, rally, server, winner (-1: the match was cut off), score before the rally, policies."""
    winner = np.where(rallies.finished, rallies.winner.astype(np.int64), -1)
    columns = (rallies.pairing, rallies.match, rallies.rally, rallies.server, winner)
    return np.concatenate([np.stack(columns, axis=1), rallies.score, rallies.policy], axis=1, dtype=np.int64)
