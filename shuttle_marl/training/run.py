"""A training run from its configuration to its folder: collect, learn, evaluate, save, and continue after a kill."""

import contextlib
import dataclasses
import math
import os
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text
from safetensors.numpy import save
from torch.utils.tensorboard import SummaryWriter

from shuttle_marl import exact, runs
from shuttle_marl.game import draws
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.agents import save_agent
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training.a2c import make_a2c
from shuttle_marl.training.collecting import SEEDS, RallyCollector
from shuttle_marl.training.config import TrainingConfig, TrainingError
from shuttle_marl.training.evaluation import Evaluation, Evaluator
from shuttle_marl.training.learner import (
    CHECKPOINTS,
    DivergedError,
    Learner,
    check_finite,
    last_checkpoint,
    save_checkpoint,
)
from shuttle_marl.training.metrics import Metrics
from shuttle_marl.training.networks import imitate, tabulated, weights_of
from shuttle_marl.training.ppo import PPOConfig, make_ppo
from shuttle_marl.training.run_log import RALLIES, RunLog, open_log
from shuttle_marl.training.sac import make_sac
from shuttle_marl.training.self_play import SelfPlay, slots

AGENT: Final = "agent"
"""Folder of the trained agent in the folder of its run."""
BEST: Final = "best"
"""Folder of the agent at the evaluation that was best: least exploitable in self-play, else the one that won most rallies."""
METRICS: Final = "metrics.jsonl"
_PACKAGES: Final = ("numpy", "torch", "torchrl", "tensordict", "numba", "scipy")
_LEARNERS: Final[dict[str, Callable[[Any, Game], Learner]]] = {"ppo": make_ppo, "a2c": make_a2c, "sac": make_sac}
_FIRST, _SEGMENT = 0, 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingRun:
    """A finished run.

    Attributes:
        folder: the run folder; the agent lies in ``agent`` there.
        iterations: how many were run.
        strokes: of the learner.
        evaluation: of the final weights.
        policy: the agent on every state.
    """

    folder: Path
    iterations: int
    strokes: int
    evaluation: Evaluation
    policy: TabulatedPolicy


def train(config: TrainingConfig, console: Console | None = None) -> TrainingRun:
    """Train an agent, or continue to train it, and write its run folder.

    Args:
        config: what to train, and its opponents.
        console: shows progress; None shows nothing.

    Raises:
        PolicyError: an opponent cannot be found or is no distribution over the legal strokes; nothing was written.
        GameError: the model cannot be found; nothing was written.
        RunError: the run folder cannot be used.
        TrainingError: the device is not there or the memory too small, and nothing was written; or learning diverged, the memory
            of the device ran out, or a file of the run is damaged or cannot be written, and the last checkpoint is whole.
        RecordingError: the rally log cannot be written any further; the last checkpoint is whole.
    """
    console = console or Console(quiet=True)
    game = resolve_game(config.game, config.profile)
    names = () if config.self_play else config.opponent
    opponents = [tabulate(resolve(name, game), game, name) for name in names]
    _check_machine(config, game)
    name = f"{config.algorithm}-{config.seed}"
    with runs.open_run(config.out, name, config.fixed(), resume=config.resume, overwrite=config.overwrite) as folder:
        try:
            return _Run(config, game, opponents, folder, console).go()
        except torch.OutOfMemoryError as error:
            raise TrainingError(
                f"--device {config.device}: its memory is too small for this run ({_first_line(error)}); the last checkpoint is "
                "whole; train with smaller --batch, --growth or --width, or with --device cpu"
            ) from error


def check_device(device: str) -> None:
    """Refuse a device on which PyTorch cannot compute.

    Raises:
        TrainingError: it cannot.
    """
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        needed = "; cuda needs an NVIDIA GPU with its driver, and a build of PyTorch for CUDA" if "cuda" in device else ""
        raise TrainingError(f"--device {device}: cannot be used here ({_first_line(error)}); --device cpu can{needed}") from error


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


def _check_machine(config: TrainingConfig, game: Game) -> None:
    """Refuse a device or sizes that this machine does not have, before anything is allocated or written."""
    check_device(config.device)
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for flags, needed in config.memory(game.n_strokes).items():
        if needed > there:
            raise TrainingError(
                f"{flags}: such a run needs {needed / 1e9:,.0f} GB of memory or more, and this machine has {there / 1e9:,.0f}; "
                "choose smaller numbers"
            )


class _Run:
    def __init__(
        self, config: TrainingConfig, game: Game, opponents: list[TabulatedPolicy], folder: Path, console: Console
    ) -> None:
        torch.set_num_threads(config.threads)
        self.config, self.game, self.folder, self.console = config, game, folder, console
        # Self-play is measured against the benchmark's opponent.
        measured = opponents or [tabulate(resolve("bc", game), game, "bc")]
        self.evaluator = Evaluator(game, measured)
        torch.manual_seed(self._seed(_FIRST))
        self.learner = _LEARNERS[config.algorithm](config, game)
        met = opponents
        if isinstance(config, PPOConfig) and config.way != "plain":
            met = measured * slots(config)
        self.collector = RallyCollector(config, game, met, self.learner.assess, distinct=self.learner.distinct)
        self.partners: SelfPlay | None = None
        if isinstance(config, PPOConfig) and config.self_play:
            self.partners = SelfPlay(config, game, self.learner, self.collector.sampler)
        self.metrics = Metrics(folder / METRICS)
        self.made_with: dict[str, str] = {}
        self.opponents = opponents
        self.iteration, self.strokes, self.saved, self.seconds = 0, 0, 0, 0.0
        self.stopped = False
        self.best = -math.inf
        """Figure of the best evaluation."""
        self.evaluation: tuple[TabulatedPolicy, Evaluation] | None = None
        """The latest one, and what was evaluated; a run ends with one."""
        self.rallies = 0
        """Rallies in the log at the last checkpoint."""

    def go(self) -> TrainingRun:
        config = self.config
        about = {
            "status": "running",
            "seed": config.seed,
            **runs.describe(_PACKAGES),
            "game": {"model": config.game, "hash": self.game.hash, "catalogue": self.game.catalogue.version},
        }
        self.made_with = about["packages"]
        resumed = self._restore()
        runs.write_json(self.folder / runs.MANIFEST, about)
        if not resumed and config.warm_start is not None:
            self._warm_start(config.warm_start)
        begun = time.monotonic() - self.seconds
        with (
            SummaryWriter(str(self.folder / "tensorboard"), purge_step=self.iteration) as board,
            _progress(self.console) as bar,
        ):
            task = bar.add_task(config.algorithm, total=config.iterations, completed=self.iteration, now="")

            def after(losses: dict[str, float]) -> None:
                self.seconds = time.monotonic() - begun
                bar.update(task, completed=self.iteration)
                if self.iteration % config.evaluate_every == 0 or self.iteration == config.iterations:
                    evaluation = self._evaluate(losses, board)
                    bar.update(task, now=self._now(evaluation))

            log = self._open_log()
            try:
                while self.iteration < config.iterations and not self.stopped:
                    self._segment(after, log)
            except BaseException:
                if log is not None:
                    log.abort()
                raise
            if log is not None:
                log.close()
        return self._finish(about)

    def _open_log(self) -> RunLog | None:
        config, ended = self.config, self.iteration >= self.config.iterations or self.stopped
        if ended and (self.folder / RALLIES).exists():
            return None
        seeds = [self._segment_seed(segment) for segment in range(config.segments)]
        return open_log(self.folder, config, self.game, self.opponents, seeds, rallies=self.rallies)

    def _segment(self, after: Callable[[dict[str, float]], None], log: RunLog | None) -> None:
        """Iterations up to the next checkpoint. Their draws depend on its number alone, so a resumed run repeats them."""
        config = self.config
        segment = self.iteration // config.checkpoint_every
        seed = self._segment_seed(segment)
        self.collector.begin(seed)
        begins = True
        for _ in range(min(config.checkpoint_every, config.iterations - self.iteration)):
            remaining = 1 - self.iteration / config.iterations
            self.learner.begin(remaining)
            with self._diverging(self.iteration):
                if self.partners is not None:
                    self.partners.prepare(self.iteration, first=begins, seed=seed)
                    begins = False
                data = self.collector.collect()
            if log is not None:
                log.add(self.collector.sampler, segment, self.iteration)
            with self._diverging(self.iteration + 1):
                losses = self.learner.learn(data, remaining)
                self.learner.check_weights()
            if log is not None:
                log.settle()
            self.strokes += self.collector.strokes
            self.iteration += 1
            after(losses)
            if self.stopped:
                break
        state = self.learner.state() | {f"collector.{name}": part for name, part in self.collector.state_dict().items()}
        if self.partners is not None:
            state |= self.partners.state()
        with self._diverging(self.iteration):
            check_finite(state.values())
        # The log is on the disk before the checkpoint is, so that a resumed run finds all that the checkpoint counts.
        self.rallies = 0 if log is None else log.flush()
        about = {
            "game": self.game.hash,
            "seconds": self.seconds,
            "strokes": self.strokes,
            "best": None if self.best == -math.inf else self.best,
            "stopped": self.stopped,
            "rallies": self.rallies,
            "metrics": self.metrics.mark(),
        }
        save_checkpoint(self.folder, self.iteration, state, about)
        self.saved = self.iteration

    @contextlib.contextmanager
    def _diverging(self, iteration: int) -> Iterator[None]:
        """Say in which iteration learning diverged, and what to do."""
        try:
            yield
        except DivergedError as error:
            kept = f"the weights of iteration {self.saved} are kept" if self.saved else "no weights were saved yet"
            raise DivergedError(
                f"{self.folder}: learning diverged in iteration {iteration}: {error}; {kept} in its checkpoints. "
                "Train again with a lower --learning-rate"
            ) from error

    def _evaluate(self, losses: dict[str, float], board: SummaryWriter) -> Evaluation:
        with self._diverging(self.iteration):
            policy = tabulated(self.learner.played, self.game, self.config.play_temperature)
        evaluation = self.evaluator.evaluate(policy, exploitability=self._exploitability)
        strokes = self.strokes
        figures = {**dataclasses.asdict(evaluation), **losses}
        line = {"iteration": self.iteration, "strokes": strokes, "seconds": round(self.seconds, 2), **figures}
        self.metrics.append(line)
        for name, value in figures.items():
            if value is not None:
                board.add_scalar(name, value, strokes)
        board.add_scalar("strokes_per_second", strokes / max(self.seconds, 1e-9), strokes)
        self.evaluation = policy, evaluation
        found = evaluation.exploitability
        figure = -found if self.config.self_play and found is not None else evaluation.rally_win
        if figure > self.best:
            self.best = figure
            self._save_agent(BEST, evaluation)
        score, wanted = evaluation.normalised_score, self.config.target_score
        if self.config.target is not None and evaluation.match_win >= self.config.target:
            self.stopped = True
        if wanted is not None and score is not None and score >= wanted:
            self.stopped = True
        return evaluation

    @property
    def _exploitability(self) -> bool:
        return self.config.exploitability or self.config.self_play

    def _now(self, evaluation: Evaluation) -> str:
        speed = self.strokes / max(self.seconds, 1e-9)
        return (
            f"{speed / 1e3:.0f} k strokes/s · wins {evaluation.rally_win:.1%} of rallies, {evaluation.match_win:.1%} of "
            f"matches · {evaluation.score_text} · {evaluation.exploitability_text}"
        )

    def _restore(self) -> bool:
        """Take over the last checkpoint; returns whether there is one."""
        saved = last_checkpoint(self.folder) if self.config.resume else None
        if saved is None:
            self.metrics.cut(None)
            return False
        about, state = saved
        if about.get("game") != self.game.hash:
            raise TrainingError(
                f"{self.folder}: was trained on game {str(about.get('game'))[:12]}, this is {self.game.hash[:12]}; "
                "continue with the same --game, or train again with another --out"
            )
        try:
            self.iteration, self.seconds, self.stopped = int(about["iteration"]), float(about["seconds"]), bool(about["stopped"])
            self.saved, self.rallies, self.strokes = self.iteration, int(about["rallies"]), int(about["strokes"])
            self.best = -math.inf if about["best"] is None else float(about["best"])
            mark = {"bytes": int(about["metrics"]["bytes"]), "sha256": str(about["metrics"]["sha256"])}
            self.learner.restore(state)
            if self.partners is not None:
                self.partners.restore(state)
            self.collector.load_state_dict(OrderedDict((name, state[f"collector.{name}"]) for name in ("known", "iteration")))
        except (KeyError, IndexError, TypeError, ValueError, RuntimeError) as error:
            found = f"{self.folder / CHECKPOINTS}: the last checkpoint is of another kind of run"
            raise TrainingError(f"{found} ({type(error).__name__}: {error}); train again with --overwrite") from error
        self.metrics.cut(mark)
        self.console.print(f"{self.folder}: continues after iteration {self.iteration}", highlight=False, markup=False)
        return True

    def _warm_start(self, name: str) -> None:
        policy = tabulate(resolve(name, self.game), self.game, name)
        weight = exact.visits(policy, policy).states[0]
        with self.console.status(Text(f"imitating {name}")):
            gap = imitate(self.learner.actor, policy, weight)
            if self.learner.shown is not None:
                self.learner.shown.load_state_dict(self.learner.actor.state_dict())
        self.console.print(f"imitated {name}: {gap:.3f} nats a stroke from it", highlight=False, markup=False)

    def _finish(self, about: dict[str, Any]) -> TrainingRun:
        if self.evaluation is None:  # a run that had ended before it was resumed
            policy = tabulated(self.learner.played, self.game, self.config.play_temperature)
            self.evaluation = policy, self.evaluator.evaluate(policy, exploitability=self._exploitability)
        policy, evaluation = self.evaluation
        self._save_agent(AGENT, evaluation)
        runs.write_json(self.folder / runs.MANIFEST, {**about, "status": "finished", "seconds": round(self.seconds, 1)})
        return TrainingRun(
            folder=self.folder, iterations=self.iteration, strokes=self.strokes, evaluation=evaluation, policy=policy
        )

    def _save_agent(self, name: str, evaluation: Evaluation) -> None:
        """Save the agent as it is now in a folder of the run."""
        card = {
            "algorithm": self.config.algorithm,
            "config": self.config.fixed(),
            "iterations": self.iteration,
            "strokes": self.strokes,
            "seconds": round(self.seconds, 1),
            "evaluation": dataclasses.asdict(evaluation),
            "made_with": self.made_with,
        }
        save_agent(self.folder / name, self.game, save(weights_of(self.learner.played, self.config.play_temperature)), card)

    def _segment_seed(self, segment: int) -> int:
        return self._seed(_SEGMENT, segment) % SEEDS

    def _seed(self, *numbers: int) -> int:
        return int(draws.stream(self.config.seed, *numbers)[0] >> np.uint64(1))


def _progress(console: Console) -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[now]}"),
    )
    return Progress(*columns, console=console, transient=True)
