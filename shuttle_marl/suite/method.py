"""Methods by name: the baselines of the suite, and user code ``MODULE:ATTRIBUTE``.

A method is called with the setting of a case (see the page of the task) and returns what the protocol of the task asks for. A
baseline is a module of this package; its name may have an argument after a colon, such as ``restricted-nash:0.5``.
"""

import dataclasses
import functools
import importlib
import inspect
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import ShuttleError, described
from shuttle_marl.base.extras import lacking
from shuttle_marl.policy.foreign import import_attribute
from shuttle_marl.policy.sources import source_hashes
from shuttle_marl.suite.options import Access, Kind, SuiteError

Method = Callable[..., Any]


@dataclasses.dataclass(frozen=True)
class Baseline:
    """A method of this package.

    Attributes:
        path: ``MODULE:ATTRIBUTE`` within this package.
        kind: references do not depend on the seed, so one is enough.
        argument: of the method, if its name has none.
    """

    path: str
    access: Access = "samples"
    kind: Kind = "method"
    argument: str | None = None


_KNOWN: Final = {name: Baseline(f"references:{name}", "tables", "reference") for name in ("bc", "minimax")}
_LEARNERS: Final = {name: Baseline("training:learner", argument=name) for name in ("ppo", "a2c", "sac")}
_RANDOM: Final = Baseline("references:random", "samples", "reference")
BASELINES: Final[dict[str, dict[str, Baseline]]] = {
    "exploit": {
        **_LEARNERS,
        "ppo-self-play": Baseline("training:ppo_blind"),
        "ppo-restricted": Baseline("training:ppo_restricted", "tables"),
        "ppo-mixed": Baseline("training:ppo_mixed"),
        "restricted-counts": Baseline("modelled:restricted_counts", "tables"),
        "restricted-mixture": Baseline("modelled:restricted_mixture", "tables"),
        "best-response-counts": Baseline("modelled:restricted_counts", "tables", argument="1"),
        **{name: Baseline("modelled:from_log", argument=name) for name in ("fitted-q", "fitted-q-boosted", "model")},
        "model-boosted": Baseline("modelled:boosted_model"),
        "constant": Baseline("references:constant", "opponent", "reference"),
        "constant-by-incoming": Baseline("references:constant_by_incoming", "opponent", "reference"),
        **_KNOWN,
        "best-response": Baseline("references:best_response", "opponent", "reference"),
        "restricted": Baseline("references:restricted", "opponent", "reference"),
        "random": _RANDOM,
    },
    "equilibrium": {
        **_LEARNERS,
        "ppo-deterministic": Baseline("training:ppo_deterministic"),
        **{f"ppo-{name}": Baseline("training:ppo_variant", "tables", argument=name) for name in ("best-response", "restarts")},
        **{f"ppo-{name}": Baseline("training:ppo_variant", argument=name) for name in ("pool", "magnet", "nash")},
        "fictitious-self-play": Baseline("training:fictitious_self_play"),
        "psro": Baseline("training:psro", "tables"),
        "model": Baseline("modelled:solved_model", argument="means"),
        "model-boosted": Baseline("modelled:solved_model", argument="trees"),
        "psro-exact": Baseline("training:psro_exact", "tables", "reference"),
        "fictitious-play": Baseline("references:fictitious_play", "tables", "reference"),
        "minimax-deterministic": Baseline("references:minimax_deterministic", "tables", "reference"),
        **_KNOWN,
        "random": _RANDOM,
    },
    "adapt": {
        "minimax": Baseline("adapters:Minimax", "tables", "reference"),
        "best-response-bc": Baseline("adapters:RestrictedNash", "tables", "reference"),
        "restricted-nash": Baseline("adapters:RestrictedNash", "tables", "reference"),
        "bandit": Baseline("adapters:Bandit", "tables"),
        "bayes": Baseline("adapters:Bayes", "tables"),
        "thompson": Baseline("adapters:Thompson", "tables"),
        "posterior-mean": Baseline("adapters:PosteriorMean", "tables"),
        "likeliest": Baseline("adapters:Likeliest", "tables"),
        "counts": Baseline("adapters:Counts", "tables"),
        "counts-recent": Baseline("adapters:RecentCounts", "tables"),
        "counts-typed": Baseline("adapters:TypedCounts", "tables"),
        "tilts": Baseline("adapters:Tilts", "tables"),
        "mixture": Baseline("adapters:Mixture", "tables"),
        **{
            f"mixture-without-{part}": Baseline("adapters:ablated", "tables", "ablation", part)
            for part in ("levels", "weights", "places", "change")
        },
    },
    "offline": {
        "clone": Baseline("learned:Clone"),
        "clone-won": Baseline("learned:CloneWon"),
        "one-step": Baseline("learned:OneStep"),
        "advantage-weighted": Baseline("learned:AdvantageWeighted", argument="0.02"),
        "fitted-q": Baseline("learned:FittedQ"),
        "fitted-q-pessimistic": Baseline("learned:PessimisticQ", argument="0.1"),
        "bcq": Baseline("learned:ConstrainedQ", argument="0.3"),
        "iql": Baseline("learned:ImplicitQ", argument="10"),
        "model": Baseline("learned:Model"),
        "model-pessimistic": Baseline("learned:PessimisticModel", argument="0.1"),
        "model-ensemble": Baseline("learned:ModelEnsemble", argument="3"),
        "fitted-q-boosted": Baseline("learned:BoostedQ", argument="100"),
        "model-boosted": Baseline("learned:BoostedModel", argument="150"),
        "shipped-minimax": Baseline("learned:Shipped", "tables", "reference", "minimax"),
        "shipped-best-response": Baseline("learned:Shipped", "tables", "reference", "best-response:human:0.05"),
    },
    "evaluate": {
        "behaviour": Baseline("estimators:Behaviour", kind="reference"),
        "importance-sampling": Baseline("estimators:ImportanceSampling"),
        "weighted-importance-sampling": Baseline("estimators:WeightedImportanceSampling"),
        "truncated-importance-sampling": Baseline("estimators:TruncatedImportanceSampling"),
        "doubly-robust": Baseline("estimators:DoublyRobust"),
        "weighted-doubly-robust": Baseline("estimators:WeightedDoublyRobust"),
        "magic": Baseline("estimators:Magic"),
        "dice": Baseline("estimators:DensityRatio"),
        "fitted-q-evaluation": Baseline("estimators:FittedQEvaluation"),
        "model": Baseline("estimators:ModelBased"),
        "model-boosted": Baseline("estimators:BoostedModel"),
    },
    "text": {
        "random": Baseline("chat:RandomLegal", "samples", "reference"),
        "ppo": Baseline("chat:Policy", argument="ppo"),
        "ppo-self-play": Baseline("chat:Policy", argument="ppo:self-play"),
        "policy": Baseline("chat:Policy", "tables", "reference"),
        "chat": Baseline("chat:Chat"),
    },
}
"""Baselines by kind of task."""


PROGRAMS: Final = ("exploit", "equilibrium", "text")
"""Kinds of tasks whose methods may be programs."""


def kind_of(task: str) -> str:
    """Kind of a task: the first word of its name, which it shares with its entrance."""
    return task.partition("-")[0]


def baseline_of(task: str, name: str) -> Baseline | None:
    """The baseline of this package that a name means; None for methods of others."""
    return BASELINES[kind_of(task)].get(name.partition(":")[0])


def find(task: str, name: str) -> Method:
    """A method by name.

    Args:
        name: a baseline of the task, ``program:COMMAND`` for a program in any language, or ``MODULE:ATTRIBUTE``; the module may
            be in the current folder.

    Raises:
        SuiteError: there is no such method.
        PolicyError: importing the module failed.
    """
    known = BASELINES[kind_of(task)]
    key, colon, argument = name.partition(":")
    if key in known:
        module, _, attribute = known[key].path.partition(":")
        method: Method = getattr(importlib.import_module(f"shuttle_marl.suite.methods.{module}"), attribute)
        chosen = argument if colon else known[key].argument
        return method if chosen is None else functools.partial(method, argument=chosen)
    if key == "program" and argument and kind_of(task) in PROGRAMS:
        return functools.partial(_program, name)
    if key == "program":
        tasks = ", ".join(f"{kind}-v0" for kind in PROGRAMS)
        raise SuiteError(f"no method {name!r} of {task}: programs, as program:COMMAND, are possible in {tasks}")
    if not colon or not argument:
        raise SuiteError(f"no method {name!r} of {task}; there are: {', '.join(known)}. Your own is given as MODULE:ATTRIBUTE")
    thing = import_attribute(name)
    if not callable(thing):
        raise SuiteError(f"method {name!r} is a {type(thing).__name__}; expected a function or a class")
    return thing


def sources(task: str, name: str) -> dict[str, str]:
    """Hashes of the files of a method that :func:`find` found, by file or package."""
    key, _, argument = name.partition(":")
    if key not in BASELINES[kind_of(task)]:
        return source_hashes(name)
    return {**source_hashes(f"{__name__}:"), **source_hashes(f":{argument}")}


def _program(name: str, setting: Any) -> Any:
    """What a program plays: a name for tasks of players, else its adapter of the task."""
    return setting.program(name) if hasattr(setting, "program") else name


def made(method: Method, setting: Any, name: str, *calls: str) -> Any:
    """Call a method with a setting; a class or function without parameters is called without one.

    Raises:
        SuiteError: it raised, or made an object without one of the ``calls``.
    """
    try:
        inspect.signature(method).bind()
    except TypeError:
        found = called(name, method, setting)
    else:
        found = called(name, method)
    if not all(callable(getattr(found, call, None)) for call in calls):
        raise SuiteError(f"the method of {name}: expected an object with {' and '.join(calls)}, got a {type(found).__name__}")
    return found


def called(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call code of a method.

    Raises:
        SuiteError: it raised.
    """
    try:
        return function(*arguments)
    except ShuttleError:
        raise
    except ModuleNotFoundError as error:
        raise SuiteError(f"the method of {name}: {lacking(error) or error}") from error
    except (Exception, SystemExit) as error:
        # The last line of the file whose code was called.
        frames = traceback.extract_tb(error.__traceback__)[1:]
        own = [frame for frame in frames if frame.filename == frames[0].filename]
        place = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
        raise SuiteError(f"the method of {name} raised {described(error)}{place}") from error
