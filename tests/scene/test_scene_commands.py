"""``python -m shuttle_marl.recording scene``, and which rallies it shows."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.commands.recording import main
from shuttle_marl.dynamics import default_game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyLog, RallyLogWriter
from shuttle_marl.scene.playback import Playback
from shuttle_marl.scene.selection import select
from shuttle_marl.scene.write import film
from shuttle_marl.staging import StagingError, play_rallies


def test_one_rally_to_a_file(log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "scene.mcap"
    assert main(["scene", str(log_path), "--rally", "1", "--out", str(out)]) == 0
    assert f"{out}: 1 rallies" in capsys.readouterr().out
    assert Playback(out.read_bytes()).end > 0
    assert [path.name for path in out.parent.iterdir()] == [out.name]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rally", "1"], "either --out FILE or --live"),
        (["--rally", "1", "--out", "x.mcap", "--live"], "either --out FILE or --live"),
        (["--out", "x.mcap"], "one of --rally NUMBER, --match NUMBER, --best COUNT"),
        (["--rally", "1", "--best", "2", "--out", "x.mcap"], "one of --rally NUMBER"),
        (["--rally", "999999", "--out", "x.mcap"], "no rally 999999"),
        (["--match", "999", "--out", "x.mcap"], "no match 999 of pairing 0"),
        (["--best", "0", "--out", "x.mcap"], "expected 1 or more"),
        (["--rally", "1", "--fps", "10", "--out", "x.mcap"], "10 frames a second: expected 25 to 50"),
        (["--rally", "1", "--fps", "100", "--out", "x.mcap"], "100 frames a second: expected 25 to 50"),
        (["--rally", "1", "--live", "--port", "99999"], "expected 0 (any free one) to 65535"),
    ],
)
def test_what_cannot_be_shown(
    log_path: Path,
    tmp_path: Path,
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["scene", str(log_path), *arguments]) == 1
    assert message in capsys.readouterr().err.replace("\n", " ")
    assert list(tmp_path.iterdir()) == []


def test_a_scene_is_no_rally_log(scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", str(scene_file), "--rally", "0", "--out", str(tmp_path / "x.mcap")]) == 1
    assert "no rally log" in capsys.readouterr().err


def test_a_match_is_all_its_rallies(log_path: Path) -> None:
    with RallyLog(log_path) as log:
        numbers = select(log, rally=None, match=1, pairing=0, best=None)
        scores = np.concatenate([log.rally(number).score for number in numbers]).astype(int)
    assert scores[0].tolist() == [0, 0, 0, 0]
    assert (np.diff(scores[:, 2:].sum(axis=1)) >= 0).all()
    assert max(scores[-1, 2:]) == 1


def test_the_best_are_the_longest(log_path: Path) -> None:
    with RallyLog(log_path) as log:
        chosen = select(log, rally=None, match=None, pairing=0, best=7)
        lengths = np.concatenate([rallies.length for _, rallies in log.batches()])
    assert len(set(chosen)) == 7
    assert lengths[chosen].tolist() == sorted(np.sort(lengths)[-7:].tolist())


def test_without_its_policy_a_rally_is_told_without_values(tmp_path: Path) -> None:
    """A log of a policy that this machine does not have: what follows from the game alone is still told."""
    game = default_game()
    policy = resolve("bc", game)
    (rally,) = play_rallies(game, (policy, policy), 1, seed=2)
    n = len(rally)
    header = LogHeader(
        seed=1,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=(Player(name="agent:runs/gone"), Player(name="bc")),
        rules=SINGLE_RALLY,
        draws="unknown",
    )
    small = {name: np.zeros(1, dtype=kind) for name, kind in (("pairing", "u4"), ("match", "u4"), ("rally", "u2"))}
    winner = (rally.striker[-1] + (rally.ending == 0)) % 2
    rallies = Rallies(
        **small,
        policy=np.array([[0, 1]], dtype=np.uint16),
        server=np.array([rally.server], dtype=np.uint8),
        winner=np.array([winner], dtype=np.uint8),
        reason=np.array([rally.ending], dtype=np.uint8),
        score=np.zeros((1, 4), dtype=np.uint8),
        length=np.array([n], dtype=np.int32),
        stroke=rally.stroke.astype(np.uint8 if game.n_strokes <= 256 else np.uint16),
    )
    path = tmp_path / "rallies.mcap"
    with RallyLogWriter(path, header) as writer:
        writer.append(rallies)
    with RallyLog(path) as log:
        content, unknown = film(log, [0], game)
        assert list(unknown) == ["agent:runs/gone"]
        wrong = dataclasses.replace(rallies, stroke=np.full(n, rally.stroke[0], dtype=rallies.stroke.dtype))
    topics = Playback(content).topics
    assert "/rally/stroke" in topics
    assert "/rally/value" not in topics
    if n > 1:
        with RallyLogWriter(tmp_path / "wrong.mcap", header) as writer:
            writer.append(wrong)
        with RallyLog(tmp_path / "wrong.mcap") as log, pytest.raises(StagingError, match="has no other"):
            film(log, [0], game)
