"""Settings of PPO, A2C and SAC, and the bounds of their numbers. This module does not import torch.

The defaults are those of the win rates in ``docs/training.md``.
"""

import dataclasses
import functools
import json
import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self

import msgspec

from shuttle_marl.base.errors import ShuttleError, did_you_mean, printable, suggesting
from shuttle_marl.base.files import Count, CountOrZero, FileReadError, Fraction, FractionOrZero, Positive, Seed, Weight, read_json
from shuttle_marl.base.runs import RunOptions
from shuttle_marl.game.shipped import Profile
from shuttle_marl.game.stroke import SHOTS

SelfPlayVariant = Literal["plain", "best-response", "restarts", "pool", "magnet", "emagnet", "nash"]
CollectorName = Literal["kernel", "torchrl"]

Growth = Annotated[float, msgspec.Meta(ge=0, le=1000)]
SEEDS: Final = 1 << 31  # number of seeds of PyTorch's generators and of a sampler
SELF: Final = "self"
SHARP: Final = 0.1  # softmax temperature of an agent that is to play the best stroke it knows
_NO_EFFECT: Final = ("out", "resume", "overwrite", "workers", "ray")


class TrainingError(ShuttleError):
    """A run that cannot be started, continued, or finished."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunConfig(RunOptions):
    """Settings of a run and its game."""

    error = TrainingError

    seed: Seed = 0
    """Random seed."""
    record: Literal["all", "none"] = "all"
    """Rallies in the rally log: all (some 1.8 bytes a stroke) or none; does not change the weights."""
    profile: Profile | None = None
    """Discipline of the game; default: the average of both."""

    def fixed(self) -> dict[str, Any]:
        """Settings that determine the result, as JSON."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in _NO_EFFECT}
        decisive: dict[str, Any] = json.loads(json.dumps(fields))
        return decisive


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingConfig(RunConfig):
    """Settings that all algorithms share."""

    algorithm: ClassVar[str]
    usual_strokes: ClassVar[int]

    opponent: tuple[str, ...] = ("bc",)
    """Names of one or more opponents (see `docs/league.md`), or `self` for self-play."""
    strokes: Count | None = None
    """Strokes of the learner, and its positions in the game with recovery. Default: 60 million (ppo), 40 million (a2c) or 8
    million (sac); with --collector torchrl 4 million."""
    collector: CollectorName = "kernel"
    """What collects strokes: the compiled kernel, or TorchRL's own collector, which takes longer."""
    figures: Literal["auto", "all", "none"] = "auto"
    """Rallies of the log whose strokes have the learner's log-probability and value, some 5 bytes a stroke: all, none, or auto,
    the first 10,000 and one in a hundred."""
    bonus: tuple[str, ...] = ()
    """Reward for a shot type, as SHOT=POINTS, for example smash=0.1; a rally is worth 1 (not in self-play)."""
    fault_cost: Weight = 0.0
    """Additional cost of losing a rally by an own fault (not in self-play)."""
    risk_aversion: Weight = 0.0
    """Parameter b of the entropic risk measure of the return; has no effect without --fault-cost."""
    target: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None
    """Stop when the exact probability of winning a match against the opponent reaches this."""
    target_score: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None
    """Stop when the normalised score reaches this: 0 for bc, 1 for the best response to the opponent."""
    batch: Count = 8192
    """Strokes of the learner in the first iteration; its rallies are played to their end."""
    growth: Growth = 0.0
    """Growth of the batch per iteration, as a fraction of `batch`."""
    cache_iterations: Count = 8
    """Iterations for which cached network outputs of rarely visited states are reused."""
    gae_lambda: FractionOrZero = 0.7
    """Lambda of generalised advantage estimation."""
    width: Count = 64
    """Units of each layer of the networks."""
    hidden: CountOrZero = 1
    """Hidden layers after the embedding."""
    evaluate_every: Count = 10
    """Iterations between exact evaluations."""
    exploitability: bool = True
    """Compute the exploitability in evaluations, which takes half of their time; always computed in self-play."""
    checkpoint_every: Count = 20
    """Iterations between checkpoints; changes the result, because the generator is reseeded at each."""
    eval_temperature: Fraction | None = None
    """Softmax temperature of the trained agent. Default: 0.1; in self-play with recovery that of the last rollouts."""
    device: str = "cpu"
    """PyTorch device of the networks, such as cuda."""
    threads: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 1
    """PyTorch threads of this process; changes the result, because it changes the order of sums."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.opponent:
            raise TrainingError("--opponent: expected one or more policies, or self")
        for name in self.opponent:
            if name != SELF and (hint := did_you_mean(name, [SELF], cutoff=0.75)):
                raise TrainingError(f"--opponent {name}: no such policy{hint}")
        if SELF in self.opponent and len(self.opponent) > 1:
            raise TrainingError(f"--opponent {' '.join(self.opponent)}: {SELF} cannot be combined with other opponents")
        if self.strokes is None:
            object.__setattr__(self, "strokes", 4_000_000 if self.collector == "torchrl" else self.usual_strokes)
        if self.collector == "torchrl" and self.shapes_rewards:
            raise TrainingError("--collector torchrl: has the rewards of the environment; --bonus and --fault-cost need kernel")
        self.bonuses()
        if self.self_play and (self.bonus or self.fault_cost):
            raise TrainingError("--bonus and --fault-cost: not available in self-play, which is a zero-sum game")

    @property
    def temperature(self) -> float:
        """Softmax temperature of the trained agent."""
        return SHARP if self.eval_temperature is None else self.eval_temperature

    @property
    def self_play(self) -> bool:
        """Whether the learner plays both sides."""
        return self.opponent == (SELF,)

    @property
    def discount(self) -> float:
        """Discount factor gamma: 1 because rallies end, -1 in self-play, where the next state is the opponent's."""
        return -1.0 if self.self_play else 1.0

    def bonuses(self) -> dict[str, float]:
        """Bonus of each shot type in ``bonus``. Raises TrainingError: an entry is not SHOT=POINTS."""
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
    def shapes_rewards(self) -> bool:
        """Whether the learner's rewards include a bonus or a cost of faults."""
        return any(self.bonuses().values()) or self.fault_cost > 0

    @functools.cached_property
    def iterations(self) -> int:
        """Iterations of the whole run."""
        assert self.strokes is not None  # set by the configuration
        # The strokes of n iterations are batch (n + growth n (n - 1) / 2).
        batches, half = self.strokes / self.batch, self.growth / 2
        return max(
            1, math.ceil(batches if not half else (half - 1 + math.sqrt((1 - half) ** 2 + 4 * half * batches)) / (2 * half))
        )

    def batch_of(self, iteration: int) -> int:
        """Minimum number of strokes in an iteration, counted from 0."""
        return round(self.batch * (1 + self.growth * iteration))

    @property
    def segments(self) -> int:
        """Number of segments; each ends with a checkpoint."""
        return -(-self.iterations // self.checkpoint_every)

    @classmethod
    def load(cls, path: Path | str, **changes: Any) -> Self:
        """The settings of a JSON file, such as ``config.json`` of a run; those that it lacks have their defaults.

        Args:
            **changes: other values of some settings.

        Raises:
            TrainingError: no readable file, of another algorithm, or a setting that does not exist or has another type.
        """
        try:
            settings = read_json(Path(path), dict[str, Any])
        except FileReadError as error:
            raise TrainingError(f"{path}: no settings ({error})") from error
        if (algorithm := settings.pop("algorithm", cls.algorithm)) != cls.algorithm:
            raise TrainingError(f"{path}: settings of {printable(str(algorithm)):.50}, expected those of {cls.algorithm}")
        known = [field.name for field in dataclasses.fields(cls)]
        for name in settings.keys() - set(known):
            raise TrainingError(f"{path}: no setting {printable(name)!r:.60}{did_you_mean(name, known)}")
        try:
            return msgspec.convert({**settings, **changes}, cls, dec_hook=lambda kind, value: kind(value))
        except msgspec.ValidationError as error:
            raise TrainingError(f"{path}: {error}") from error

    def fixed(self) -> dict[str, Any]:
        """Settings that determine the result, as JSON."""
        return {"algorithm": self.algorithm, **super().fixed()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class ActorCriticConfig(TrainingConfig):
    """Settings that PPO and A2C share."""

    learning_rate: Positive = 8e-3
    """Learning rate of Adam; decays linearly to 1/50."""
    entropy: Weight = 0.05
    """Weight of the entropy bonus, which the variant emagnet does not have; decays linearly to 0."""
    critic: Positive = 1.0
    """Weight of the value loss."""
    gradient_norm: Positive = 0.5
    """Maximum norm of the gradient."""


@suggesting
@dataclasses.dataclass(frozen=True, kw_only=True)
class PPOConfig(ActorCriticConfig):
    """Proximal policy optimisation (Schulman et al. 2017), and variants of self-play (:mod:`shuttle_marl.training.self_play`)."""

    algorithm: ClassVar[str] = "ppo"
    usual_strokes: ClassVar[int] = 60_000_000

    growth: Growth = 0.1
    gae_lambda: FractionOrZero = 0.6
    evaluate_every: Count = 25
    checkpoint_every: Count = 50
    variant: SelfPlayVariant = "plain"
    """Variant of self-play (docs/training.md)."""
    fraction: FractionOrZero = 0.2
    """Fraction of rallies that are not plain self-play, of best-response, restarts and pool."""
    update_interval: Count = 40
    """Iterations between updates of the best response, the pool or the reference policy of nash."""
    pool_size: Annotated[int, msgspec.Meta(ge=1, le=64)] = 8
    """Maximum number of earlier policies in the pool."""
    magnet_coef: Weight = 0.05
    """Weight of the KL divergence from the reference policy, of magnet, emagnet and nash."""
    magnet_rate: FractionOrZero = 0.025
    """Rate per iteration of the moving average that is the reference policy of magnet and emagnet; 1: the policy at the start of
    the iteration, 0: the initial one."""
    clip: Fraction = 0.4
    """Clipping parameter epsilon of the probability ratio."""
    anneal_after: FractionOrZero | None = None
    """Fraction of the run after which the softmax temperature of rollouts decreases from 1; 1: never. Default: 0.2 in self-play,
    else 1."""
    final_temperature: Fraction = 0.25
    """Softmax temperature of rollouts at the end of the run."""
    epochs: Count = 1
    """Passes over the strokes of an iteration."""
    minibatches: Count = 3
    """Minibatches per epoch; each holds all strokes of a subset of the states."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.variant != "plain" and not self.self_play:
            raise TrainingError(f"--variant {self.variant}: requires self-play, with --opponent self")
        if self.collector == "torchrl" and self.variant in ("best-response", "restarts", "pool"):
            raise TrainingError(
                f"--variant {self.variant}: chooses opponents or states of rallies, which needs --collector kernel"
            )
        if self.anneal_after is None:
            object.__setattr__(self, "anneal_after", 0.2 if self.self_play else 1.0)


@suggesting
@dataclasses.dataclass(frozen=True, kw_only=True)
class A2CConfig(ActorCriticConfig):
    """Advantage actor-critic (Mnih et al. 2016), synchronous, with generalised advantages."""

    algorithm: ClassVar[str] = "a2c"
    usual_strokes: ClassVar[int] = 40_000_000

    growth: Growth = 0.03
    evaluate_every: Count = 50
    checkpoint_every: Count = 100


@suggesting
@dataclasses.dataclass(frozen=True, kw_only=True)
class SACConfig(TrainingConfig):
    """Soft actor-critic (Haarnoja et al. 2018) for discrete actions (Christodoulou 2019)."""

    algorithm: ClassVar[str] = "sac"
    usual_strokes: ClassVar[int] = 8_000_000

    batch: Count = 16_384
    evaluate_every: Count = 40
    checkpoint_every: Count = 80
    learning_rate: Positive = 6e-3
    """Learning rate of Adam for actor and critics; decays linearly to 1/50."""
    alpha_learning_rate: Positive = 1e-2
    """Learning rate of Adam for the temperature alpha."""
    alpha: Fraction = 0.02
    """Initial temperature alpha, the weight of the entropy."""
    target_entropy: Fraction = 0.3
    """Initial target entropy, as a fraction of the mean entropy of uniform play; decays linearly to 0.02."""
    buffer: Count = 4_000_000
    """Capacity of the replay buffer in strokes."""
    minibatch: Count = 16_384
    """Strokes in a gradient step; identical transitions are computed once."""
    updates: Count = 4
    """Gradient steps per iteration."""
    warm_up: CountOrZero = 20_000
    """Strokes that are collected before the first gradient step."""
    critics: Annotated[int, msgspec.Meta(ge=1, le=8)] = 1
    """Number of critics; the minimum of their values is used."""
    polyak: FractionOrZero = 0.95
    """Decay of the moving average of the target critics per gradient step."""
    averaging: FractionOrZero = 0.98
    """Decay of the moving average of the weights that are evaluated and saved; 0: the current weights."""


CONFIGS: Final[dict[str, type[TrainingConfig]]] = {"ppo": PPOConfig, "a2c": A2CConfig, "sac": SACConfig}
