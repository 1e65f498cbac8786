"""Messages to a method that runs apart, what is played for it, and the commands around it."""

import dataclasses
import io
import os
import shutil
import subprocess
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.observation import observations
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.logs import play_log
from shuttle_marl.suite import apart, remote
from shuttle_marl.suite.adapt import AdaptSetting
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.remote import Container, Namespaces, Session, find_boundary, play_apart
from shuttle_marl.suite.task import Setting
from tests.exact.exact_games import THREE_STROKES, hand_made, random_game, random_policy
from tests.exact.test_hidden_positions_solved import with_recovery

GAME = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))
HIDDEN = with_recovery(random_game(2), 2)


class Method:
    """In place of the program: takes messages, and answers with those that are given."""

    def __init__(self) -> None:
        self.taken: list[dict[str, Any]] = []
        self.answers = io.BytesIO()
        self.command: list[str] = []

    def write(self, content: bytes) -> None:
        self.taken.append(apart.receive(io.BytesIO(content)))

    def read(self, size: int) -> bytes:
        return self.answers.read(size)

    def says(self, *messages: dict[str, Any] | bytes) -> None:
        self.answers = io.BytesIO(b"".join(each if isinstance(each, bytes) else apart.message(**each) for each in messages))


BOUNDARY: Any = SimpleNamespace(command=lambda folder, arguments: [str(folder), *arguments])


@pytest.fixture
def method(monkeypatch: pytest.MonkeyPatch) -> Method:
    found = Method()

    def program(command: list[str], seconds: float) -> Method:
        found.command = command
        assert seconds == 6 * 3600
        return found

    monkeypatch.setattr(remote, "Program", program)
    return found


def setting_of(folder: Path, game: Any = GAME, *, opponent: str | None = None, budget: int = 100) -> PlayerSetting:
    return PlayerSetting(game=game, model="model", opponent=opponent, budget=budget, seed=3, folder=folder)


def session_of(setting: Setting) -> Session:
    return Session("strange:learner", Path("code"), BOUNDARY, "ab" * 32, setting)


def test_a_method_is_told_the_game_as_it_is_seen(method: Method, tmp_path: Path) -> None:
    session_of(setting_of(tmp_path))
    assert method.command == ["code", "/code/apart.py", "strange:learner", "/code/entry", "/tmp/unit"]
    (told,) = method.taken
    states = np.arange(GAME.n_states)
    np.testing.assert_array_equal(told["observation"], observations(GAME, states))
    np.testing.assert_array_equal(told["mask"], GAME.mask(states))
    assert told["feasible"].shape == (0, 9)
    assert [int(told[name]) for name in ("seed", "budget", "opponents")] == [3, 100, 0]
    session_of(setting_of(tmp_path, HIDDEN))
    np.testing.assert_array_equal(method.taken[-1]["feasible"], HIDDEN.waiting.mask(HIDDEN.base(np.arange(HIDDEN.n_states))))
    session_of(Setting(game=GAME, model="model", seed=4, folder=tmp_path))
    assert [int(method.taken[-1][name]) for name in ("seed", "budget", "opponents")] == [4, 0, 0]
    known = {"a": random_policy(GAME, 0), "b": random_policy(GAME, 1)}
    session_of(AdaptSetting(game=GAME, model="model", seed=5, folder=tmp_path, known=known))
    assert [int(method.taken[-1][name]) for name in ("seed", "budget", "opponents")] == [5, 10**6, 2]
    path = tmp_path / "opponent.npz"
    random_policy(GAME, 0).save(path)
    session_of(setting_of(tmp_path, opponent=f"table:{path}"))
    assert int(method.taken[-1]["opponents"]) == 1
    assert not path.exists(), "nobody else reads it"


def test_rallies_at_once_are_limited(method: Method, tmp_path: Path) -> None:
    session = session_of(setting_of(tmp_path, budget=1 << 17))
    assert len(session._reset({"reset": 1 << 16, "opponent": 0})["state"]) == 1 << 16
    with pytest.raises(SuiteError, match=r"65537 rallies: .* 1 to 65536 at once"):
        session._reset({"reset": (1 << 16) + 1, "opponent": 0})


@pytest.mark.parametrize("opponents", [0, 2])
def test_rallies_and_strokes_are_counted(opponents: int, method: Method, tmp_path: Path) -> None:
    """Seven rallies may be reset and seven strokes played of a budget of 7, and one more of neither."""
    setting: Any = setting_of(tmp_path, budget=7)
    if opponents:
        known = {str(i): random_policy(GAME, i) for i in range(opponents)}
        setting = AdaptSetting(game=GAME, model="model", seed=5, folder=tmp_path, known=known, budget=7)
    session = session_of(setting)
    for number, says in ((0, "0 rallies: .* 1 to 65536 at once"), (8, "more rallies were reset than the budget of 7 strokes")):
        with pytest.raises(SuiteError, match=says):
            session._reset({"reset": number, "opponent": 0})
    for number, reset in ((4, 4), (3, 3)):
        found = session._reset({"reset": number, "opponent": opponents // 2})
        assert found["state"].shape == found["waits"].shape == (reset,)
        assert not found["waits"].any()
    with pytest.raises(SuiteError, match="more rallies were reset"):
        session._reset({"reset": 1, "opponent": 0})
    for used in (3, 6):
        found = session._step({"step": GAME.mask(session._seen()["state"]).argmax(axis=1)})
        assert {name: part.shape for name, part in found.items()} == dict.fromkeys(("state", "waits", "reward", "over"), (3,))
        assert session.used == used
    with pytest.raises(SuiteError, match="the budget of 7 strokes is used up"):
        session._step({"step": np.zeros(3, np.int64)})
    assert session.used == 6
    session._started = 0
    session._reset({"reset": 1, "opponent": 0})
    session._step({"step": GAME.mask(session._seen()["state"]).argmax(axis=1)})
    assert session.used == 7


def test_positions_count_as_strokes_where_both_are_played(method: Method, tmp_path: Path) -> None:
    session = session_of(setting_of(tmp_path, HIDDEN, budget=9))
    state = session._reset({"reset": 2, "opponent": 0})["state"]
    feasible = HIDDEN.waiting.mask(HIDDEN.base(state)).argmax(axis=1)
    for used in (4, 8):
        session._step({"step": HIDDEN.mask(session._seen()["state"]).argmax(axis=1), "positions": feasible})
        assert session.used == used
        feasible = HIDDEN.waiting.mask(HIDDEN.base(session._seen()["state"])).argmax(axis=1)
    with pytest.raises(SuiteError, match="used up"):
        session._step({"step": np.zeros(1, np.int64), "positions": np.zeros(1, np.int64)})


def test_resets_have_other_luck_in_another_round(method: Method, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []
    batch = SimpleNamespace(rows=SimpleNamespace(state=np.zeros(2)), waits=np.zeros(2))

    def played(game: Any, number: int, *, seed: int) -> Any:
        seeds.append(seed)
        return batch

    monkeypatch.setattr(remote, "RallyBatch", played)
    monkeypatch.setattr(remote.Session, "_seen", lambda _: {})
    for beacon in ("ab" * 32, "cd" * 32, "ab" * 32):
        session = Session("strange:learner", Path("code"), BOUNDARY, beacon, setting_of(tmp_path))
        session._reset({"reset": 2, "opponent": 0})
        session._reset({"reset": 2, "opponent": 0})
    assert seeds[:2] == seeds[4:]
    assert len({*seeds}) == 4


def test_tasks_without_budgets_reset_nothing(method: Method, tmp_path: Path) -> None:
    session = session_of(Setting(game=GAME, model="model", seed=4, folder=tmp_path))
    with pytest.raises(SuiteError, match="1 rallies: tasks that train players have 1 to"):
        session._reset({"reset": 1, "opponent": 0})
    session = session_of(setting_of(tmp_path, budget=10**6))
    with pytest.raises(SuiteError, match="65537 rallies"):
        session._reset({"reset": (1 << 16) + 1, "opponent": 0})


def test_requests_are_served_until_the_answer(method: Method, tmp_path: Path) -> None:
    first = GAME.mask(np.arange(GAME.n_states)).argmax(axis=1)
    method.says(
        {"reset": 3, "opponent": 0}, {"step": np.full(3, 99)}, {"step": np.zeros(3, np.int64)}, {"stroke": first}, {"text": "x"}
    )
    trained = play_apart("strange:learner", Path("code"), BOUNDARY, "ab" * 32, setting_of(tmp_path))
    assert isinstance(trained, Trained)
    _, asked, started, refused, played = method.taken
    assert (str(asked["call"]), started["state"].shape) == ("player", (3,))
    assert "error" in refused
    assert played["reward"].shape == (3,)
    assert trained.strokes == 3
    chosen = trained.player.pair_probabilities() == 1
    assert np.array_equal(chosen, GAME.pair_stroke == first[GAME.pair_state])
    plain = play_apart("x:y", Path("code"), BOUNDARY, "ab" * 32, Setting(game=GAME, model="model", seed=4, folder=tmp_path))
    assert isinstance(plain, Session)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ({"error": "ValueError: \x1b[1mno"}, r"the method raised ValueError: \\x1b\[1mno"),
        ({"error": "x" * 3000}, "the method raised x{1000}$"),
        ({"text": "minimax"}, "the method returned a text; expected an object with act or probabilities"),
        ({"stroke": np.zeros(3)}, "the method returned a stroke"),
        ({"probability": np.zeros((3, 4))}, "the method returned a probability"),
        (b"\x08" + bytes(7) + b"x" * 8, "the method sent an invalid message: no message"),
    ],
)
def test_answers_that_are_no_player(answer: Any, says: str, method: Method, tmp_path: Path) -> None:
    session = session_of(setting_of(tmp_path))
    method.says(answer)
    with pytest.raises(SuiteError, match=says):
        session.player(call="player")


def test_players_are_strokes_or_shares_and_positions(method: Method, tmp_path: Path) -> None:
    session = session_of(setting_of(tmp_path, HIDDEN))
    states = np.arange(HIDDEN.n_states)
    shares = HIDDEN.mask(states) / np.maximum(1, HIDDEN.mask(states).sum(axis=1))[:, None]
    feasible = HIDDEN.waiting.mask(HIDDEN.base(states))
    last = np.eye(9)[8 - feasible[:, ::-1].argmax(axis=1)]
    method.says({"probability": shares, "position": last}, {"probability": shares})
    found = session.player(call="player")
    uniform = tabulate(resolve("random", HIDDEN), HIDDEN)
    np.testing.assert_allclose(found.pair_probabilities(), uniform.pair_probabilities(), atol=2e-5)
    np.testing.assert_array_equal(found.position_probabilities(), last)
    assert session.policy_for_next_rally().waits is None
    assert [str(each["call"]) for each in method.taken[1:]] == ["player", "policy_for_next_rally"]


def test_logs_are_sent_without_pairs(method: Method, tmp_path: Path) -> None:
    session = session_of(Setting(game=GAME, model="model", seed=4, folder=tmp_path))
    data = play_log((random_policy(GAME, 0), random_policy(GAME, 1)), 40, 0)
    policies = [random_policy(GAME, seed) for seed in (5, 6)]
    method.says({"policy": 1, "state": data.state[:4]}, {"values": np.array([0.25, 0.5])}, {"nothing": 0}, {"nothing": 0})
    assert session.estimate(data, policies).tolist() == [0.25, 0.5]
    _, asked, shares = method.taken
    assert (str(asked["call"]), int(asked["policies"])) == ("estimate", 2)
    columns = {field.name for field in dataclasses.fields(data)} - {"game", "pair"}
    assert set(asked) == {"call", "policies", "stroke", *columns}
    np.testing.assert_array_equal(asked["stroke"], GAME.pair_stroke[data.pair])
    np.testing.assert_array_equal(asked["state"], data.state)
    mine = random_policy(GAME, 6).pair_probabilities()
    for row, state in zip(shares["probability"], data.state[:4].tolist(), strict=True):
        pairs = GAME.pairs_of(state)
        np.testing.assert_allclose(row[GAME.pair_stroke[pairs]], mine[pairs], atol=1e-6)
    session.observe_rally(data)
    assert str(method.taken[-1]["call"]) == "observe_rally"
    with pytest.raises(SuiteError, match="returned a nothing"):
        session.fit(data)
    assert str(method.taken[-1]["call"]) == "fit"


def test_messages_are_arrays_alone() -> None:
    sent = {"a": np.arange(6).reshape(2, 3), "b": np.array("x"), "c": np.array([True])}
    found = apart.receive(io.BytesIO(apart.message(**sent)))
    assert {name: part.tolist() for name, part in found.items()} == {name: part.tolist() for name, part in sent.items()}
    two = io.BytesIO(apart.message(a=1) + apart.message(a=2))
    assert [int(apart.receive(two)["a"]) for _ in range(2)] == [1, 2]
    for short in (b"", bytes(7)):
        with pytest.raises(EOFError, match="the other side has ended"):
            apart.receive(io.BytesIO(short))


def test_messages_that_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    packed, empty = io.BytesIO(), io.BytesIO()
    np.savez_compressed(packed, a=np.zeros(99))
    with zipfile.ZipFile(empty, "w") as archive:
        archive.writestr("a.npy", b"no array")
    pickled = io.BytesIO()
    np.savez(pickled, a=np.array([{}], dtype=object))

    def framed(content: bytes) -> io.BytesIO:
        return io.BytesIO(len(content).to_bytes(8, "little") + content)

    for content, says in (
        (packed.getvalue(), "a message that is packed"),
        (b"no archive", "no message"),
        (pickled.getvalue(), "pickle"),
    ):
        with pytest.raises(ValueError, match=says):
            apart.receive(framed(content))
    size = len(apart.message(a=1)) - 8
    monkeypatch.setattr(apart, "_MOST", size)
    assert int(apart.receive(io.BytesIO(apart.message(a=1)))["a"]) == 1
    monkeypatch.setattr(apart, "_MOST", size - 1)
    with pytest.raises(ValueError, match=f"a message of {size} bytes; expected at most {size - 1}"):
        apart.receive(io.BytesIO(apart.message(a=1)))


def test_a_method_apart_asks_and_sees_what_is_told() -> None:
    asked: list[dict[str, Any]] = []
    replies = [{"state": "s", "waits": "w"}, {"state": "t", "waits": "v", "reward": "r", "over": "o"}] * 2
    fields = {
        "observation": np.eye(3), "mask": np.array([[True, False], [False, False], [True, True]]), "feasible": np.zeros((0, 9)),
        "seed": np.array(3), "budget": np.array(7), "opponents": np.array(2),
    }  # fmt: skip

    def ask(**request: Any) -> Any:
        asked.append(request)
        return replies[len(asked) - 1]

    setting = apart.Setting(ask, fields, Path("unit"))
    assert (setting.seed, setting.budget, setting.opponents, setting.waits.tolist()) == (3, 7, 2, [])
    assert (setting.reset(), setting.waits) == ("s", "w")
    assert (setting.step([1, 2]), setting.waits) == (("t", "r", "o"), "v")
    setting.reset(5, opponent=1)
    setting.step([1, 2], [3, 4])
    assert asked[0] == {"reset": 256, "opponent": 0}
    assert asked[2] == {"reset": 5, "opponent": 1}
    assert {name: part.tolist() for name, part in asked[1].items()} == {"step": [1, 2]}
    assert {name: part.tolist() for name, part in asked[3].items()} == {"step": [1, 2], "positions": [3, 4]}
    act = SimpleNamespace(act=lambda seen, mask: mask.argmax() + seen[2], positions=lambda seen, feasible: feasible)
    assert {name: part.tolist() for name, part in apart.answer_of(act, setting).items()} == {"stroke": [0, -1, 1]}
    setting.feasible = np.ones((3, 9))
    assert apart.answer_of(act, setting)["position"].shape == (3, 9)
    shares = apart.answer_of(SimpleNamespace(probabilities=lambda seen, mask: mask), setting)
    assert (list(shares), shares["probability"].tolist()) == (["probability"], [[1, 0], [0, 0], [1, 1]])
    assert shares["probability"].dtype == np.float32
    assert apart.answer_of(None, setting) == {"nothing": 0}
    assert apart.answer_of("minimax", setting) == {"text": "minimax"}
    assert apart.answer_of([1, 2], setting)["values"].tolist() == [1.0, 2.0]


def test_namespaces_are_entered_by_root_as_nobody_and_by_others_as_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "_mounts", lambda code: [f"mount {code}"])
    for user, named in ((0, True), (1000, False)):
        monkeypatch.setattr(os, "geteuid", lambda user=user: user)
        command = Namespaces().command(tmp_path, ["-c", "a b"])
        assert command[:3] == ["setpriv", "--pdeathsig=KILL", "unshare"]
        assert set(command[3:10]) == {"--mount", "--net", "--ipc", "--uts", "--pid", "--fork", "--kill-child"}
        assert command[10:-3] == ([] if named else ["--user", "--map-root-user"])
        assert command[-3:-1] == ["sh", "-c"]
        steps = command[-1].split("\n")
        assert steps[:4] == ["set -e", "mount --make-rprivate /", "cd /", f"mount {tmp_path}"]
        assert (steps[4], steps[-1]) == ("ulimit -f 2097152", "exit 0")
        assert steps[5].startswith("chroot /mnt env -i PATH=/usr/bin:/bin HOME=/tmp LANG=C.UTF-8 OMP_NUM_THREADS=1")
        assert steps[5].endswith(" -I -c 'a b'")
        assert ("--reuid=1" in steps[5]) == ("--regid=1" in steps[5]) == ("--clear-groups" in steps[5]) == named
        for part in ("--no-new-privs", "--inh-caps=-all", "--bounding-set=-all"):
            assert part in steps[5]


def test_every_process_has_a_user_of_its_own() -> None:
    users = {int(remote._nobody()) for _ in range(50)}
    assert len(users) > 45
    assert (1 << 30) <= min(users) <= max(users) < (1 << 30) + (1 << 29)


def test_what_is_missing_or_shown_already_is_not_mounted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "shown" / "inside").mkdir(parents=True)
    places = [str(tmp_path / name) for name in ("shown", "shown/inside", "missing")]
    monkeypatch.setattr(remote, "_SHOWN", places)
    bound = [step.split()[-2] for step in remote._mounts(tmp_path / "code") if step.startswith("mount --bind")]
    assert [place in bound for place in places] == [True, False, False]


def test_all_is_mounted_for_reading_but_devices(tmp_path: Path) -> None:
    root = "/mnt"
    steps = remote._mounts(tmp_path)
    assert steps[0] == "mount -t tmpfs -o mode=755,size=4g none /mnt"
    bound = [step.split()[-1] for step in steps if step.startswith("mount --bind")]
    locked = [step.split()[-1] for step in steps if step.startswith("mount -o remount,bind,ro")]
    devices = [f"{root}/dev/null", f"{root}/dev/zero", f"{root}/dev/urandom"]
    assert [each for each in bound if each not in locked] == devices
    assert f"{root}/code" in locked
    assert f"mount --bind {tmp_path} {root}/code" in steps
    assert {f"mkdir -p {root}/usr", f"mkdir -p {root}/code", f"touch {root}/dev/null", f"mkdir -p {root}/proc {root}/tmp"} <= set(
        steps
    )
    assert steps[-2:] == [f"chmod 1777 {root}/tmp", f"mount -t proc -o subset=pid none {root}/proc"]
    assert len({*steps}) == len(steps)
    for inside in bound:
        assert not any(Path(inside).is_relative_to(other) for other in bound if other != inside)


@pytest.mark.parametrize(
    ("returncode", "output", "says"),
    [
        (0, "", None),
        (0, " \n", None),
        (0, "a network, your files\n", "docker: inside, one sees a network, your files"),
        (1, "", "docker: no such image$"),
        (1, "a network", "docker: no such image$"),
    ],
)
def test_a_boundary_is_probed(
    returncode: int, output: str, says: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def probe(command: list[str], **options: Any) -> Any:
        asked.append((command, options["timeout"]))
        return SimpleNamespace(returncode=returncode, stdout=output, stderr="x" * 999 + "no such image\n")

    monkeypatch.setattr(subprocess, "run", probe)
    monkeypatch.setattr(shutil, "which", lambda name: name if name == "docker" else None)
    if says is None:
        assert find_boundary(tmp_path, "image", hidden=[tmp_path / "secret"]) == Container("docker", "image")
    else:
        with pytest.raises(SuiteError, match=says if returncode == 0 else r"docker: x{287}no such image$"):
            find_boundary(tmp_path, "image", hidden=[tmp_path / "secret"])
    ((command, seconds),) = asked
    assert command[:2] == ["docker", "run"]
    assert command[-3:] == ["-c", remote._PROBE, str((tmp_path / "secret").resolve())]
    assert seconds == 120


def test_a_probe_that_hangs_is_no_boundary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def hangs(command: list[str], **_: Any) -> Any:
        raise subprocess.TimeoutExpired(command, 1)

    monkeypatch.setattr(subprocess, "run", hangs)
    monkeypatch.setattr(shutil, "which", str)
    with pytest.raises(SuiteError, match="no unshare and setpriv"):
        find_boundary(tmp_path)
