"""A small log and its scenes."""

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from shuttle_marl.court.scene import write as topics
from shuttle_marl.court.scene.shapes import WORLD
from shuttle_marl.court.scene.write import select, write_scene
from shuttle_marl.game import default_game
from shuttle_marl.league import LeagueConfig
from shuttle_marl.recording import RallyLog
from tests.tournaments import play_league

RALLIES = 2
Placed = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""Rotation and position of a frame of reference on the court."""


@dataclasses.dataclass(frozen=True)
class Reel:
    """A scene file, read by the official reader with all checksums checked.

    Attributes:
        content: the file.
        numbers: of its rallies in the log.
        messages: (time, topic, decoded) in order; JSON messages are dictionaries.
    """

    content: bytes
    numbers: list[int]
    messages: list[tuple[int, str, Any]]

    def of(self, topic: str) -> list[tuple[int, Any]]:
        return [(time, message) for time, name, message in self.messages if name == topic]

    def placed(self, time: int) -> dict[str, Placed]:
        """Pose of every frame of reference after a seek to a time: from the last message of each topic."""
        message = next(message for when, message in reversed(self.of(topics.TF)) if when <= time)
        found = {WORLD: (np.eye(3), np.zeros(3))}
        for transform in message.transforms:
            assert transform.parent_frame_id == WORLD
            q, v = transform.rotation, transform.translation
            found[transform.child_frame_id] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), np.array([v.x, v.y, v.z])
        return found


def read(content: bytes) -> list[tuple[int, str, Any]]:
    decoders, out = DecoderFactory(), []
    for schema, channel, message in make_reader(io.BytesIO(content), validate_crcs=True).iter_messages():
        if channel.message_encoding == "json":
            out.append((message.log_time, channel.topic, json.loads(message.data)))
        else:
            decoder = decoders.decoder_for(channel.message_encoding, schema)
            out.append((message.log_time, channel.topic, decoder(message.data)))
    return out


@pytest.fixture(scope="session")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two players over two matches; read-only."""
    out = tmp_path_factory.mktemp("scene") / "run"
    play_league(LeagueConfig(pool=("bc", "random"), matches=2, out=out))
    return out / "rallies.mcap"


@pytest.fixture(scope="session")
def reel(log_path: Path) -> Reel:
    with RallyLog(log_path) as log:
        numbers = select(log, match=0)[:RALLIES]
        content, unknown = write_scene(log, numbers, default_game(), hands=("right", "left"), athletes=("male", "female"))
    assert unknown == {}
    return Reel(content, numbers, read(content))


@pytest.fixture(scope="session")
def second_game(log_path: Path) -> Reel:
    """The first rally of a second game."""
    with RallyLog(log_path) as log:
        number = next(number for number in range(log.n_rallies) if log.rally(number).score[0, 2:].sum() == 1)
        content, _ = write_scene(log, [number], default_game())
    return Reel(content, [number], read(content))


@pytest.fixture(scope="session")
def scene_file(reel: Reel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "scene.mcap"
    path.write_bytes(reel.content)
    return path
