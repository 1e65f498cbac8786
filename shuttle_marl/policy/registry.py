"""Every player by name: one registry for shipped policies, families of policies, and a user's own.

A name is ``KEY`` or ``KEY:ARGUMENT`` where KEY was registered (``random``, ``bc:viktor-axelsen``), else
``module:attribute``. ``@greedy`` or ``@TEMPERATURE`` behind it makes the policy sharper or flatter (``bc@0.5``). A new
family is one call of :func:`register`, or an entry point of an installed package:

    [project.entry-points."shuttle_marl.policies"]
    KEY = "package.module:FAMILY"

where ``FAMILY`` is a :class:`Family`. Entry points are read when a name is asked for that is not registered, or all names, so
they slow nothing else; a package's module should import what is heavy inside its functions.
"""

import contextlib
import dataclasses
import difflib
import functools
import importlib
import importlib.metadata
import inspect
import operator
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.policy import Policy, PolicyError, States
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy, tabulate
from shuttle_marl.game.tempered import TemperedPolicy
from shuttle_marl.game.uniform import UniformPolicy
from shuttle_marl.policy import agents, bc
from shuttle_marl.policy.scripted import STYLES, ScriptedPolicy

Load = Callable[[str | None, Game], Policy]

ENTRY_POINTS: Final = "shuttle_marl.policies"
"""Group of the entry points by which installed packages add families."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Family:
    """Policies that share the part of their name before the colon.

    Attributes:
        load: called with what stands behind the colon (None without one) and the game; raises :class:`PolicyError` for an
            argument it does not know.
        names: the full names that can be listed now.
        of_policies: whether what stands behind the colon is the name of another policy, and so keeps its own ``@…``.
    """

    load: Load
    names: Callable[[], Iterable[str]]
    of_policies: bool = False


_FAMILIES: dict[str, Family] = {}


def register(key: str, load: Load, names: Callable[[], Iterable[str]] | None = None, *, of_policies: bool = False) -> None:
    """Add policies to the registry.

    Args:
        key: what stands before the colon, or the whole name.
        load: called with what stands behind the colon (None without one) and the game; raises :class:`PolicyError` for an
            argument it does not know. Import what is heavy inside.
        names: the full names that can be listed now; default just ``key``.
        of_policies: whether what stands behind the colon is the name of another policy.

    Raises:
        PolicyError: the key is taken, or is no plain word.
    """
    if not key or any(c in key for c in ":@ "):
        raise PolicyError(f"policy key {key!r}: expected a word without ':', '@' and spaces")
    if key in _FAMILIES:
        raise PolicyError(f"policy key {key!r} is registered already; choose another")
    _FAMILIES[key] = Family(load=load, names=names or (lambda: (key,)), of_policies=of_policies)


def names() -> tuple[str, ...]:
    """Names of all policies that can be listed: those of installed packages and those registered since."""
    families = list(_FAMILIES.values())
    for key in _entry_points():
        # A package that cannot be imported says so when its policies are asked for, and is in nobody else's way.
        with contextlib.suppress(PolicyError):
            families += [family for family in [_plugged_in(key)] if family is not None and key not in _FAMILIES]
    return tuple(name for family in families for name in family.names())


@functools.cache
def _entry_points() -> dict[str, importlib.metadata.EntryPoint]:
    return {point.name: point for point in importlib.metadata.entry_points(group=ENTRY_POINTS)}


def _family(key: str) -> Family | None:
    """The family of a key, registered or from an entry point; a registered one hides an entry point of the same name."""
    return _FAMILIES.get(key) or _plugged_in(key)


@functools.cache
def _plugged_in(key: str) -> Family | None:
    point = _entry_points().get(key)
    if point is None:
        return None
    try:
        family = point.load()
    except Exception as error:
        raise PolicyError(f"policies {key!r}: entry point {point.value} raised {type(error).__name__}: {error}") from error
    if not isinstance(family, Family):
        raise PolicyError(f"policies {key!r}: entry point {point.value} is a {type(family).__name__}, expected a Family")
    return family


def resolve(name: str, game: Game) -> Policy:
    """Find a policy by name.

    Args:
        name: see the module's first lines; ``attribute`` of ``module:attribute`` is a policy, a class of policies that
            takes nothing or the game, or a function from :class:`States` to ``[B, n]`` chances. The module may lie in the
            current folder.
        game: the tables that the policy will play on.

    Raises:
        PolicyError: there is no such policy (with the closest names), or it cannot be made.
    """
    base, at, suffix = name.rpartition("@")
    key, colon, _ = name.partition(":")
    family = _family(key) if at and colon else None
    if not at or (family is not None and family.of_policies):
        return _resolve_plain(name, game)
    return TemperedPolicy(_resolve_plain(base, game), _temperature(name, suffix))


def _resolve_plain(name: str, game: Game) -> Policy:
    key, colon, argument = name.partition(":")
    if (family := _family(key)) is not None:
        return family.load(argument if colon else None, game)
    if colon and key and argument:
        return _from_module(name, key, argument, game)
    close = difflib.get_close_matches(name, names(), n=4, cutoff=0.5)
    hint = f"did you mean {', '.join(close)}?" if close else f"known: {', '.join(names())}."
    raise PolicyError(f"no policy {name!r}; {hint} Your own is given as module:attribute.")


def _temperature(name: str, suffix: str) -> float:
    if suffix == "greedy":
        return 0.0
    try:
        temperature = float(suffix)
    except ValueError:
        temperature = -1.0
    if not 0 < temperature < float("inf"):
        raise PolicyError(f"policy {name!r}: expected @greedy or a temperature above 0 such as @0.5 behind the name")
    return temperature


@dataclasses.dataclass(frozen=True, eq=False)
class FunctionPolicy:
    """A plain function from states to chances as a policy; its attribute ``reads_score`` counts."""

    function: Callable[[States], npt.NDArray[np.floating]]

    @property
    def reads_score(self) -> bool:
        """Whether the function says that it reads the score."""
        return bool(getattr(self.function, "reads_score", False))

    def probabilities(self, states: States) -> npt.NDArray[np.floating]:
        """What the function returns."""
        return self.function(states)


def _from_module(name: str, module_name: str, attribute: str, game: Game) -> Policy:
    module = _import(name, module_name)
    try:
        thing: Any = operator.attrgetter(attribute)(module)
    except AttributeError as error:
        close = difflib.get_close_matches(attribute, [a for a in vars(module) if not a.startswith("_")], n=4, cutoff=0.5)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        raise PolicyError(f"policy {name!r}: module {module_name!r} has no {attribute!r}{hint}") from error
    if inspect.isclass(thing):
        thing = _instance(name, thing, game)
    if callable(getattr(thing, "probabilities", None)):
        return thing
    if callable(thing):
        return FunctionPolicy(thing)
    raise PolicyError(
        f"policy {name!r} is a {type(thing).__name__}; expected an object or class with a method probabilities(states), "
        "or a function from states to an array [B, n] of chances"
    )


def _import(name: str, module_name: str) -> ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:
        # Behind everything else, so that a file of the user's hides no installed module; it stays, because the policy
        # may import its neighbours later.
        sys.path.append(here)
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if (module_name + ".").startswith(f"{error.name}."):
            close = difflib.get_close_matches(name, names(), n=4, cutoff=0.6)
            hint = f"; did you mean {', '.join(close)}?" if close else ""
            raise PolicyError(f"policy {name!r}: no module {module_name!r} in the current folder or installed{hint}") from error
        raise PolicyError(f"policy {name!r}: its module needs {error.name!r}, which is not installed") from error
    except Exception as error:
        raise PolicyError(f"policy {name!r}: importing its module raised {type(error).__name__}: {error}") from error


def _instance(name: str, cls: Callable[..., Any], game: Game) -> Any:
    try:
        try:
            inspect.signature(cls).bind()
        except TypeError:
            return cls(game)
        return cls()
    except Exception as error:
        raise PolicyError(f"policy {name!r}: making it raised {type(error).__name__}: {error}") from error


def _plain(key: str, make: Callable[[Game], Policy]) -> None:
    """Register a policy that takes no argument."""

    def load(argument: str | None, game: Game) -> Policy:
        if argument is not None:
            raise PolicyError(f"policy {key}:{argument}: {key!r} takes nothing behind a colon; write {key}")
        return make(game)

    register(key, load)


def _scripted(style: Any, game: Game) -> Policy:  # noqa: ARG001  every family is called alike
    return ScriptedPolicy(style)


def _load_bc(player: str | None, game: Game) -> Policy:
    return bc.load(player, game)


def _load_table(file: str | None, game: Game) -> Policy:
    if not file:
        raise PolicyError("policy table: expected a file behind the colon, as in table:FILE")
    return TabulatedPolicy.load(Path(file), game)


def _bc_names() -> list[str]:
    return ["bc", *(f"bc:{player}" for player in bc.players())] if bc.installed() else []


@functools.lru_cache(maxsize=4)
def minimax_policy(game: Game) -> TabulatedPolicy:
    """The minimax policy of a game, solved once."""
    from shuttle_marl.exact.minimax import solve  # noqa: PLC0415  numba, only when it is asked for

    return solve(game).policy[0]


def _load_best_response(name: str | None, game: Game) -> Policy:
    from shuttle_marl.exact.response import best_response  # noqa: PLC0415  numba, only when it is asked for

    if not name:
        raise PolicyError("policy best-response: expected the name of a policy behind the colon, as in best-response:bc")
    return best_response(tabulate(resolve(name, game), game, name)).policy


def _best_response_names() -> tuple[str, ...]:
    return ("best-response:bc",) if bc.installed() else ()


register("bc", _load_bc, _bc_names)
for _key, _style in STYLES.items():
    _plain(_key, functools.partial(_scripted, _style))
_plain("random", lambda _: UniformPolicy())
_plain("minimax", minimax_policy)
register("best-response", _load_best_response, _best_response_names, of_policies=True)
for _key in agents.ALGORITHMS:
    register(_key, functools.partial(agents.load_shipped, _key), functools.partial(agents.installed, _key))
register("agent", agents.load_folder, lambda: ())
register("table", _load_table, lambda: ())
