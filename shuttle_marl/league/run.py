"""A tournament from its flags to its run folder."""

import collections
import contextlib
import dataclasses
import datetime
import io
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from shuttle_marl import runs
from shuttle_marl.files import replace_file
from shuttle_marl.game.rally import Game
from shuttle_marl.game.shipped import load_game
from shuttle_marl.league import folder as run_folder
from shuttle_marl.league.config import LeagueConfig, LeagueError, default_pool
from shuttle_marl.league.entrants import Entrant, enter
from shuttle_marl.league.exact_odds import ExactOdds, exact_odds
from shuttle_marl.league.manifest import manifest
from shuttle_marl.league.ranking import Standing, rank, ranking_table
from shuttle_marl.league.report import report
from shuttle_marl.league.results import PairResult, results_table
from shuttle_marl.league.schedule import Pairing, round_robin
from shuttle_marl.league.tournament import Tournament
from shuttle_marl.policy.time_limit import time_limit
from shuttle_marl.recording import LogHeader, Player, RallyRecorder, Sampling
from shuttle_marl.recording.recover import rallies_of_pairings
from shuttle_marl.recording.recover import resume as resume_log


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueRun:
    """A finished tournament.

    Attributes:
        folder: the run folder.
        standings: the ranked table, best first.
        results: what every pairing came to.
    """

    folder: Path
    standings: list[Standing]
    results: list[PairResult]


def run_league(config: LeagueConfig, console: Console | None = None) -> LeagueRun:
    """Play a tournament, or the rest of one, and write its run folder.

    Args:
        config: what to play.
        console: shows progress; None shows nothing.

    Raises:
        PolicyError: an entrant cannot be found; nothing was written.
        GameError: the model cannot be found; nothing was written.
        LeagueError: the run folder cannot be used, or written any more.
        RecordingError: the rally log cannot be written any more.
    """
    console = console or Console(quiet=True)
    game = load_game(config.game)
    config = dataclasses.replace(config, pool=config.pool or default_pool())
    with console.status("evaluating the entrants on every state"), time_limit(config.policy_timeout):
        entrants = [enter(name, game) for name in config.pool]
    for entrant in entrants:
        if entrant.failure:
            console.print(f"[bold red]forfeit:[/] {entrant.failure}", highlight=False)
    try:
        return _run(config, game, entrants, console)
    except runs.RunError as error:
        raise LeagueError(str(error)) from error


def _run(config: LeagueConfig, game: Game, entrants: Sequence[Entrant], console: Console) -> LeagueRun:
    with run_folder.open_run(config) as folder:
        about = manifest(config, game, entrants)
        _check_same(folder, about)
        pairings = round_robin(config.pool)
        results = run_folder.read_results(folder)
        if runs.is_finished(folder):
            console.print(f"{folder}: finished already")
            standings = rank(config.pool, results, config.seed, _exact(game, entrants, console))
            return LeagueRun(folder=folder, standings=standings, results=results)
        begun = time.monotonic()
        runs.write_json(folder / runs.MANIFEST, about)
        strokes = _play(config, game, entrants, pairings, results, folder, console)
        seconds = time.monotonic() - begun
        standings = _write_tables(config, game, results, folder, _exact(game, entrants, console))
        done = {
            "status": "finished",
            "finished": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "strokes_played": strokes,
            "seconds": round(seconds, 2),
        }
        runs.write_json(folder / runs.MANIFEST, {**about, **done})
        if strokes:
            speed = f"{strokes / seconds / 1e6:.1f} million a second"
            console.print(f"{strokes:,} strokes in {seconds:.1f} s, {speed}", highlight=False)
    return LeagueRun(folder=folder, standings=standings, results=results)


def _check_same(folder: Path, about: dict[str, object]) -> None:
    """Refuse to go on with a run that was started with another game or other policies."""
    path = folder / runs.MANIFEST
    if not path.exists():
        return
    before = runs.read_json(path)
    for what in ("game", "policies"):
        if before.get(what) != about[what]:
            raise LeagueError(f"{folder}: the {what} changed since the run was started; start a new one with another --out")


def _play(
    config: LeagueConfig,
    game: Game,
    entrants: Sequence[Entrant],
    pairings: Sequence[Pairing],
    results: list[PairResult],
    folder: Path,
    console: Console,
) -> int:
    """Play what is left, adding to ``results``; returns the number of strokes."""
    with contextlib.ExitStack() as stack:
        recorder = _open_recorder(config, game, entrants, pairings, results, folder)
        if recorder is not None:
            stack.enter_context(recorder)
        advance = stack.enter_context(_progress(console, len(pairings), len(results)))
        tournament = Tournament(
            game, entrants, matches=config.matches, seed=config.seed, batch=config.batch, keep_strokes=recorder is not None
        )
        strokes = 0

        def count(more: int) -> None:
            nonlocal strokes
            strokes += more
            advance(more, 0)

        def keep(new: list[PairResult]) -> None:
            run_folder.append_results(folder, new)
            results.extend(new)
            advance(0, len(new))
            for result in new:
                if result.forfeit and not any(e.failure for e in entrants if e.name in result.forfeit):
                    console.print(f"[bold red]forfeit:[/] {' v '.join(result.names)}: {result.reason}", highlight=False)

        # The log is on the disk before the results are, so that no result is without its rallies; meanwhile play goes on.
        unsaved: collections.deque[tuple[Future[int], list[PairResult]]] = collections.deque()
        for blocks in tournament.play(pairings[len(results) :], count):
            new = [result for result, _ in blocks]
            if recorder is None:
                keep(new)
                continue
            for _, rallies in blocks:
                for part in rallies:
                    recorder.add(part)
                # Batches end where pairings do, so that a resumed run can go on with the same bytes.
                recorder.request_flush(sync=False)
            unsaved.append((recorder.request_flush(), new))
            while unsaved and unsaved[0][0].done():
                saved, new = unsaved.popleft()
                saved.result()
                keep(new)
        for saved, new in unsaved:
            saved.result()
            keep(new)
    return strokes


def _open_recorder(
    config: LeagueConfig,
    game: Game,
    entrants: Sequence[Entrant],
    pairings: Sequence[Pairing],
    results: Sequence[PairResult],
    folder: Path,
) -> RallyRecorder | None:
    path = folder / run_folder.RALLIES
    every = Sampling.parse(config.record).every
    if not every or (path.exists() and len(results) == len(pairings)):
        return None
    header = LogHeader(
        seed=config.seed,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=tuple(Player(name=entrant.name, hash=entrant.hash) for entrant in entrants),
        pairings=tuple(pairing.key for pairing in pairings),
        record=config.record,
    )
    if every == 1:
        recorded = sum(counts["rallies"] for result in results for counts in result.seats)
    else:
        recorded = rallies_of_pairings(path, len(results))
    return RallyRecorder(resume_log(path, header, recorded))


def _exact(game: Game, entrants: Sequence[Entrant], console: Console) -> ExactOdds:
    with console.status("solving every pair exactly"):
        exact = exact_odds(game, entrants)
    if exact.problem:
        console.print(f"no exact figures: {exact.problem}", highlight=False)
    return exact


def _write_tables(
    config: LeagueConfig, game: Game, results: Sequence[PairResult], folder: Path, exact: ExactOdds
) -> list[Standing]:
    standings = rank(config.pool, results, config.seed, exact)
    table = results_table(results, exact)
    replace_file(folder / "results.csv", _csv(table))
    with io.BytesIO() as buffer:
        pyarrow.parquet.write_table(table, buffer, compression="zstd")
        replace_file(folder / "results.parquet", buffer.getvalue())
    replace_file(folder / "ranking.csv", _csv(ranking_table(standings)))
    replace_file(folder / "report.md", report(config, standings, results, game.hash, exact).encode())
    return standings


def _csv(table: pa.Table) -> bytes:
    with io.BytesIO() as buffer:
        pyarrow.csv.write_csv(table, buffer)
        return buffer.getvalue()


@contextlib.contextmanager
def _progress(console: Console, total: int, done: int) -> Iterator[Callable[[int, int], None]]:
    """A bar over pairings, with the number of strokes a second."""
    columns = (
        TextColumn("pairings"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=total, completed=done, speed="")
        begun, strokes = time.monotonic(), 0

        def advance(more: int, finished: int) -> None:
            nonlocal strokes
            strokes += more
            speed = f"{strokes / 1e6 / max(1e-9, time.monotonic() - begun):.1f} M strokes/s"
            bar.update(task, advance=finished, speed=speed)

        yield advance
