"""Registry of policies by name: shipped policies, families of policies, and user policies.

A name is ``KEY`` or ``KEY:ARGUMENT`` with a registered KEY (``random``, ``bc:viktor-axelsen``), else ``module:attribute``. A
suffix ``@greedy`` or ``@TEMPERATURE`` makes the policy sharper or flatter (``bc@0.5``). :func:`register` adds a family.

A name that a user typed may run user code (:func:`resolve`). A name from a file, such as the header of a rally log, may not
(:func:`resolve_recorded`): it resolves only families that allow it, and neither modules nor files.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

from shuttle_marl.base.errors import did_you_mean
from shuttle_marl.game.policy import GamePolicy, Policy, PolicyError, TabulatedPolicy, TemperedPolicy, UniformPolicy, tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import agents, baselines, computed
from shuttle_marl.policy.baselines import STYLES, ScriptedPolicy
from shuttle_marl.policy.foreign import ModuleMissingError, current_limit, from_module
from shuttle_marl.policy.plain_network import load_weights
from shuttle_marl.policy.programs import ProgramPolicy

Load = Callable[[str | None, Game], Policy]
Names = Callable[[Game], Iterable[str]]
Opponents = str | Policy | Sequence[str | Policy]  # name of a policy, a policy, or several of either

_MOST_NESTED: Final = 8  # largest nesting depth of names, as in best-response:best-response:bc; each level solves a game


class UnrequestedError(PolicyError):
    """The name of a policy in a file would run code or open a file of its choice."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Family:
    """Policies with the same key, the part of the name before the colon.

    Attributes:
        load: called with the part after the colon (None without one) and the game; raises :class:`PolicyError` for an
            unknown argument.
        names: names for a game that can be listed; None: the key alone.
        about: description of all names in one line, or a function from a name to its description.
        form: the name with its argument in capitals, such as ``table:FILE``, if not all names can be listed.
        of_policies: whether the argument is the name of another policy, which keeps its own ``@`` suffix.
        from_data: whether names from files may be resolved; then no argument may make ``load`` run code or open a file of its
            choice. With ``of_policies``, the inner name is checked before ``load``.
    """

    load: Load
    names: Names | None = None
    about: str | Callable[[str], str] = ""
    form: str = ""
    of_policies: bool = False
    from_data: bool = False

    def described(self, name: str) -> str:
        """Description of one of its names."""
        return self.about(name) if callable(self.about) else self.about


_FAMILIES: dict[str, Family] = {}


def register(key: str, family: Family) -> None:
    """Add policies to the registry.

    Args:
        key: the part before the colon, or the whole name.

    Raises:
        PolicyError: the key is registered already, or is not a plain word.
    """
    if not key or any(c in key for c in ":@ "):
        raise PolicyError(f"policy key {key!r}: expected a word without ':', '@' and spaces")
    if key in _FAMILIES:
        raise PolicyError(f"policy key {key!r} is registered already; choose another")
    _FAMILIES[key] = family


def names(game: Game) -> tuple[str, ...]:
    """Names of all policies that can be listed for a game."""
    return tuple(described_names(game))


def described_names(game: Game) -> dict[str, str]:
    """Description of each of :func:`names`, in one line."""
    listed = ((family, (key,) if family.names is None else family.names(game)) for key, family in _FAMILIES.items())
    return {name: family.described(name) for family, names in listed for name in names}


def forms() -> dict[str, str]:
    """Names with an argument of the user, such as ``table:FILE``, and their descriptions."""
    return {family.form: family.described(family.form) for family in _FAMILIES.values() if family.form}


def resolve(name: str, game: Game) -> TabulatedPolicy | GamePolicy:
    """Resolve the name of a policy that the user gave; for names from files use :func:`resolve_recorded`.

    Args:
        name: see the description of this module; for ``module:attribute`` see :func:`shuttle_marl.policy.foreign.from_module`.

    Returns:
        The policy; a program under the time limit of :func:`shuttle_marl.policy.foreign.time_limit` within that context.

    Raises:
        PolicyError: the policy does not exist (the message suggests names), or it cannot be loaded.
    """
    _check_depth(name)
    base, temperature = _split(name)
    policy = _resolve_plain(base, game)
    policy = policy if temperature is None else TemperedPolicy(policy, temperature)
    return policy if isinstance(policy, TabulatedPolicy | GamePolicy) else GamePolicy(policy, game, name)


def resolve_recorded(name: str, game: Game) -> TabulatedPolicy | GamePolicy:
    """Resolve the name of a policy from a file, without importing modules or opening files of its choice.

    Args:
        name: as in :func:`resolve`.

    Raises:
        PolicyError: the name is of a module, a file, or a family that does not allow it; or as for :func:`resolve`.
    """
    _check_depth(name)
    _check_from_data(name)
    return resolve(name, game)


def tabulated(opponents: Opponents, game: Game) -> list[TabulatedPolicy]:
    """The tables of one or several opponents.

    Raises:
        PolicyError: an opponent does not exist, returns no distribution over the legal strokes, or reads the score.
    """
    several = opponents if isinstance(opponents, Sequence) and not isinstance(opponents, str) else [opponents]
    return [tabulate(resolve(one, game) if isinstance(one, str) else one, game) for one in several]


def _check_depth(name: str) -> None:
    inner = name
    for _ in range(_MOST_NESTED):
        key, colon, inner = inner.partition(":")
        family = _FAMILIES.get(key) if colon else None
        if family is None or not family.of_policies:
            return
    raise PolicyError(f"policy {name[:60]!r}…: more than {_MOST_NESTED - 1} names around a policy")


def _check_from_data(name: str) -> None:
    base, _ = _split(name)
    key, colon, argument = base.partition(":")
    family = _FAMILIES.get(key)
    if family is None and not colon:
        return  # no policy has this name, which resolve says
    if family is None or not family.from_data:
        raise UnrequestedError(
            f"policy {name!r} is not resolved because a file named it: only policies of the package and of families that "
            "allow it are, no modules and no files"
        )
    if family.of_policies and colon:
        _check_from_data(argument)


def _split(name: str) -> tuple[str, float | None]:
    """The name without the suffix of its temperature, and the temperature; None without a suffix."""
    base, at, suffix = name.rpartition("@")
    key, colon, _ = name.partition(":")
    family = _FAMILIES.get(key) if at and colon else None
    if not at or (family is not None and family.of_policies):
        return name, None
    if suffix == "greedy":
        return base, 0.0
    with contextlib.suppress(ValueError):
        if 0 < (temperature := float(suffix)) < float("inf"):
            return base, temperature
    raise PolicyError(f"policy {name!r}: expected @greedy or a temperature above 0 such as @0.5 behind the name")


def _resolve_plain(name: str, game: Game) -> Policy:
    key, colon, argument = name.partition(":")
    if (family := _FAMILIES.get(key)) is not None:
        return family.load(argument if colon else None, game)
    if colon and key and argument:
        try:
            return from_module(name, game)
        except ModuleMissingError as error:
            raise PolicyError(f"{error}{did_you_mean(name, names(game))}") from error
    plain = [known for known in names(game) if ":" not in known]
    hint = (
        did_you_mean(name, names(game), cutoff=0.5)
        or f"; known: {', '.join(plain)}, bc:PLAYER and others (`policies` lists all)."
    )
    raise PolicyError(f"no policy {name!r}{hint} Your own is given as module:attribute.")


def _plain(key: str, policy: Policy, about: str) -> None:
    def load(argument: str | None, _: Game) -> Policy:
        if argument is not None:
            raise PolicyError(f"policy {key}:{argument}: {key!r} takes nothing behind a colon; write {key}")
        return policy

    register(key, Family(load=load, about=about, from_data=True))


def _with_argument(
    form: str, example: str, expected: str, about: str, load: Callable[[str, Game], Policy], names: Names = lambda _: ()
) -> None:
    """Register a family whose names need an argument; names from files are resolved if the argument is the name of a policy."""
    key, _, argument = form.partition(":")

    def checked(given: str | None, game: Game) -> Policy:
        if not given:
            raise PolicyError(f"policy {key}: expected {expected} behind the colon, as in {key}:{example}")
        return load(given, game)

    nested = argument == "POLICY"
    register(key, Family(load=checked, names=names, about=about, form=form, of_policies=nested, from_data=nested))


_BC_ABOUT: Final = {
    "bc": "the average player of the data, imitated",
    baselines.REMEMBERING: "the same with a memory of the rally, for simulated matches that look real; has no table",
}


def _load_bc(player: str | None, game: Game) -> Policy:
    return baselines.load_remembering(game) if f"bc:{player}" == baselines.REMEMBERING else baselines.load(player, game)


def _bc_names(game: Game) -> list[str]:
    if not baselines.known_for(game):
        return []
    remembering = [baselines.REMEMBERING] if baselines.remembers(game) else []
    return ["bc", *remembering, *(f"bc:{player}" for player in baselines.players(game))]


_bc = Family(
    load=_load_bc,
    names=_bc_names,
    about=lambda name: _BC_ABOUT.get(name) or f"{name.partition(':')[2]}, imitated",
    from_data=True,
)
register("bc", _bc)
for _key, _rules in STYLES.items():
    _plain(_key, ScriptedPolicy(_rules), f"scripted: {(_rules.__doc__ or '').partition(chr(10))[0]}")
_plain("random", UniformPolicy(), "every legal stroke equally likely")
_minimax = Family(
    load=lambda kind, game: computed.minimax_policy(game, kind),
    names=computed.minimax_names,
    about=lambda name: "best play in the model" if name == "minimax" else "best worst case over the game and its refits",
    from_data=True,
)
register("minimax", _minimax)
_human = Family(
    load=computed.load_human,
    names=lambda game: (f"human:{computed.TYPICAL_TAU}",) if baselines.known_for(game) else (),
    about="strong play at a cost for each nat away from how people play",
    form="human:TAU",
    from_data=True,
)
register("human", _human)
_with_argument(
    "best-response:POLICY", "bc", "the name of a policy", "best response to another policy, solved exactly",
    lambda name, game: computed.best_response_policy(tabulate(resolve(name, game.opposite), game.opposite)),
    names=lambda game: ("best-response:bc",) if baselines.known_for(game) else (),
)  # fmt: skip
for _key in agents.ALGORITHMS:
    _load, _names = functools.partial(agents.load_shipped, _key), functools.partial(agents.installed, _key)
    register(_key, Family(load=_load, names=_names, about=agents.about, from_data=True))
_with_argument(
    "agent:FOLDER", "runs/ppo-0/agent", "the folder of a trained agent", "trained agent, from the folder of its run",
    lambda folder, game: agents.load_agent(Path(folder), game),
)  # fmt: skip
_with_argument(
    "torch:FILE", "mine.safetensors", "a file",
    "network of your own from its weights: linear layers with one activation function, saved by save_network",
    lambda file, _: load_weights(Path(file)),
)  # fmt: skip
_with_argument(
    "program:COMMAND", "./player", "a command",
    "program of your own in any language, asked for every stroke in lines of JSON",
    lambda command, game: ProgramPolicy(command, game, current_limit()),
)  # fmt: skip
_with_argument(
    "table:FILE", "FILE", "a file", "policy kept as a table",
    lambda file, game: dataclasses.replace(TabulatedPolicy.load(Path(file), game.average), game=game),
)  # fmt: skip
