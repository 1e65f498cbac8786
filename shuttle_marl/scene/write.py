"""Selection of rallies, and scene files: MCAP with the messages that Foxglove and Lichtblick show."""

import io
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from foxglove import Context, open_mcap
from foxglove.mcap import MCAPCompression, MCAPWriteOptions

from shuttle_marl import __version__
from shuttle_marl.analysis import LogPlayers
from shuttle_marl.analysis.rally import Resolve
from shuttle_marl.errors import printable
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve_recorded
from shuttle_marl.recording.reader import RallyLog, rally_rows
from shuttle_marl.scene import SceneError, models, topics
from shuttle_marl.scene.commentary import commentary
from shuttle_marl.scene.motion import joint_message, motion_messages
from shuttle_marl.scene.report import SECOND, StagedRally, report_rally
from shuttle_marl.scene.topics import entities_on
from shuttle_marl.staging import stage

EPOCH: Final = 1_735_689_600 * SECOND
"""Start of every scene, 2025-01-01: recorded rallies have no date, and viewers need one."""
MOST_FPS: Final = 50
LAYOUTS: Final = tuple(
    Path(__file__).parent / "layouts" / f"{scope}.{viewer}.json"
    for scope in ("layout", "match")
    for viewer in ("lichtblick", "foxglove")
)
"""Layouts of the viewers' panels, for a rally (``layout``) and for a match; attached to every scene."""
METADATA: Final = "shuttle_marl.scene"
CUT: Final = SECOND // 1000
"""Time between two rallies [ns]: too short for a visible interpolation."""
_CHUNK: Final = 1 << 20


def select(
    log: RallyLog, *, rally: int | None = None, match: int | None = None, pairing: int = 0, best: int | None = None
) -> list[int]:
    """Numbers of the rallies of a scene, in their order.

    Args:
        log: the log.
        rally: number of one rally.
        match: number of a match: all its rallies.
        pairing: number of the pairing of the match.
        best: number of rallies: the longest of the log, the longest last.

    Raises:
        SceneError: not exactly one of rally, match and best; or the log has no such match.
        RecordingError: the log is damaged.
    """
    if sum(choice is not None for choice in (rally, match, best)) != 1:
        raise SceneError("expected one of --rally NUMBER, --match NUMBER, --best COUNT")
    if rally is not None:
        return [rally]
    if match is not None:
        numbers = log.numbers_of_match(pairing, match)
        if not len(numbers):
            raise SceneError(f"{log.path}: no match {match} of pairing {pairing}; see `info` for how many pairings there are")
        return [int(number) for number in numbers]
    if best is None or best < 1:
        raise SceneError(f"--best {best}: expected 1 or more")
    found: list[tuple[int, int]] = []
    for first, rallies in log.batches():
        longest = np.argsort(-rallies.length, kind="stable")[:best]
        found += [(int(rallies.length[row]), first + int(row)) for row in longest]
        found = sorted(found, key=lambda entry: (-entry[0], entry[1]))[:best]
    return [number for _, number in reversed(found)]


def write_scene(
    log: RallyLog,
    numbers: Sequence[int],
    game: Game,
    *,
    athletes: tuple[str, str] = ("male", "male"),
    handedness: tuple[str, str] = ("right", "right"),
    fps: int = 50,
    resolve: Resolve = resolve_recorded,
    progress: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> tuple[bytes, dict[str, str]]:
    """Write rallies of a log, one after the other, as the bytes of an MCAP file.

    Args:
        log: the log.
        numbers: numbers of the rallies in the log, at least one.
        game: the game that was played.
        athletes: athletes at seats 0 and 1, ``male`` or ``female``.
        handedness: racket hands of seats 0 and 1, ``right`` or ``left``.
        fps: frames per second, 25 to 50; viewers warn about more.
        resolve: resolves the policies that the log names; by default no modules and no files, because logs are untrusted.
        progress: wraps the numbers, for a progress bar.

    Returns:
        The file, and by the names of unknown policies the reasons; the scene leaves out their probabilities.

    Raises:
        RecordingError: the log has no such rally, is damaged, or was played on another game.
        RallyError: the strokes of a rally do not form one.
        SceneError: a stroke is not legal in the game, or the frame rate is out of range.
        StagingError: an unknown option of the staging.
    """
    if not 25 <= fps <= MOST_FPS:
        raise SceneError(f"{fps} frames per second: expected 25 to {MOST_FPS}; viewers warn about more")
    players = LogPlayers(log, game, resolve)
    context, buffer = Context(), io.BytesIO()
    options = MCAPWriteOptions(profile="", compression=MCAPCompression.Zstd, chunk_size=_CHUNK, compression_threads=0)
    writer = open_mcap(buffer, context=context, writer_options=options)
    channels, start = topics.Channels(context), EPOCH
    names: tuple[str, str] | None = None
    for i, number in enumerate(progress(numbers)):
        report = report_rally(log, int(number), game, players)
        motion = stage(report.played, seed=report.key, athletes=athletes, handedness=handedness, fps=fps)
        staged = StagedRally(report=report, motion=motion, start=start)
        if not i:
            channels.write([joint_message(start, motion), entities_on(topics.COURT, start, models.court(start))])
        if names != report.names:
            names = report.names
            channels.write([entities_on(topics.PLAYERS, start, models.players(start, motion, names))])
        channels.write([*motion_messages(staged), *commentary(staged)])
        start = staged.end + CUT
    for path in LAYOUTS:
        writer.attach(log_time=EPOCH, create_time=EPOCH, name=path.name, media_type="application/json", data=path.read_bytes())
    rows = _rows(log, numbers)
    writer.attach(
        log_time=EPOCH, create_time=EPOCH, name="rallies.arrow", media_type="application/vnd.apache.arrow.file", data=rows
    )
    writer.write_metadata(METADATA, _facts(log, numbers, game))
    writer.close()
    return buffer.getvalue(), players.unknown


def _rows(log: RallyLog, numbers: Sequence[int]) -> bytes:
    """The rows of the rallies in the log, as an Arrow IPC file."""
    table = pa.concat_tables([rally_rows(log, int(number), log.rally(int(number))) for number in numbers])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema) as file:
        file.write_table(table.unify_dictionaries())
    return sink.getvalue().to_pybytes()


def _facts(log: RallyLog, numbers: Sequence[int], game: Game) -> dict[str, str]:
    """Origin of the rallies: log, seeds, game and policies."""
    headers = [file.header for file in log.files]
    seated = sorted({int(policy) for number in numbers for policy in log.rally(int(number)).policy[0]})
    players = [log.policies[i] for i in seated]
    return {
        "software": f"shuttle_marl {__version__}",
        "log": printable(log.path.name),
        "rallies": " ".join(str(int(number)) for number in numbers),
        "game": game.hash,
        "seeds": " ".join(dict.fromkeys(str(header.seed) for header in headers)),
        "policies": json.dumps({player.name: player.hash for player in players}),
    }
