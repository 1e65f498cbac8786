"""Runs of the suite: stored units, resuming, exact scores, verification, and the board."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.base import runs
from shuttle_marl.base.arrays import U16
from shuttle_marl.base.files import seal
from shuttle_marl.commands.suite import main
from shuttle_marl.exact import best_response, evaluate
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite import store
from shuttle_marl.suite.board import render
from shuttle_marl.suite.exploit import Trained
from shuttle_marl.suite.method import sources
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import TASKS, task_of_run
from shuttle_marl.suite.results import Row, difference, summarise, verify_run
from tests import golden
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, summary, verified

GAME = reduced_game()


def table(name: str) -> TabulatedPolicy:
    return tabulate(resolve(name, GAME), GAME)


def noisy(setting: Any) -> TabulatedPolicy:
    """A method that depends on the seed."""
    return table(f"bc@{0.3 + 0.1 * setting.seed}")


def illegal(setting: Any) -> Any:
    class Illegal:
        def probabilities(self, states: Any) -> Any:
            p = np.zeros((len(states), states.game.n_strokes))
            p[:, 0] = 1.0
            return p

    return Illegal()


def greedy(setting: Any) -> Any:
    class First:
        def act(self, observation: Any, mask: Any) -> int:
            return int(mask.argmax())

    return First()


def played(tmp_path: Path, method: str, task: str = "exploit-entrance-v0", **options: Any) -> Path:
    return run(task, method, tmp_path / method.replace(":", "-"), **options)


def reasons(folder: Path) -> list[str]:
    return [each.reason for each in verified(folder).refused]


def first_entry(folder: Path) -> tuple[Path, dict[str, Any]]:
    path = store.entry_path(folder, 0, 0)
    return path, json.loads(path.read_text())


def forge(path: Path, fields: dict[str, Any]) -> None:
    """Write an entry with a valid checksum."""
    path.write_bytes(seal({name: value for name, value in fields.items() if name != "checksum"}))


def test_a_model_folder_that_a_run_names_is_not_opened(tmp_path: Path) -> None:
    folder = played(tmp_path, "bc")
    with pytest.raises(SuiteError, match=r"not shipped; name it with --game"):
        verify_run(folder)
    with pytest.raises(SuiteError, match=r"not shipped; name it with --game"):
        summarise(folder)


def test_the_game_of_a_run_is_the_one_that_its_reader_names() -> None:
    game = store.GameOf(model="default", hash="0" * 64)
    config = store.RunConfig(task="exploit-v0", method="ppo", split="dev", quick=False, budget=10**6, seeds=1, game=game)
    for model, found in ((None, "default"), (reduced_model(), reduced_model())):
        task, arena, cases = task_of_run(config, model)
        assert (task.name, arena.split, arena.quick, arena.budget) == ("exploit-v0", "dev", False, 10**6)
        assert arena.model == f"{found}:recovery"
        assert {case.budget for case in cases} == {10**6}
    with pytest.raises(SuiteError, match="names no budget; budgets are never pooled"):
        task_of_run(dataclasses.replace(config, budget=None))


def test_scores_are_exact_and_verified(tmp_path: Path) -> None:
    folder = played(tmp_path, f"{__name__}:noisy", seeds=2)
    result, opponent = summary(folder), table("bc@0.5")
    wins = [evaluate(table(f"bc@{temperature}"), opponent).odds().rally for temperature in (0.3, 0.4)]
    perfect = evaluate(table("minimax"), opponent).odds().rally
    assert result["scores"]["score"]["value"] == pytest.approx(100 * (np.mean(wins) - perfect), abs=1e-6)
    assert result["low"] < result["score"] < result["high"]
    assert reasons(folder) == []


def fails(setting: Any) -> Any:
    settings: dict[str, Any] = {}
    return settings["zz"]


def test_errors_of_methods_say_where_and_it_can_be_run_again(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(SuiteError, match=rf"{__name__}:fails, case bc@0.5/20,000, seed 0: .*KeyError: 'zz' \(.*, line \d+\)"):
            played(tmp_path, f"{__name__}:fails")
    assert not runs.has_results(tmp_path / f"{__name__}-fails")
    folder = played(tmp_path, "bc")
    with pytest.raises(runs.RunError, match="a finished run"):
        played(tmp_path, "bc")
    assert runs.has_results(folder)
    assert json.loads((folder / runs.MANIFEST).read_text())["status"] == "finished"


@dataclasses.dataclass(frozen=True)
class Declared:
    strokes: Any

    def __call__(self, setting: Any) -> Any:
        return Trained(player="bc", strokes=self.strokes)


counted, halves, negative, many = map(Declared, (np.int64(100), 0.5, -5, 10**9))


def test_declared_strokes_are_checked(tmp_path: Path) -> None:
    assert summary(played(tmp_path, f"{__name__}:counted"))["strokes"] == 100
    for name in ("halves", "negative", "many"):
        with pytest.raises(SuiteError, match="strokes"):
            played(tmp_path, f"{__name__}:{name}")
        assert not list((tmp_path / f"{__name__}-{name}" / store.ENTRIES).glob("*"))


def test_a_method_whose_library_is_missing_says_how_to_install_it(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from shuttle_marl.commands.suite import main\n"
        f"arguments = ['run', 'exploit-v0', '--method', 'ppo', '--quick', '--game', {reduced_model()!r}, '--out', 'o']\n"
        "main(arguments), main(arguments)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stderr.count("this needs torch, which is not installed; `make install`") == 2


def test_a_wrong_option_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="--budget -1"):
        played(tmp_path, "bc", budget=-1)
    assert not list(tmp_path.iterdir())


def test_unknown_scores_are_refused_and_aggregates_are_not_read(tmp_path: Path) -> None:
    folder = played(tmp_path, "bc")
    (folder / store.RESULTS).write_text('{"score": 0.99}')
    assert reasons(folder) == []
    assert verified(folder).summary["score"] < 0
    path, entry = first_entry(folder)
    forge(path, {**entry, "scores": {**entry["scores"], "exploitabilty": -1.0}})
    (reason,) = reasons(folder)
    assert "exploitabilty" in reason


def test_references_bound_the_scale(tmp_path: Path) -> None:
    best = summary(played(tmp_path, "restricted"))["scores"]
    assert best["gain"]["value"] == pytest.approx(best["best"]["value"], abs=1e-5)
    response = best_response(table("bc@0.5")).value.odds().rally - evaluate(table("minimax"), table("bc@0.5")).odds().rally
    assert summary(played(tmp_path, "best-response"))["scores"]["score"]["value"] == pytest.approx(100 * response, abs=1e-6)
    assert summary(played(tmp_path, "minimax"))["score"] == pytest.approx(0, abs=1e-6)
    assert summary(played(tmp_path / "e", "minimax", "equilibrium-entrance-v0"))["score"] == pytest.approx(0, abs=1e-6)
    one, some = (summary(played(tmp_path, name))["scores"]["score"]["value"] for name in ("constant", "constant-by-incoming"))
    assert one < some < 100 * response
    golden.check("player_methods", {"constant": one, "constant-by-incoming": some})


def test_perfect_play_has_to_mix_where_positions_are_hidden(tmp_path: Path) -> None:
    hidden, plain = "equilibrium-v0", "equilibrium-entrance-v0"
    risks = {task: summary(played(tmp_path / task, "minimax-deterministic", task))["score"] for task in (hidden, plain)}
    assert risks[hidden] > 0.5
    assert risks[plain] == pytest.approx(0, abs=1e-6)
    assert summary(played(tmp_path / "m", "minimax", hidden))["score"] < 0.01


def test_estimates_of_the_opponent_are_answered(tmp_path: Path) -> None:
    found = summary(played(tmp_path, "restricted-counts", "exploit-v0"))
    assert 0.25 * found["scores"]["best"]["value"] < found["score"] <= found["scores"]["best"]["value"] + 1e-6
    assert 0 < found["strokes"] <= 20_000
    golden.check("player_methods", {"restricted-counts": {**found["scores"], "strokes": found["strokes"]}})


def test_fictitious_play_approaches_the_equilibrium(tmp_path: Path) -> None:
    found = summary(played(tmp_path, "fictitious-play", "equilibrium-entrance-v0"))
    assert 0 < found["score"] < 0.2 * 50 * best_response(table("bc")).value.odds().value
    golden.check("player_methods", {"fictitious-play": found["scores"]})


def test_players_that_act_are_tabulated(tmp_path: Path) -> None:
    folder = played(tmp_path, f"{__name__}:greedy")
    player = store.read_outcome(folder, store.read_entry(store.entry_path(folder, 0, 0)), GAME).policies["player"]
    first = np.zeros(GAME.n_pairs)
    first[GAME.first_pairs] = 1
    assert np.array_equal(player.pair_probabilities(), first)


def test_an_illegal_stroke_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="plays the illegal stroke"):
        played(tmp_path, f"{__name__}:illegal")


def test_a_run_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = played(tmp_path, f"{__name__}:noisy", seeds=2)
    whole = summary(folder)
    kept = store.entry_path(folder, 0, 0).read_bytes()
    store.entry_path(folder, 0, 1).unlink()
    with pytest.raises(SuiteError, match="1 of 2 units are missing"):
        summary(folder)
    played(tmp_path, f"{__name__}:noisy", seeds=2, resume=True)
    assert store.entry_path(folder, 0, 0).read_bytes() == kept
    again = summary(folder)
    assert {**again, "seconds": 0} == {**whole, "seconds": 0}
    with pytest.raises(runs.RunError, match="other flags"):
        played(tmp_path, f"{__name__}:noisy", seeds=3, resume=True)


def test_units_of_two_versions_of_a_method_are_not_mixed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "my_methods").mkdir()
    (tmp_path / "my_methods" / "__init__.py").write_text(
        "def player(setting):\n    from my_methods.helper import NAME\n    return NAME\n"
    )
    helper = tmp_path / "my_methods" / "helper.py"
    helper.write_text("NAME = 'bc'\n")
    folder = played(tmp_path, "my_methods:player", seeds=2)
    assert set(json.loads((folder / runs.MANIFEST).read_text())["sources"]) == {"my_methods"}
    helper.write_text("NAME = 'safe'\n")
    kept = store.entry_path(folder, 0, 1).read_bytes()
    played(tmp_path, "my_methods:player", seeds=2, resume=True)  # nothing is left to play
    store.entry_path(folder, 0, 1).unlink()
    for _ in range(2):
        with pytest.raises(SuiteError, match=r"my_methods changed after .* --overwrite or another --out"):
            played(tmp_path, "my_methods:player", seeds=2, resume=True)
    helper.write_text("NAME = 'bc'\n")
    played(tmp_path, "my_methods:player", seeds=2, resume=True)
    assert {**json.loads(kept), "seconds": 0, "checksum": 0} == {
        **json.loads(store.entry_path(folder, 0, 1).read_text()),
        "seconds": 0,
        "checksum": 0,
    }


def test_the_files_of_a_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bot.py").write_text("import numpy\n")
    (tmp_path / "weights.bin").write_bytes(b"12")

    def now() -> dict[str, str]:
        return sources("exploit-entrance-v0", "program:python bot.py --weights weights.bin")

    before = now()
    assert set(before) == {"bot.py", "weights.bin"}
    for changed in ("bot.py", "weights.bin"):
        with (tmp_path / changed).open("a") as file:
            file.write("# changed\n")
        assert {key for key, value in now().items() if value != before[key]} == {changed}
        before = now()
    assert set(sources("exploit-entrance-v0", "bc")) == {"shuttle_marl"}
    assert set(sources("text-v0", "policy:table:weights.bin")) == {"shuttle_marl", "weights.bin"}


def test_policies_of_other_roles_are_refused(tmp_path: Path) -> None:
    folder = played(tmp_path, "bc")
    path, entry = first_entry(folder)
    (digest,) = entry["policies"].values()
    forge(path, {**entry, "policies": {f"role {i}\x1b": digest for i in range(1000)}})
    assert r"1000 policies or answers that the task does not have, such as role 0\x1b" in str(reasons(folder)[0])


def test_changed_submissions_are_refused(tmp_path: Path) -> None:
    folder = played(tmp_path, "bc")
    path, entry = first_entry(folder)
    original = path.read_bytes()

    path.write_bytes(original.replace(b'"score": -', b'"score": '))
    assert "checksum" in str(reasons(folder)[0])
    forge(path, {**entry, "scores": {**entry["scores"], "score": 0.5}})
    assert "score is" in str(reasons(folder)[0])
    forge(path, {**entry, "seed": 1})
    assert "seed 1" in str(reasons(folder)[0])
    forge(path, {**entry, "fingerprint": "0" * 64})
    assert "fingerprint" in str(reasons(folder)[0])
    path.write_bytes(original)
    assert reasons(folder) == []

    (policy,) = (folder / store.POLICIES).iterdir()
    content = policy.read_bytes()
    numbers = TabulatedPolicy.unpacked(content, GAME, "").cumulative.copy()

    def packed(numbers: U16) -> bytes:
        return TabulatedPolicy(game=GAME, cumulative=numbers).packed()

    numbers[np.flatnonzero((numbers > 0) & (numbers < 65534) & (numbers % 2 == 0))[0]] ^= 1  # one bit
    policy.write_bytes(packed(numbers))
    assert "the table was changed" in str(reasons(folder)[0])
    policy.write_bytes(packed(numbers[1:]))
    assert "expected the" in str(reasons(folder)[0])
    numbers[1] = 65535
    policy.write_bytes(packed(numbers))
    assert "a cumulative probability falls" in str(reasons(folder)[0])
    policy.write_bytes(b"nonsense")
    assert "cannot be read" in str(reasons(folder)[0])
    policy.write_bytes(content)

    config = json.loads((folder / runs.CONFIG).read_text())
    (folder / runs.CONFIG).write_text(json.dumps({**config, "game": {**config["game"], "hash": "f" * 64}}))
    assert "played on game ffffffffffff" in str(reasons(folder)[0])


def test_paired_differences(tmp_path: Path) -> None:
    better = played(tmp_path, "restricted", seeds=2)
    worse = played(tmp_path, f"{__name__}:noisy", seeds=2)
    rows = [summary(folder) for folder in (better, worse)]
    found = difference(*rows)
    assert found["value"] == pytest.approx(rows[0]["score"] - rows[1]["score"], abs=1e-9)
    assert found["low"] <= found["value"] <= found["high"]
    with pytest.raises(SuiteError, match="different cases or seeds"):
        difference(rows[0], summary(played(tmp_path, "bc")))


def test_the_board_orders_and_escapes(tmp_path: Path) -> None:
    played_row = summary(played(tmp_path, "bc"))
    row: Row = {**played_row, "kind": "method", "recomputed": True}
    rows: list[Row] = [{**row, "method": "<b>x</b>|y `z` @all", "score": 0.4}, {**row, "method": "other", "score": 0.6}]
    markdown, html = render(rows, "md"), render(rows, "html")
    assert markdown.index("| 1 | `other` |") < markdown.index("| 2 | `<b>x</b>\\|y 'z' @all` |")
    assert "<b>x" not in html
    assert "&lt;b&gt;x" in html

    homograph, long, empty = ({**rows[0], "method": name} for name in ("\u0440po", "x" * 10**6, "\u200b "))
    shown = render([homograph, long, empty], "md")  # type: ignore[list-item]
    assert all(text in shown for text in ("`\\u0440po`", f"`{'x' * 60}...`", "`\\u200b`"))


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def told(*arguments: str) -> Any:
        assert main((*arguments, "--json")) == 0, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)

    tasks = told("list")["tasks"]
    assert [task["task"] for task in tasks] == list(TASKS)
    assert all(task["about"] and task["protocol"] and task["baselines"] for task in tasks)
    found = told("run", "exploit-entrance-v0", "--method", "bc", "--quick", "--game", reduced_model())
    assert found["remarks"] == ["a quick run"]
    for name in ("exploit-v0", "exploit-entrance-v0"):
        (task,) = (task for task in tasks if task["task"] == name)
        assert (task["unit"], task["zero"]) == ("points", "perfect play, which uses no weakness")
        assert task["entrance"] == ("entrance" in name)
    hidden = [task["task"] for task in tasks if "position of the receiver" in task["hidden"]]
    assert hidden == ["exploit-v0", "equilibrium-v0", "adapt-v0"]
    assert len({task["game"] for task in tasks}) > 1
    assert told("verify", found["folder"], "--game", reduced_model())["reproduced"] == 1
    assert main(("board", found["folder"], "--game", reduced_model(), "--out", "board.html", "--html")) == 0
    assert "exploit-entrance-v0" in (tmp_path / "board.html").read_text()
    path, entry = first_entry(Path(found["folder"]))
    # A damaged folder is left out of the board, and one is needed.
    path.write_text("{}")
    assert main(("board", found["folder"], str(tmp_path / "none"), "--game", reduced_model())) == 1
    assert "left out" in capsys.readouterr().err
    assert main(("board",)) == 1
    assert "--results" in capsys.readouterr().err
    forge(path, {**entry, "scores": {**entry["scores"], "score": 0.5}})
    assert main(("verify", found["folder"], "--game", reduced_model())) == 1
    printed = capsys.readouterr()
    assert "refused: bc@0.5" in printed.out
    assert main(("run", "exploit-entrance-v0", "--method", "nothing")) == 1
    assert "no method 'nothing'" in capsys.readouterr().err
