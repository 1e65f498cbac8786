"""A small log and its scenes."""

import bisect
import dataclasses
import functools
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

from shuttle_marl.game import default_game
from shuttle_marl.league import LeagueConfig
from shuttle_marl.recording import RallyLog
from shuttle_marl.scene import topics
from shuttle_marl.scene.topics import WORLD
from shuttle_marl.scene.write import select, write_scene
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
        told = self._told[max(when for when in self._told if when <= time)]
        return {WORLD: (np.eye(3), np.zeros(3))} | {name: one.at(time) for name, one in told.items()}

    @functools.cached_property
    def _told(self) -> dict[int, dict[str, "Transforms"]]:
        """Transforms by the time of their packet."""
        return {time: transforms_by_frame(packet.transforms) for time, packet in self.of(topics.TF)}


@dataclasses.dataclass(frozen=True)
class Transforms:
    """A frame of reference: quaternions and places on the court by time [ns]."""

    when: list[int]
    turns: npt.NDArray[np.float64]
    places: npt.NDArray[np.float64]

    def at(self, time: int) -> Placed:
        """Interpolated rotation and position."""
        after = min(bisect.bisect_right(self.when, time), len(self.when) - 1)
        before = max(after - 1, 0)
        share = min(max((time - self.when[before]) / max(self.when[after] - self.when[before], 1), 0.0), 1.0)
        turn, to = (Rotation.from_quat(self.turns[i]) for i in (before, after))
        way = (turn.inv() * to).as_rotvec()
        matrix = (turn * Rotation.from_rotvec(share * way)).as_matrix()
        return matrix, (1 - share) * self.places[before] + share * self.places[after]


def transforms_by_frame(transforms: list[Any]) -> dict[str, Transforms]:
    by_name: dict[str, list[Any]] = {}
    for transform in transforms:
        assert transform.parent_frame_id == WORLD
        by_name.setdefault(transform.child_frame_id, []).append(transform)
    return {
        name: Transforms(
            when=[t.timestamp.ToNanoseconds() for t in own],
            turns=np.array([(t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w) for t in own]),
            places=np.array([(t.translation.x, t.translation.y, t.translation.z) for t in own]),
        )
        for name, own in by_name.items()
    }


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
