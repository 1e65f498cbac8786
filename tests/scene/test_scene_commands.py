"""``python -m shuttle_marl.recording scene``, and which rallies it shows."""

import dataclasses
import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from shuttle_marl.commands.recording import main
from shuttle_marl.court import WatchError
from shuttle_marl.court.recorded import LogRallies
from shuttle_marl.court.scene import select
from shuttle_marl.court.scene import write as topics
from shuttle_marl.court.scene.write import write_scene
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.kernel import play_rallies
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, RallyLog, RallyLogWriter
from tests.scene.conftest import read


def test_a_rally_is_written_to_a_file(log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "scene.mcap"
    assert main(["scene", str(log_path), "--rally", "1", "--out", str(out)]) == 0
    assert f"{out}: 1 rally, " in capsys.readouterr().out
    summary = make_reader(io.BytesIO(out.read_bytes())).get_summary()
    assert summary.statistics.message_count > 0
    assert [path.name for path in out.parent.iterdir()] == [out.name]


def test_a_match_that_the_log_does_not_have(log_path: Path) -> None:
    with RallyLog(log_path) as log:
        for pairing, match in ((0, 99), (7, 0)):
            with pytest.raises(WatchError, match=f"no match {match} of pairing {pairing}"):
                select(log, match=match, pairing=pairing)


def test_rallies_that_a_scene_may_show(log_path: Path) -> None:
    with RallyLog(log_path) as log:
        with pytest.raises(WatchError, match="expected one of --rally NUMBER, --match NUMBER"):
            select(log, rally=0, match=0)
        assert select(log, rally=0) == [0]
        lengths = log.rally_table()["length"].to_pylist()
        assert select(log) == [max(range(log.n_rallies), key=lambda k: (lengths[k], -k))]
        for match in (0, 1):
            numbers = select(log, match=match)
            assert numbers == sorted(numbers)
            assert {int(log.rally(k).match[0]) for k in numbers} == {match}


@pytest.fixture(scope="module")
def bc() -> TabulatedPolicy:
    return tabulate(resolve("bc", default_game()), default_game())


@pytest.fixture(scope="module")
def bc_hash(bc: TabulatedPolicy) -> str:
    return bc.hash


@pytest.fixture
def log_of(bc: TabulatedPolicy, tmp_path: Path) -> Callable[..., Path]:
    """Writes a log of short rallies between policies, by the numbers of those in the header."""
    game = default_game()
    rallies = play_rallies(game, (bc, bc), 20, seed=2)
    shortest = np.where(rallies.length < 2, 99, rallies.length).argmin()

    def write(*players: Player, seats: tuple[tuple[int, int], ...] = ((0, 1),)) -> Path:
        header = LogHeader(
            seed=1, game=game.hash, strokes=game.catalogue.names, policies=players, rules=SINGLE_RALLY, draws="unknown"
        )
        path = tmp_path / "rallies.mcap"
        with RallyLogWriter(path, header) as writer:
            for pair in seats:
                rally = rallies.select(np.arange(20) == shortest)
                writer.append(dataclasses.replace(rally, policy=np.array([pair], rally.policy.dtype)))
        return path

    return write


def shown(path: Path, *flags: str) -> dict[str, list[dict[str, Any]]]:
    """The JSON messages of the scene that the command makes of the one rally of a log, by topic."""
    out = path.with_name("scene.mcap")
    assert main(["scene", str(path), "--rally", "0", "--out", str(out), *flags]) == 0
    found: dict[str, list[dict[str, Any]]] = {}
    for _, channel, message in make_reader(io.BytesIO(out.read_bytes())).iter_messages():
        if channel.message_encoding == "json":
            found.setdefault(channel.topic, []).append(json.loads(message.data))
    return found


def test_probabilities_of_an_unknown_policy_are_omitted(
    log_of: Callable[..., Path], bc_hash: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log of a policy that this machine does not have: what follows from the game alone is still shown."""
    found = shown(log_of(Player(name="no-such-policy", hash="0" * 64), Player(name="bc", hash=bc_hash)))
    assert "without probabilities of no-such-policy: no policy" in capsys.readouterr().err
    assert all("rally_win_0" not in stroke for stroke in found["/rally/stroke"])
    for stroke in found["/rally/stroke"]:
        assert 0 <= stroke["p_succ"] <= 1
        assert ("probability" in stroke) == (stroke["player"] == "bc")


def test_a_training_run_shows_what_its_learner_thought(tmp_path: Path) -> None:
    from shuttle_marl.training import PPOConfig, train

    config = PPOConfig(strokes=600, batch=256, width=8, record="all", exploitability=False, out=tmp_path / "run")
    train(config)
    path = tmp_path / "run" / "rallies.mcap"
    found = shown(path)
    with RallyLog(path) as log:
        rally = log.rally(0)
    assert rally.log_probability is not None
    assert rally.value is not None
    mine = np.isfinite(rally.value)
    assert mine.any()
    for stroke, own, chosen, value in zip(found["/rally/stroke"], mine, np.exp(rally.log_probability), rally.value, strict=True):
        assert ("estimate" in stroke) == own
        if own:
            assert (stroke["probability"], stroke["estimate"]) == (pytest.approx(chosen), pytest.approx(value))


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module in the current folder that leaves a trace when it is imported; its policy plays at random."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "trap_of_a_log", raising=False)
    trace = tmp_path / "trace"
    (tmp_path / "trap_of_a_log.py").write_text(
        f"open({str(trace)!r}, 'w').close()\nfrom shuttle_marl.game.policy import UniformPolicy as Policy\n"
    )
    return trace


@pytest.mark.parametrize("name", ["trap_of_a_log:Policy", "best-response:bc@trap_of_a_log:x"])
def test_a_log_never_runs_code(
    name: str, log_of: Callable[..., Path], trap: Path, bc_hash: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = shown(log_of(Player(name=name, hash="0" * 64), Player(name="bc", hash=bc_hash)))
    assert not trap.exists()
    assert all("rally_win_0" not in stroke for stroke in found["/rally/stroke"])
    said = capsys.readouterr().err
    assert f"without probabilities of {name}: " in said
    assert "--policy" in said


def test_a_flag_gives_the_policy_of_a_name(
    log_of: Callable[..., Path], trap: Path, bc_hash: str, capsys: pytest.CaptureFixture[str]
) -> None:
    game = default_game()
    table = tabulate(resolve("random", game), game)
    log, named = log_of(Player(name="trap_of_a_log:Policy", hash=table.hash), Player(name="bc", hash=bc_hash)), "--policy"
    found = shown(log, named, "trap_of_a_log:Policy=random")
    assert not trap.exists()
    assert "without probabilities" not in capsys.readouterr().err
    assert all("probability" in stroke for stroke in found["/rally/stroke"])
    assert all(0 < stroke["rally_win_0"] < 1 for stroke in found["/rally/stroke"])


@pytest.mark.parametrize(("recorded", "said"), [("1" * 64, "not the one that played"), ("", "holds no hash of its table")])
def test_a_different_policy_of_the_same_name_is_not_used(
    recorded: str, said: str, log_of: Callable[..., Path], bc_hash: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """An agent that was trained again has other probabilities under its old name."""
    found = shown(log_of(Player(name="bc", hash=bc_hash), Player(name="random", hash=recorded)))
    assert f"without probabilities of random: {'' if recorded else 'the log '}" in (err := capsys.readouterr().err)
    assert said in err
    assert all("rally_win_0" not in stroke for stroke in found["/rally/stroke"])
    assert all(("probability" in stroke) == (stroke["player"] == "bc") for stroke in found["/rally/stroke"])


def test_names_of_a_log_are_printed_without_control_characters_and_markup(
    log_of: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "[bold]a[/x]\x1b[31m\n\u202e<b>"
    path = log_of(Player(name=name), Player(name="[/]"))
    found = shown(path)
    clean = "[bold]a[/x]\\x1b[31m\\n\\u202e<b>"
    assert found["/rally/score"][0]["name_0"] == clean
    said = capsys.readouterr().err
    assert f"without probabilities of {clean}: " in said
    assert "without probabilities of [/]: " in said
    content = (tmp_path / "scene.mcap").read_bytes()
    texts = [t.text for _, topic, m in read(content) if topic in topics.SCENES for e in m.entities for t in e.texts]
    assert clean in texts
    assert all(character not in text for text in texts for character in "\x1b\u202e")
    (facts,) = (found.metadata for found in make_reader(io.BytesIO(content)).iter_metadata())
    assert list(json.loads(facts["policies"])) == [name, "[/]"]


def test_players_look_as_who_they_are(log_of: Callable[..., Path], bc_hash: str) -> None:
    """The average player is as a person of known hand is; a scene shows their bodies."""
    players = Player(name="bc", hash=bc_hash), Player(name="bc:kento-momota"), Player(name="bc:an-se-young")
    game = default_game()
    with RallyLog(log_of(*players, seats=((0, 0), (0, 1), (2, 0)))) as log:
        rallies = [LogRallies(log, game).rally(k) for k in range(3)]
        looks = [(rally.hands[1], rally.athletes[1]) for rally in rallies]
        assert looks == [("right", "male"), ("left", "male"), ("right", "female")]
        content, _ = write_scene(log, [0, 1, 2], game)
    shown = [message for _, topic, message in read(content) if topic == topics.PLAYERS]
    knees = [{entity.frame_id: entity for entity in message.entities}["1/LeftLeg"].spheres[0].size.x for message in shown]
    assert knees[2] < knees[0] == knees[1], "one entity of players for each look"
