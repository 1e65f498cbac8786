"""Run a method on a task: units in parallel, resumable, each stored and scored.

An isolated method runs as a program of its own, and sees states, legal strokes and rewards alone (:mod:`.program`).
"""

import dataclasses
import functools
import itertools
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from shuttle_marl.base import runs
from shuttle_marl.base.arrays import Ints
from shuttle_marl.base.cluster import check_processes, in_processes, open_cluster
from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.base.files import cache_folder
from shuttle_marl.base.programs import Program
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game.observation import observations
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.kernel import RallyBatch
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite import frozen, program, store
from shuttle_marl.suite.exploit import OPPONENT, PlayerSetting, Trained
from shuttle_marl.suite.method import Method, baseline_of, find, sources
from shuttle_marl.suite.options import SuiteError, SuiteRun
from shuttle_marl.suite.registry import arena_of, arena_of_run, find_task
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.robust import RobustSetting
from shuttle_marl.suite.store import Card, Entry, RunConfig

PACKAGES: Final = ("numpy", "scipy", "numba", "msgspec", "zstandard")


_PACKAGE: Final = Path(__file__).parents[1]
_MOST_RALLIES: Final = 1 << 16


def _isolated(name: str, setting: Any) -> Any:
    """The trained player of a method ``MODULE:ATTRIBUTE`` that runs alone, or the object that the method made.

    Raises:
        SuiteError: the method failed, or the task gives tables.
    """
    if isinstance(setting, RobustSetting):
        raise SuiteError("robust-v0 gives the tables of games, so its methods cannot be isolated")
    started = IsolatedMethod(name, setting)
    if not isinstance(setting, PlayerSetting):
        return started
    return Trained(player=started.player(call="player"), strokes=started.used)


class IsolatedMethod:
    """A method in a process of its own; :attr:`used` counts the strokes of the learner."""

    def __init__(self, name: str, setting: Any) -> None:
        self._setting, self.game, self.used = setting, setting.game, 0
        if isinstance(setting, PlayerSetting) and setting.opponent is not None:
            self._opponent = resolve(setting.opponent, self.game)
            (setting.folder / OPPONENT).unlink(missing_ok=True)
        closed = [_PACKAGE, *([] if (cache := cache_folder()) is None else [cache])]
        command = [sys.executable, "-I", program.__file__, name, *map(str, (Path.cwd(), *(path.resolve() for path in closed)))]
        self._program = Program(command, shown=True)
        states = np.arange(self.game.n_states)
        self._send(
            observation=observations(self.game, states),
            mask=self.game.mask(states),
            seed=setting.seed,
            budget=setting.budget if isinstance(setting, PlayerSetting) else 0,
            folder=str(setting.folder.resolve()),
        )

    def _send(self, **arrays: Any) -> None:
        self._program.write(program.message(**arrays))

    def _ask(self, **request: Any) -> dict[str, Any]:
        """Send a request, and serve those of the method until it answers."""
        self._send(**request)
        while True:
            try:
                answer = program.receive(self._program)
            except (ValueError, OSError) as error:
                raise SuiteError(f"the isolated method sent an invalid message: {error}") from error
            served = {"reset", "step", "policy"} & answer.keys()
            if not served:
                break
            try:
                reply = getattr(self, f"_{served.pop()}")(answer)
            except (ShuttleError, ValueError, IndexError) as error:
                reply = {"error": str(error)}
            self._send(**reply)
        if "error" in answer:
            raise SuiteError(f"the isolated method raised {printable(str(answer['error']))}")
        return answer

    def _reset(self, request: dict[str, Any]) -> dict[str, Any]:
        number, setting = int(request["reset"]), self._setting
        if not isinstance(setting, PlayerSetting) or not 1 <= number <= _MOST_RALLIES:
            raise SuiteError(f"{number} rallies: tasks that train players have 1 to {_MOST_RALLIES} at once")
        if setting.opponent is None:
            self._batch: RallyBatch | RallyVectorEnv = RallyBatch(self.game, number, seed=setting.seed)
        else:
            self._batch = RallyVectorEnv(number, opponent=self._opponent, game=self.game, mask="none", info="none")
            self._batch.reset(seed=setting.seed)
        return {"state": self._states()}

    def _states(self) -> Ints:
        return (self._batch if isinstance(self._batch, RallyBatch) else self._batch.versus).rows.state

    def _step(self, request: dict[str, Any]) -> dict[str, Any]:
        strokes, batch = request["step"], self._batch
        if self.used + len(strokes) > self._setting.budget:
            raise SuiteError(f"the budget of {self._setting.budget:,} strokes is used up")
        reward, over = batch.step(strokes) if isinstance(batch, RallyBatch) else batch.step(strokes)[1:3]
        self.used += len(strokes)
        return {"state": self._states(), "reward": reward, "over": over}

    def _policy(self, request: dict[str, Any]) -> dict[str, Any]:
        row, pair = self.game.pairs(request["state"])
        chance = np.zeros((len(request["state"]), self.game.n_strokes), dtype=np.float32)
        chance[row, self.game.pair_stroke[pair]] = self._policies[int(request["policy"])].probability_of(pair)
        return {"probability": chance}

    def player(self, **request: Any) -> TabulatedPolicy:
        """The policy that the method answers with."""
        answer, game = self._ask(**request), self.game
        row, pair = game.pairs(np.arange(game.n_states))
        if (strokes := answer.get("stroke", np.zeros(0))).shape == (game.n_states,):
            chance = (strokes[row] == game.pair_stroke[pair]).astype(np.float64)
        elif (given := answer.get("probability", np.zeros(0))).shape == (game.n_states, game.n_strokes):
            chance = given[row, game.pair_stroke[pair]].astype(np.float64)
        else:
            raise SuiteError(
                "an isolated method returns an object with act(observation, mask) or probabilities(observation, mask), not a "
                f"{next(iter(answer))}"
            )
        if not (chance >= 0).all():
            raise SuiteError("the isolated method returned probabilities below 0, or none")
        return from_pair_probabilities(game, chance)

    def _arrays(self, data: Any) -> dict[str, Any]:
        """Columns of strokes; the stroke stands for the pair, which only the tables number."""
        names = [field.name for field in dataclasses.fields(data) if field.name not in ("game", "pair")]
        return {"stroke": self.game.pair_stroke[data.pair], **{name: np.asarray(getattr(data, name)) for name in names}}

    def fit(self, data: Any) -> TabulatedPolicy:
        """Learn from strokes."""
        return self.player(call="fit", **self._arrays(data))

    def estimate(self, log: Any, policies: list[TabulatedPolicy]) -> Any:
        """Values of policies."""
        self._policies = policies
        return self._ask(call="estimate", policies=len(policies), **self._arrays(log)).get("values")

    def answer(self, position: Any) -> Any:
        """The name of a stroke."""
        return str(self._ask(call="answer", position=json.dumps(position)).get("text"))

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """What is played next."""
        return self.player(call="policy_for_next_rally")

    def observe_rally(self, rally: Any) -> None:
        """A rally that was played."""
        self._ask(call="observe_rally", **self._arrays(rally))


PlayedUnit = tuple[Path, Entry, dict[str, bytes]]
"""File of the entry of a unit, the entry, and the compressed table of each policy by its hash."""


def run_method(options: SuiteRun, console: Console | None = None) -> Path:
    """Run a method, or continue an interrupted run; returns the run folder.

    Raises:
        SuiteError, PolicyError: the task or the method does not exist, or the method failed; finished units are kept.
        RunError: the folder cannot be used.
    """
    task = find_task(options.task)
    method_of(task.name, options.method, isolated=options.isolated)
    baseline = baseline_of(task.name, options.method)
    fixed_seeds = options.quick or (baseline is not None and baseline.kind == "reference")
    arena = arena_of(
        task, options.game, options.split, quick=options.quick, budget=options.budget, beacon=options.beacon, data=options.data
    )
    cases = task.cases(arena)
    if options.budget is None and len(budgets := {case.budget for case in cases}) > 1:
        # Scores of different budgets are never pooled.
        return run_method(dataclasses.replace(options, budget=min(budgets)), console)
    task.fingerprint(arena, cases[0], 0)  # fails before a folder is made if something is missing, such as --data
    config = RunConfig(
        task=task.name,
        method=options.method,
        split=options.split,
        quick=options.quick,
        budget=options.budget,
        seeds=options.seeds or (1 if fixed_seeds else task.seeds),
        game=store.GameOf(model=options.game, hash=arena.game.hash),
        isolated=options.isolated,
    )
    own = baseline and Card(method=options.method, kind=baseline.kind, access=baseline.access)
    name = "-".join([task.name, options.method, options.split, *([] if options.budget is None else [str(options.budget)])])
    words = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
    fixed = dataclasses.asdict(config)
    check_processes(1 if options.ray is not None else options.workers)
    with runs.open_run(options.out, words[:80], fixed, resume=options.resume, overwrite=options.overwrite) as folder:
        numbers = itertools.product(range(len(cases)), range(config.seeds))
        units = [unit for unit in numbers if not store.entry_path(folder, *unit).exists()]
        about = {**runs.describe(PACKAGES), "sources": _sources(folder, config, more=bool(units))}
        runs.write_json(folder / runs.MANIFEST, {"status": "running", **about})
        play = functools.partial(play_unit, folder, config, options.beacon, options.data)
        with Progress(
            *Progress.get_default_columns(), TimeElapsedColumn(), console=console or Console(quiet=True), transient=True
        ) as bar:
            # A unit may take hours.
            for path, entry, policies in bar.track(_played(play, units, options), len(units), description="units"):
                store.write_entry(folder, path, entry, policies)
        store.write_card(folder, own or store.read_card(Path()))
        runs.write_json(folder / store.RESULTS, summarise(folder, options.beacon, options.game))
        runs.write_json(folder / runs.MANIFEST, {"status": "finished", **about})
    return folder


def method_of(task: str, name: str, *, isolated: bool) -> Method:
    """The method of a run, see :func:`shuttle_marl.suite.method.find`.

    Raises:
        SuiteError: there is none, or a method of this package is to be isolated.
    """
    if not isolated:
        return find(task, name)
    if baseline_of(task, name) is not None or ":" not in name or name.startswith("program:"):
        raise SuiteError(f"--isolated takes a method MODULE:ATTRIBUTE of your own, not {name!r}")
    return functools.partial(_isolated, name)


def _sources(folder: Path, config: RunConfig, *, more: bool) -> Mapping[str, str]:
    """Hashes of the files of a method, which are those that the run was started with if there is more to play."""
    path, now = folder / runs.MANIFEST, sources(config.task, config.method, isolated=config.isolated)
    if not runs.has_results(folder):
        return now
    before: dict[str, str] = runs.read_json(path, dict[str, Any]).get("sources", {}) if path.exists() else {}
    changed = sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key))
    if changed and more:
        raise SuiteError(
            f"{folder}: {', '.join(changed)} changed after the run was started, and results of two versions of a method are "
            "never mixed; restore what it was, or start the run again with --overwrite or another --out"
        )
    return before


def _played(
    play: Callable[[tuple[int, int]], PlayedUnit], units: Sequence[tuple[int, int]], options: SuiteRun
) -> Iterator[PlayedUnit]:
    if options.ray is not None:
        with open_cluster(options.ray, PACKAGES) as cluster:
            for task in [cluster.submit(play, unit) for unit in units]:
                yield task.result()
    else:
        yield from in_processes(play, units, min(options.workers, len(units)))


def play_unit(folder: Path, config: RunConfig, beacon: str | None, data: Path | None, unit: tuple[int, int]) -> PlayedUnit:
    """Play and score the unit of a case and a seed, in any process."""
    (number, seed), task = unit, find_task(config.task)
    arena = arena_of_run(task, config, config.game.model, beacon=beacon, data=data)
    case = task.cases(arena)[number]
    fingerprint = task.fingerprint(arena, case, seed)
    frozen.load().check(task, config.split, f"{case.name}/{seed}", fingerprint, arena.base)
    begun = time.monotonic()
    work = folder / "work" / f"{fingerprint[:16]}-{seed}"  # a number would name the opponent
    work.mkdir(parents=True, exist_ok=True)
    try:
        outcome = task.play(arena, case, method_of(task.name, config.method, isolated=config.isolated), seed, work)
    except ShuttleError as error:
        raise SuiteError(f"{config.method}, case {case.name}, seed {seed}: {error}") from error
    seconds = time.monotonic() - begun
    entry = store.checked(Entry(
        case=case.name,
        seed=seed,
        fingerprint=fingerprint,
        policies={role: policy.hash for role, policy in outcome.policies.items()},
        answers=dict(outcome.answers),
        scores=task.score(arena, case, seed, outcome),
        parts=task.parts(arena, case, outcome),
        seconds=seconds,
        strokes=outcome.strokes,
        curve=tuple(outcome.curve),
    ))  # fmt: skip
    if not any(work.iterdir()):
        work.rmdir()
    return store.entry_path(folder, number, seed), entry, {p.hash: p.packed() for p in outcome.policies.values()}
