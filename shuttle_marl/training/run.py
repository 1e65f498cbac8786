"""Training runs: iterations, exact evaluations, checkpoints, the run folder, and resuming.

A checkpoint is a folder ``checkpoints/ITERATION`` that is complete or absent. It holds everything that the next iteration depends
on: tensors in ``state.safetensors``, the rest in ``about.json``, which also holds the hash of the tensors.
"""

import contextlib
import dataclasses
import functools
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text
from safetensors import SafetensorError
from safetensors import numpy as weights_file
from safetensors.torch import load, save
from torch.utils.tensorboard import SummaryWriter

from shuttle_marl import exact
from shuttle_marl.base import runs
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import FileReadError, StoredCount, hash_in, problem, read_hashed, read_sealed, replace_with_card
from shuttle_marl.base.interrupts import check_interrupt, interrupts_held, was_interrupted
from shuttle_marl.base.pytorch import InitialWeights, own_settings
from shuttle_marl.exact.known import best_odds, pair_odds
from shuttle_marl.exact.match import Odds, normalised_score
from shuttle_marl.exact.optimal import best_response
from shuttle_marl.exact.profile import InducedChain, evaluate, evaluate_chains, induced
from shuttle_marl.game import draws
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.agents import save_agent
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import REFERENCE
from shuttle_marl.training.config import PPOConfig, SelfPlayConfig, TrainingConfig, TrainingError, missed
from shuttle_marl.training.learner import SEEDS, Learner, RallyCollector, Trainer
from shuttle_marl.training.networks import DivergedError, imitate, tabulated, weights_of
from shuttle_marl.training.ppo import A2C, PPO
from shuttle_marl.training.rally_log import RunLog, open_log
from shuttle_marl.training.sac import SAC
from shuttle_marl.training.self_play import SelfPlayOpponents, n_opponents

_TOLERANCE = 1e-5
"""Error bound of the values, far below the resolution of a learning curve."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Exact figures of a policy, averaged over its opponents.

    Attributes:
        rally_win: probability of winning a rally, averaged over both servers.
        match_win: probability of winning a match with a random first server.
        normalised_score: ``(J(pi) - J(bc)) / (J(best response) - J(bc))``, with J the probability of winning a rally; opponents
            to whom ``bc`` is a best response are left out, None if there are no others.
        exploitability: gain of a best response to the policy, from 0 to 1; None if it was not computed.
    """

    rally_win: float
    match_win: float
    normalised_score: float | None
    exploitability: float | None

    @property
    def score_text(self) -> str:
        """The normalised score, as text."""
        return "no normalised score" if self.normalised_score is None else f"normalised score {self.normalised_score:.3f}"

    @property
    def exploitability_text(self) -> str:
        """The exploitability, as text."""
        return "no exploitability" if self.exploitability is None else f"exploitability {self.exploitability:z.3f}"


class Evaluator:
    """Evaluates policies against fixed opponents; what does not depend on the policy is solved once."""

    def __init__(self, game: Game, opponents: Sequence[TabulatedPolicy]) -> None:
        self._opponents = opponents
        self._reference = tabulate(resolve(REFERENCE, game), game)

    @functools.cached_property
    def _scales(self) -> list[tuple[Odds, Odds]]:
        """Odds of ``bc`` and of the best response against each opponent."""
        reference = pair_odds([(self._reference, opponent) for opponent in self._opponents])
        return list(zip(reference, best_odds(self._opponents), strict=True))

    @functools.cached_property
    def _chains(self) -> list[InducedChain]:
        return [_chain(opponent) for opponent in self._opponents]

    def evaluate(self, policy: TabulatedPolicy, *, exploitability: bool = True) -> Evaluation:
        """Evaluate a policy of the same game; ``exploitability`` takes half of the time."""
        known: TabulatedPolicy | InducedChain
        if policy.game.recovery is None:
            known = own = induced(policy)
            odds = [evaluate_chains(own, chain, tolerance=_TOLERANCE).odds() for chain in self._chains]
        else:  # where the opponent waits changes the chain
            known, odds = policy, [evaluate(policy, opponent, tolerance=_TOLERANCE).odds() for opponent in self._opponents]
        normalised = [
            normalised_score(o.rally, bc.rally, best.rally, error_bound=bc.error_bound + best.error_bound)
            for o, (bc, best) in zip(odds, self._scales, strict=True)
        ]
        scores = [score for score in normalised if score is not None]
        return Evaluation(
            rally_win=float(np.mean([o.rally for o in odds])),
            match_win=float(np.mean([o.match() for o in odds])),
            normalised_score=float(np.mean(scores)) if scores else None,
            exploitability=best_response(known, tolerance=_TOLERANCE).value.odds().value if exploitability else None,
        )


# The runs of a study share their few opponents.
@functools.lru_cache(maxsize=2)
def _chain(opponent: TabulatedPolicy) -> InducedChain:
    return induced(opponent)


CHECKPOINTS: Final = "checkpoints"
"""Folder of the checkpoints in the folder of a run."""
_STATE: Final = "state.safetensors"
_ABOUT: Final = "about.json"
_RETAINED: Final = 2
AGENT: Final = "agent"
"""Folder of the trained agent in the folder of its run."""
BEST: Final = "best"
"""Folder of the best agent: the least exploitable in self-play, else that with the highest probability of winning rallies."""
_PACKAGES: Final = ("numpy", "torch", "torchrl", "tensordict", "numba", "scipy")
LEARNERS: Final[dict[str, Callable[[Any, Game], Learner]]] = {"ppo": PPO, "a2c": A2C, "sac": SAC}
"""Learners by name of the algorithm."""
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
        RunError: the run folder cannot be used.
        TrainingError: the device is not available or the memory is too small; nothing was written. Or learning diverged, the
            device ran out of memory, or a file of the run is damaged or cannot be written; the last checkpoint is intact.
        RecordingError: the rally log cannot be written; the last checkpoint is intact.
        KeyboardInterrupt: Ctrl-C, raised between two iterations; the message says what is saved.
    """
    console = console or Console(quiet=True)
    game = resolve_game(config.game, config.profile)
    names = () if config.self_play else config.opponent
    opponents = [tabulate(resolve(name, game), game) for name in names]
    config = tempered(config, game)
    _check_machine(config, game)
    name = f"{config.algorithm}-{config.seed}"
    opened = runs.open_run(config.out, name, config.fixed(), resume=config.resume, overwrite=config.overwrite)
    with interrupts_held(), opened as folder:

        def saved() -> str:
            number = max((int(path.name) for path in _complete(folder)), default=0)
            return f"iteration {number} of {config.iterations} is saved" if number else "no iteration yet is saved"

        try:
            with resumable(folder, saved), own_settings(config.threads):
                return _Run(config, game, opponents, folder, console).go()
        except torch.OutOfMemoryError as error:
            raise TrainingError(
                f"--device {config.device}: its memory is too small for this run ({_first_line(error)}); the last checkpoint is "
                "intact; train with smaller --batch, --growth or --width, or with --device cpu"
            ) from error


def tempered(config: TrainingConfig, game: Game) -> TrainingConfig:
    """Settings with the temperature of the agent: where perfect play mixes, sharper play than that of rollouts is exploitable."""
    if config.eval_temperature is not None or not config.self_play or game.recovery is None:
        return config
    return dataclasses.replace(config, eval_temperature=config.final_temperature if isinstance(config, PPOConfig) else 1.0)


@contextlib.contextmanager
def resumable(folder: Path, saved: Callable[[], str]) -> Iterator[None]:
    """Say in a KeyboardInterrupt what is saved of a run, and how it continues.

    Raises:
        KeyboardInterrupt: Ctrl-C, or an error that it caused in a library.
    """
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        if not (isinstance(error, KeyboardInterrupt) or was_interrupted()):
            raise
        raise KeyboardInterrupt(f"interrupted; {saved()}; the same with --resume --out {folder} continues") from error


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


def save_checkpoint(run: Path, iteration: int, state: dict[str, torch.Tensor], about: dict[str, Any]) -> None:
    """Write a checkpoint, and remove all but the latest two.

    Raises:
        RunError: the checkpoint cannot be written; earlier ones are intact.
    """
    target = run / CHECKPOINTS / f"{iteration:08d}"
    part = target.with_name(f".{target.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        write_state(part / _STATE, part / _ABOUT, state, about)
        shutil.rmtree(target, ignore_errors=True)
        os.replace(part, target)
    except (OSError, ShuttleError) as error:
        raise runs.RunError(f"{target}: cannot be written ({error}); free some space and continue with --resume") from error
    for old in _complete(run)[:-_RETAINED]:
        shutil.rmtree(old, ignore_errors=True)


def last_checkpoint(run: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]] | None:
    """``about`` and ``state`` of the last checkpoint of a run, see :func:`save_checkpoint`; None if there is none.

    Raises:
        RunError: the last checkpoint is damaged.
    """
    complete = _complete(run)
    if not complete:
        return None
    folder = complete[-1]
    try:
        return read_state(folder / _STATE, folder / _ABOUT)
    except FileReadError as error:
        raise runs.RunError(f"{folder}: cannot be read ({error}); delete it to continue from the one before") from error


def write_state(path: Path, about_path: Path, state: dict[str, torch.Tensor], about: dict[str, Any]) -> None:
    """Write tensors, and then a description with their hash."""
    # Some tensors share their memory, which safetensors refuses.
    replace_with_card(about_path, about, {path.name: save({name: tensor.clone() for name, tensor in state.items()})})


def read_state(path: Path, about_path: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    """Read the description and the tensors of :func:`write_state`.

    Raises:
        FileReadError: a file is missing or damaged.
    """
    try:
        about = read_sealed(about_path)
        return about, load(read_hashed(path, hash_in(about, path.name)))
    except (OSError, ValueError, SafetensorError) as error:
        raise FileReadError(f"{path.name}: {problem(error)}") from error


def _complete(run: Path) -> list[Path]:
    return sorted(path for path in (run / CHECKPOINTS).glob("[0-9]*") if (path / _ABOUT).is_file())


@dataclasses.dataclass(kw_only=True)
class Checkpoint:
    """Progress of a run, in the description of its checkpoints.

    Attributes:
        iteration, strokes: of the trainer.
        stopped: whether the run ended before its last iteration.
    """

    iteration: StoredCount = 0
    game: str
    seconds: float = 0.0
    strokes: StoredCount = 0
    best: float | None = None
    stopped: bool = False
    rallies: StoredCount = 0
    metrics: StoredCount = 0


class _Run:
    def __init__(
        self, config: TrainingConfig, game: Game, opponents: list[TabulatedPolicy], folder: Path, console: Console
    ) -> None:
        self.config, self.game, self.folder, self.console, self.opponents = config, game, folder, console, opponents
        self.limit = config.seconds
        # Self-play is evaluated against the benchmark's opponent.
        evaluated = opponents or [tabulate(resolve("bc", game), game)]
        self.evaluator = Evaluator(game, evaluated)
        self.generator = torch.Generator().manual_seed(self._seed(_WEIGHTS))
        with InitialWeights(self.generator):
            self.learner = LEARNERS[config.algorithm](config, game)
        variant = config if isinstance(config, SelfPlayConfig) and config.variant != "plain" else None
        initial = opponents if variant is None else evaluated * n_opponents(variant)
        collector = RallyCollector(config, game, initial, self.learner.predict, distinct=self.learner.distinct)
        self.self_play = None if variant is None else SelfPlayOpponents(variant, game, self.learner, collector.sampler)
        self.trainer = Trainer(self.learner, collector, None if self.self_play is None else self.self_play.update)
        self.metrics = runs.Journal(folder / runs.METRICS)
        self.about = {
            "status": "running",
            "seed": config.seed,
            **runs.describe(_PACKAGES),
            "game": {"model": config.game, "hash": game.hash, "catalogue": game.catalogue.version},
            "opponents": [opponent.hash for opponent in opponents],
        }
        self.at = Checkpoint(game=game.hash)
        """Progress; its iteration and strokes are those of the last checkpoint."""
        self.evaluation: tuple[TabulatedPolicy, Evaluation] | None = None
        """The latest evaluation, and its policy; a run ends with an evaluation."""
        self.evaluating = 0.0
        """Duration of the latest evaluation [s]."""

    def go(self) -> TrainingRun:
        config, trainer = self.config, self.trainer
        resumed = self._restore()
        runs.write_json(self.folder / runs.MANIFEST, self.about)
        if not resumed and config.warm_start is not None:
            self._warm_start(config.warm_start)
        self.begun = time.monotonic() - self.at.seconds
        with (
            SummaryWriter(str(self.folder / "tensorboard"), purge_step=trainer.strokes + 1 if resumed else None) as board,
            _progress(self.console) as bar,
        ):
            total = config.iterations if config.seconds is None else round(config.seconds)
            bar.add_task(config.algorithm, total=total, completed=round(self._fraction() * total), status="")
            log = None
            if (trainer.iteration < config.iterations and not self.at.stopped) or not (self.folder / runs.RALLIES).exists():
                seeds = [self._segment_seed(segment) for segment in range(config.segments)]
                log = open_log(self.folder, config, self.game, self.opponents, seeds, rallies=self.at.rallies)
            with log or contextlib.nullcontext():
                while trainer.iteration < config.iterations and not self.at.stopped:
                    self._segment(log, board, bar)
        if config.seconds is not None and (warning := missed(time.monotonic() - self.begun, config.seconds)):
            self.say(warning)
        return self._finish()

    def say(self, text: str) -> None:
        self.console.print(f"{self.folder}: {text}", highlight=False, markup=False, soft_wrap=True)

    def _fraction(self) -> float:
        """Fraction of the run that is over, by iterations or by time."""
        part = self.trainer.iteration / self.config.iterations
        return part if self.limit is None else min(1.0, max(part, self.at.seconds / self.limit))

    def _segment(self, log: RunLog | None, board: SummaryWriter, bar: Progress) -> None:
        """Iterations up to the next checkpoint. Random numbers depend on the segment alone, so a resumed run repeats them."""
        config, trainer = self.config, self.trainer
        segment = trainer.iteration // config.checkpoint_every
        seed = trainer.collector.set_seed(self._segment_seed(segment))
        if self.self_play is not None:
            self.self_play.set_seed(seed)

        def collected() -> None:
            if log is not None:
                log.record(trainer.collector.sampler, segment, trainer.iteration - 1)

        for _ in range(min(config.checkpoint_every, config.iterations - trainer.iteration)):
            check_interrupt()
            with self._diverging():
                losses = trainer.iterate(1 - self._fraction(), collected)
            if log is not None:
                log.settle()
            self._after(losses, board, bar)
            if self.at.stopped:
                break
        with self._diverging():
            state = trainer.state_dict() | ({} if self.self_play is None else self.self_play.state_dict())
        # The log is written to disk before the checkpoint, so that it holds all rallies that the checkpoint counts.
        rallies = 0 if log is None else log.flush()
        at = dataclasses.replace(self.at, iteration=trainer.iteration, strokes=trainer.strokes, rallies=rallies)
        save_checkpoint(self.folder, trainer.iteration, state, dataclasses.asdict(at))
        self.at = at

    def _after(self, losses: dict[str, float], board: SummaryWriter, bar: Progress) -> None:
        """Show the progress after an iteration, and evaluate and stop if it is time."""
        config, trainer, at, (task,) = self.config, self.trainer, self.at, bar.tasks
        at.seconds = time.monotonic() - self.begun
        bar.update(task.id, completed=round(self._fraction() * (task.total or 0)))
        # The last evaluation is part of the budget; it takes as long as the one before.
        at.stopped = self.limit is not None and at.seconds + self.evaluating > self.limit
        if trainer.iteration % config.evaluate_every == 0 or trainer.iteration == config.iterations or at.stopped:
            evaluation = self._evaluate(losses, board)
            self.evaluating = time.monotonic() - self.begun - at.seconds
            speed = f"{trainer.strokes / max(at.seconds, 1e-9) / 1e3:.0f} k strokes/s"
            won = f"wins {evaluation.rally_win:.1%} of rallies, {evaluation.match_win:.1%} of matches"
            bar.update(task.id, status=f"{won} · {evaluation.exploitability_text} · {evaluation.score_text} · {speed}")

    @contextlib.contextmanager
    def _diverging(self) -> Iterator[None]:
        """Add the iteration and a remedy to errors of diverged learning."""
        try:
            yield
        except DivergedError as error:
            saved = f"the weights of iteration {self.at.iteration} are kept" if self.at.iteration else "no weights were saved yet"
            raise DivergedError(
                f"{self.folder}: learning diverged in iteration {self.trainer.iteration}: {error}; {saved} in its checkpoints. "
                "Train again with a lower --learning-rate"
            ) from error

    def _evaluate(self, losses: dict[str, float], board: SummaryWriter) -> Evaluation:
        config, at, trainer = self.config, self.at, self.trainer
        with self._diverging():
            self.evaluation = self._evaluated()
        evaluation = self.evaluation[1]
        figures = {**dataclasses.asdict(evaluation), **losses}
        line = {"iteration": trainer.iteration, "strokes": trainer.strokes, "seconds": round(at.seconds, 2), **figures}
        self.metrics.append([line])
        at.metrics += 1
        for name, value in figures.items():
            if value is not None:
                board.add_scalar(name, value, trainer.strokes)
        board.add_scalar("strokes_per_second", trainer.strokes / max(at.seconds, 1e-9), trainer.strokes)
        exploitability, score = evaluation.exploitability, evaluation.normalised_score
        figure = -exploitability if config.self_play and exploitability is not None else evaluation.rally_win
        if at.best is None or figure > at.best:
            at.best = figure
            self._save_agent(BEST, evaluation)
        if config.target is not None and evaluation.match_win >= config.target:
            at.stopped = True
        if config.target_score is not None and score is not None and score >= config.target_score:
            at.stopped = True
        return evaluation

    def _evaluated(self) -> tuple[TabulatedPolicy, Evaluation]:
        policy = tabulated(self.learner.eval_actor, self.game, self.config.temperature)
        exploitability = self.config.exploitability or self.config.self_play
        return policy, self.evaluator.evaluate(policy, exploitability=exploitability)

    def _restore(self) -> bool:
        """Restore the last checkpoint; returns whether there is one."""
        saved = last_checkpoint(self.folder) if self.config.resume else None
        if saved is None:
            self.metrics.keep(0)
            return False
        fields, state = saved
        if fields.get("game") != self.game.hash:
            raise TrainingError(
                f"{self.folder}: was trained on game {str(fields.get('game'))[:12]}, this is {self.game.hash[:12]}; "
                "continue with the same --game, or train again with another --out"
            )
        manifest = self.folder / runs.MANIFEST
        before = runs.read_json(manifest, dict[str, Any]) if manifest.exists() else {}
        if before.get("opponents", self.about["opponents"]) != self.about["opponents"]:
            raise TrainingError(f"{self.folder}: the opponents changed after the run was started; train again with another --out")
        try:
            self.at = msgspec.convert(fields, Checkpoint)
            self.trainer.iteration, self.trainer.strokes = self.at.iteration, self.at.strokes
            self.trainer.load_state_dict(state)
            if self.self_play is not None:
                self.self_play.load_state_dict(state)
        except (msgspec.ValidationError, KeyError, IndexError, TypeError, ValueError, RuntimeError) as error:
            path = self.folder / CHECKPOINTS
            raise TrainingError(
                f"{path}: the last checkpoint is of another kind of run ({type(error).__name__}: {error}); train again with "
                "--overwrite"
            ) from error
        self.metrics.keep(self.at.metrics)
        self.say(f"continues after iteration {self.at.iteration}")
        return True

    def _warm_start(self, name: str) -> None:
        policy = tabulate(resolve(name, self.game), self.game)
        weight = exact.visits(policy, policy).states[0]
        with self.console.status(Text(f"imitating {name}")):
            gap = imitate(self.learner.actor, policy, weight, self.generator)
            self.learner.eval_actor.load_state_dict(self.learner.actor.state_dict())
        self.say(f"imitated {name}, {gap:.3f} nats per stroke above its entropy")

    def _finish(self) -> TrainingRun:
        # None if the resumed run had ended before.
        policy, evaluation = self.evaluation or self._evaluated()
        self._save_agent(AGENT, evaluation)
        finished = {**self.about, "status": "finished", "seconds": round(self.at.seconds, 1)}
        runs.write_json(self.folder / runs.MANIFEST, finished)
        return TrainingRun(
            folder=self.folder,
            iterations=self.trainer.iteration,
            strokes=self.trainer.strokes,
            evaluation=evaluation,
            policy=policy,
        )

    def _save_agent(self, name: str, evaluation: Evaluation) -> None:
        card = {
            "algorithm": self.config.algorithm,
            "config": self.config.fixed(),
            "iterations": self.trainer.iteration,
            "strokes": self.trainer.strokes,
            "seconds": round(self.at.seconds, 1),
            "evaluation": dataclasses.asdict(evaluation),
            "made_with": self.about["packages"],
        }
        weights = weights_of(self.learner.eval_actor, self.config.temperature)
        save_agent(self.folder / name, self.game, weights_file.save(weights), card)

    def _segment_seed(self, segment: int) -> int:
        return self._seed(_SEGMENT, segment) % SEEDS

    def _seed(self, *numbers: int) -> int:
        return int(draws.stream(self.config.seed, *numbers)[0] >> np.uint64(1))


def _progress(console: Console) -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=10),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[status]}", table_column=Column(no_wrap=True, overflow="ellipsis")),
    )
    return Progress(*columns, console=console, transient=True, disable=not (console.is_terminal or console.is_jupyter))
