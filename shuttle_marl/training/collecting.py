"""Strokes to learn from: TorchRL's collectors on the batched environments, the shaping of rewards, and the log of the rallies.

A collector is named by a seed that can be given again. Shaped rewards hold a bonus for shot types, and aversion to losing points
by one's own faults: the return of a rally is G = +1 or -1, and -1 - c where it was lost by an own fault, with c the cost of a
fault. Aversion to risk is the entropic risk measure: the agent minimises rho(-G) = log(E exp(-b G)) / b (Föllmer & Schied 2002)
with b the aversion. As G takes three values only, this is the same as maximising an expected reward with u(g) = -exp(-b g),
scaled so that u(1) = 1 and u(-1) = -1: a loss by an own fault counts -1 - k, where

    k = 2 (exp(b (1 + c)) - exp(b)) / (exp(b) - exp(-b)),    k = c for b = 0.

So without a cost of faults (c = 0) no aversion to risk changes anything: a rally is won or lost, and minimising the
risk of losing is maximising the probability of winning. The cost is charged as its expectation, k times the probability of
a fault of the stroke chosen, which is the same on average and varies less.

The log holds every rally that the collectors play, without a share in what is learned. The learner sees its own strokes alone;
in the recorder's thread :class:`~shuttle_marl.kernel.BatchLog` plays them once more on the seed of the environment, and so
knows the rest. Every checkpoint begins with draws of its own, so a pairing of the log is what one process plays between two
checkpoints, and its key is the seed of that environment. Rallies that a checkpoint interrupts are not played to their end, and
not recorded.
"""

import dataclasses
import functools
import importlib
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from tensordict import TensorDictBase
from torchrl import collectors
from torchrl._utils import seed_generator
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor

from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.game.rally import ONE, Game, IllegalStrokeError
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.kernel import BatchLog, RallyBatch, VersusBatch
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyRecorder, RecordingError, Sampling
from shuttle_marl.recording.kernel_rallies import single_rallies_of
from shuttle_marl.recording.recover import resume
from shuttle_marl.training.config import TrainingConfig, TrainingError

_SEEDS = 1 << 31
"""TorchRL hands seeds to numpy and torch, which take 32 bits."""


def seeds(seed: int, processes: int) -> tuple[int, ...]:
    """Seeds of the environments of all processes, of which :meth:`Collector.begin` is given one number."""
    found = [seed % _SEEDS]
    while len(found) < processes:
        found.append(seed_generator(found[-1]))  # as TorchRL hands them on
    return tuple(found)


class Collector:
    """Collects the strokes of one iteration after another.

    Args:
        config: rows, steps, processes, device.
        game: the tables.
        opponents: of the learner; none in self-play.
        actor: the policy that collects.
    """

    def __init__(
        self, config: TrainingConfig, game: Game, opponents: Sequence[TabulatedPolicy], actor: ProbabilisticActor
    ) -> None:
        self._config, self._actor = config, actor
        rows = config.rows // config.processes
        self._make: Callable[[], EnvBase] = functools.partial(_environment, game, tuple(opponents), rows)
        self._collector: Any = None

    def begin(self, seed: int) -> None:
        """Begin again: from here on, what is collected depends on this seed and on the weights alone."""
        seed %= _SEEDS
        torch.manual_seed(seed)
        if self._config.processes == 1 and self._config.collector == "local":
            self.close()
            env = self._make()
            env.set_seed(seed)
            self._collector = self._one(env)
        elif self._collector is None:
            self._collector = self._several()
            self._collector.set_seed(seed)
        else:
            self._collector.set_seed(seed)  # which also begins again

    def collect(self) -> TensorDictBase:
        """``[rows, steps]`` strokes by the present weights."""
        assert self._collector is not None, "begin() comes first"
        self._collector.update_policy_weights_()
        data: TensorDictBase = self._collector.next()
        return data.reshape(self._config.rows, self._config.steps)

    def close(self) -> None:
        """End the processes."""
        if self._collector is not None:
            self._collector.shutdown()
            self._collector = None

    def _options(self) -> dict[str, Any]:
        device = torch.device(self._config.device)
        devices = {} if device.type == "cpu" else {"policy_device": device, "storing_device": device, "env_device": "cpu"}
        return {"frames_per_batch": self._config.frames, **devices}

    def _one(self, env: EnvBase) -> collectors.Collector:
        return collectors.Collector(
            env,
            self._actor,
            total_frames=-1,
            track_traj_ids=False,
            auto_register_policy_transforms=False,
            **self._options(),
        )

    def _several(self) -> Any:
        makers = [self._make] * self._config.processes
        if self._config.collector == "ray":
            return _ray_collector(makers, self._actor, self._options())
        return collectors.MultiSyncCollector(
            makers,
            self._actor,
            total_frames=-1,
            cat_results=0,
            auto_register_policy_transforms=False,
            **self._options(),
        )


class _SeededCollector(collectors.Collector):
    """A collector in a process of its own, which `set_seed` begins again, as it does those of MultiSyncCollector."""

    def set_seed(self, seed: int, static_seed: bool = False) -> int:
        torch.manual_seed(seed)
        following = super().set_seed(seed, static_seed)
        self.reset()
        return int(following)


def _ray_collector(makers: Sequence[Callable[[], EnvBase]], actor: ProbabilisticActor, options: dict[str, Any]) -> Any:
    """A collector on the Ray cluster that RAY_ADDRESS names, or on one that is started on this machine.

    Raises:
        TrainingError: Ray is not installed.
    """
    try:
        ray = importlib.import_module("ray")
    except ModuleNotFoundError as error:
        raise TrainingError("--collector ray: Ray is not installed; `pip install ray` on every machine installs it") from error
    from torchrl.collectors.distributed import RayCollector  # noqa: PLC0415

    # Ray would hide GPUs from processes that asked for none, and says so at length.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if not ray.is_initialized():
        ray.init(
            log_to_driver=False, logging_level="ERROR", **({} if "RAY_ADDRESS" in os.environ else {"include_dashboard": False})
        )
    return RayCollector(
        list(makers),
        actor,
        total_frames=sys.maxsize,
        sync=True,
        collector_class=_SeededCollector,
        collector_kwargs={"track_traj_ids": False, "auto_register_policy_transforms": False},
        remote_configs={"num_cpus": 1, "num_gpus": 0},
        ray_init_config={},
        **options,
    )


def _environment(game: Game, opponents: Sequence[TabulatedPolicy], rows: int) -> EnvBase:
    return VersusEnv(rows, opponents=opponents, game=game) if opponents else RallyEnv(rows, game=game)


def fault_penalty(cost: float, aversion: float) -> float:
    """Penalty k above: a loss by an own fault counts -1 - k.

    Args:
        cost: c, from 0 on.
        aversion: b, from 0 on.
    """
    if aversion == 0:
        return cost
    return 2 * math.exp(aversion) * math.expm1(aversion * cost) / (2 * math.sinh(aversion))


class RewardShaping:
    """Adds bonus and penalty to rewards.

    Args:
        config: of the run.
        game: the tables.
    """

    def __init__(self, config: TrainingConfig, game: Game) -> None:
        bonus = np.zeros(len(SHOTS))
        for shot, points in config.bonuses().items():
            bonus[SHOTS.index(shot)] = points
        penalty = fault_penalty(config.fault_cost, config.risk_aversion)
        self._game, self._penalty = game, penalty
        self._bonus = bonus[game.catalogue.shot]

    def rewards(self, data: TensorDictBase) -> torch.Tensor:
        """``[..., 1]`` rewards of what was collected, with bonus and penalty added to those of the rules."""
        game = self._game
        state = game.state_of(*np.moveaxis(data["observation"].cpu().numpy(), -1, 0))
        stroke = data["action"].cpu().numpy()
        fault = game.limits_of(game.pair(state, stroke))[..., 0].astype(np.float64) / ONE
        added = (self._bonus[stroke] - self._penalty * fault).astype(np.float32)
        reward: torch.Tensor = data["next", "reward"]
        return reward + torch.from_numpy(added).unsqueeze(-1).to(reward.device)


RALLIES: Final = "rallies.mcap"
"""The rally log in the folder of a run."""
_ENTRIES: Final = {"log_probability": "action_log_prob", "value": "state_value"}
"""Columns of the log, and what they are called in what is collected."""
_COLUMNS: Final = {"ppo": ("update", *_ENTRIES), "a2c": ("update", *_ENTRIES), "sac": ("update",)}
_STROKES_A_STEP: Final = 2
"""The learner's stroke and the reply to it, to count what waits."""


def open_log(
    folder: Path,
    config: TrainingConfig,
    game: Game,
    opponents: Sequence[TabulatedPolicy],
    seeds: Sequence[Sequence[int]],
    *,
    rallies: int,
) -> "RunLog | None":
    """The log of a run, or of the rest of one; None where nothing is recorded.

    Rallies on a Ray cluster are not recorded: which of its processes a stroke comes from is not known here.

    Args:
        folder: of the run.
        config: of the run.
        game: the tables.
        opponents: in the order of ``config.opponent``.
        seeds: of the environments, by segment and process.
        rallies: number in the log at the checkpoint from which the run continues.

    Raises:
        RecordingError: the log cannot be written, or holds fewer rallies than that.
    """
    if not Sampling.parse(config.record).every or config.collector == "ray":
        return None
    names = () if config.self_play else config.opponent
    header = LogHeader(
        seed=config.seed,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=(
            Player(name=f"{config.algorithm}-{config.seed}"),
            *(Player(name=name, hash=policy.hash) for name, policy in zip(names, opponents, strict=True)),
        ),
        pairings=tuple(seed for segment in seeds for seed in segment),
        matches_per_draw=1,
        rules=SINGLE_RALLY,
        draws="training",
        record=config.record,
        columns=_COLUMNS[config.algorithm],
    )
    rows, figures = config.rows // config.processes, sum(name in _ENTRIES for name in header.columns)
    logs = [
        BatchLog(VersusBatch(game, rows, opponents=opponents) if opponents else RallyBatch(game, rows), extra=figures)
        for _ in range(config.processes)
    ]
    recorder = RallyRecorder(resume(folder / RALLIES, header, rallies))
    return RunLog(recorder, logs, seeds, header.columns, seat=0 if opponents else None)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Collected:
    """``[rows, steps]`` arrays of an iteration, ``extra`` ``[E, rows, steps]``, and when that was."""

    segment: int
    update: int
    stroke: npt.NDArray[np.int64]
    reward: npt.NDArray[np.float32]
    extra: npt.NDArray[np.float32]


class RunLog:
    """Log of the rallies of a run.

    Args:
        recorder: writes them.
        logs: one for each process.
        seeds: of the environments, by segment and process.
        columns: of the log.
        seat: the learner's; None in self-play.
    """

    def __init__(
        self,
        recorder: RallyRecorder,
        logs: list[BatchLog],
        seeds: Sequence[Sequence[int]],
        columns: tuple[str, ...],
        *,
        seat: int | None,
    ) -> None:
        self._recorder, self._logs, self._seeds, self._seat = recorder, logs, seeds, seat
        self._columns = tuple(name for name in columns if name in _ENTRIES)
        self._segment = 0
        self._played = -1
        """Segment that the batches are in; they live in the recorder's thread."""

    def begin(self, segment: int) -> None:
        """From here on rallies belong to what follows the given checkpoint, counted from 0."""
        self._segment = segment

    def add(self, data: TensorDictBase, update: int) -> None:
        """Record ``[rows, steps]`` strokes after the learner has learned from them.

        Raises:
            RecordingError: the log cannot be written any further; every rally before is there.
        """
        extra = np.empty((len(self._columns), *data.shape), np.float32)
        for figures, name in zip(extra, self._columns, strict=True):
            figures[:] = data[_ENTRIES[name]].detach().cpu().numpy().reshape(data.shape)
        collected = _Collected(
            segment=self._segment,
            update=update,
            stroke=_copy(data["action"]),
            reward=_copy(data["next", "reward"])[..., 0],
            extra=extra,
        )
        self._recorder.add_later(functools.partial(self._rallies, collected), _STROKES_A_STEP * data.numel())

    def flush(self) -> int:
        """Have everything on the disk; returns the number of rallies there."""
        return self._recorder.flush()

    def close(self) -> None:
        """Move the log into place."""
        self._recorder.close()

    def abort(self) -> None:
        """Leave the log unfinished, for a run that continues it."""
        self._recorder.abort()

    def _rallies(self, collected: _Collected) -> Rallies:
        """The rallies that ended in an iteration, process after process.

        Raises:
            RecordingError: the environments played other rallies than their seeds give.
        """
        segment, share = collected.segment, len(collected.stroke) // len(self._logs)
        found = []
        for p, (log, seed) in enumerate(zip(self._logs, self._seeds[segment], strict=True)):
            as_recorded = functools.partial(
                single_rallies_of,
                pairing=segment * len(self._logs) + p,
                seat=self._seat,
                update=collected.update,
                columns=self._columns,
            )
            if segment != self._played:
                log.reset(seed)
                found.append(as_recorded(log.take()))
            rows = slice(p * share, (p + 1) * share)
            try:
                same = np.array_equal(log.play(collected.stroke[rows], collected.extra[:, rows]), collected.reward[rows])
            except IllegalStrokeError:
                same = False
            if not same:
                raise RecordingError(f"process {p}: its strokes and rewards do not follow from its seed")
            found.append(as_recorded(log.take()))
        self._played = segment
        return Rallies.join(found)


def _copy(tensor: Any) -> npt.NDArray[Any]:
    """A copy of a tensor as an array, which later steps do not change."""
    array: npt.NDArray[Any] = tensor.detach().cpu().numpy().copy()
    return array
