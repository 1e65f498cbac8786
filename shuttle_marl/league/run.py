"""Run a tournament and write its run folder."""

import collections
import contextlib
import dataclasses
import datetime
import functools
import itertools
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import Cluster, open_cluster
from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import csv_bytes, write_parquet
from shuttle_marl.game.scoring import RULES
from shuttle_marl.game.shipped import least_support, refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.league import folder as run_folder
from shuttle_marl.league.assessment import as_json, assess
from shuttle_marl.league.entrants import Entrant, LeagueConfig, LeagueError, default_pool, enter
from shuttle_marl.league.page.learning import METRICS, Curve, read_curve
from shuttle_marl.league.page.tournament import TournamentReport, page
from shuttle_marl.league.ranking import ExactOdds, Standing, exact_odds, rank, ranking_table, results_table
from shuttle_marl.league.report import report
from shuttle_marl.league.style import styles
from shuttle_marl.league.tournament import MatchOptions, Pairing, PairResult, Tournament, stages
from shuttle_marl.policy.foreign import time_limit
from shuttle_marl.recording import LogHeader, Pair, Player, RallyRecorder, Sampling
from shuttle_marl.recording.recover import rallies_of_pairings
from shuttle_marl.recording.recover import resume as resume_log

if TYPE_CHECKING:
    from shuttle_marl.exact.regret import Holes

_HOLES: Final = 1e-6
"""Error bound of the losses in the report."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueRun:
    """A finished tournament.

    Attributes:
        folder: the run folder.
        standings: the ranked table, best first.
        results: results of every pairing.
    """

    folder: Path
    standings: list[Standing]
    results: list[PairResult]


def run_league(config: LeagueConfig, console: Console | None = None) -> LeagueRun:
    """Play a tournament, or the rest of one, and write its run folder.

    Args:
        config: configuration of the tournament.
        console: console for progress; None: no output.

    Raises:
        PolicyError: an entrant does not exist; nothing was written.
        GameError: the model does not exist; nothing was written.
        LeagueError: the run folder cannot be used or written.
        RecordingError: the rally log cannot be written.
        ClusterError: the cluster cannot be used (nothing was written), or loses pairings repeatedly.
    """
    console = console or Console(quiet=True)
    game = config.load()
    try:
        config = dataclasses.replace(config, pool=config.pool or default_pool(game))
        requested = set(config.pool)
        config = run_folder.continued(config)
    except runs.RunError as error:
        raise LeagueError(str(error)) from error
    # A policy may change the working directory, here and while it plays.
    with (
        contextlib.chdir(Path.cwd()),
        console.status("tabulating the entrants"),
        time_limit(config.policy_timeout),
    ):
        entrants = [enter(name, game, requested=name in requested) for name in config.pool]
    for entrant in entrants:
        if entrant.failure:
            _say_forfeit(console, entrant.failure)
    with contextlib.ExitStack() as stack:
        packages = run_folder.PACKAGES
        cluster = None if config.ray is None else stack.enter_context(open_cluster(config.ray, packages))
        try:
            return _run(config, game, entrants, console, cluster)
        except runs.RunError as error:
            raise LeagueError(str(error)) from error


def _run(config: LeagueConfig, game: Game, entrants: Sequence[Entrant], console: Console, cluster: Cluster | None) -> LeagueRun:
    with run_folder.open_run(config) as opened:
        folder = opened.absolute()
        about = run_folder.manifest(config, game, entrants)
        run_folder.check_same(folder, about)
        schedule = functools.partial(stages, config.pool, config.format, rounds=config.rounds, grown=config.grown)
        finished = runs.is_finished(folder)
        results = run_folder.read_results(folder, lambda found: [*itertools.chain(*schedule(found))], finished=finished)
        if finished:
            _say(console, f"{folder}: already finished")
            standings = rank(config.pool, results, config.seed, _exact(config, game, entrants, console))
            return LeagueRun(folder=opened, standings=standings, results=results)
        begun = time.monotonic()
        runs.write_json(folder / runs.MANIFEST, about)
        strokes, stage = 0, 0
        while stage < len(known := schedule(results)):
            strokes += _play(config, game, entrants, known[: stage + 1], results, folder, console, cluster)
            stage += 1
        seconds = time.monotonic() - begun
        standings = _write_tables(config, game, entrants, known, results, folder, _exact(config, game, entrants, console))
        done = {
            "status": "finished",
            "finished": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "strokes_played": strokes,
            "seconds": round(seconds, 2),
        }
        runs.write_json(folder / runs.MANIFEST, {**about, **done})
        if strokes:
            _say(console, f"{strokes:,} strokes in {seconds:.1f} s, {float(f'{strokes / seconds:.2g}'):,.0f} a second")
    return LeagueRun(folder=opened, standings=standings, results=results)


def _play(
    config: LeagueConfig,
    game: Game,
    entrants: Sequence[Entrant],
    known: Sequence[Sequence[Pairing]],
    results: list[PairResult],
    folder: Path,
    console: Console,
    cluster: Cluster | None,
) -> int:
    """Play the rest of the last stage in ``known``, appending to ``results``; returns the number of strokes."""
    pairings = known[-1]
    done = min(len(results) - pairings[0].number, len(pairings))
    with contextlib.ExitStack() as stack:
        recorder = _open_recorder(config, game, entrants, known, results, folder)
        if recorder is not None:
            stack.enter_context(recorder)
        advance = stack.enter_context(_progress(console, len(pairings), done))
        options = MatchOptions(
            matches=config.matches,
            seed=config.seed,
            batch=config.batch,
            keep_strokes=recorder is not None,
            rules=RULES[config.rules],
            sample=None if recorder is None else recorder.sample,
            decide=config.decide,
        )
        tournament = Tournament(game, entrants, options, workers=config.workers, cluster=cluster)
        strokes = 0

        counting = threading.Lock()

        def count(more: int) -> None:
            nonlocal strokes
            with counting:
                strokes += more
                advance(more, 0)

        def keep(new: list[PairResult]) -> None:
            run_folder.append_results(folder, new)
            results.extend(new)
            advance(0, len(new))
            for result in new:
                if result.forfeit and not any(e.failure for e in entrants if e.name in result.forfeit):
                    _say_forfeit(console, f"{' v '.join(result.names)}: {result.reason}")

        # The log is on the disk before the results are, so no result lacks its rallies; play continues meanwhile.
        unsaved: collections.deque[tuple[Future[int], list[PairResult]]] = collections.deque()
        for blocks in tournament.play(pairings[done:], count):
            new = [result for result, _ in blocks]
            if recorder is None:
                keep(new)
                continue
            for _, rallies in blocks:
                for part in rallies:
                    recorder.add(part)
                # Batches end where pairings do, so a resumed run writes the same bytes.
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
    known: Sequence[Sequence[Pairing]],
    results: Sequence[PairResult],
    folder: Path,
) -> RallyRecorder | None:
    """The recorder of the last stage in ``known``; None if nothing remains to be recorded."""
    stage = len(known) - 1
    path = folder / run_folder.log_name(stage)
    first, end = known[-1][0].number, known[-1][-1].number + 1
    every = Sampling.parse(config.record).every
    if not every or (path.exists() and len(results) >= end):
        return None
    # The header of a log does not name entrants that were added after it was started.
    present = entrants[: (*config.grown, len(entrants))[min(stage, len(config.grown))]]
    header = LogHeader(
        seed=config.seed,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=tuple(Player(name=entrant.name, hash=entrant.hash) for entrant in present),
        pairings=tuple(pairing.key for pairings in known for pairing in pairings),
        rules=RULES[config.rules],
        record=config.record,
        pair=Pair.of(game),
    )
    if every == 1:
        recorded = sum(counts["rallies"] for result in results[first:end] for counts in result.seats)
    else:
        recorded = rallies_of_pairings(path, min(len(results), end))
    return RallyRecorder(resume_log(path, header, recorded))


def _exact(config: LeagueConfig, game: Game, entrants: Sequence[Entrant], console: Console) -> ExactOdds:
    if not config.exact:
        return exact_odds(game, [dataclasses.replace(entrant, table=None) for entrant in entrants])
    refits: Sequence[Game] = ()
    if config.away:
        refits = game.people.refits() if game.people is not None else refits_of(game)
    if config.away and len(refits) < 2:
        refits = ()
        _say(console, "the model has fewer than two refits, so there are no results in refits (--away)")
    with console.status("solving all pairs"):
        exact = exact_odds(game, entrants, refits, RULES[config.rules])
    if exact.problem:
        _say(console, f"no exact results: {exact.problem}")
    return exact


def _write_tables(
    config: LeagueConfig,
    game: Game,
    entrants: Sequence[Entrant],
    known: Sequence[Sequence[Pairing]],
    results: Sequence[PairResult],
    folder: Path,
    exact: ExactOdds,
) -> list[Standing]:
    standings = rank(config.pool, results, config.seed, exact)
    tables = {entrant.name: entrant.table for entrant in entrants if entrant.table is not None}
    assessment = assess(standings, config.pool, results, exact, styles(game.seats[0], tables) if config.exact else {})
    table = results_table(results, exact)
    replace_file(folder / "results.csv", csv_bytes(table))
    write_parquet(folder / "results.parquet", table)
    replace_file(folder / "ranking.csv", csv_bytes(ranking_table(standings)))
    runs.write_json(folder / run_folder.REPORT, as_json(assessment, standings))
    shown = TournamentReport(
        config=config,
        game=game.hash,
        standings=standings,
        results=results,
        assessment=assessment,
        curves=_curves(config.pool),
        logs={pairings[0].number: run_folder.log_name(stage) for stage, pairings in enumerate(known)},
        holes=_holes(game, {s.player: tables[s.player] for s in standings if s.player in tables}, config.holes),
    )
    replace_file(folder / run_folder.PAGE, page(shown))
    replace_file(folder / "report.md", report(config, standings, results, game.hash, exact, assessment).encode())
    return standings


def _holes(game: Game, tables: Mapping[str, TabulatedPolicy], best: int) -> "dict[str, Holes]":
    """States in which the best policies lose most to their best responses."""
    if not best or game.people is not None:
        return {}
    from shuttle_marl.exact import ExactError, solve  # noqa: PLC0415  numba
    from shuttle_marl.exact.optimal import limited  # noqa: PLC0415  numba
    from shuttle_marl.exact.regret import holes  # noqa: PLC0415  numba

    losses = {}
    with contextlib.suppress(ExactError):  # play may never end, which was reported with the exact results
        least = least_support(game)
        solution = solve(limited(game, least), tolerance=_HOLES)
        for name in list(tables)[:best]:
            losses[name] = holes(tables[name], at_least=least, solution=solution, tolerance=_HOLES)
    return losses


def _curves(pool: Sequence[str]) -> list[Curve]:
    """Evaluations of the entrants whose training runs still exist."""
    curves = []
    for name in pool:
        key, _, agent = name.partition(":")
        folder = Path(agent.rpartition("@")[0] or agent).parent
        if key == "agent" and agent and (folder / METRICS).is_file():
            with contextlib.suppress(LeagueError):  # the tournament does not depend on it
                curves.append(read_curve(folder, name))
    return curves


def _say(console: Console, text: str, label: str = "") -> None:
    """Print untrusted text, which is never interpreted as markup."""
    console.print(Text.assemble((label, "bold red"), printable(text)), highlight=False, soft_wrap=True)


def _say_forfeit(console: Console, reason: str) -> None:
    _say(console, reason, "forfeit: ")


@contextlib.contextmanager
def _progress(console: Console, total: int, done: int) -> Iterator[Callable[[int, int], None]]:
    """Progress bar over pairings, with the speed in strokes a second."""
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
