"""``python -m shuttle_marl.staging measure``: simulated rallies, and those of a log."""

import json
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.commands.staging import main
from shuttle_marl.game import default_game
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyLog, RallyLogWriter
from shuttle_marl.staging import Motion, PlayedRally, measure, stage, summary
from shuttle_marl.staging.rally import recorded_rally


@pytest.fixture(scope="module")
def log(played: list[PlayedRally], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two shortest rallies as a log."""
    game = default_game()
    rallies = sorted(played, key=len)[:2]
    n = len(rallies)
    kinds = (("pairing", "u4"), ("match", "u4"), ("rally", "u2"), ("winner", "u1"))
    small = {name: np.zeros(n, dtype=kind) for name, kind in kinds}
    path = tmp_path_factory.mktemp("log") / "rallies.mcap"
    header = LogHeader(
        seed=1,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=(Player(name="bc"),),
        rules=SINGLE_RALLY,
        draws="unknown",
    )
    with RallyLogWriter(path, header) as writer:
        writer.append(
            Rallies(
                **small | {"match": np.arange(n, dtype="u4")},
                policy=np.zeros((n, 2), dtype=np.uint16),
                server=np.array([rally.server for rally in rallies], dtype=np.uint8),
                reason=np.array([rally.ending for rally in rallies], dtype=np.uint8),
                score=np.zeros((n, 4), dtype=np.uint8),
                length=np.array([len(rally) for rally in rallies], dtype=np.int32),
                stroke=np.concatenate([rally.stroke for rally in rallies]).astype(np.uint16),
            )
        )
    return path


def test_the_summary_covers_every_motion(motions: list[Motion]) -> None:
    found = [measure(motion) for motion in motions[:3]]
    figures = summary(found)
    assert figures["rallies"] == 3
    assert figures["strokes"] == sum(len(one.contact) for one in found)
    assert figures["seconds"] == pytest.approx(sum(one.seconds for one in found))
    assert figures["contact_max"] == max(one.contact.max() for one in found)
    assert figures["net_clearance_min"] == min(np.concatenate([one.clearance for one in found]))
    assert figures["ends_as_it_must"] == 1


def test_rallies_of_a_log_are_measured(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", str(log), "--json", "--hands", "left", "right", "--seed", "3"]) == 0
    with RallyLog(log) as opened:
        rallies = [recorded_rally(opened, number) for number in range(2)]
    staged = [
        stage(rally, seed=3 + i, athletes=("male", "female"), handedness=("left", "right")) for i, rally in enumerate(rallies)
    ]
    assert json.loads(capsys.readouterr().out) == summary([measure(motion) for motion in staged])


def test_without_a_log_rallies_are_simulated(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "--rallies", "1", "--policies", "random", "safe"]) == 0
    out = capsys.readouterr().out
    assert "1 rallies" in out
    assert "contacts within a centimetre" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rallies", "0"], "--rallies 0: expected 1 or more"),
        (["nothing.mcap"], "nothing.mcap: cannot be read"),
        (["--rallies", "1", "--fps", "3"], "3 frames a second: expected 25 to 1000"),
        (["--rallies", "1", "--policies", "bc", "no-one"], "no policy 'no-one'"),
    ],
)
def test_what_cannot_be_measured(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", *arguments]) == 1
    assert message in capsys.readouterr().err
