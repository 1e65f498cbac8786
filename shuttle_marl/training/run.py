"""Training runs: an algorithm iterates, and its callback evaluates, records and saves in the run folder."""

import contextlib
import dataclasses
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text
from safetensors import numpy as weights_file
from torch.utils.tensorboard import SummaryWriter

from shuttle_marl import exact
from shuttle_marl.base import runs
from shuttle_marl.base.files import StoredCount
from shuttle_marl.base.interrupts import check_interrupt, interrupts_held
from shuttle_marl.base.pytorch import InitialWeights, own_settings
from shuttle_marl.game import draws
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.agents import save_agent
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import REFERENCE
from shuttle_marl.training.checkpoints import complete, last_checkpoint, save_checkpoint
from shuttle_marl.training.config import PPOConfig, TrainingConfig, TrainingError, missed
from shuttle_marl.training.evaluation import Evaluation, Evaluator
from shuttle_marl.training.learner import SEEDS, Callback, Learner
from shuttle_marl.training.networks import DivergedError, imitate, tabulated, weights_of
from shuttle_marl.training.ppo import A2C, PPO
from shuttle_marl.training.rally_log import open_log
from shuttle_marl.training.sac import SAC
from shuttle_marl.training.self_play import SelfPlayOpponents, n_opponents

AGENT: Final = "agent"
"""Folder of the trained agent in the folder of its run."""
BEST: Final = "best"
"""Folder of the best agent: the least exploitable in self-play, else that with the highest probability of winning rallies."""
_PACKAGES: Final = ("numpy", "torch", "torchrl", "tensordict", "numba", "scipy")
LEARNERS: Final[dict[str, Callable[..., Learner]]] = {"ppo": PPO, "a2c": A2C, "sac": SAC}
"""Learners by name of the algorithm, see :class:`~shuttle_marl.training.learner.Learner`."""
_WEIGHTS, _SEGMENT = 0, 1
"""Streams of random numbers: initial weights, and segments between checkpoints."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingRun:
    """A finished run.

    Attributes:
        folder: the run folder, with the agent in its folder ``agent``.
    """

    folder: Path
    iterations: int
    strokes: int
    evaluation: Evaluation
    policy: TabulatedPolicy


def train(config: TrainingConfig, console: Console | None = None) -> TrainingRun:
    """Train an agent, or resume its training, and write its run folder.

    Args:
        console: shows progress; None: silent.

    Raises:
        PolicyError: an opponent does not exist or is not a distribution over the legal strokes; nothing was written.
        GameError: the model does not exist; nothing was written.
        RunError: the run folder cannot be used, or the game or an opponent changed after the run was started.
        TrainingError: the device is not available or the memory is too small; nothing was written. Or learning diverged, the
            device ran out of memory, or a file of the run is damaged or cannot be written; the last checkpoint is intact.
        RecordingError: the rally log cannot be written; the last checkpoint is intact.
        KeyboardInterrupt: Ctrl-C, raised between two iterations; the message says what is saved.
    """
    game = resolve_game(config.game, config.profile)
    opponents = [] if config.self_play else [tabulate(resolve(name, game), game) for name in config.opponent]
    config = tempered(config, game)
    _check_machine(config, game)
    name, fixed = f"{config.algorithm}-{config.seed}", config.fixed()
    opened = runs.open_run(config.out, name, fixed, resume=config.resume, overwrite=config.overwrite)
    with interrupts_held(), opened as run, run.resumable(lambda: _saved(run.folder, config)), own_settings(config.threads):
        return _Training(config, game, opponents, run, console or Console(quiet=True)).go()


def _saved(folder: Path, config: TrainingConfig) -> str:
    number = max((int(path.name) for path in complete(folder)), default=0)
    return f"iteration {number} of {config.iterations} is saved" if number else "no iteration yet is saved"


def game_of(model: str, game: Game) -> dict[str, str]:
    """The game of a run in its manifest."""
    return {"model": model, "hash": game.hash, "catalogue": game.catalogue.version}


def tempered(config: TrainingConfig, game: Game) -> TrainingConfig:
    """Settings with the temperature of the agent: where perfect play mixes, sharper play than that of rollouts is exploitable."""
    if config.eval_temperature is not None or not config.self_play or game.recovery is None:
        return config
    return dataclasses.replace(config, eval_temperature=config.final_temperature if isinstance(config, PPOConfig) else 1.0)


def check_device(device: str) -> None:
    """Check that PyTorch can compute on a device.

    Raises:
        TrainingError: the device is not available.
    """
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        hint = "; cuda needs an NVIDIA GPU with its driver, and a build of PyTorch for CUDA" if "cuda" in device else ""
        raise TrainingError(f"--device {device}: cannot be used here ({_first_line(error)}); --device cpu can{hint}") from error


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


def _check_machine(config: TrainingConfig, game: Game) -> None:
    """Check the device and the memory of this machine, before anything is allocated or written."""
    check_device(config.device)
    available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for flags, required in config.memory(game.n_actions).items():
        if required > available:
            raise TrainingError(
                f"{flags}: such a run needs {required / 1e9:,.0f} GB of memory or more, and this machine has "
                f"{available / 1e9:,.0f}; choose smaller numbers"
            )


@dataclasses.dataclass(kw_only=True)
class Checkpoint:
    """Progress of a run, in the description of its checkpoints.

    Attributes:
        iteration, strokes: of the learner at the last checkpoint.
        best: figure of the best evaluation.
        stopped: whether the run ended before its last iteration.
        rallies, metrics: numbers of recorded rallies at the last checkpoint, and of evaluations.
    """

    iteration: StoredCount = 0
    seconds: float = 0.0
    strokes: StoredCount = 0
    best: float | None = None
    stopped: bool = False
    rallies: StoredCount = 0
    metrics: StoredCount = 0


class _Training(Callback):
    """A run: the loop over the iterations of its learner, and what happens in each of them."""

    def __init__(
        self, config: TrainingConfig, game: Game, opponents: list[TabulatedPolicy], run: runs.Run, console: Console
    ) -> None:
        self.config, self.game, self.folder, self.console, self.run = config, game, run.folder, console, run
        # Self-play is evaluated against the benchmark's opponent.
        evaluated = opponents or [tabulate(resolve(REFERENCE, game), game)]
        self.evaluator, self.opponents = Evaluator(game, evaluated), opponents
        self.generator = torch.Generator().manual_seed(self._seed(_WEIGHTS))
        with InitialWeights(self.generator):
            self.learner = LEARNERS[config.algorithm](config, game, opponents or evaluated * n_opponents(config))
        self.self_play = SelfPlayOpponents(config, game, self.learner)
        self.metrics = runs.Journal(self.folder / runs.METRICS)
        self.at = Checkpoint()
        self.evaluation: tuple[TabulatedPolicy, Evaluation] | None = None
        """The latest evaluation, and its policy; a run ends with an evaluation."""
        self.evaluating = 0.0
        """Duration of the latest evaluation [s]."""

    def go(self) -> TrainingRun:
        config, learner, run = self.config, self.learner, self.run
        same = {"game": game_of(config.game, self.game), "opponents": [each.hash for each in self.opponents]}
        run.begin(_PACKAGES, same=same, seed=config.seed)
        self._restore()
        self.begun = time.monotonic() - self.at.seconds
        seeds = [self._seed(_SEGMENT, segment) % SEEDS for segment in range(config.segments)]
        recorded = self._over and (self.folder / runs.RALLIES).exists()
        record = "none" if recorded else config.record
        self.log = open_log(self.folder, config, self.game, self.opponents, seeds, self.at.rallies, record=record)
        purge = learner.strokes + 1 if learner.iteration else None
        with SummaryWriter(str(self.folder / "tensorboard"), purge_step=purge) as self.board, _bar(self.console) as self.bar:
            total = config.iterations if config.seconds is None else round(config.seconds)
            self.bar.add_task(config.algorithm, total=total, completed=round(self._fraction() * total), status="")
            with self.log, self._diverging():
                for remaining in self._schedule():
                    learner.iterate(remaining, self)
        if config.seconds is not None and (warning := missed(time.monotonic() - self.begun, config.seconds)):
            self.say(warning)
        policy, evaluation = self.evaluation or self._evaluated()  # None if the resumed run had ended before
        self._save_agent(AGENT, evaluation)
        run.finish(seconds=round(self.at.seconds, 1))
        return TrainingRun(
            folder=self.folder, iterations=learner.iteration, strokes=learner.strokes, evaluation=evaluation, policy=policy
        )

    def say(self, text: str) -> None:
        self.console.print(f"{self.folder}: {text}", highlight=False, markup=False, soft_wrap=True)

    @property
    def _over(self) -> bool:
        return self.at.stopped or self.learner.iteration >= self.config.iterations

    def _fraction(self) -> float:
        """Fraction of the run that is over, by iterations or by time."""
        part, limit = self.learner.iteration / self.config.iterations, self.config.seconds
        return part if limit is None else min(1.0, max(part, self.at.seconds / limit))

    def _schedule(self) -> Iterator[float]:
        """Fraction of the run that remains in each iteration.

        Random numbers depend on the segment between two checkpoints alone, so a resumed run repeats them.
        """
        while not self._over:
            check_interrupt()
            self.segment, done = divmod(self.learner.iteration, self.config.checkpoint_every)
            if not done:
                self.self_play.set_seed(self.learner.collector.set_seed(self._seed(_SEGMENT, self.segment) % SEEDS))
            yield 1 - self._fraction()

    def begin(self, learner: Learner) -> None:
        """Update the opponents of self-play."""
        self.self_play.update(learner.iteration)

    def collected(self, learner: Learner) -> None:
        """Record the rallies, while the learner learns from them."""
        self.log.record(learner.collector.sampler, self.segment, learner.iteration - 1)

    def learned(self, learner: Learner, losses: dict[str, float]) -> None:
        """Show the progress; evaluate, stop and save if it is time."""
        self.log.settle()
        config, at, (task,) = self.config, self.at, self.bar.tasks
        at.seconds = time.monotonic() - self.begun
        self.bar.update(task.id, completed=round(self._fraction() * (task.total or 0)))
        # The last evaluation is part of the budget; it takes as long as the one before.
        at.stopped = config.seconds is not None and at.seconds + self.evaluating > config.seconds
        if learner.iteration % config.evaluate_every == 0 or self._over:
            evaluation = self._evaluate(losses)
            self.evaluating = time.monotonic() - self.begun - at.seconds
            speed = f"{learner.strokes / max(at.seconds, 1e-9) / 1e3:.0f} k strokes/s"
            won = f"wins {evaluation.rally_win:.1%} of rallies, {evaluation.match_win:.1%} of matches"
            self.bar.update(task.id, status=f"{won} · {evaluation.exploitability_text} · {evaluation.score_text} · {speed}")
        if learner.iteration % config.checkpoint_every == 0 or self._over:
            self._save()

    def _save(self) -> None:
        state = {**self.learner.state_dict(), **self.self_play.state_dict()}
        # The log is written to disk before the checkpoint, so that it holds all rallies that the checkpoint counts.
        rallies, learner = self.log.flush(), self.learner
        at = dataclasses.replace(self.at, iteration=learner.iteration, strokes=learner.strokes, rallies=rallies)
        save_checkpoint(self.folder, learner.iteration, state, dataclasses.asdict(at))
        self.at = at

    @contextlib.contextmanager
    def _diverging(self) -> Iterator[None]:
        """Add the iteration and a remedy to errors of diverged learning, and of a device that is too small."""
        try:
            yield
        except DivergedError as error:
            saved = f"the weights of iteration {self.at.iteration} are kept" if self.at.iteration else "no weights were saved yet"
            raise DivergedError(
                f"{self.folder}: learning diverged in iteration {self.learner.iteration}: {error}; {saved} in its checkpoints. "
                "Train again with a lower --learning-rate"
            ) from error
        except torch.OutOfMemoryError as error:
            raise TrainingError(
                f"--device {self.config.device}: its memory is too small for this run ({_first_line(error)}); the last "
                "checkpoint is intact; train with smaller --batch, --growth or --width, or with --device cpu"
            ) from error

    def _evaluate(self, losses: dict[str, float]) -> Evaluation:
        config, at, learner = self.config, self.at, self.learner
        self.evaluation = self._evaluated()
        evaluation = self.evaluation[1]
        figures = {**dataclasses.asdict(evaluation), **losses}
        line = {"iteration": learner.iteration, "strokes": learner.strokes, "seconds": round(at.seconds, 2), **figures}
        self.metrics.append([line])
        at.metrics += 1
        for name, value in figures.items():
            if value is not None:
                self.board.add_scalar(name, value, learner.strokes)
        self.board.add_scalar("strokes_per_second", learner.strokes / max(at.seconds, 1e-9), learner.strokes)
        exploitability, score = evaluation.exploitability, evaluation.normalised_score
        figure = -exploitability if config.self_play and exploitability is not None else evaluation.rally_win
        if at.best is None or figure > at.best:
            at.best = figure
            self._save_agent(BEST, evaluation)
        at.stopped |= config.target is not None and evaluation.match_win >= config.target
        at.stopped |= config.target_score is not None and score is not None and score >= config.target_score
        return evaluation

    def _evaluated(self) -> tuple[TabulatedPolicy, Evaluation]:
        policy = tabulated(self.learner.eval_actor, self.game, self.config.temperature)
        exploitability = self.config.exploitability or self.config.self_play
        return policy, self.evaluator.evaluate(policy, exploitability=exploitability)

    def _restore(self) -> None:
        """Restore the last checkpoint, or start anew."""
        saved = last_checkpoint(self.folder)
        if saved is not None:
            fields, state = saved
            try:
                self.at = msgspec.convert(fields, Checkpoint)
                self.learner.iteration, self.learner.strokes = self.at.iteration, self.at.strokes
                self.learner.load_state_dict(state)
                self.self_play.load_state_dict(state)
            except (msgspec.ValidationError, KeyError, ValueError, RuntimeError) as error:
                raise TrainingError(
                    f"{self.folder}: the last checkpoint is of another kind of run ({type(error).__name__}: {error}); train "
                    "again with --overwrite"
                ) from error
            self.say(f"continues after iteration {self.at.iteration}")
        elif self.config.warm_start is not None:
            self._warm_start(self.config.warm_start)
        self.metrics.keep(self.at.metrics)

    def _warm_start(self, name: str) -> None:
        policy = tabulate(resolve(name, self.game), self.game)
        weight = exact.visits(policy, policy).states[0]
        with self.console.status(Text(f"imitating {name}")):
            gap = imitate(self.learner.actor, policy, weight, self.generator)
            self.learner.eval_actor.load_state_dict(self.learner.actor.state_dict())
        self.say(f"imitated {name}, {gap:.3f} nats per stroke above its entropy")

    def _save_agent(self, name: str, evaluation: Evaluation) -> None:
        card = {
            "algorithm": self.config.algorithm,
            "config": self.config.fixed(),
            "iterations": self.learner.iteration,
            "strokes": self.learner.strokes,
            "seconds": round(self.at.seconds, 1),
            "evaluation": dataclasses.asdict(evaluation),
            "made_with": self.run.about["packages"],
        }
        weights = weights_of(self.learner.eval_actor, self.config.temperature)
        save_agent(self.folder / name, self.game, weights_file.save(weights), card)

    def _seed(self, *numbers: int) -> int:
        return int(draws.stream(self.config.seed, *numbers)[0] >> np.uint64(1))


def _bar(console: Console) -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=10),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[status]}", table_column=Column(no_wrap=True, overflow="ellipsis")),
    )
    return Progress(*columns, console=console, transient=True, disable=not (console.is_terminal or console.is_jupyter))
