"""Rallies as the kernel plays them, whole matches or one by one, for a log."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from shuttle_marl.arrays import Ints
from shuttle_marl.game.draws import pairing_key
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel.uncompiled import Matches, PlayedMatches, SingleRallies
from shuttle_marl.recording.header import LogHeader, Player
from shuttle_marl.recording.log_file import existing_parts
from shuttle_marl.recording.recorder import RallyRecorder
from shuttle_marl.recording.schema import Rallies


def rallies_of(
    played: PlayedMatches,
    *,
    pairing: Ints | int,
    match: Ints,
    policy: Ints,
) -> Rallies:
    """The rallies of matches, for a log.

    Args:
        played: R rallies of M matches, with their strokes.
        pairing: ``[R]`` index into the pairings of the log.
        match: ``[R]`` number of the match in its pairing.
        policy: ``[M, 2]`` who sat at each seat, an index into the policies of the log.
    """
    return Rallies(
        pairing=np.broadcast_to(pairing, played.match.shape).astype(np.uint32),
        match=match.astype(np.uint32),
        rally=played.rally.astype(np.uint16),
        policy=policy[played.match].astype(np.uint16),
        server=played.server,
        winner=played.winner,
        reason=played.reason,
        score=played.score,
        length=played.length,
        stroke=played.stroke,
    )


def single_rallies_of(
    played: SingleRallies, *, pairing: int = 0, seat: int | None = 0, update: int | None = None, columns: Sequence[str] = ()
) -> Rallies:
    """Rallies that each stand for themselves, for a log whose rules are ``SINGLE_RALLY``: each is a match of its own number.

    Args:
        played: the rallies; policy 0 of the log is the learner, policy 1 + k opponent k.
        pairing: index into the pairings of the log.
        seat: seat of the learner; None: it plays at both.
        update: how many updates the learner had made; None: not recorded.
        columns: what the E figures of a stroke are, ``log_probability`` and ``value``.
    """
    count = len(played.length)
    policy = np.zeros((count, 2), np.uint16)
    if seat is not None:
        policy[:, 1 - seat] = 1 + played.opponent
    return Rallies(
        pairing=np.full(count, pairing, np.uint32),
        match=played.rally.astype(np.uint32),
        rally=np.zeros(count, np.uint16),
        policy=policy,
        server=played.server,
        winner=played.winner,
        reason=played.reason,
        score=np.zeros((count, 4), np.uint8),
        length=played.length,
        stroke=played.stroke,
        update=None if update is None else np.full(count, update, np.uint32),
        **dict(zip(columns, played.extra, strict=True)),
    )


Add = Callable[[int, int, Matches, PlayedMatches], None]
"""``(pairing, first, matches, played)``: records matches from number ``first`` of a pairing on."""


@contextlib.contextmanager
def sampled_log(
    path: Path, policies: Sequence[str], opponent: Player, game: Game, *, seed: int, record: str = "all"
) -> Iterator[Add]:
    """A log of the matches that policies are sampled in against one opponent (:func:`shuttle_marl.policy.scorecard.sample`).

    Args:
        path: where the finished log goes.
        policies: names of those who are sampled, each once: a pairing each, in which each is entrant 0.
        opponent: entrant 1 of all of them.
        game: the game that is played.
        seed: of all draws.
        record: ``all`` or ``sample:N``.

    Yields:
        What records a batch of matches.

    Raises:
        RecordingError: a log is there already, or it cannot be written, or ``record`` is something else.
    """
    header = LogHeader(
        seed=seed,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=(opponent, *(Player(name=name) for name in policies)),
        pairings=tuple(pairing_key(name, opponent.name) for name in policies),
        matches_per_draw=1,
    )
    with RallyRecorder.create(path, header, record) as recorder:

        def add(pairing: int, first: int, matches: Matches, played: PlayedMatches) -> None:
            seated = np.array([1 + pairing, 0])[matches.entrant]
            recorder.add(rallies_of(played, pairing=pairing, match=first + played.match, policy=seated))

        yield add


def free_name(path: Path) -> Path:
    """The path, or the first of ``NAME-2``, ``NAME-3``, … where no log stands yet."""
    found, number = path, 1
    while existing_parts(found):
        number += 1
        found = path.with_stem(f"{path.stem}-{number}")
    return found
