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
from shuttle_marl.policy.foreign import time_limit
from shuttle_marl.policy.sources import source_hashes
from shuttle_marl.recording import LogHeader, Pair, Player, RallyRecorder, Sampling
from shuttle_marl.recording.recover import rallies_of_pairings
from shuttle_marl.recording.recover import resume as resume_log

if TYPE_CHECKING:
    from shuttle_marl.exact.regret import Holes

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
            if extends:
                add_entrants(config, manifest(config, game, entrants))
            with open_run(config) as folder:
                return _Run(config, game, entrants, console, cluster, folder.absolute()).go(folder)
    except runs.RunError as error:
        raise LeagueError(str(error)) from error


def open_run(config: LeagueConfig) -> contextlib.AbstractContextManager[Path]:
    """Create or resume the run folder, and lock it, see :func:`shuttle_marl.base.runs.open_run`."""
    name, called, fixed = f"league-{config.seed}", f"of seed {config.seed}", config.fixed()
    return runs.open_run(config.out, name, fixed, resume=config.resume, overwrite=config.overwrite, called=called)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Entrants:
    """Entrants in the configuration of a run, see :class:`LeagueConfig`."""

    pool: tuple[str, ...] = ()
    grown: tuple[int, ...] = ()


def continued(config: LeagueConfig) -> LeagueConfig:
    """The configuration of a continued run, with the entrants that were added to it, now or before; nothing is written.

    Raises:
        LeagueError: there is no run to extend, or it was started with other flags, or no entrant is new.
        RunError: its files cannot be read.
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
    before = runs.read_json(folder / runs.CONFIG, dict[str, Any])
    wanted = {**found.fixed(), "pool": before.get("pool"), "grown": before.get("grown")}
    different = [f"{key}: {before.get(key)!r} then, {value!r} now" for key, value in wanted.items() if before.get(key) != value]
    if different:
        raise LeagueError(f"{folder}: was started with other flags ({'; '.join(different)}); give the same ones to add entrants")
    return found


def add_entrants(config: LeagueConfig, about: dict[str, Any]) -> None:
    """Write the configuration of :func:`continued` to a run to which entrants are added, once all of them are known to exist.

    Args:
        about: its :func:`manifest`.

    Raises:
        LeagueError: the run was started with another game or other policies.
        RunError: another process uses the folder, or its files cannot be read.
    """
    assert config.out is not None
    with runs.locked(config.out):
        check_same(config.out, about)
        # If the process is killed between the two writes, the old run only has to be finished again.
        path = config.out / runs.MANIFEST
        before = runs.read_json(path, dict[str, Any]) if path.exists() else {}
        runs.write_json(path, {**before, "status": "running"})
        runs.write_json(config.out / runs.CONFIG, config.fixed())


def manifest(config: LeagueConfig, game: Game, entrants: Sequence[Entrant]) -> dict[str, Any]:
    """Manifest of a run that starts now: everything that is needed to reproduce it."""
    return {
        "status": "running",
        "seed": config.seed,
        **runs.describe(PACKAGES),
        "game": {"model": config.game, "hash": game.hash, "catalogue": game.catalogue.version},
        "policies": {entrant.name: entrant.hash for entrant in entrants},
        # What has no table is known by its files alone.
        "sources": {entrant.name: source_hashes(entrant.name) for entrant in entrants if not entrant.hash},
    }


def check_same(folder: Path, about: dict[str, Any]) -> None:
    """Check that a run was started with the same game and policies.

    Raises:
        LeagueError: it was not.
        RunError: the manifest cannot be read.
    """
    path = folder / runs.MANIFEST
    if not path.exists():
        return
    before = runs.read_json(path, dict[str, Any])
    for what in ("game", "policies", "sources"):
        known = before.get(what, {})
        # Entrants may have been added since then.
        if not isinstance(known, dict) or {key: about[what].get(key) for key in known} != known:
            raise LeagueError(f"{folder}: the {what} changed after the run was started; start a new run with another --out")


def read_results(
    folder: Path, schedule: Callable[[Sequence[PairResult]], Sequence[Pairing]], *, finished: bool = False
) -> list[PairResult]:
    """Read the finished pairings of a run; an incomplete last line of an unfinished run is removed.

    Args:
        schedule: the pairings of the tournament that its first results determine.
        finished: whether the run is finished, so that all pairings are required.

    Raises:
        RunError: a line is damaged.
        LeagueError: pairings are missing.
    """
    journal = runs.Journal(folder / PAIRINGS)
    try:
        results = [msgspec.convert(fields, PairResult) for fields in journal.read(finished=finished)]
    except msgspec.ValidationError as error:
        raise LeagueError(f"{folder / PAIRINGS}: is damaged ({error}); play the tournament again with --overwrite") from error
    expected = [(pairing.number, pairing.names) for pairing in schedule(results)]
    found = [(result.pairing, result.names) for result in results]
    if found != expected[: len(found)] or (finished and found != expected):
        raise LeagueError(
            f"{folder / PAIRINGS}: pairings are missing, out of order, or of another run; restore it from a backup, or play the "
            "tournament again with --overwrite"
        )
    if not finished:
        journal.keep(len(results))
    return results


def append_results(folder: Path, results: list[PairResult]) -> None:
    """Append finished pairings, synchronised to the disk.

    Raises:
        RunError: the file cannot be written.
    """
    runs.Journal(folder / PAIRINGS).append([dataclasses.asdict(result) for result in results])


class _Run:
    """A tournament that is being run in its folder; ``results`` are of all pairings that were played."""

    def __init__(
        self,
        config: LeagueConfig,
        game: Game,
        entrants: Sequence[Entrant],
        console: Console,
        cluster: Cluster | None,
        folder: Path,
    ) -> None:
        self.config, self.game, self.entrants = config, game, entrants
        self.console, self.cluster, self.folder = console, cluster, folder
        self.results: list[PairResult] = []

    def go(self, opened: Path) -> LeagueRun:
        config, folder = self.config, self.folder
        about = manifest(config, self.game, self.entrants)
        check_same(folder, about)
        finished = runs.is_finished(folder)
        self.results = read_results(folder, lambda found: [*itertools.chain(*self.stages(found))], finished=finished)
        if finished:
            _say(self.console, f"{folder}: already finished")
            return LeagueRun(
                folder=opened, standings=rank(config.pool, self.results, config.seed, self.exact()), results=self.results
            )
        begun = time.monotonic()
        runs.write_json(folder / runs.MANIFEST, about)
        strokes, stage = 0, 0
        while stage < len(known := self.stages(self.results)):
            strokes += self.play(known[: stage + 1])
            stage += 1
        seconds = time.monotonic() - begun
        standings = self.write_reports(known, self.exact())
        done = {
            "status": "finished",
            "finished": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "strokes_played": strokes,
            "seconds": seconds,
        }
        runs.write_json(folder / runs.MANIFEST, {**about, **done})
        if strokes:
            _say(self.console, f"{strokes:,} strokes in {seconds:.1f} s, {float(f'{strokes / seconds:.2g}'):,.0f} a second")
        return LeagueRun(folder=opened, standings=standings, results=self.results)

    def stages(self, results: Sequence[PairResult]) -> list[list[Pairing]]:
        config = self.config
        return stages(config.pool, config.format, results, rounds=config.rounds, grown=config.grown)

    def play(self, known: Sequence[Sequence[Pairing]]) -> int:
        """Play the rest of the last stage in ``known``; returns the number of strokes."""
        config, results, pairings = self.config, self.results, known[-1]
        done = min(len(results) - pairings[0].number, len(pairings))
        recorder = self.recorder(known)
        with recorder or contextlib.nullcontext(), _progress(self.console, len(pairings), done) as advance:
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
            strokes, counting = 0, threading.Lock()

            def count(more: int) -> None:
                nonlocal strokes
                with counting:
                    strokes += more
                    advance(more, 0)

            def keep(new: list[PairResult]) -> None:
                append_results(self.folder, new)
                results.extend(new)
                advance(0, len(new))
                for result in new:
                    if result.forfeit and not any(e.failure for e in self.entrants if e.name in result.forfeit):
                        _say_forfeit(self.console, f"{' v '.join(result.names)}: {result.reason}")

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
        if key == "agent" and agent and (folder / runs.METRICS).is_file():
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
