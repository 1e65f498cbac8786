"""What decides a training run: one frozen dataclass an algorithm, one sentence a field. No torch here.

The defaults reach the figures of ``docs/training.md`` on two cores; ``benchmarks/time_to_win.py`` uses them as they are.
"""

import dataclasses
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.stroke import SHOTS

SELF: Final = "self"
"""The opponent that is the learner itself."""
_NOT_DECISIVE: Final = ("out", "resume", "overwrite")


class TrainingError(ShuttleError):
    """A run that cannot be started, gone on with, or finished."""


def _bounds() -> Iterator[tuple[str, Callable[[float], bool], str]]:
    """Name of a field, whether a value of it can be meant, and what was expected; NaN fits nowhere."""
    counts = ("strokes", "rows", "steps", "width", "evaluate_every", "checkpoint_every", "processes", "threads")
    for name in (*counts, "epochs", "minibatch", "buffer", "updates"):
        yield name, lambda value: value >= 1, "1 or more"
    for name in ("hidden", "warm_up"):
        yield name, lambda value: value >= 0, "0 or more"
    for name in ("learning_rate", "temperature_rate", "gradient_norm", "critic"):
        yield name, lambda value: 0 < value < math.inf, "a number above 0"
    for name in ("clip", "temperature", "entropy_share", "target"):
        yield name, lambda value: 0 < value <= 1, "a number above 0, at most 1"
    for name in ("lmbda", "polyak"):
        yield name, lambda value: 0 <= value <= 1, "a number from 0 to 1"
    for name in ("entropy", "fault_cost", "risk_aversion"):
        yield name, lambda value: 0 <= value <= 10, "a number from 0 to 10"


_BOUNDS: Final = tuple(_bounds())


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """What all algorithms share."""

    algorithm: ClassVar[str]

    opponent: tuple[str, ...] = ("bc",)
    """Who is played against: one policy or several at once by name (see `docs/league.md`), or `self` for self-play."""
    strokes: int = 2_000_000
    """Strokes of the learner to train on."""
    seed: int = 0
    """Names every random draw: the same seed gives the same weights."""
    out: Path | None = None
    """Run folder; default runs/ALGORITHM-SEED, with a number behind it if that exists."""
    resume: bool = False
    """Go on with the run in --out (or the default folder) from its last checkpoint."""
    overwrite: bool = False
    """Replace the run that stands in --out."""
    record: str = "all"
    """Which rallies go into the run's rally log: all, none, or sample:N for one rally in N; never changes the weights."""
    game: str = "default"
    """Model whose game is played: a shipped one or a folder."""
    warm_start: str | None = None
    """Policy that the network imitates before it learns, for example bc."""
    bonus: tuple[str, ...] = ()
    """Reward for playing a shot type, as SHOT=POINTS, for example smash=0.1; a rally is worth 1 (not in self-play)."""
    fault_cost: float = 0.0
    """How much worse than a loss is a loss by an own fault (not in self-play)."""
    risk_aversion: float = 0.0
    """Weight b of the entropic risk measure of what a rally brings; changes nothing without --fault-cost."""
    target: float | None = None
    """Stop once the exact chance to win a match against the opponent reaches this."""
    rows: int = 1024
    """Rallies that are played side by side."""
    steps: int = 16
    """Strokes of each row that are collected before the learner learns."""
    width: int = 128
    """Numbers in a layer of the networks."""
    hidden: int = 1
    """Layers behind the embedding."""
    evaluate_every: int = 10
    """Iterations between two exact evaluations."""
    checkpoint_every: int = 20
    """Iterations between two checkpoints; also how often all draws are named anew, so it is part of what decides a run."""
    processes: int = 1
    """Processes that collect; with more than one, each plays its share of the rows."""
    collector: Literal["local", "ray"] = "local"
    """Where the processes run: on this machine, or on those of a Ray cluster."""
    device: str = "cpu"
    """Device of the networks, such as cuda; the rallies stay on the CPU."""
    threads: int = 1
    """Threads of PyTorch in this process; part of what decides a run, because sums are split by it."""

    def __post_init__(self) -> None:
        from shuttle_marl.recording.header import Sampling  # noqa: PLC0415  pyarrow; not for a help page

        Sampling.parse(self.record)
        for name, fits, expected in _BOUNDS:
            value = getattr(self, name, None)
            if value is not None and not fits(value):
                raise TrainingError(f"--{name.replace('_', '-')} {value}: expected {expected}")
        if self.rows % self.processes:
            raise TrainingError(f"--rows {self.rows}: expected a multiple of --processes {self.processes}")
        if not 0 <= self.seed < 1 << 63:
            raise TrainingError(f"--seed {self.seed}: expected a number from 0 up to 2^63")
        if not self.opponent:
            raise TrainingError("--opponent: expected a policy or more, or self")
        if SELF in self.opponent and len(self.opponent) > 1:
            raise TrainingError(f"--opponent {' '.join(self.opponent)}: {SELF} stands alone, for self-play")
        self.bonuses()
        if self.self_play and (self.bonus or self.fault_cost):
            raise TrainingError("--bonus and --fault-cost: not in self-play, where what one player wins the other loses")
        if self.resume and self.overwrite:
            raise TrainingError("--resume goes on with a run and --overwrite replaces it; give one of them")

    @property
    def self_play(self) -> bool:
        """Whether both players are the learner."""
        return self.opponent == (SELF,)

    def bonuses(self) -> dict[str, float]:
        """Points by shot type.

        Raises:
            TrainingError: ``bonus`` holds something else.
        """
        points = {}
        for entry in self.bonus:
            shot, _, number = entry.partition("=")
            try:
                points[shot] = float(number)
            except ValueError:
                points[shot] = math.nan
            if shot not in SHOTS or not abs(points[shot]) <= 1:
                raise TrainingError(f"--bonus {entry}: expected SHOT=POINTS, points from -1 to 1, shot of {', '.join(SHOTS)}")
        return points

    @property
    def frames(self) -> int:
        """Strokes that are collected in an iteration."""
        return self.rows * self.steps

    @property
    def iterations(self) -> int:
        """Iterations of the whole run."""
        return -(-self.strokes // self.frames)

    def fixed(self) -> dict[str, Any]:
        """What decides the result, as JSON."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in _NOT_DECISIVE}
        decisive: dict[str, Any] = json.loads(json.dumps({"algorithm": self.algorithm, **fields}))
        return decisive


@dataclasses.dataclass(frozen=True, kw_only=True)
class PPOConfig(TrainingConfig):
    """Proximal policy optimisation (Schulman et al. 2017) with generalised advantages (Schulman et al. 2016)."""

    algorithm: ClassVar[str] = "ppo"

    strokes: int = 4_000_000
    """Strokes of the learner to train on."""
    rows: int = 2048
    """Rallies that are played side by side."""
    evaluate_every: int = 5
    """Iterations between two exact evaluations."""
    checkpoint_every: int = 10
    """Iterations between two checkpoints; also how often all draws are named anew, so it is part of what decides a run."""
    learning_rate: float = 2e-3
    """Of Adam; falls linearly to a fiftieth."""
    clip: float = 0.2
    """The ratio of chances is clipped to 1 - clip and 1 + clip."""
    lmbda: float = 0.7
    """Lambda of the generalised advantages."""
    entropy: float = 0.01
    """Weight of the entropy bonus; falls linearly to 0."""
    critic: float = 1.0
    """Weight of the value loss."""
    epochs: int = 1
    """Passes over what was collected."""
    minibatch: int = 4096
    """Strokes in one gradient step."""
    gradient_norm: float = 0.5
    """Gradients are scaled down to this norm."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class A2CConfig(TrainingConfig):
    """Advantage actor-critic (Mnih et al. 2016), synchronous, with generalised advantages."""

    algorithm: ClassVar[str] = "a2c"

    strokes: int = 6_000_000
    """Strokes of the learner to train on."""
    rows: int = 2048
    """Rallies that are played side by side."""
    steps: int = 4
    """Strokes of each row that are collected before the learner learns."""
    evaluate_every: int = 50
    """Iterations between two exact evaluations."""
    checkpoint_every: int = 100
    """Iterations between two checkpoints; also how often all draws are named anew, so it is part of what decides a run."""
    learning_rate: float = 2e-3
    """Of Adam; falls linearly to a fiftieth."""
    lmbda: float = 0.7
    """Lambda of the generalised advantages."""
    entropy: float = 0.03
    """Weight of the entropy bonus; falls linearly to 0."""
    critic: float = 1.0
    """Weight of the value loss."""
    gradient_norm: float = 0.5
    """Gradients are scaled down to this norm."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SACConfig(TrainingConfig):
    """Soft actor-critic (Haarnoja et al. 2018) for discrete actions (Christodoulou 2019)."""

    algorithm: ClassVar[str] = "sac"

    strokes: int = 1_500_000
    """Strokes of the learner to train on."""
    rows: int = 512
    """Rallies that are played side by side."""
    steps: int = 2
    """Strokes of each row that are collected before the learner learns."""
    evaluate_every: int = 100
    """Iterations between two exact evaluations."""
    checkpoint_every: int = 200
    """Iterations between two checkpoints; also how often all draws are named anew, so it is part of what decides a run."""
    learning_rate: float = 1e-3
    """Of Adam, for actor and critics; falls linearly to a fiftieth."""
    temperature_rate: float = 1e-3
    """Of Adam, for the temperature alpha."""
    temperature: float = 0.05
    """Temperature alpha at the start."""
    entropy_share: float = 0.3
    """Target entropy, as a share of the mean entropy of choosing equally among the legal strokes; falls linearly to 0.02."""
    buffer: int = 400_000
    """Strokes that the replay buffer holds."""
    minibatch: int = 1024
    """Strokes in one gradient step."""
    updates: int = 2
    """Gradient steps an iteration."""
    warm_up: int = 20_000
    """Strokes that are collected before the first gradient step."""
    polyak: float = 0.99
    """Share of the old weights that a target network keeps at each step."""
