"""The tasks ``offline-v1`` and ``evaluate-v1``: learning, and evaluation of policies, from a fixed log."""

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec
import numpy as np
import scipy  # its statistics are imported when first used

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.files import FractionOrZero
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.odds import best_odds, pair_odds
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.policy.computed import cached_table, mixture
from shuttle_marl.recording.logs import Log, blank, play_log
from shuttle_marl.suite import tabular
from shuttle_marl.suite.method import Method, called, find, made
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.population import luck
from shuttle_marl.suite.task import POINTS, Arena, Case, Outcome, Setting, Task, exploitabilities, required, table_of

OPPONENT: Final = "human:0.05"  # opponent of all logs: strong enough that a list of strokes by incoming shot is no answer to it
BEHAVIOURS: Final = ("bc", "bc+0.1*minimax", "attacking@greedy", "minimax", "bc:PLAYER")
"""Behaviour policies of the logs; PLAYER is the first imitated player of the split."""
_APART: Final = "minimax"  # behaviour that cloning it almost solves, so its logs do not count
_SIGMA: Final = 1.0  # spread of drawn games, so large that play that is perfect in the shipped game is not strong in them
NAMED: Final = (  # targets of `evaluate` by name
    "bc", "bc@0.7", "bc@0.4", "bc@greedy", "bc:PLAYER", "attacking", "attacking@greedy", "defensive", "defensive@greedy", "safe",
    "safe@greedy", "minimax", "human:0.05", "human:0.2", "random", "bc+0.5*minimax",
)  # fmt: skip
TRAINED: Final = (  # targets of `evaluate` that methods of `offline` trained on the log
    "one-step", "one-step:2", "one-step:8", "fitted-q", "fitted-q:2", "fitted-q:8", "one-step:64", "fitted-q:64", "model:64",
    "model", "model:2", "model:8", "model-pessimistic", "model-pessimistic:0.2", "clone", "clone:8",
)  # fmt: skip
_QUICK: Final = 3000
_FRESH: Final = 1000  # added to the seed of a fresh log


class LogTask(Task):
    """A task with logs; the dev split is the game of one discipline, and the others have a game that does not ship.

    Probabilities of the game of a setting are meaningless.
    """

    access = "samples"
    hidden: ClassVar[tuple[str, ...]] = ("probabilities of the game", "opponent")
    variants: ClassVar[Mapping[str, str]] = {"dev": "women"}
    drawn: ClassVar[Mapping[str, float]] = {"test": _SIGMA, "round": _SIGMA}

    def behaviours(self, arena: Arena) -> tuple[str, ...]:
        """Names of the behaviour policies of the split."""
        return tuple(_of_split(name, arena) for name in BEHAVIOURS[: 1 if arena.quick else None])


def _of_split(name: str, arena: Arena) -> str:
    return name.replace("PLAYER", baselines.players(arena.game)[arena.split == "dev"])


def behaviour(arena: Arena, name: str) -> TabulatedPolicy:
    """Behaviour policy of a log: the name of a policy, or ``NAME+FRACTION*NAME``, a mixture for every stroke."""
    first, plus, rest = name.partition("+")
    if not plus:
        return arena.policy(name)
    fraction, _, second = rest.partition("*")
    return mixture([arena.policy(first), arena.policy(second)], [1 - float(fraction), float(fraction)])


@functools.lru_cache(maxsize=2)
def generate(arena: Arena, name: str, strokes: int, seed: int) -> Log:
    """The log of a behaviour policy against :data:`OPPONENT`; arguments of :func:`shuttle_marl.recording.logs.play_log`."""
    key = luck(arena.split, arena.seed, seed, arena.split == "dev", strokes)
    return play_log((behaviour(arena, name), arena.policy(OPPONENT)), strokes, key)


def log_of_unit(arena: Arena, case: Case, seed: int) -> Log:
    """The log of a unit; in ``evaluate`` that on which its policies were trained, or a fresh one."""
    fresh = _FRESH if case.options.get("log") == "fresh" else 0
    return generate(arena, case.options["behaviour"], case.budget, seed + fresh)


class Offline(LogTask):
    """Learn from a fixed log and nothing else.

    Given: 10^4, 10^5 or (bc) 10^6 own strokes of a behaviour policy against human:0.05, with the replies. Score: rallies won
    against it, in points above half. A method reads the strokes of both players, or its own alone (``track = "own"``).
    """

    name = "offline-v1"
    metric = "score"
    zero = "play as strong as the opponent"
    not_proved = "strength against other opponents, safe play (see exploitability), and that the log alone was used"
    protocol = "method(setting: Setting) -> object with fit(log) -> player; log is a Log, or Transitions if track is 'own'"

    def all_cases(self, arena: Arena) -> list[Case]:
        """Each behaviour policy with each number of strokes."""
        sizes = (_QUICK,) if arena.quick else (10**4, 10**5)
        pairs = [(name, size) for name in self.behaviours(arena) for size in sizes]
        if not arena.quick:
            pairs.append(("bc", 10**6))
        return [
            Case(name=f"{name}/{size:,}", budget=size, counts=name != _APART, options={"behaviour": name}) for name, size in pairs
        ]

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:
        """Fit the method to the log."""
        log = log_of_unit(arena, case, seed)
        player = fitted(method, log, Setting(game=log.game, model=arena.model, seed=seed, folder=folder), self.name)
        return Outcome(policies={"player": in_game(player, arena.game)})

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:
        """The log."""
        return (log_of_unit(arena, case, seed).hash, arena.policy(OPPONENT).hash)

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Rallies won above half, those of the best response, and exploitability, in points."""
        player, opponent = required(outcome), arena.policy(OPPONENT)
        (won,), (best,) = pair_odds([(player, opponent)]), best_odds([opponent])
        (risk,) = exploitabilities([player], tolerance=TOLERANCE)
        return {"score": POINTS * (won.rally - 0.5), "best": POINTS * (best.rally - 0.5), "exploitability": risk}


def fitted(method: Method, log: Log, setting: Setting, name: str) -> TabulatedPolicy:
    """Table of the player that a method fits to a log. Raises SuiteError: it raised, or returned none; PolicyError: no policy."""
    learner = made(method, setting, name, "fit")
    data = log.transitions if getattr(learner, "track", "both") == "own" else log
    return table_of(called(name, learner.fit, data), log.game, name)


def in_game(policy: TabulatedPolicy, game: Game) -> TabulatedPolicy:
    """A table of the rules alone as a table of the game."""
    return dataclasses.replace(policy, game=game)


class Evaluate(LogTask):
    """Estimate the value of 32 policies from a log (off-policy evaluation).

    Given: 10^4 or 10^5 own strokes of a behaviour policy against human:0.05 with their probabilities, and 32 policies: 16 named
    ones and 16 trained by methods of ``offline`` on the same log (``same``) or on another one (``fresh``). Score: root mean
    square error of the estimates, in points of rallies won; also bias, rank correlation, and regret of the policy chosen.
    """

    name = "evaluate-v1"
    roles = ()
    answers = ("estimates",)
    metric = "error"
    higher_is_better = False
    optimum = 0.0
    protocol = "method(setting: Setting) -> object with estimate(log, policies) -> one number from 0 to 1 for each policy"
    zero = "the exact values"
    not_proved = "accuracy for other policies or logs, and that a value comes from the log alone"

    def all_cases(self, arena: Arena) -> list[Case]:
        """Each behaviour policy with each number of strokes, on the log that the policies were trained on, and on a fresh one."""
        sizes = (_QUICK,) if arena.quick else (10**4, 10**5)
        return [
            # Logs of one size and kind are exchangeable: with a single seed, each is a unit of the sample.
            Case(name=f"{name}/{kind}", stratum=kind, budget=size, options={"behaviour": name, "log": which})
            for name in self.behaviours(arena)
            for size in sizes
            for which in ("same", "fresh")
            for kind in [f"{size:,}/{which}"]
        ]

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:
        """Ask the method for its estimates."""
        log = log_of_unit(arena, case, seed)
        policies = targets(arena, case, seed)
        setting = Setting(game=log.game, model=arena.model, seed=seed, folder=folder)
        estimator = made(method, setting, self.name, "estimate")
        # Names would tell what a policy is.
        tables = [in_game(policy, log.game) for policy in policies.values()]
        values = called(self.name, lambda: np.asarray(estimator.estimate(log, tables), dtype=np.float64))
        return Outcome(answers={"estimates": np.clip(values, 0, 1).tolist()})

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:
        """The log and the policies."""
        return (log_of_unit(arena, case, seed).hash, *(policy.hash for policy in targets(arena, case, seed).values()))

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:
        """Error, bias, rank correlation and regret; bias of the trained policies alone; error by coverage (:func:`covered`)."""
        policies, estimates = targets(arena, case, seed), outcome.answers.get("estimates")
        try:
            estimated = np.array(msgspec.convert(estimates, list[FractionOrZero]))
        except msgspec.ValidationError as error:
            raise SuiteError(f"the estimates are no numbers from 0 to 1 ({error})") from error
        if len(estimated) != len(policies):
            raise SuiteError(f"expected {len(policies)} estimates, got {len(estimated)}")
        odds = pair_odds([(policy, arena.policy(OPPONENT)) for policy in policies.values()])
        true, share = np.array([each.rally for each in odds]), covered(log_of_unit(arena, case, seed), [*policies.values()])
        parts = {"covered": share >= np.median(share), "not_covered": share < np.median(share)}
        apart = {f"error_{name}": errors(estimated[part], true[part], ())["error"] for name, part in parts.items() if part.any()}
        found = errors(estimated, true, [name in TRAINED for name in policies])
        return {**found, "error_not_covered": 0.0, **apart, "coverage": float(share.mean())}


def covered(log: Log, policies: Sequence[TabulatedPolicy]) -> F64:
    """``[K]`` coverage of policies: which fraction of their strokes, in the own states of a log, it has at least once."""
    game, data = log.game, log.transitions
    seen = np.bincount(data.pair % game.n_base_pairs, minlength=game.n_base_pairs) > 0
    states, number = np.unique(game.base(data.state), return_counts=True)
    shares = [tabular.by_state(game, policy.block_probabilities(0) * seen, states, np.add) for policy in policies]
    return np.array([np.average(share, weights=number) for share in shares])


def errors(estimated: Any, true: Any, trained: Sequence[bool]) -> dict[str, float]:
    """Figures of estimates ``[K]`` against true values ``[K]``, in points; ``trained``: which policies were trained on a log."""
    off = POINTS * (estimated - true)
    rank = scipy.stats.spearmanr(estimated, true).statistic if np.ptp(estimated) > 0 else 0.0
    return {
        "error": float(np.sqrt(np.mean(off**2))),
        "bias": float(np.mean(off)),
        "bias_trained": float(np.mean(off[np.asarray(trained)])) if any(trained) else 0.0,
        "rank_correlation": float(rank),
        "regret": POINTS * float(true.max() - true[int(np.argmax(estimated))]),
    }


def targets(arena: Arena, case: Case, seed: int) -> dict[str, TabulatedPolicy]:
    """The policies to be evaluated in a unit, by name."""
    return _targets(arena, case.options["behaviour"], case.budget, seed)


@functools.lru_cache(maxsize=2)
def _targets(arena: Arena, behaviour_name: str, strokes: int, seed: int) -> dict[str, TabulatedPolicy]:
    log = generate(arena, behaviour_name, strokes, seed)
    setting = Setting(game=blank(arena.game), model=arena.model, seed=seed, folder=Path())
    found = {name: behaviour(arena, _of_split(name, arena)) for name in NAMED}
    for name in TRAINED:
        train = functools.partial(lambda name: fitted(find(Offline.name, name), log, setting, name), name)
        table = cached_table(log.game, f"{log.hash} {name} {seed}", train, rooms=("recording", "suite"))
        found[name] = in_game(table, arena.game)
    return found
