"""Run a tournament in its folder: configuration, manifest, one line for each finished pairing, rally logs, and reports."""

import collections
import contextlib
import dataclasses
import datetime
import itertools
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import Cluster, open_cluster
from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import csv_bytes, write_parquet
from shuttle_marl.game.rally.record import columns_of
from shuttle_marl.game.scoring import RULES
from shuttle_marl.game.shipped import least_support, refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.league.assessment import as_json, assess
from shuttle_marl.league.curves import Curve, read_curve
from shuttle_marl.league.entrants import PAIRINGS, REPORT, Entrant, LeagueConfig, LeagueError, default_pool, enter
from shuttle_marl.league.page.tournament import page
from shuttle_marl.league.ranking import ExactOdds, Standing, exact_odds, rank, ranking_table, results_table
from shuttle_marl.league.report import TournamentReport
from shuttle_marl.league.style import styles
from shuttle_marl.league.tournament import MatchOptions, Pairing, PairResult, Tournament, stages
from shuttle_marl.policy.foreign import source_hashes, time_limit
from shuttle_marl.recording import LogHeader, Pair, Player, RallyRecorder, Sampling
from shuttle_marl.recording.recover import rallies_of_pairings
from shuttle_marl.recording.recover import resume as resume_log

if TYPE_CHECKING:
    from shuttle_marl.exact.occupancy import Holes

PACKAGES: Final = ("numpy", "scipy", "numba", "pyarrow", "mcap", "zstandard", "matplotlib", "jinja2")
"""Packages whose versions can affect the files of a run."""
_HOLES: Final = 1e-6
"""Error bound of the losses in the report."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueRun:
    """A finished tournament."""

    folder: Path
    standings: list[Standing]
    results: list[PairResult]


def run_league(config: LeagueConfig, console: Console | None = None) -> LeagueRun:
    """Play a tournament, or the rest of one, and write its run folder.

    Args:
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
        extends, config = config.extend, continued(config)
        # A policy may change the working directory, here and while it plays.
        with contextlib.chdir(Path.cwd()), console.status("tabulating the entrants"), time_limit(config.policy_timeout):
            entrants = [enter(name, game, requested=name in requested) for name in config.pool]
        for entrant in entrants:
            if entrant.failure:
                _say_forfeit(console, entrant.failure)
        with contextlib.nullcontext() if config.ray is None else open_cluster(config.ray, PACKAGES) as cluster:
            same = _same(config, game, entrants)
            if extends:
                add_entrants(config, same)
            name, called, fixed = f"league-{config.seed}", f"of seed {config.seed}", config.fixed()
            opened = runs.open_run(config.out, name, fixed, resume=config.resume, overwrite=config.overwrite, called=called)
            with opened as run:
                return _Run(config, game, entrants, console, cluster, run).go(same)
    except runs.RunError as error:
        raise LeagueError(str(error)) from error


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Entrants:
    """Entrants in the configuration of a run, see :class:`LeagueConfig`."""

    pool: tuple[str, ...] = ()
    grown: tuple[int, ...] = ()


def continued(config: LeagueConfig) -> LeagueConfig:
    """The configuration of a continued run, with the entrants that were added to it, now or before; nothing is written.

    Raises:
        LeagueError: there is no run to extend, or no entrant is new.
        RunError: it was started with other flags, or its files cannot be read.
    """
    folder = config.out
    if folder is None or not (config.resume or config.extend) or not (folder / runs.CONFIG).is_file():
        if config.extend:
            raise LeagueError(f"{folder}: contains no run to extend")
        return config
    earlier = runs.read_json(folder / runs.CONFIG, _Entrants)
    pool, grown = earlier.pool, earlier.grown
    if sorted(grown) != list(grown) or not all(2 <= number <= len(pool) for number in grown):
        raise LeagueError(f"{folder / runs.CONFIG}: grown {list(grown)}: expected ascending numbers of entrants")
    if not config.extend:
        return dataclasses.replace(config, pool=pool, grown=grown) if grown and set(config.pool) <= set(pool) else config
    added = tuple(name for name in config.pool if name not in pool)
    if not added:
        raise LeagueError(f"{folder}: all entrants of --pool are already in this run; --resume continues it")
    found = dataclasses.replace(config, pool=(*pool, *added), grown=(*grown, len(pool)), resume=True, extend=False)
    runs.check_flags(folder, {name: value for name, value in found.fixed().items() if name not in ("pool", "grown")})
    return found


def add_entrants(config: LeagueConfig, same: Mapping[str, Any]) -> None:
    """Write the configuration of :func:`continued` to a run to which entrants are added, once all of them are known to exist.

    Args:
        same: game and policies, which were those of the run before.

    Raises:
        RunError: they were not, another process uses the folder, or its files cannot be read.
    """
    assert config.out is not None
    with runs.locked(config.out):
        runs.check_same(config.out, same)
        # If the process is killed between the two writes, the old run only has to be finished again.
        path = config.out / runs.MANIFEST
        before = runs.read_json(path, dict[str, Any]) if path.exists() else {}
        runs.write_json(path, {**before, "status": "running"})
        runs.write_json(config.out / runs.CONFIG, config.fixed())


def _same(config: LeagueConfig, game: Game, entrants: Sequence[Entrant]) -> dict[str, Any]:
    """What stays the same in a run: the game and the policies; what has no table is known by its files alone."""
    return {
        "game": {"model": config.game, "hash": game.hash, "catalogue": game.catalogue.version},
        "policies": {entrant.name: entrant.hash for entrant in entrants},
        "sources": {entrant.name: source_hashes(entrant.name) for entrant in entrants if not entrant.hash},
    }


class _Run:
    """A tournament that is being run in its folder; ``results`` are of all pairings that were played."""

    def __init__(
        self,
        config: LeagueConfig,
        game: Game,
        entrants: Sequence[Entrant],
        console: Console,
        cluster: Cluster | None,
        run: runs.Run,
    ) -> None:
        self.config, self.game, self.entrants = config, game, entrants
        self.console, self.cluster, self.run = console, cluster, run
        self.folder = run.folder.absolute()  # a policy may change the working directory
        self.journal = runs.Journal(self.folder / PAIRINGS)
        self.results: list[PairResult] = []
        self.strokes = 0

    def go(self, same: Mapping[str, Any]) -> LeagueRun:
        config, run, finished = self.config, self.run, self.run.finished
        runs.check_same(self.folder, same)
        self.results = self.read_results(finished=finished)
        if finished:
            _say(self.console, f"{self.folder}: already finished")
            standings = rank(config.pool, self.results, config.seed, self.exact())
            return LeagueRun(folder=run.folder, standings=standings, results=self.results)
        begun = time.monotonic()
        run.begin(PACKAGES, same=same, seed=config.seed)
        stage = 0
        while stage < len(known := self.stages(self.results)):
            stage += 1
            self.play(known[:stage])
        seconds = time.monotonic() - begun
        standings = self.write_reports(known, self.exact())
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        run.finish(finished=now, strokes_played=self.strokes, seconds=seconds)
        if self.strokes:
            speed = float(f"{self.strokes / seconds:.2g}")
            _say(self.console, f"{self.strokes:,} strokes in {seconds:.1f} s, {speed:,.0f} a second")
        return LeagueRun(folder=run.folder, standings=standings, results=self.results)

    def read_results(self, *, finished: bool) -> list[PairResult]:
        """The finished pairings; an incomplete last line of an unfinished run is removed.

        Raises:
            RunError: a line is damaged.
            LeagueError: pairings are missing.
        """
        path = self.folder / PAIRINGS
        try:
            results = [msgspec.convert(fields, PairResult) for fields in self.journal.read(finished=finished)]
        except msgspec.ValidationError as error:
            raise LeagueError(f"{path}: is damaged ({error}); play the tournament again with --overwrite") from error
        expected = [(pairing.number, pairing.names) for pairing in itertools.chain(*self.stages(results))]
        found = [(result.pairing, result.names) for result in results]
        if found != expected[: len(found)] or (finished and found != expected):
            raise LeagueError(
                f"{path}: pairings are missing, out of order, or of another run; restore it from a backup, or play the "
                "tournament again with --overwrite"
            )
        if not finished:
            self.journal.keep(len(results))
        return results

    def stages(self, results: Sequence[PairResult]) -> list[list[Pairing]]:
        config = self.config
        return stages(config.pool, config.format, results, rounds=config.rounds, grown=config.grown)

    def play(self, known: Sequence[Sequence[Pairing]]) -> None:
        """Play the rest of the last stage in ``known``."""
        config, results, pairings = self.config, self.results, known[-1]
        done = min(len(results) - pairings[0].number, len(pairings))
        recorder = self.recorder(known)
        options = MatchOptions(
            matches=config.matches,
            seed=config.seed,
            batch=config.batch,
            keep_strokes=recorder is not None,
            rules=RULES[config.rules],
            sample=None if recorder is None else recorder.sample,
            decide=config.decide,
        )
        tournament = Tournament(self.game, self.entrants, options, workers=config.workers, cluster=self.cluster)
        # The log is on the disk before the results are, so no result lacks its rallies; play continues meanwhile.
        unsaved: collections.deque[tuple[Future[int] | None, list[PairResult]]] = collections.deque()
        with recorder or contextlib.nullcontext(), self.progress(len(pairings), done) as advance:

            def keep(*, wait: bool) -> None:
                while unsaved and (wait or unsaved[0][0] is None or unsaved[0][0].done()):
                    saved, new = unsaved.popleft()
                    if saved is not None:
                        saved.result()
                    self.journal.append([dataclasses.asdict(result) for result in new])
                    results.extend(new)
                    advance(0, len(new))
                    for result in new:
                        if result.forfeit and not any(e.failure for e in self.entrants if e.name in result.forfeit):
                            _say_forfeit(self.console, f"{' v '.join(result.names)}: {result.reason}")

            for blocks in tournament.play(pairings[done:], lambda more: advance(more, 0)):
                saved = None
                if recorder is not None:
                    for _, rallies in blocks:
                        for part in rallies:
                            recorder.add(part)
                        # Batches end where pairings do, so a resumed run writes the same bytes.
                        recorder.request_flush(sync=False)
                    saved = recorder.request_flush()
                unsaved.append((saved, [result for result, _ in blocks]))
                keep(wait=False)
            keep(wait=True)

    @contextlib.contextmanager
    def progress(self, total: int, done: int) -> Iterator[Callable[[int, int], None]]:
        """Progress bar over pairings, with the speed in strokes a second; threads advance it by strokes and pairings."""
        columns = (
            TextColumn("pairings"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[speed]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=self.console, transient=True) as bar:
            task, counting = bar.add_task("", total=total, completed=done, speed=""), threading.Lock()
            begun, before = time.monotonic(), self.strokes

            def advance(strokes: int, pairings: int) -> None:
                with counting:
                    self.strokes += strokes
                    speed = (self.strokes - before) / 1e6 / max(1e-9, time.monotonic() - begun)
                bar.update(task, advance=pairings, speed=f"{speed:.1f} M strokes/s")

            yield advance

    def recorder(self, known: Sequence[Sequence[Pairing]]) -> RallyRecorder | None:
        """The recorder of the last stage in ``known``; None if nothing remains to be recorded."""
        config, results, stage = self.config, self.results, len(known) - 1
        path = self.folder / log_name(stage)
        first, end = known[-1][0].number, known[-1][-1].number + 1
        every = Sampling.parse(config.record).every
        if not every or (path.exists() and len(results) >= end):
            return None
        # The header of a log does not name entrants that were added after it was started.
        present = self.entrants[: (*config.grown, len(self.entrants))[min(stage, len(config.grown))]]
        header = LogHeader(
            seed=config.seed,
            game=self.game.hash,
            strokes=self.game.catalogue.names,
            policies=tuple(Player(name=entrant.name, hash=entrant.hash) for entrant in present),
            pairings=tuple(pairing.key for pairings in known for pairing in pairings),
            rules=RULES[config.rules],
            record=config.record,
            columns=columns_of(self.game),
            pair=Pair.of(self.game),
        )
        if every == 1:
            recorded = sum(counts["rallies"] for result in results[first:end] for counts in result.seats)
        else:
            recorded = rallies_of_pairings(path, min(len(results), end))
        return RallyRecorder(resume_log(path, header, recorded))

    def exact(self) -> ExactOdds:
        config, game = self.config, self.game
        if not config.exact:
            return exact_odds(game, [dataclasses.replace(entrant, table=None) for entrant in self.entrants])
        refits: Sequence[Game] = ()
        if config.away:
            refits = game.people.refits() if game.people is not None else refits_of(game)
        if config.away and len(refits) < 2:
            refits = ()
            _say(self.console, "the model has fewer than two refits, so there are no results in refits (--away)")
        with self.console.status("solving all pairs"):
            exact = exact_odds(game, self.entrants, refits, RULES[config.rules])
        if exact.problem:
            _say(self.console, f"no exact results: {exact.problem}")
        return exact

    def write_reports(self, known: Sequence[Sequence[Pairing]], exact: ExactOdds) -> list[Standing]:
        config, game, folder, results = self.config, self.game, self.folder, self.results
        standings = rank(config.pool, results, config.seed, exact)
        tables = {entrant.name: entrant.table for entrant in self.entrants if entrant.table is not None}
        assessment = assess(standings, results, exact, styles(game.seats[0], tables) if config.exact else {})
        table = results_table(results, exact)
        replace_file(folder / "results.csv", csv_bytes(table))
        write_parquet(folder / "results.parquet", table)
        replace_file(folder / "ranking.csv", csv_bytes(ranking_table(standings)))
        runs.write_json(folder / REPORT, as_json(assessment, standings))
        shown = TournamentReport(
            config=config,
            game=game.hash,
            standings=standings,
            results=results,
            assessment=assessment,
            curves=_curves(config.pool),
            logs={pairings[0].number: log_name(stage) for stage, pairings in enumerate(known)},
            holes=_holes(game, {s.player: tables[s.player] for s in standings if s.player in tables}, config.holes),
        )
        replace_file(folder / runs.PAGE, page(shown))
        return standings


def log_name(stage: int) -> str:
    """File name of the rally log of a stage, counted from 0."""
    return f"rallies-{stage + 1}.mcap" if stage else runs.RALLIES


def _holes(game: Game, tables: Mapping[str, TabulatedPolicy], best: int) -> "dict[str, Holes]":
    """States in which the best policies lose most to their best responses."""
    if not best or game.people is not None:
        return {}
    from shuttle_marl.exact import ExactError, solve  # noqa: PLC0415  numba
    from shuttle_marl.exact.occupancy import holes  # noqa: PLC0415  numba
    from shuttle_marl.exact.optimal import limited  # noqa: PLC0415  numba

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
        if key == "agent" and agent and (folder / runs.METRICS).is_file():
            with contextlib.suppress(LeagueError):  # the tournament does not depend on it
                curves.append(read_curve(folder, name))
    return curves


def _say(console: Console, text: str, label: str = "") -> None:
    """Print untrusted text, which is never interpreted as markup."""
    console.print(Text.assemble((label, "bold red"), printable(text)), highlight=False, soft_wrap=True)


def _say_forfeit(console: Console, reason: str) -> None:
    _say(console, reason, "forfeit: ")
