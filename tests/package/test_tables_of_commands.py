"""Tables that commands print, from a few figures; files that they may not overwrite; the game and the options of a command."""

import contextlib
import datetime
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rich.table import Table
from rich.text import Text

from shuttle_marl.analysis.outlook import PlayerRow, Prediction
from shuttle_marl.analysis.scouting import ListedPlayer
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli, options
from shuttle_marl.commands.options import RallyGameOptions, SampleOptions
from shuttle_marl.commands.training import _with_settings
from shuttle_marl.commands.watch import MatchOptions, OutputOptions, RallyOptions, TagOptions, _game, _recorded, watch
from shuttle_marl.exact.away import Spread
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.exact.regret import Hole
from shuttle_marl.policy.scorecard import Scorecard
from shuttle_marl.recording import RecordingError
from shuttle_marl.watch import WatchError


def cells(table: Table) -> list[list[str]]:
    """Rows of a table."""
    return [[str(cell) for cell in row] for row in zip(*(column._cells for column in table.columns), strict=True)]


def headings(table: Table) -> list[tuple[str, str]]:
    return [(str(column.header), column.justify) for column in table.columns]


def test_fractions_and_numbers() -> None:
    assert [cli.percent(share) for share in (0, 0.1234, 1)] == ["0.0 %", "12.3 %", "100.0 %"]
    assert [cli._number(value) for value in (None, 0.12345, -0.00001, 2.0)] == ["-", "0.1235", "0.0000", "2.0000"]
    assert cli._with_interval(0.5, None) == "50.0 %"
    assert cli._with_interval(0.5, (0.25, 0.75)) == "50.0 % (25.0 % to 75.0 %)"
    named = {"a": 0.25, "b": 0.5, "c": 0.25}
    assert cli.shares(named) == "b 50.0 %, a 25.0 %, c 25.0 %"
    assert cli.shares(named, 1) == "b 50.0 %"


def card(**fields: Any) -> Scorecard:
    usual: dict[str, Any] = {"policy": "bc", "rally_win_vs_bc": 0.5, "match_win_vs_bc": 0.75, "normalised_score": 0.125}
    return Scorecard(**{**usual, "rally_length_vs_bc": 9.125, **fields})


def test_scorecards() -> None:
    exact = card(exploitability=0.0625, regret_per_rally=-1e-9, thin_vs_bc=0.01)
    sampled = card(policy="[a]", normalised_score=None, rally_interval=(0.25, 0.75), match_interval=(0.5, 1.0))
    table = cli.scorecards([exact, sampled])
    assert cells(table) == [
        ["bc", "50.0 %", "75.0 %", "0.1250", "0.0625", "0.0000", "9.12", "1.0 %"],
        ["[a]", "50.0 % (25.0 % to 75.0 %)", "75.0 % (50.0 % to 100.0 %)", "-", "-", "-", "9.12", "-"],
    ]
    assert headings(table)[:2] == [("policy", "left"), ("rallies won", "right")]
    assert table.columns[0].no_wrap


def test_rallies_of_scorecards_that_know_them() -> None:
    endings, mix = {"fault": 0.75, "winner": 0.25}, {name: (6 - i) / 21 for i, name in enumerate("abcdef")}
    known = card(endings_vs_bc=endings, shot_mix_vs_bc=mix)
    (row,) = cells(cli.play([card(), known, card(endings_vs_bc=endings), card(shot_mix_vs_bc=mix)]))
    assert row == ["bc", "fault 75.0 %, winner 25.0 %", "a 28.6 %, b 23.8 %, c 19.0 %, d 14.3 %, e 9.5 %"]


def hole(**fields: Any) -> Hole:
    usual: dict[str, Any] = {
        "state": 1, "description": "one, two, three, four", "played": "lift", "played_share": 0.75, "best": "drop",
        "best_share": 0.25,
        "in_self_play": 0.5, "against_best_response": 1e-4, "played_real": 1234.0, "best_real": None, "regret": 0.125,
        "loss": 0.0625,
        "expected": None,
    }  # fmt: skip
    return Hole(**{**usual, **fields})


def test_states_in_which_a_policy_loses() -> None:
    found: Any = SimpleNamespace(holes=[hole(), hole(best="lift", in_self_play=9.9e-5, best_real=7.0, played_real=None)])
    table = cli.holes("b[c", found)
    assert str(table.title) == "Largest losses of b[c to its best response"
    assert cells(table) == [
        ["one\ntwo\nthree, four", "lift 75.0 %\n1,234 real strokes\ndrop 25.0 %", "0.5000", "0.0001", "0.1250", "0.06250"],
        ["one\ntwo\nthree, four", "lift 75.0 %", "1e-04", "0.0001", "0.1250", "0.06250"],
    ]
    assert [column.overflow for column in table.columns[:3]] == ["fold", "fold", "ellipsis"]


def test_results_in_refits(capsys: pytest.CaptureFixture[str]) -> None:
    spread = Spread(value=0.5, low=-0.25, high=1.25)
    home = {"rally_win": 0.51, "match_win": None, "exploitability": 0.25}
    away = {"rally_win": spread, "match_win": spread, "exploitability": spread}
    assert cli.home_and_away_json(home, None) == {"home": home, "away": None}
    assert cli.home_and_away_json(home, {"rally_win": spread})["away"] == {
        "rally_win": {"value": 0.5, "low": -0.25, "high": 1.25}
    }
    rows: list[cli.Headlines] = [("bc", home, away), ("safe", home, None)]
    for asked, shown, refits, says in (
        (False, rows, [1], ""),
        (True, [], [1], ""),
        (True, rows, [], "has no refits on resampled matches"),
    ):
        cli.print_home_and_away(cast(Any, shown), cast(Any, refits), asked=asked)
        printed = capsys.readouterr().out
        assert says in printed
        assert bool(printed) == bool(says)
    cli.print_home_and_away(rows, cast(Any, [1, 2, 3]), asked=True)
    lines = [re.sub(r"[^\w.%]+", " ", line).strip() for line in capsys.readouterr().out.splitlines()]
    assert "bc rallies won 51.0 % 50.0 % 0.0 % to 100.0 %" in lines
    assert "exploitability 0.250 0.500 0.000 to 1.000" in lines
    assert not [line for line in lines if line.startswith(("safe", "matches won"))]
    assert any("played in 3 refits of the game" in line for line in lines)


def test_a_matrix_has_no_diagonal() -> None:
    table = cli.matrix("wins", ["a", "b"], np.array([[0.5, 0.25], [0.75, 0.5]]))
    assert cells(table) == [["a", "", "25.0 %"], ["b", "75.0 %", ""]]
    assert headings(table) == [("", "left"), ("a", "right"), ("b", "right")]


def pair(**fields: Any) -> Prediction:
    usual: dict[str, Any] = {"players": ("a", "b"), "hash": "", "rally_win": 0.5, "rally_low": 0.25, "rally_high": 0.75}
    return Prediction(
        **{**usual, "match_win": 0.625, "match_low": 0.125, "match_high": 0.875, "reasons": {"net [x]": 1.5}, **fields}
    )


def test_predictions_of_pairs_and_players() -> None:
    plain = ["a against b", "50.0 %", "25.0 to 75.0", "62.5 %", "12 to 88"]
    assert cells(cli.pair_rows([pair()])) == [plain]
    assert cells(cli.pair_rows([pair(), pair(rallies=40, rallies_won=30, matches=2, matches_won=1)])) == [
        [*plain, "0 of 0", "0 of 0"],
        [*plain, "30 of 40", "1 of 2"],
    ]
    assert [heading for heading, _ in headings(cli.pair_rows([pair(matches=1)]))][-2:] == ["real rallies", "real matches"]
    assert len(headings(cli.pair_rows([pair()]))) == 5
    assert cells(cli.reason_rows(pair())) == [["net [x]", "+1.50"]]
    row = PlayerRow(name="a", since="2021-01-02", strokes=12_345, rally_win=0.5, match_win=0.75)
    assert cells(cli.player_rows([row])) == [["a", "2021-01-02", "12,345", "50.0 %", "75.0 %"]]
    listed: dict[str, Any] = {"name": "a", "discipline": "men", "strokes": 1234, "matches": 5, "last": datetime.date(2021, 1, 2)}
    rows = [ListedPlayer(**listed, imitated=imitated) for imitated in (True, False)]
    assert [row[-2:] for row in cells(cli.scouted_rows(rows))] == [["2021-01-02", "yes"], ["2021-01-02", "no"]]


def test_depth_of_play() -> None:
    people = {
        "shots": {"clear": 0.75, "drop": 0.25},
        "smash_after_lift": 0.125,
        "short_serve_replies": {"a": 0.3, "b": 0.6, "c": 0.1},
        "net_runs": 0.001,
        "kinds": 37,
    }
    found = {
        "policies": {"bc": {"itself": {**people, "types": 3, "bits": 1.256, "length": 9.0, "rare": 0.5}}},
        "people": people,
        "lists": {"no_duel": {"score": 0.12345, "exploitability": -1e-9, "against_minimax": 0.25}},
    }
    play, beside, best = cli.depth(found)
    assert cells(play) == [["bc", "itself", "clear 75.0 %, drop 25.0 %", "3", "1.26", "9.00", "50.0 %"]]
    figures = ["b 60.0 %, a 30.0 %", "75.0 %", "25.0 %", "12.5 %", "0.1 %", "37"]
    assert cells(beside) == [["bc", "itself", *figures], ["people", "people", *figures]]
    assert len(cells(cli.depth({**found, "people": None})[1])) == 1
    assert cells(best) == [["no duel", "0.123", "0.000", "25.0 %"]]


def test_facts_are_plain_text() -> None:
    (row,) = cells(cli.facts({"na[me]": "va\x1b[2Jlue"}))
    assert row == ["na[me]", "va\\x1b[2Jlue"]
    assert all(isinstance(cell, Text) for column in cli.facts({"a": "b"}).columns for cell in column._cells)


def test_a_log_is_watched_in_its_game() -> None:
    for game, profile, flags in (
        ("default", None, ""),
        ("club", None, " --game club"),
        ("club", "men", " --game club --profile men"),
    ):
        assert cli.watching(Path("a.mcap"), game, profile).endswith(f"watch --replay a.mcap{flags}")


def test_a_file_or_a_folder_with_content_is_taken(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    (tmp_path / "file").touch()
    for name in ("empty", "new"):
        cli.check_free(tmp_path / name)
    for name in ("full", "file"):
        cli.check_free(tmp_path / name, overwrite=True)
        with pytest.raises(ShuttleError, match="already exists; --overwrite replaces it"):
            cli.check_free(tmp_path / name)


def test_what_is_read_is_not_overwritten(tmp_path: Path) -> None:
    folder, inside, other, link = (tmp_path / name for name in ("data", "data/a.csv", "b.csv", "c.csv"))
    replace_file(inside, b"a")
    replace_file(other, b"b")
    link.symlink_to(other)
    replace_file(folder / "report.html", b"c")
    missing = tmp_path / "missing"
    for written, read in (
        ([], []), ([tmp_path / "new.csv"], [folder, other]), ([folder / "report.html"], [folder]),
        ([folder / "new.csv"], [folder]),
        ([missing], [missing]), ([other], [inside]), ([tmp_path / "x", tmp_path / "y"], []),
    ):  # fmt: skip
        cli.check_apart(written, read)
    hard = tmp_path / "hard.csv"
    hard.hardlink_to(other)
    for written, read, role in (
        ([other], [other], "read"), ([link], [other], "read"), ([other], [link], "read"), ([hard], [other], "read"),
        ([inside], [folder], "read"), ([folder], [folder], "read"), ([missing, missing], [], "written"),
        ([link, other], [], "written"),
    ):  # fmt: skip
        with pytest.raises(ShuttleError, match=f"is not written, because it is {role} too"):
            cli.check_apart(written, read)


def test_a_command_does_not_write_over_its_inputs(tmp_path: Path) -> None:
    ran: list[Path] = []

    def serve(*, data: str, out: Path) -> None:
        """Serve."""
        ran.append(out)

    replace_file(tmp_path / "a", b"")
    for data, out, status in (("a", "b", 0), ("a", "a", 1), ("table:a", "a", 1), ("default", "a", 0)):
        with contextlib.chdir(tmp_path):
            assert cli.run(serve, prog="tea", description="", argv=["--data", data, "--out", out]) == status
    assert ran == [Path("b"), Path("a")]


@pytest.mark.parametrize(
    ("path", "game", "profile", "header", "loaded"),
    [
        (None, None, None, None, "(None, None)"),
        (None, "club", "men", None, "('club', 'men')"),
        ("a.csv", "club", None, None, "('club', None)"),
        ("a.csv", None, "men", None, "(None, 'men')"),
        ("a.csv", None, None, None, "(None,) with a notice"),
        ("a.mcap", None, None, ("known", None), "shipped known"),
        ("a.mcap", "club", None, ("known", None), "('club', None)"),
        ("a.mcap", None, "men", ("known", None), "(None, 'men')"),
        ("a.mcap", None, None, ("known", "pair"), "pair in default"),
        ("a.mcap", "club", None, ("known", "pair"), "pair in club"),
    ],
)
def test_the_game_of_recorded_rallies(
    path: str | None,
    game: str | None,
    profile: Any,
    header: tuple[str, str | None] | None,
    loaded: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    @contextlib.contextmanager
    def opened(_: Path) -> Iterator[Any]:
        played, people = cast(Any, header)
        pair = None if people is None else SimpleNamespace(game=lambda model: f"{people} in {model}")
        yield SimpleNamespace(files=[SimpleNamespace(header=SimpleNamespace(game=played, pair=pair))])

    monkeypatch.setattr("shuttle_marl.recording.RallyLog", opened)
    monkeypatch.setattr("shuttle_marl.recording.reader.is_log", lambda found: found.suffix == ".mcap")
    monkeypatch.setattr(options, "resolve_game", lambda *about: str(about))
    monkeypatch.setattr(options, "shipped_game", lambda found: f"shipped {found}" if found == "known" else None)
    asked = RallyGameOptions(game=game, profile=profile)
    found = cast(Any, asked.load_for(None if path is None else Path(path)))
    said = "elite men's and women's singles" in capsys.readouterr().err
    assert f"{found} with a notice" == loaded if said else found == loaded
    if header == ("known", None) and game is None and profile is None:
        header = ("0123456789abcdef", None)
        with pytest.raises(RecordingError, match=r"a\.mcap: played on game 0123456789ab, which is not shipped"):
            asked.load_for(Path("a.mcap"))


def test_samples_have_a_match_at_least() -> None:
    for matches in (1, 10_000_000):
        assert SampleOptions(matches=matches).matches == matches
    for matches in (0, 10_000_001):
        with pytest.raises(ExactError, match="a number from 1 to 10,000,000"):
            SampleOptions(matches=matches)


def test_settings_of_a_file_stand_before_the_flags(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    path.write_text('{"algorithm": "ppo", "seed": 3, "opponent": ["bc", "safe"], "exploitability": false, "width": 64}')
    found = _with_settings(["ppo", "--width", "9", "--config", str(path), "--seed", "4"])
    assert found[0] == "ppo"
    assert found[-4:] == ["--width", "9", "--seed", "4"]
    assert found[1:-4] == ["--opponent", "bc", "safe", "--seed", "3", "--no-resume", "--no-overwrite", "--no-exploitability"]
    for words in (["ppo", "--seed", "1"], ["ppo", "--config"], ["dqn", "--config", str(path)], ["--config", "ppo", "x"], []):
        assert _with_settings(words) == words


def test_what_cannot_be_watched_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.commands.watch.load_game", lambda name: f"model {name}")
    monkeypatch.setattr("shuttle_marl.commands.watch.pair_game", lambda *people, **about: (people, about))
    path, none, log = tmp_path / "a", RallyOptions(), RallyOptions(replay=tmp_path)
    people = MatchOptions(players=("a", "b"), date="2021-01-02")
    refused: list[tuple[Any, str]] = [
        (lambda: watch(output=OutputOptions(video=path, save_site=path)), "--video and --save-site: give one of them"),
        (lambda: TagOptions(tag=path).open(), "belong together"),
        (lambda: TagOptions(out=path).open(), "belong together"),
        (lambda: _game(MatchOptions(date="2021-01-02"), none, RallyGameOptions()), "give both"),
        (lambda: _game(people, log, RallyGameOptions()), "leave out --players"),
        (lambda: _game(people, RallyOptions(real=tmp_path), RallyGameOptions()), "leave out --players"),
        (lambda: _recorded(RallyOptions(replay=path, real=path), cast(Any, None)), "--replay and --real: give one of them"),
    ]
    for act, says in refused:
        with pytest.raises(WatchError, match=says):
            act()
    assert TagOptions().open() is None
    assert _recorded(RallyOptions(rally=99), cast(Any, None)) is None
    monkeypatch.setattr(RallyGameOptions, "load_for", lambda self, found: f"game of {found}")
    assert _game(MatchOptions(), none, RallyGameOptions()) == "model default:recovery"
    assert _game(MatchOptions(), none, RallyGameOptions(profile="men")) == "model default:men-recovery"
    assert _game(MatchOptions(), none, RallyGameOptions(game="club")) == "game of None"
    assert _game(MatchOptions(), log, RallyGameOptions()) == f"game of {tmp_path}"
    found: Any = _game(people, none, RallyGameOptions(profile="men"))
    assert found == (("a", "b"), {"date": "2021-01-02", "discipline": "men", "game": "default:recovery"})


@pytest.mark.parametrize(("rally", "accepted"), [(None, True), (0, True), (4, True), (5, False), (-1, False)])
def test_a_recorded_rally_exists(rally: int | None, accepted: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = SimpleNamespace(count=5)
    monkeypatch.setattr("shuttle_marl.watch.recorded.LogRallies", lambda *_: shown)
    asked = RallyOptions(replay=Path("a.mcap"), rally=rally)
    if accepted:
        assert cast(Any, _recorded(asked, cast(Any, None))) is shown
    else:
        with pytest.raises(WatchError, match=f"--rally {rally}: expected 0 to 4"):
            _recorded(asked, cast(Any, None))
