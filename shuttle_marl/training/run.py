"""Training runs: an algorithm iterates, and its callback evaluates, records and saves in the run folder; one seed or many."""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn, track
from rich.table import Column
from safetensors import SafetensorError
from safetensors import numpy as weights_file
from safetensors.torch import load
from torch.utils.tensorboard import SummaryWriter

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import check_processes, in_processes
from shuttle_marl.base.files import StoredCount
from shuttle_marl.base.intervals import interquartile_mean
from shuttle_marl.base.pytorch import InitialWeights, own_settings
from shuttle_marl.base.runs import check_interrupt, interrupts_held
from shuttle_marl.exact.fixed_point import Odds
from shuttle_marl.exact.odds import best_odds, normalised_score, pair_odds
from shuttle_marl.exact.optimal import best_response
from shuttle_marl.exact.profile import evaluate
from shuttle_marl.game import draws
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.agents import read_card, save_agent
from shuttle_marl.policy.registry import tabulated as tables_of
from shuttle_marl.policy.scorecard import REFERENCE
from shuttle_marl.training.config import SEEDS, PPOConfig, TrainingConfig, TrainingError
from shuttle_marl.training.learner import STATE, Callback, Learner, stored
from shuttle_marl.training.networks import DivergedError, tabulated, weights_of
from shuttle_marl.training.ppo import A2C, PPO
from shuttle_marl.training.rally_log import open_log
from shuttle_marl.training.sac import SAC
from shuttle_marl.training.self_play import SelfPlayOpponents, n_opponents

AGENT: Final = "agent"
BEST: Final = "best"  # folder of the best agent: the least exploitable in self-play, else that which wins most rallies
PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")
LEARNERS: Final[dict[str, Callable[..., Learner]]] = {"ppo": PPO, "a2c": A2C, "sac": SAC}
_WEIGHTS, _SEGMENT = 0, 1  # streams of random numbers: initial weights, and segments between checkpoints
_TOLERANCE: Final = 1e-5  # error bound of evaluations, far below the resolution of a learning curve


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
    def text(self) -> str:
        """Score and exploitability, as text."""
        score = "no normalised score" if self.normalised_score is None else f"normalised score {self.normalised_score:.3f}"
        return f"{score}, {'no exploitability' if self.exploitability is None else f'exploitability {self.exploitability:z.3f}'}"


class Evaluator:
    """Evaluates policies against fixed opponents; what does not depend on the policy is solved once."""

    def __init__(self, game: Game, opponents: Sequence[TabulatedPolicy], reference: TabulatedPolicy | None = None) -> None:
        self._opponents, self._reference = opponents, reference or tables_of(REFERENCE, game)[0]

    @functools.cached_property
    def _scales(self) -> list[tuple[Odds, Odds]]:
        reference = pair_odds([(self._reference, opponent) for opponent in self._opponents])
        return list(zip(reference, best_odds(self._opponents), strict=True))

    def evaluate(self, policy: TabulatedPolicy, *, exploitability: bool = True) -> Evaluation:
        """Evaluate a policy of the same game; ``exploitability`` takes half of the time."""
        odds = [evaluate(policy, opponent, tolerance=_TOLERANCE).odds() for opponent in self._opponents]
        scores = [
            score
            for o, (bc, best) in zip(odds, self._scales, strict=True)
            if (score := normalised_score(o.rally, bc.rally, best.rally, error_bound=bc.error_bound + best.error_bound))
            is not None
        ]
        return Evaluation(
            rally_win=float(np.mean([o.rally for o in odds])),
            match_win=float(np.mean([o.match() for o in odds])),
            normalised_score=float(np.mean(scores)) if scores else None,
            exploitability=best_response(policy, tolerance=_TOLERANCE).value.odds().value if exploitability else None,
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingRun:
    """A finished run.

    Attributes:
        folder: the run folder, with the agent in its folder ``agent``.
        seconds: time of its iterations and evaluations, also before it was resumed.
    """

    folder: Path
    iterations: int
    strokes: int
    seconds: float
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
        TrainingError: the device is not available; nothing was written. Or learning diverged, the device ran out of memory, or a
            file of the run is damaged or cannot be written; the last checkpoint is intact.
        RecordingError: the rally log cannot be written; the last checkpoint is intact.
        KeyboardInterrupt: Ctrl-C, raised between two iterations; the message says what is saved.
    """
    game = resolve_game(config.game, config.profile)
    reference, *opponents = tables_of([REFERENCE, *(() if config.self_play else config.opponent)], game)
    config = tempered(config, game)
    check_device(config.device)
    name, fixed = f"{config.algorithm}-{config.seed}", config.fixed()
    opened = runs.open_run(config.out, name, fixed, resume=config.resume, overwrite=config.overwrite)
    with interrupts_held(), opened as run, run.resumable(lambda: _saved(run, config)), own_settings(config.threads):
        return _Training(config, game, reference, opponents, run, console or Console(quiet=True)).go()


def _saved(run: runs.Run, config: TrainingConfig) -> str:
    return f"iteration {run.last} of {config.iterations} is saved" if run.last else "no iteration is saved yet"


def game_of(model: str, game: Game) -> dict[str, str]:
    """The game of a run in its manifest."""
    return {"model": model, "hash": game.hash, "catalogue": game.catalogue.version}


def tempered(config: TrainingConfig, game: Game) -> TrainingConfig:
    """Settings with the temperature of the agent: where perfect play mixes, sharper play than that of rollouts is exploitable."""
    if config.eval_temperature is not None or not config.self_play or not game.hides:
        return config
    return dataclasses.replace(config, eval_temperature=config.final_temperature if isinstance(config, PPOConfig) else 1.0)


def check_device(device: str) -> None:
    """Check that PyTorch can compute on a device. Raises TrainingError: the device is not available."""
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        hint = "; cuda needs an NVIDIA GPU with its driver, and a build of PyTorch for CUDA" if "cuda" in device else ""
        raise TrainingError(f"--device {device}: cannot be used here ({_first_line(error)}); --device cpu can{hint}") from error


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


@dataclasses.dataclass(kw_only=True)
class Checkpoint:
    """Progress of a run, in the description of its checkpoints.

    Attributes:
        iteration, strokes: of the learner at the last checkpoint.
        rallies, metrics: numbers of recorded rallies at the last checkpoint, and of evaluations.
    """

    iteration: StoredCount = 0
    seconds: float = 0.0
    strokes: StoredCount = 0
    best: float | None = None  # figure of the best evaluation
    stopped: bool = False  # whether the run ended before its last iteration
    rallies: StoredCount = 0
    metrics: StoredCount = 0


@dataclasses.dataclass(eq=False)
class _Training(Callback):
    """A run: the loop over the iterations of its learner, and what happens in each of them."""

    config: TrainingConfig
    game: Game
    reference: TabulatedPolicy
    opponents: list[TabulatedPolicy]
    run: runs.Run
    console: Console
    at: Checkpoint = dataclasses.field(default_factory=Checkpoint)
    evaluation: tuple[TabulatedPolicy, Evaluation] | None = None  # the latest one, with its policy; a run ends with one

    def __post_init__(self) -> None:
        config, game, self.folder = self.config, self.game, self.run.folder
        # Self-play is evaluated against the benchmark's opponent.
        self.evaluator = Evaluator(game, self.opponents or [self.reference], self.reference)
        with InitialWeights(self._seed(_WEIGHTS)):
            opponents = self.opponents or [self.reference] * n_opponents(config)
            self.learner = LEARNERS[config.algorithm](config, game, opponents)
        self.self_play = SelfPlayOpponents(config, game, self.learner)
        self.metrics = runs.Journal(self.folder / runs.METRICS)

    def go(self) -> TrainingRun:
        config, learner, run = self.config, self.learner, self.run
        same = {"game": game_of(config.game, self.game), "opponents": [each.hash for each in self.opponents]}
        run.begin(PACKAGES, same=same, seed=config.seed)
        self._restore()
        self.begun = time.monotonic() - self.at.seconds
        seeds = [self._seed(_SEGMENT, segment) % SEEDS for segment in range(config.segments)]
        recorded = self._over and (self.folder / runs.RALLIES).exists()
        self.log = open_log(self.folder, config, self.game, self.opponents, seeds, self.at.rallies, record=not recorded)
        purge = learner.strokes + 1 if learner.iteration else None
        with SummaryWriter(str(self.folder / "tensorboard"), purge_step=purge) as self.board, _bar(self.console) as self.bar:
            self.bar.add_task(config.algorithm, total=config.iterations, completed=learner.iteration, status="")
            with self.log:
                self._iterate()
        policy, evaluation = self.evaluation or self._evaluated()  # None if the resumed run had ended before
        self._save_agent(AGENT, evaluation)
        run.finish(seconds=round(self.at.seconds, 1))
        return TrainingRun(
            folder=self.folder,
            iterations=learner.iteration,
            strokes=learner.strokes,
            seconds=round(self.at.seconds, 1),
            evaluation=evaluation,
            policy=policy,
        )

    def say(self, text: str) -> None:
        self.console.print(f"{self.folder}: {text}", highlight=False, markup=False, soft_wrap=True)

    @property
    def _over(self) -> bool:
        return self.at.stopped or self.learner.iteration >= self.config.iterations

    def _iterate(self) -> None:
        """Iterate to the end; random numbers depend on the segment between two checkpoints alone: a resumed run repeats them."""
        learner = self.learner
        try:
            while not self._over:
                check_interrupt()
                self.segment, done = divmod(learner.iteration, self.config.checkpoint_every)
                if not done:
                    self.self_play.set_seed(learner.collector.set_seed(self._seed(_SEGMENT, self.segment) % SEEDS))
                learner.iterate(1 - learner.iteration / self.config.iterations, self)
        except DivergedError as error:
            saved = f"the weights of iteration {self.at.iteration} are kept" if self.at.iteration else "no weights were saved yet"
            raise DivergedError(
                f"{self.folder}: learning diverged in iteration {learner.iteration}: {error}; {saved} in its checkpoints. "
                "Train again with a lower --learning-rate"
            ) from error
        except torch.OutOfMemoryError as error:
            raise TrainingError(
                f"--device {self.config.device}: its memory is too small for this run ({_first_line(error)}); the last "
                "checkpoint is intact; train with smaller --batch, --growth or --width, or with --device cpu"
            ) from error

    def begin(self, learner: Learner) -> None:
        """Update the opponents of self-play."""
        self.self_play.update(learner.iteration)

    def collected(self, learner: Learner) -> None:
        self.log.record(learner.collector.sampler, self.segment, learner.iteration - 1)

    def learned(self, learner: Learner, losses: dict[str, float]) -> None:
        self.log.settle()
        config, at, (task,) = self.config, self.at, self.bar.tasks
        at.seconds = time.monotonic() - self.begun
        self.bar.update(task.id, completed=learner.iteration)
        if learner.iteration % config.evaluate_every == 0 or self._over:
            evaluation = self._evaluate(losses)
            speed = f"{learner.strokes / max(at.seconds, 1e-9) / 1e3:.0f} k strokes/s"
            won = f"wins {evaluation.rally_win:.1%} of rallies, {evaluation.match_win:.1%} of matches"
            self.bar.update(task.id, status=f"{won} · {evaluation.text} · {speed}")
        if learner.iteration % config.checkpoint_every == 0 or self._over:
            state = {**learner.state_dict(), **self.self_play.state_dict()}
            # The log is written to disk before the checkpoint, so that it holds all rallies that the checkpoint counts.
            at.iteration, at.strokes, at.rallies = learner.iteration, learner.strokes, self.log.flush()
            self.run.save(learner.iteration, dataclasses.asdict(at), {STATE: stored(state)})

    def _evaluate(self, losses: dict[str, float]) -> Evaluation:
        config, at, learner = self.config, self.at, self.learner
        self.evaluation = self._evaluated()
        evaluation = self.evaluation[1]
        figures = {**dataclasses.asdict(evaluation), **losses}
        line = {"iteration": learner.iteration, "strokes": learner.strokes, "seconds": round(at.seconds, 2), **figures}
        self.metrics.append([line])
        at.metrics += 1
        for name, value in {**figures, "strokes_per_second": learner.strokes / max(at.seconds, 1e-9)}.items():
            if value is not None:
                self.board.add_scalar(name, value, learner.strokes)
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
        if (saved := self.run.saved(STATE)) is not None:
            try:
                self.at, state = msgspec.convert(saved[0], Checkpoint), load(*saved[1])
                self.learner.iteration, self.learner.strokes = self.at.iteration, self.at.strokes
                self.learner.load_state_dict(state)
                self.self_play.load_state_dict(state)
            except (msgspec.ValidationError, SafetensorError, KeyError, ValueError, RuntimeError) as error:
                raise TrainingError(
                    f"{self.folder}: the last checkpoint is of another kind of run ({type(error).__name__}: {error}); train "
                    "again with --overwrite"
                ) from error
            self.say(f"continues after iteration {self.at.iteration}")
        self.metrics.keep(self.at.metrics)

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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """Finished runs that differ only in their seeds.

    Attributes:
        folder: run folder, with a folder ``seed-N`` for each seed.
        evaluations: by seed, its strokes, its seconds, and its last exact figures by name.
        figures: by name, the interquartile mean over the seeds with its 95 % interval, and the lowest and highest value.
    """

    folder: Path
    evaluations: dict[int, dict[str, float | None]]
    figures: dict[str, dict[str, float]]


def train_seeds(config: TrainingConfig, seeds: int, jobs: int, console: Console | None = None) -> Study:
    """Train with the seeds ``config.seed`` to ``config.seed + seeds - 1``.

    Args:
        config: settings of each run; ``out``, ``resume`` and ``overwrite`` are those of the common folder.
        seeds: number of runs, 2 or more.
        jobs: number of parallel processes; does not change the results.
        console: shows progress; None: silent.

    Raises:
        TrainingError: too few seeds or jobs, or a run failed (:func:`train`); finished runs are kept.
        RunError: the folder cannot be used.
        ClusterError: processes cannot be started.
        KeyboardInterrupt: Ctrl-C; the message says what is saved.
    """
    if seeds < 2 or jobs < 1:
        raise TrainingError(f"--seeds {seeds} --jobs {jobs}: expected at least 2 seeds and 1 job")
    check_processes(min(jobs, seeds))
    name, fixed = f"{config.algorithm}-{seeds}-seeds", {**config.fixed(), "seeds": seeds}
    with runs.open_run(config.out, name, fixed, resume=config.resume, overwrite=config.overwrite) as run:
        run.begin(PACKAGES, same={})
        folders = {seed: run.folder / f"seed-{seed}" for seed in range(config.seed, config.seed + seeds)}
        configs = [
            dataclasses.replace(config, seed=seed, out=out, resume=False, overwrite=False) for seed, out in folders.items()
        ]
        with run.resumable(lambda: f"{sum(map(runs.is_finished, folders.values()))} of {seeds} runs are finished"):
            train_all(configs, jobs, console or Console(quiet=True))
        cards = {seed: read_card(out / AGENT) for seed, out in folders.items()}
        evaluations = {
            seed: {"strokes": card["strokes"], "seconds": card["seconds"], **card["evaluation"]} for seed, card in cards.items()
        }
        figures = _figures([card["evaluation"] for card in cards.values()])
        study = Study(folder=run.folder, evaluations=evaluations, figures=figures)
        found = {"figures": study.figures, "seeds": {str(seed): each for seed, each in evaluations.items()}}
        runs.write_json(run.folder / runs.RESULTS, {**runs.describe(PACKAGES), **found})
        run.finish()
    return study


def _figures(evaluations: Sequence[dict[str, float | None]]) -> dict[str, dict[str, float]]:
    figures = {}
    for name in evaluations[0]:
        values = [value for evaluation in evaluations if (value := evaluation[name]) is not None]
        if len(values) == len(evaluations):
            middle = interquartile_mean([values])
            figures[name] = {**middle._asdict(), "lowest": min(values), "highest": max(values)}
    return figures


def _train(config: TrainingConfig) -> None:
    assert config.out is not None
    train(dataclasses.replace(config, resume=(config.out / runs.CONFIG).exists()))


def train_all(configs: Sequence[TrainingConfig], jobs: int, console: Console) -> None:
    """Start or resume training runs in this order, in ``jobs`` processes that end with this one; results do not depend on it."""
    done = in_processes(_train, configs, min(jobs, len(configs)))
    for _ in track(done, "training", len(configs), console=console, transient=True):
        pass
