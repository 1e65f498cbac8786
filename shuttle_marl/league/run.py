"""Run a tournament in its folder: configuration, manifest, one line for each finished pairing, rally logs, and reports."""

import collections
import contextlib
import dataclasses
import datetime
import itertools
import json
import time
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.text import Text

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import Cluster, open_cluster
from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import content_hash, replace_file
from shuttle_marl.base.table_files import csv_bytes, write_parquet
from shuttle_marl.game.rally import columns_of
from shuttle_marl.game.scoring import RULES
from shuttle_marl.game.tables import Game
from shuttle_marl.league.assessment import as_json, assess
from shuttle_marl.league.entrants import PAIRINGS, REPORT, Entrant, LeagueConfig, LeagueError, default_pool, enter
from shuttle_marl.league.page import page
from shuttle_marl.league.ranking import ExactOdds, Standing, exact_odds, rank, ranking_table, results_table, unknown
from shuttle_marl.league.tournament import Pairing, PairResult, Tournament, stages
from shuttle_marl.policy.foreign import source_hashes, time_limit
from shuttle_marl.recording import LogHeader, Pair, Player, RallyLog, RallyRecorder
from shuttle_marl.recording.recorder import resume as resume_log

PACKAGES: Final = ("numpy", "scipy", "numba", "pyarrow", "mcap", "zstandard", "matplotlib", "jinja2")


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
        RunError: the run folder cannot be used or written, or the game or a policy changed after the run was started.
        RecordingError: the rally log cannot be written.
        ClusterError: the cluster cannot be used (nothing was written), or loses pairings repeatedly.
        KeyboardInterrupt: Ctrl-C; the message says what is saved.
    """
    console = console or Console(quiet=True)
    game = config.load()
    config = dataclasses.replace(config, pool=config.pool or default_pool(game))
    # A policy may change the working directory, here and while it plays.
    _say(console, f"tabulating {len(config.pool)} policies")
    with contextlib.chdir(Path.cwd()), time_limit(config.policy_timeout):
        entrants = [enter(name, game) for name in config.pool]
    for entrant in entrants:
        if entrant.failure:
            _say_forfeit(console, entrant.failure)
    with contextlib.nullcontext() if config.ray is None else open_cluster(config.ray, PACKAGES) as cluster:
        name, fixed = f"league-{config.seed}", config.fixed()
        with runs.open_run(config.out, name, fixed, resume=config.resume, overwrite=config.overwrite) as run:
            playing = _Run(config, game, entrants, console, cluster, run)
            with run.resumable(lambda: f"{len(playing.results)} pairings are saved"):
                return playing.go()


@dataclasses.dataclass(eq=False)
class _Run:
    """A tournament that is being run in its folder; ``results`` are of all pairings that were played."""

    config: LeagueConfig
    game: Game
    entrants: Sequence[Entrant]
    console: Console
    cluster: Cluster | None
    run: runs.Run
    results: list[PairResult] = dataclasses.field(default_factory=list)
    strokes: int = 0

    def __post_init__(self) -> None:
        self.folder = self.run.folder.absolute()  # a policy may change the working directory
        self.journal = runs.Journal(self.folder / PAIRINGS)
        self.name = content_hash(json.dumps([self.config.fixed(), self.game.hash]).encode())[:16]  # in every line of the journal

    def go(self) -> LeagueRun:
        config, run, finished = self.config, self.run, self.run.finished
        # A policy without a table is known by its files alone.
        same = {
            "game": {"model": config.game, "hash": self.game.hash, "catalogue": self.game.catalogue.version},
            "policies": {entrant.name: entrant.hash for entrant in self.entrants},
            "sources": {entrant.name: source_hashes(entrant.name) for entrant in self.entrants if not entrant.hash},
        }
        run.check_same(same)
        self.results = self.read_results(finished=finished)
        if finished:
            _say(self.console, f"{self.folder}: already finished")
            known = self.stages(self.results)
            for stage in range(1, len(known) + 1):
                self.has_log(known[:stage])
            standings = rank(config.pool, self.results, config.seed, self.exact())
            return LeagueRun(folder=run.folder, standings=standings, results=self.results)
        begun = time.monotonic()
        run.begin(PACKAGES, same=same, seed=config.seed)
        stage = 0
        while stage < len(known := self.stages(self.results)):
            stage += 1
            self.play(known[:stage])
        if stage < config.rounds:
            _say(self.console, f"{stage} of {config.rounds} rounds: no further one was found between entrants that have not met")
        seconds = time.monotonic() - begun
        standings = self.write_reports(known, self.exact())
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        run.finish(finished=now, strokes_played=self.strokes, seconds=seconds)
        if self.strokes:
            speed = float(f"{self.strokes / seconds:.2g}")
            _say(self.console, f"{self.strokes:,} strokes in {seconds:.1f} s, {speed:,.0f} a second")
        return LeagueRun(folder=run.folder, standings=standings, results=self.results)

    def read_results(self, *, finished: bool) -> list[PairResult]:
        """The finished pairings; an incomplete last line of an unfinished run is removed."""
        path = self.folder / PAIRINGS
        try:
            lines = self.journal.read(finished=finished)
            results = [msgspec.convert(fields, PairResult) for fields in lines]
            if odd := [result.pairing for result in results if not result.sound]:
                raise ValueError(f"the counts of pairing {odd[0]} contradict each other")
        except ValueError as error:
            raise LeagueError(f"{path}: is damaged ({error}); play the tournament again with --overwrite") from error
        expected = [(pairing.number, pairing.names) for pairing in itertools.chain(*self.stages(results))]
        found = [(result.pairing, result.names) for result in results]
        named = all(fields.get("run") == self.name for fields in lines)
        if not named or found != expected[: len(found)] or (finished and found != expected):
            advice = "restore it from a backup, or play the tournament again with --overwrite"
            raise LeagueError(f"{path}: pairings are missing, out of order, or of another run; {advice}")
        if not finished:
            self.journal.keep(len(results))
        return results

    def stages(self, results: Sequence[PairResult]) -> list[list[Pairing]]:
        config = self.config
        return stages(config.pool, config.format, results, rounds=config.rounds)

    def play(self, known: Sequence[Sequence[Pairing]]) -> None:
        """Play the rest of the last stage in ``known``."""
        config, results, pairings = self.config, self.results, known[-1]
        done = min(len(results) - pairings[0].number, len(pairings))
        _say(self.console, f"playing {len(pairings) - done} pairs, {config.matches} matches each")
        recorder = self.recorder(known)
        tournament = Tournament(
            self.game,
            self.entrants,
            matches=config.matches,
            seed=config.seed,
            batch=config.batch,
            keep_strokes=recorder is not None,
            rules=RULES[config.rules],
            workers=config.workers,
            cluster=self.cluster,
        )
        # The log is on the disk before the results are, so no result lacks its rallies; play continues meanwhile.
        unsaved: collections.deque[tuple[Future[int] | None, list[PairResult]]] = collections.deque()
        columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
        with recorder or contextlib.nullcontext(), Progress(*columns, console=self.console, transient=True) as bar:
            task = bar.add_task("pairings", total=len(pairings), completed=done)

            def keep(*, wait: bool) -> None:
                while unsaved and (wait or unsaved[0][0] is None or unsaved[0][0].done()):
                    saved, new = unsaved.popleft()
                    if saved is not None:
                        saved.result()
                    self.journal.append([dataclasses.asdict(result) | {"run": self.name} for result in new])
                    results.extend(new)
                    bar.advance(task, len(new))
                    for result in new:
                        self.strokes += sum(counts["strokes"] for counts in result.seats)
                        if result.forfeit and not any(e.failure for e in self.entrants if e.name in result.forfeit):
                            _say_forfeit(self.console, f"{' v '.join(result.names)}: {result.reason}")

            for blocks in tournament.play(pairings[done:]):
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

    def recorder(self, known: Sequence[Sequence[Pairing]]) -> RallyRecorder | None:
        """The recorder of the last stage in ``known``; None if nothing remains to be recorded."""
        if self.config.record == "none" or (len(self.results) > known[-1][-1].number and self.has_log(known)):
            return None
        path = self.folder / log_name(len(known) - 1)
        return RallyRecorder(resume_log(path, self.header(known), self.played_in(known[-1])))

    def played_in(self, stage: Sequence[Pairing]) -> int:
        """Number of the rallies of the finished pairings of a stage."""
        done = self.results[stage[0].number : stage[-1].number + 1]
        return sum(counts["rallies"] for result in done for counts in result.seats)

    def has_log(self, known: Sequence[Sequence[Pairing]]) -> bool:
        """Whether the log of the last stage in ``known``, which is played, is there; an error if it is another one."""
        path = self.folder / log_name(len(known) - 1)
        if path.exists():
            with RallyLog(path) as log:
                whole = log.n_rallies == self.played_in(known[-1])
                expected = self.header(known)
                if not whole or dataclasses.replace(log.header, software=expected.software) != expected:
                    told = "is the log of another run; restore it, or play the tournament again with --overwrite"
                    raise LeagueError(f"{path}: {told}")
        return path.exists()

    def header(self, known: Sequence[Sequence[Pairing]]) -> LogHeader:
        """The header of the log of the last stage in ``known``."""
        config = self.config
        return LogHeader(
            seed=config.seed,
            game=self.game.hash,
            strokes=self.game.catalogue.names,
            policies=tuple(Player(name=entrant.name, hash=entrant.hash) for entrant in self.entrants),
            pairings=tuple(pairing.key for pairings in known for pairing in pairings),
            rules=RULES[config.rules],
            columns=columns_of(self.game),
            pair=Pair.of(self.game),
        )

    def exact(self) -> ExactOdds:
        config = self.config
        if not config.exact:
            return unknown(config.pool)
        _say(self.console, "solving all pairs")
        exact = exact_odds(self.game, self.entrants, RULES[config.rules])
        if exact.problem:
            _say(self.console, f"no exact results: {exact.problem}")
        return exact

    def write_reports(self, known: Sequence[Sequence[Pairing]], exact: ExactOdds) -> list[Standing]:
        config, game, folder, results = self.config, self.game, self.folder, self.results
        _say(self.console, "writing the report")
        standings = rank(config.pool, results, config.seed, exact)
        assessment = assess(standings, results, exact)
        table = results_table(results, exact)
        replace_file(folder / "results.csv", csv_bytes(table))
        write_parquet(folder / "results.parquet", table)
        replace_file(folder / "ranking.csv", csv_bytes(ranking_table(standings)))
        runs.write_json(folder / REPORT, as_json(assessment, standings))
        logs = {pairings[0].number: log_name(stage) for stage, pairings in enumerate(known)}
        shown = page(config, game.hash, standings, results, assessment, logs=logs)
        replace_file(folder / runs.PAGE, shown)
        return standings


def log_name(stage: int) -> str:
    """File name of the rally log of a stage, counted from 0."""
    return f"rallies-{stage + 1}.mcap" if stage else runs.RALLIES


def _say(console: Console, text: str, label: str = "") -> None:
    """Print untrusted text, which is never interpreted as markup."""
    console.print(Text.assemble((label, "bold red"), printable(text)), highlight=False, soft_wrap=True)


def _say_forfeit(console: Console, reason: str) -> None:
    _say(console, reason, "forfeit: ")
