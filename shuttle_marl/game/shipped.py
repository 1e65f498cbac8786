"""Finds the models that come with the package, and reads their games and the variants of these.

A name such as ``default:men`` means a variant of a model: the game of one discipline, or of a refit on resampled matches. It has
the same strokes and rules. For every base pair it says by how many steps of :data:`STEP` the log-odds of five probabilities
differ from those of the model: of a fault, of a winner given a good stroke, of a return from below given a return, and of a
hurried receiver given a return from below and from above; in whole numbers, the same on every machine.
"""

import contextlib
import dataclasses
import functools
import itertools
import json
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I8, I32, U64, Bools, Intp
from shuttle_marl.base.errors import ShuttleError, command
from shuttle_marl.base.files import FileReadError, hash_in, parsed, read_sealed
from shuttle_marl.base.tensor_files import Tensors, checked, packed_bytes, read_tensors, tensor_bytes, unpacked_bytes
from shuttle_marl.game.draws import HURRY_ONE, ONE, moved_share, odds_of_steps
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.recovery import N_POSITIONS, Recovery
from shuttle_marl.game.stroke import frozen
from shuttle_marl.game.tables import Game

GAME: Final = "game.safetensors"  # the compiled game in a model folder
BC: Final = "bc.safetensors"  # its behaviour-cloned players
CHOICE_UNITS: Final = 64  # their log-probabilities are multiples of 1/64: within .8 % of a probability, in a third of the space
HISTORY: Final = "history.safetensors"  # shifts of the average player's choices by earlier strokes of the rally
NETWORKS: Final = "networks.safetensors"  # the fitted models that the game was compiled from
VARIANTS: Final = "variants.safetensors"  # variants of the game, as differences from it
Profile = Literal["men", "women"]
PROFILES: Final = ("men", "women")  # variants that are the games of one discipline
OPPOSITE: Final = "opposite"  # variant of players with different hands; behind another one: that of it (`men-opposite`)
OPPOSITE_GAME: Final = "opposite.safetensors"  # the game of players with different hands; legal replies fly to the other side
RECOVERY: Final = "recovery"  # in names of games: receivers choose where to wait (`default:recovery`, `default:men-recovery`)
SKILL: Final = "skill.safetensors"  # skill of the players, as differences from the average player
HABITS: Final = "habits.safetensors"  # counted strokes of the players, for reports
HURRY: Final = "hurry.safetensors"  # index that decides whether strikers were hurried, in models of strokes with positions
POSITIONS: Final = "recovery.safetensors"  # where people wait, and what a position changes (`recovery`)
SUPPORT: Final = "support.safetensors"  # data file beside the models: the torch reference of the tables needs it
RELIABLE: Final = 20  # number of real strokes below which the probabilities of a stroke are not reliable
REFITS: Final = 8  # refits of a shipped model on resampled matches, named :1, :2, … behind the model
CARD: Final = "card.json"  # the model card, which holds the hashes of the other files
FILES: Final = (GAME, OPPOSITE_GAME, BC, NETWORKS, SUPPORT)  # files of every model, beside its card
OPTIONAL_FILES: Final = (HABITS, HISTORY, HURRY, POSITIONS, SKILL, VARIANTS)  # files that some models have
STEP: Final = 0.0625  # difference of log-odds of one step of a variant
COARSE: Final = 4  # steps of refits are multiples of this: in half the space, and their errors are about five steps
MOST_STEPS: Final = 127  # maximum size of a difference in steps
_RARE: Final = 0.006
_SLACK: Final = 1e-6
_MODELS: Final = Path(__file__).parent.parent / "models"


class Origin(NamedTuple):
    """The model and the variant that a game was loaded from."""

    folder: Path  # the model folder
    variant: str | None = None  # name of the variant; None: the game of the model itself
    recovery: bool = False  # whether receivers choose where to wait

    def name_in(self, model: str | Path) -> str:
        """Name of the game in a model of this name or folder."""
        return ":".join(filter(None, (str(model), "-".join(filter(None, (self.variant, RECOVERY * self.recovery))))))

    @property
    def name(self) -> str:
        """Name of the game."""
        return self.name_in(self.folder.name if self.folder.parent == _MODELS else self.folder)

    @property
    def loader(self) -> Callable[[], Game] | None:
        """What loads the game in another process; None for a model that is not shipped."""
        return functools.partial(load_game, self.name) if self.folder.parent == _MODELS else None


_ORIGINS: dict[str, Origin] = {}  # by hash, for copies of a loaded game: two models may have the same tables and other refits


def model_folder(name: str = "default") -> Path:
    """Folder of a shipped model, or of the model in the folder ``name``, also of a variant. Raises GameError: there is none."""
    return origin_named(name).folder


def is_shipped(name: str) -> bool:
    """Whether a model of this name is part of the package."""
    return name in {path.parent.name for path in _MODELS.glob(f"*/{GAME}")}


@functools.cache
def load_game(name: str = "default") -> Game:
    """The game of a model by name or folder, or of ``MODEL:VARIANT``. Raises GameError: there is none, or it is damaged."""
    return game_of(origin_named(name))


@functools.cache
def game_of(origin: Origin) -> Game:
    """The game of an origin. Raises GameError: the model or variant does not exist, or its file is damaged."""
    folder, variant, recovery = origin
    tables = {None: GAME, OPPOSITE: OPPOSITE_GAME}.get(variant)
    if recovery:
        game = dataclasses.replace(game_of(Origin(folder, variant)), recovery=load_positions(folder))
    elif tables is not None and (folder / tables).is_file():
        game = Game.load(folder / tables)
    else:
        (tensors, known), (equal, opposite) = _variants(folder), hands_of_variant(variant)
        if opposite and equal in known:
            game = between_hands(game_of(Origin(folder, equal)), folder)
        elif tensors is None or variant not in known:
            raise GameError(f"no variant {variant!r} of model {Origin(folder).name!r}; there are: {', '.join(known) or 'none'}")
        else:
            game = unpacked(tensors, game_of(Origin(folder)), variant, folder)
    if folder.parent == _MODELS or game.hash not in _ORIGINS:
        _ORIGINS[game.hash] = origin
    object.__setattr__(game, "origin", origin)
    return game


def load_positions(folder: Path) -> Recovery:
    """Where people wait in a model folder, and what a position changes. Raises GameError: it has none, or they are damaged."""
    if not (folder / POSITIONS).is_file():
        raise GameError(f"{folder}: a model without positions of receivers; fit it to strokes that have them")
    with readable(folder, POSITIONS, "positions") as tensors:
        return Recovery.checked(tensors)


@functools.cache
def waiting_places() -> F64:
    """``[9, 2]`` mean place of people at each position: towards the forehand side, from the net [m]; of the shipped model."""
    return frozen(checked(read_model(_MODELS / "default", POSITIONS).arrays["mean"], np.float64, (N_POSITIONS, 2)))


def variant_of(name: str | None, *, opposite: bool) -> str | None:
    """Name of a variant, None for the game of the model, with equal or different hands."""
    return "-".join(filter(None, (name, OPPOSITE if opposite else None))) or None


def hands_of_variant(variant: str | None) -> tuple[str | None, bool]:
    """The same variant between equal hands, None for the game of the model, and whether the hands differ."""
    equal, _, last = (variant or "").rpartition("-")
    return (equal or None, True) if last == OPPOSITE else (variant, False)


def is_refit(variant: str) -> bool:
    """Whether a variant is a refit on resampled matches; their names are numbers from 1."""
    return variant.isdecimal()


def variants(name: str | Path = "default") -> list[str]:
    """Names of the variants of a model, by name or folder: disciplines, hands, refits. Raises GameError: none, or damaged."""
    return list(_variants(name if isinstance(name, Path) else model_folder(name))[1])


def origin_named(name: str) -> Origin:
    """Folder and variant that a name means. Raises GameError: the model does not exist."""
    model, _, variant = name.rpartition(":")
    # The name of a folder may hold a colon itself.
    for whole, part in ((name, None), (model, variant)):
        for folder in (_MODELS / whole, Path(whole)):
            if whole and (folder / GAME).is_file():
                without, _, last = (part or "").rpartition("-")
                return Origin(folder, without or None, recovery=True) if last == RECOVERY else Origin(folder, part)
    shipped = ", ".join(sorted(p.parent.name for p in _MODELS.glob(f"*/{GAME}"))) or "none"
    fit = command("dynamics", "fit")
    there = f"{shipped}, and such as default:men and default:recovery"
    raise GameError(f"no model {name!r}: neither shipped (there: {there}) nor a folder with {GAME}; fit one with `{fit}`")


def between_hands(equal: Game, folder: Path) -> Game:
    """A game of the layout of a model as it is between players of different hands.

    Where the shuttle flies as in a pair of the model, the odds differ from those of the model's game of different hands as they
    differ between the game and that of the model.
    """
    model, opposite = game_of(Origin(folder)), game_of(Origin(folder, OPPOSITE))
    if equal is model:
        return opposite
    same = opposite.counterparts(model)
    return moved(opposite, np.where(same < 0, np.int8(0), steps_between(model, equal)[:, same]), equal.fault_odds)


def _variants(folder: Path) -> tuple[Tensors | None, dict[str, str]]:
    """The file of variants of a model, None if it has none, and the hash of each by name."""
    if not (folder / VARIANTS).is_file():
        return None, {}
    with readable(folder, VARIANTS, "variants") as tensors:
        hashes = parsed(tensors.metadata["variants"])["hashes"]
        if not isinstance(hashes, dict) or not all(isinstance(value, str) for value in hashes.values()):
            raise ValueError("the variants are no table of names and hashes")
        return tensors, hashes


def unpacked(tensors: Tensors, game: Game, name: str, folder: Path) -> Game:
    """One variant from a file of a model folder. Raises GameError: not of this game, or the tables form no game."""
    try:
        about = parsed(tensors.metadata["variants"])
        if about["game"] != game.hash:
            raise ValueError("its variants are of another game")
        steps = np.empty((5, game.n_base_pairs), dtype=np.int8)
        steps[:, _order(game)] = unpacked_bytes(tensors.arrays[f"{name}.steps"], np.int8, steps.shape)
        variant = moved(game, steps, np.ascontiguousarray(tensors.arrays[f"{name}.fault_odds"]))
        if variant.hash != about["hashes"][name]:
            raise ValueError(f"variant {name} does not match its hash")
    except (KeyError, TypeError, ValueError, GameError) as error:
        raise GameError(f"{folder / VARIANTS}: no readable variants ({error}); fit or install the model again") from error
    return variant


def packed(game: Game, others: Mapping[str, Game], *, coarse: Collection[str] = ()) -> bytes:
    """Content of a file of variants (safetensors), by their nearest steps; ``coarse``: those in multiples of :data:`COARSE`."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    hashes = {}
    for name, other in others.items():
        steps = steps_between(game, other, COARSE if name in coarse else 1)
        arrays[f"{name}.steps"] = packed_bytes(steps[:, _order(game)])
        arrays[f"{name}.fault_odds"] = other.fault_odds
        hashes[name] = moved(game, steps, other.fault_odds).hash
    return tensor_bytes(arrays, {"variants": json.dumps({"game": game.hash, "hashes": hashes})})


def _order(game: Game) -> Intp:
    """Order of the base pairs in a file: by the edge that follows, because the same answer differs alike and packs well."""
    return np.argsort(game.base_pair_edge, kind="stable")


def moved(game: Game, steps: I8, fault_odds: I32 | None = None) -> Game:
    """A game of the same layout whose log-odds differ by steps.

    Args:
        steps: ``[5, base pairs]`` of fault, winner given a good stroke, from below given a return, and hurried from below and
            above.
        fault_odds: ``[L]`` odds of a fault by effort; default as before.
    """
    every = np.maximum(np.arange(256, dtype=np.uint8).view(np.int8).astype(np.int64), -MOST_STEPS)
    up, down = (table[steps.view(np.uint8)] for table in odds_of_steps(every, step=STEP))
    return with_odds(game, up, down, fault_odds)


def with_odds(game: Game, up: U64, down: U64, fault_odds: I32 | None = None) -> Game:
    """A game of the same layout with other odds.

    Args:
        up, down: ``[5, base pairs]`` what the odds of fault, winner given a good stroke, from below given a return, and hurried
            from below and above are multiplied and divided by, as :func:`odds_of_steps` gives them; ``[3, base pairs]`` keep the
            last two.
        fault_odds: ``[L]`` odds of a fault by effort; default as before.
    """
    faults, winners, belows, *hurried = _shares(game)
    one, most = np.uint64(ONE), np.uint64(ONE - 1)
    fault = np.minimum(moved_share(*faults, up[0], down[0], ONE), most)
    winner = np.minimum(fault + moved_share(*winners, up[1], down[1], one - fault), most)
    below = np.minimum(winner + moved_share(*belows, up[2], down[2], one - winner), most)
    # The chance of a hurried receiver stays below 1, which 8 bits cannot hold.
    most = np.uint64(HURRY_ONE - 1)
    moved_by = zip(hurried, up[3:], down[3:], strict=False)
    hurry = [np.minimum(moved_share(part, whole, by, under, whole), most) for (part, whole), by, under in moved_by]
    return dataclasses.replace(
        game,
        threshold=np.stack([fault, winner, below], axis=1).astype(np.uint16),
        hurry=np.stack(hurry, axis=1).astype(np.uint8) if hurry else game.hurry,
        fault_odds=game.fault_odds if fault_odds is None else fault_odds,
    )


def steps_between(game: Game, other: Game, unit: int = 1) -> I8:
    """``[5, base pairs]`` steps that lead from a game to another one of the same layout, in multiples of ``unit``.

    To the nearest multiple; of faults and winners upwards where they end few rallies, so that every stroke still ends as many.
    """
    # Half a unit on either side: a probability that was rounded to 0 or 1 is finite.
    before, after = ([np.log(p + 0.5) - np.log((of - p) + 0.5) for p, of in _shares(each)] for each in (game, other))
    steps = (np.stack(after) - np.stack(before)) / (unit * STEP)
    rare = other.threshold[:, 1] < _RARE * ONE
    steps[:2, rare] = np.ceil(steps[:2, rare] - _SLACK)
    most = MOST_STEPS // unit
    return (unit * np.clip(np.rint(steps), -most, most)).astype(np.int8)


def _shares(game: Game) -> tuple[tuple[U64, U64], ...]:
    """Part and whole of the five probabilities: fault, winner of good, from below of returned, hurried of each contact."""
    fault, winner, below = game.threshold.T.astype(np.uint64)
    hurry = game.hurry.T.astype(np.uint64)
    one, known = np.uint64(ONE), np.full_like(fault, HURRY_ONE)
    ends = (fault, np.full_like(fault, one)), (winner - fault, one - fault), (below - winner, one - winner)
    return *ends, (hurry[0], known), (hurry[1], known)


def read_model_card(folder: Path) -> dict[str, Any]:
    """The model card in a model folder. Raises GameError: there is none, or it was changed after it was written."""
    try:
        return read_sealed(folder / CARD)
    except FileReadError as error:
        raise GameError(f"{folder / CARD}: no readable model card ({error}); fit or install the model again") from error


def read_model(folder: Path, name: str) -> Tensors:
    """The arrays of a file of a model folder, whose hash is the one in the model card.

    Args:
        name: of the file, such as :data:`BC`.

    Raises:
        GameError: the model card cannot be read.
        OSError, ValueError: the file cannot be read, or is not the one of the model card.
    """
    card = read_model_card(folder)
    return read_tensors(folder / name, hash_in(card, name))


@contextlib.contextmanager
def readable(folder: Path, name: str, what: str, error: type[ShuttleError] = GameError) -> Iterator[Tensors]:
    """Context that reads a file of a model folder as :func:`read_model` does, and in which what it holds is checked.

    Args:
        what: the file holds, for messages.

    Raises:
        GameError: the model card cannot be read.
        error: the file cannot be read, is not the one of the model card, or a check failed.
    """
    card = read_model_card(folder)
    try:
        yield read_tensors(folder / name, hash_in(card, name))
    except (OSError, LookupError, TypeError, ValueError, RuntimeError, AttributeError, ArithmeticError, ShuttleError) as reason:
        raise error(f"{folder / name}: no readable {what} ({reason}); fit or install the model again") from reason


class Estimate(NamedTuple):
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float

    def scaled(self, number: float) -> "Estimate":
        """The estimate times a number; the interval stays in order."""
        low, high = sorted((number * self.low, number * self.high))
        return Estimate(number * self.value, low, high)


def factors_of(folder: Path) -> dict[str, Estimate] | None:
    """Estimates of a model by horizon: after 1, 4 and 8 strokes, and at the end of the rally (``end``).

    A factor is the fraction of a predicted advantage that was realised in matches to which the game was not fitted. The factors
    are fitted to training matches by ``experiments.truth --cross 4 --train-only`` and stored in the card by
    ``dynamics card --truth``. A predicted advantage times its factor is the advantage to expect in real matches.

    Returns:
        The factors; None for models whose card has none.

    Raises:
        GameError: the model card cannot be read, or its factors are invalid.
    """
    truth = read_model_card(folder).get("truth")
    if not isinstance(truth, dict) or not truth.get("train_only"):
        return None
    try:
        return {
            str(name): Estimate(*(float(slope[key]) for key in Estimate._fields))
            for name, slope in truth["decision_slope"].items()
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise GameError(f"{folder / CARD}: invalid factors of advantages ({error!r}); store them again with --truth") from error


def factor_of(game: Game) -> Estimate | None:
    """Factor of advantages at the end of the rally; None without a model or factors. Raises GameError: the card is unreadable."""
    folder = folder_of(game)
    factors = None if folder is None else factors_of(folder)
    return None if factors is None else factors.get("end")


def real_play(game: Game) -> dict[str, Any] | None:
    """Figures of the play of people in the matches of a model (:func:`shuttle_marl.exact.play.mix`, and ``length``).

    None where that is not known: for games of one discipline, pairs, and models whose card has none.

    Raises:
        GameError: the model card cannot be read.
    """
    origin = origin_of(game)
    if origin is None or origin.variant is not None or game.people is not None:
        return None
    found: dict[str, Any] | None = read_model_card(origin.folder).get("people")
    return found


def default_game() -> Game:
    """The benchmark's game: the symmetric average profile, as shipped."""
    return load_game("default")


def folder_of(game: Game) -> Path | None:
    """Folder of the model that a game was loaded from by :func:`load_game`; None for any other game."""
    origin = origin_of(game)
    return None if origin is None else origin.folder


def origin_of(game: Game) -> Origin | None:
    """Folder and variant that a game was loaded from by :func:`load_game`; None for any other game.

    Games of the shipped default are known in every process, also where they were not loaded.
    """
    if game.whole is not None and game.whole.people is not None:
        return game.whole.people.origin
    return game.origin or _ORIGINS.get(game.hash) or _shipped_origins().get(game.hash)


def shipped_game(digest: str) -> Game | None:
    """The game of a shipped model or variant by its hash; None if none has it."""
    origin = _shipped_origins().get(digest) or _shipped_origins(positions=True).get(digest)
    return None if origin is None else game_of(origin)


@functools.cache
def _shipped_origins(*, positions: bool = False) -> dict[str, Origin]:
    """Origins of shipped games by hash; ``positions``: those of different hands and with recovery, which are loaded for it."""
    folder = _MODELS / "default"
    if not (folder / GAME).is_file():
        return {}
    if positions:
        kinds = itertools.product((None, *PROFILES), (False, True), (False, True))
        origins = [Origin(folder, variant_of(name, opposite=opposite), recovery) for name, opposite, recovery in kinds]
        return {game_of(origin).hash: origin for origin in origins}
    hashes = _variants(folder)[1]
    return {load_game("default").hash: Origin(folder), **{value: Origin(folder, name) for name, value in hashes.items()}}


def refits_of(game: Game) -> tuple[Game, ...]:
    """The same game in refits on resampled matches; none for a variant, or without refits. Raises GameError: a damaged file."""
    origin = origin_of(game)
    equal, opposite = (None, False) if origin is None else hands_of_variant(origin.variant)
    if origin is None or equal is not None:
        return ()
    names = [variant_of(name, opposite=opposite) for name in variants(origin.folder) if is_refit(name)]
    return tuple(game_of(origin._replace(variant=name)) for name in names)


def drawn_game(game: Game, rng: np.random.Generator, sigma: float) -> Game:
    """A game of the same strokes and people in which the outcomes are others, drawn at random.

    Args:
        sigma: standard deviation of the shifts of the log-probabilities of a fault, a winner and both returns: one for each shot
            type, area and contact, and one for each incoming shot type and answer.
    """
    stroke, state, catalogue = game.base_pair_stroke, game.base_pair_state, game.catalogue
    shot, came = catalogue.shot[stroke], game.incoming_shot(state)
    of_stroke, of_answer = rng.normal(size=(13, 9, 2, 4)), rng.normal(size=(14, 13, 4))
    shift = (of_stroke[shot, catalogue.area[stroke], game.contact(state)] + of_answer[came, shot]) / 2**0.5
    weight = np.diff(game.threshold.astype(np.float64), axis=1, prepend=0, append=ONE) * np.exp(sigma * shift)
    limit = np.cumsum(weight, axis=1)[:, :3] / weight.sum(axis=1, keepdims=True) * ONE
    drawn = dataclasses.replace(game, threshold=np.minimum(np.rint(limit), ONE - 1).astype(np.uint16))
    object.__setattr__(drawn, "origin", origin_of(game))
    return drawn


@functools.lru_cache(maxsize=8)
def real_strokes(game: Game) -> F64 | None:
    """``[E]`` real strokes behind each edge: those in the innermost cell of the data that its stroke belongs to.

    None where that is not known: for games that belong to no model.

    Raises:
        GameError: the file of a model folder cannot be read.
    """
    origin = origin_of(game)
    if origin is None or not (origin.folder / SUPPORT).is_file():
        return None
    name = f"{OPPOSITE}.strokes" if hands_of_variant(origin.variant)[1] else "strokes"
    with readable(origin.folder, SUPPORT, "support") as tensors:
        return frozen(checked(tensors.arrays[name], np.float64, (len(game.edge_own),)))


def least_support(game: Game) -> int:
    """Default of the real strokes behind a stroke that is advised: :data:`RELIABLE` in models of own data, 0 in shipped ones."""
    folder = folder_of(game)
    return 0 if folder is None or folder.parent == _MODELS or real_strokes(game) is None else RELIABLE


def supported(game: Game, at_least: float) -> Bools:
    """``[base pairs]`` whether so many real strokes, or the most of its state, are behind it. Raises GameError: not known."""
    if at_least <= 0:
        return np.ones(game.n_base_pairs, dtype=np.bool_)
    real = real_strokes(game)
    if real is None:
        raise GameError("the number of real strokes is not known for this game, which belongs to no model; ask for at least 0")
    behind = real[game.base_pair_edge]
    most = np.zeros(game.n_base_states)
    np.maximum.at(most, game.base_pair_state, behind)
    return np.asarray((behind >= at_least) | (behind == most[game.base_pair_state]))


def resolve_game(game: Game | str | None, profile: str | None = None) -> Game:
    """A game, or that of a model by name or folder; None: the benchmark's.

    Args:
        game: the game, or the name of a model, its folder, or a variant (``MODEL:VARIANT``).
        profile: a variant of that model, such as ``men`` or ``women``; None: the game itself.

    Raises:
        GameError: the model or variant does not exist, or its tables are damaged.
    """
    if profile is None:
        return game if isinstance(game, Game) else load_game("default" if game is None else game)
    if isinstance(game, Game):
        origin = origin_of(game)
        if origin is None or origin.variant not in (None, profile):
            raise GameError(f"profile {profile!r}: expected the game of a model, not a game of other tables or another variant")
        return game if origin.variant == profile else game_of(Origin(origin.folder, profile))
    return load_game(f"{'default' if game is None else game}:{profile}")
