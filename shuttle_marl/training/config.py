"""Settings that all training algorithms share, and the bounds of their numbers. No torch here.

The defaults of the algorithms are those of the win rates in ``docs/training.md``.
"""

import dataclasses
import functools
import json
import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, get_args, get_type_hints

from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.shipped import Profile
from shuttle_marl.game.stroke import SHOTS

Sampler = Literal["auto", "kernel", "torch"]

SELF: Final = "self"
"""The opponent that is the learner itself."""
_NOT_DECISIVE: Final = ("out", "resume", "overwrite")


class TrainingError(ShuttleError):
    """A run that cannot be started, continued, or finished."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Within:
    """Bounds of a number, as an annotation of a field; NaN is within none.

    Attributes:
        low: smallest value.
        high: largest value.
        above: values lie above this.
        text: the bounds in words, for errors.
    """

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    text: str

    def __contains__(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        return self.low <= value <= self.high and self.above < value < math.inf


Count = Annotated[int, Within(low=1, high=10**15, text="a whole number from 1 to 10^15")]
CountOrZero = Annotated[int, Within(low=0, high=10**15, text="a whole number from 0 to 10^15")]
Positive = Annotated[float, Within(above=0, text="a number above 0")]
Fraction = Annotated[float, Within(above=0, high=1, text="a number above 0, at most 1")]
FractionOrZero = Annotated[float, Within(low=0, high=1, text="a number from 0 to 1")]
Weight = Annotated[float, Within(low=0, high=10, text="a number from 0 to 10")]


def bounds_of(config: type) -> dict[str, tuple[bool, Within]]:
    """By field, whether it is a whole number, and its bounds."""
    hints = get_type_hints(config, include_extras=True)
    return {
        name: (get_args(hint)[0] is int, bounds)
        for name, hint in hints.items()
        for bounds in get_args(hint)
        if isinstance(bounds, Within)
    }


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings that all algorithms share."""

    algorithm: ClassVar[str]

    opponent: tuple[str, ...] = ("bc",)
    """Opponents: one policy or several at once by name (see `docs/league.md`), or `self` for self-play."""
    strokes: Count = 2_000_000
    """Strokes of the learner to train on."""
    seed: Annotated[int, Within(low=0, high=(1 << 63) - 1, text="a whole number from 0 up to 2^63")] = 0
    """Names every random draw: the same seed gives the same weights."""
    out: Path | None = None
    """Run folder; default runs/ALGORITHM-SEED, with a number behind it if that exists."""
    resume: bool = False
    """Continue the run in --out (or the default folder) from its last checkpoint."""
    overwrite: bool = False
    """Replace the run in --out."""
    record: str = "sample:100"
    """Rallies for the run's rally log: all, none, or sample:N for one rally in N; never changes the weights. All of them can
    fill gigabytes in a minute."""
    game: str = "default"
    """Model whose game is played: a shipped one or a folder."""
    profile: Profile | None = None
    """The game of one discipline alone; default: the average of both."""
    warm_start: str | None = None
    """Policy that the network imitates before it learns, for example bc."""
    bonus: tuple[str, ...] = ()
    """Reward for playing a shot type, as SHOT=POINTS, for example smash=0.1; a rally is worth 1 (not in self-play)."""
    fault_cost: Weight = 0.0
    """Cost of losing by an own fault, beyond that of losing (not in self-play)."""
    risk_aversion: Weight = 0.0
    """Weight b of the entropic risk measure of the return of a rally; changes nothing without --fault-cost."""
    target: Annotated[float | None, Within(above=0, high=1, text="a number above 0, at most 1")] = None
    """Stop once the exact probability of winning a match against the opponent reaches this."""
    target_score: Annotated[float | None, Within(above=0, high=1, text="a number above 0, at most 1")] = None
    """Stop once the normalised score reaches this: 0 for bc, 1 for the best response to the opponent."""
    batch: Count = 32_768
    """Strokes of the learner in the first iteration; its rallies are played to their end."""
    growth: Annotated[float, Within(low=0, high=1000, text="a number from 0 to 1,000")] = 0.0
    """Strokes by which each iteration is longer than the one before, as a share of the first."""
    age: Count = 1
    """Iterations for which what the network says of a state that is met now and then is played without asking again."""
    lmbda: FractionOrZero = 0.7
    """Lambda of the generalised advantages."""
    width: Count = 64
    """Numbers in a layer of the networks."""
    hidden: CountOrZero = 1
    """Layers behind the embedding."""
    evaluate_every: Count = 10
    """Iterations between two exact evaluations."""
    exploitability: bool = True
    """Compute the exploitability at each of them, which takes half of their time; in self-play always."""
    checkpoint_every: Count = 20
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    play_temperature: Fraction = 0.1
    """Temperature of the softmax at which the trained agent plays, in evaluations and from its folder. It learns at 1, where the
    bonus for entropy lets it play all that is nearly as good as the best."""
    device: str = "cpu"
    """Device of PyTorch, such as cuda, on which the networks learn."""
    sampler: Sampler = "auto"
    """Player of the rallies: the compiled kernel on the CPU, or torch on --device; auto: torch where that is a CUDA device."""
    threads: Annotated[int, Within(low=1, high=1024, text="a whole number from 1 to 1,024")] = 1
    """Threads of PyTorch in this process; part of what decides a run, because sums are split by it."""

    def __post_init__(self) -> None:
        from shuttle_marl.recording.header import Sampling  # noqa: PLC0415  pyarrow; not for a help page

        Sampling.parse(self.record)
        for name, (whole, bounds) in bounds_of(type(self)).items():
            value = getattr(self, name)
            if value is not None and (value not in bounds or (whole and not isinstance(value, int))):
                raise TrainingError(f"--{name.replace('_', '-')} {value}: expected {bounds.text}")
        if not self.opponent:
            raise TrainingError("--opponent: expected a policy or more, or self")
        if SELF in self.opponent and len(self.opponent) > 1:
            raise TrainingError(f"--opponent {' '.join(self.opponent)}: {SELF} stands alone, for self-play")
        self.bonuses()
        if self.self_play and (self.bonus or self.fault_cost):
            raise TrainingError("--bonus and --fault-cost: not in self-play, where what one player wins the other loses")
        if self.resume and self.overwrite:
            raise TrainingError("--resume continues a run and --overwrite replaces it; give one of them")

    @property
    def self_play(self) -> bool:
        """Whether both players are the learner."""
        return self.opponent == (SELF,)

    @property
    def discount(self) -> float:
        """Gamma of the returns: 1 because a rally ends for certain, -1 in self-play, where the next state is the opponent's."""
        return -1.0 if self.self_play else 1.0

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
    def shapes_rewards(self) -> bool:
        """Whether the learner's rewards differ from those of the rules: by a bonus, or by a cost of faults."""
        return any(self.bonuses().values()) or self.fault_cost > 0

    @functools.cached_property
    def iterations(self) -> int:
        """Iterations of the whole run."""
        # The strokes of n iterations are batch (n + growth n (n - 1) / 2).
        batches, half = self.strokes / self.batch, self.growth / 2
        return max(
            1, math.ceil(batches if not half else (half - 1 + math.sqrt((1 - half) ** 2 + 4 * half * batches)) / (2 * half))
        )

    def batch_of(self, iteration: int) -> int:
        """Least number of strokes of an iteration, counted from 0."""
        return round(self.batch * (1 + self.growth * iteration))

    @property
    def segments(self) -> int:
        """Parts of the run that end with a checkpoint."""
        return -(-self.iterations // self.checkpoint_every)

    def memory(self, n_strokes: int) -> dict[str, int]:
        """Bytes that a run needs at least, by the flags that decide how many.

        Args:
            n_strokes: size n of the catalogue.
        """
        # A state has a mask and logits with their gradients; a weight, its gradient and two moments.
        return {
            "--batch and --growth": 60 * self.batch_of(self.iterations - 1),
            "--width and --hidden": 16 * self.width * (self.hidden * self.width + 3 * n_strokes),
            "--strokes with so small --batch and --checkpoint-every": 100 * self.segments,
        }

    def fixed(self) -> dict[str, Any]:
        """Settings that decide the result, as JSON."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in _NOT_DECISIVE}
        decisive: dict[str, Any] = json.loads(json.dumps({"algorithm": self.algorithm, **fields}))
        return decisive
