"""A training run from its configuration to its folder: collect, learn, evaluate, save, and go on after a kill."""

import dataclasses
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from safetensors.torch import save
from torch.utils.tensorboard import SummaryWriter

from shuttle_marl import exact, runs
from shuttle_marl.files import replace_file
from shuttle_marl.game import draws
from shuttle_marl.game.rally import Game
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.table import TabulatedPolicy, tabulate
from shuttle_marl.policy.agents import save_agent
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training.a2c import A2C
from shuttle_marl.training.checkpoints import finite, last_checkpoint, save_checkpoint
from shuttle_marl.training.collecting import Strokes, seeds
from shuttle_marl.training.config import TrainingConfig, TrainingError
from shuttle_marl.training.evaluation import Evaluation, Evaluator
from shuttle_marl.training.inference import imitate, logit_network, tabulated
from shuttle_marl.training.learner import Learner, NotFiniteError, Tensors
from shuttle_marl.training.objective import Objective
from shuttle_marl.training.ppo import PPO
from shuttle_marl.training.recorded import RALLIES, NoLog, RunLog, open_log
from shuttle_marl.training.sac import SAC

AGENT: Final = "agent"
"""Folder of the trained agent in the folder of its run."""
METRICS: Final = "metrics.jsonl"
_PACKAGES: Final = ("numpy", "torch", "torchrl", "tensordict", "numba", "scipy")
_LEARNERS: Final[dict[str, Callable[[Any, Game], Learner]]] = {"ppo": PPO, "a2c": A2C, "sac": SAC}
_FIRST, _SEGMENT = 0, 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingRun:
    """A finished run.

    Attributes:
        folder: the run folder; the agent lies in ``agent`` there.
        iterations: how many were run.
        evaluation: of the final weights.
        policy: the agent on every state.
    """

    folder: Path
    iterations: int
    evaluation: Evaluation
    policy: TabulatedPolicy


def train(config: TrainingConfig, console: Console | None = None) -> TrainingRun:
    """Train an agent, or go on training it, and write its run folder.

    Args:
        config: what to train, and against whom.
        console: shows progress; None shows nothing.

    Raises:
        PolicyError: an opponent cannot be found or is no distribution over the legal strokes; nothing was written.
        GameError: the model cannot be found; nothing was written.
        RunError: the run folder cannot be used.
        TrainingError: learning went astray, or a checkpoint cannot be written; the last checkpoint is whole.
        RecordingError: the rally log cannot be written any further; the last checkpoint is whole.
    """
    console = console or Console(quiet=True)
    game = load_game(config.game)
    names = () if config.self_play else config.opponent
    opponents = [tabulate(resolve(name, game), game, name) for name in names]
    name = f"{config.algorithm}-{config.seed}"
    with runs.open_run(config.out, name, config.fixed(), resume=config.resume, overwrite=config.overwrite) as folder:
        return _Run(config, game, opponents, folder, console).go()


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
        self.objective = Objective(config, game)
        self.strokes = Strokes(config, game, opponents, self.learner.actor)
        self.opponents = opponents
        self.iteration, self.seconds = 0, 0.0
        self.stopped = False
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
        saved = self._restore()
        runs.write_json(self.folder / runs.MANIFEST, about)
        if saved is None and config.warm_start is not None:
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
                log.abort()
                raise
            finally:
                self.strokes.close()
            log.close()
        return self._finish(about)

    def _open_log(self) -> RunLog:
        config, ended = self.config, self.iteration >= self.config.iterations or self.stopped
        if ended and (self.folder / RALLIES).exists():
            return NoLog()
        segments = range(-(-config.iterations // config.checkpoint_every))
        environments = [seeds(self._seed(_SEGMENT, segment), config.processes) for segment in segments]
        return open_log(self.folder, config, self.game, self.opponents, environments, rallies=self.rallies)

    def _segment(self, after: Callable[[dict[str, float]], None], log: RunLog) -> None:
        """Iterations up to the next checkpoint. Their draws depend on its number alone, so a resumed run repeats them."""
        config = self.config
        segment = self.iteration // config.checkpoint_every
        self.strokes.begin(self._seed(_SEGMENT, segment))
        log.begin(segment)
        for _ in range(min(config.checkpoint_every, config.iterations - self.iteration)):
            data = self.strokes.collect()
            paid = data["next", "reward"]
            if not self.objective.plain:
                data["next", "reward"] = self.objective.rewards(data)
            try:
                losses = self.learner.learn(data, 1 - self.iteration / config.iterations)
            except NotFiniteError as error:
                raise self._astray(str(error)) from error
            data["next", "reward"] = paid
            log.add(data, self.iteration)
            self.iteration += 1
            after(losses)
            if self.stopped:
                break
        state = self.learner.state()
        if not finite(state):
            raise self._astray("a weight is no finite number")
        # The log is on the disk before the checkpoint is, so that a resumed run finds all that the checkpoint counts.
        self.rallies = log.flush()
        about = {"game": self.game.hash, "seconds": self.seconds, "stopped": self.stopped, "rallies": self.rallies}
        save_checkpoint(self.folder, self.iteration, state, about)

    def _astray(self, what: str) -> NotFiniteError:
        saved = last_checkpoint(self.folder)
        kept = f"the weights of iteration {saved[0]['iteration']} are kept" if saved else "no weights were saved yet"
        return NotFiniteError(
            f"{self.folder}: {what} in iteration {self.iteration + 1}; {kept} in its checkpoints. "
            "Train anew with a lower --learning-rate"
        )

    def _evaluate(self, losses: dict[str, float], board: SummaryWriter) -> Evaluation:
        evaluation = self.evaluator.evaluate(tabulated(self.learner.actor, self.game))
        strokes = self.iteration * self.config.frames
        figures = {**dataclasses.asdict(evaluation), **losses}
        line = {"iteration": self.iteration, "strokes": strokes, "seconds": round(self.seconds, 2), **figures}
        with (self.folder / METRICS).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        for name, value in figures.items():
            board.add_scalar(name, value, strokes)
        board.add_scalar("strokes_per_second", strokes / max(self.seconds, 1e-9), strokes)
        if self.config.target is not None and evaluation.match_win >= self.config.target:
            self.stopped = True
        return evaluation

    def _now(self, evaluation: Evaluation) -> str:
        speed = self.iteration * self.config.frames / max(self.seconds, 1e-9)
        return (
            f"{speed / 1e3:.0f} k strokes/s · wins {evaluation.rally_win:.1%} of rallies, {evaluation.match_win:.1%} of "
            f"matches · score {evaluation.normalised_score:.3f} · exploitability {evaluation.exploitability:.3f}"
        )

    def _restore(self) -> Tensors | None:
        saved = last_checkpoint(self.folder) if self.config.resume else None
        if saved is None:
            (self.folder / METRICS).unlink(missing_ok=True)
            return None
        about, state = saved
        if about.get("game") != self.game.hash:
            raise TrainingError(
                f"{self.folder}: was trained on game {str(about.get('game'))[:12]}, this is {self.game.hash[:12]}; "
                "go on with the same --game, or train anew with another --out"
            )
        self.iteration, self.seconds, self.stopped = about["iteration"], about["seconds"], about["stopped"]
        self.rallies = about["rallies"]
        self.learner.restore(state)
        path = self.folder / METRICS
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
        kept = [line for line in lines if line.endswith("\n") and json.loads(line)["iteration"] <= self.iteration]
        replace_file(path, "".join(kept).encode())
        self.console.print(f"{self.folder}: goes on after iteration {self.iteration}", highlight=False)
        return state

    def _warm_start(self, name: str) -> None:
        policy = tabulate(resolve(name, self.game), self.game, name)
        seen = exact.visits(policy, policy).pairs(0)
        weight = np.asarray(np.bincount(self.game.pair_state, seen, self.game.n_states), dtype=np.float64)
        with self.console.status(f"imitating {name}"):
            gap = imitate(self.learner.actor, policy, weight)
        self.console.print(f"imitated {name}: {gap:.3f} nats a stroke from it", highlight=False)

    def _finish(self, about: dict[str, Any]) -> TrainingRun:
        policy = tabulated(self.learner.actor, self.game)
        evaluation = self.evaluator.evaluate(policy)
        network = {name: tensor.clone() for name, tensor in logit_network(self.learner.actor).state_dict().items()}
        card = {
            "algorithm": self.config.algorithm,
            "config": self.config.fixed(),
            "iterations": self.iteration,
            "strokes": self.iteration * self.config.frames,
            "seconds": round(self.seconds, 1),
            "evaluation": dataclasses.asdict(evaluation),
            "made_with": about["packages"],
        }
        save_agent(self.folder / AGENT, policy, save(network), card)
        runs.write_json(self.folder / runs.MANIFEST, {**about, "status": "finished", "seconds": round(self.seconds, 1)})
        return TrainingRun(folder=self.folder, iterations=self.iteration, evaluation=evaluation, policy=policy)

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
