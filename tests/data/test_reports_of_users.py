"""Files of people who do this job, as they reported them: each kind of mistake is read, named, listed or refused."""

import json
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from shuttle_marl.commands import analysis, data, report
from shuttle_marl.data import DataError, read_matches
from shuttle_marl.data.schema import REASONS, Cleaned, Outcome
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import SHOTS
from tests.data import written_matches as written
from tests.data.test_written_matches import import_text, spelled

PLAYERS = ("Anna Example", "Berta Sample")
FINAL = written.match(3, "final", PLAYERS, rallies=8)
COLUMNS = ("match", "game", "rally", "stroke", "player", "shot", "ending", "winner")
TIMED = ("player", "shot", "ending", "seconds")


def said(cleaned: Cleaned) -> str:
    return "\n".join((*cleaned.warnings, *cleaned.provenance["inferred"], *cleaned.provenance["lost"]))


def refusal(content: str, fields: str = 'discipline = "WS"\n') -> str:
    with pytest.raises(DataError) as caught:
        import_text(content, fields)
    return "\n".join(map(str, caught.value.problems))


def table(columns: Sequence[str] = COLUMNS, *changes: tuple[str, str], strokes: Sequence[written.Written] = FINAL) -> str:
    content = written.as_csv(written.entries(strokes, columns))
    for old, new in changes:
        assert old in content
        content = content.replace(old, new)
    return content


# The unit of a time.


@pytest.mark.parametrize("unit", ["ms", "frames", "minutes"])
@pytest.mark.parametrize("form", ["csv", "json", "sportscode"])
@pytest.mark.parametrize("columns", [TIMED, ("game", "rally", *TIMED)])
def test_times_that_are_no_seconds_are_refused(unit: str, form: str, columns: Sequence[str]) -> None:
    as_text: dict[str, Callable[[Sequence[dict[str, str]]], str]] = {
        "csv": written.as_csv, "json": lambda rows: written.as_json(rows, {}), "sportscode": written.as_sportscode,
    }  # fmt: skip
    assert "are these seconds" in refusal(as_text[form](written.entries(FINAL, columns, unit=unit)))
    assert import_text(as_text[form](written.entries(FINAL, columns))).strokes["clock"].to_pylist() == [
        int(s.seconds) for s in FINAL
    ]


def test_short_rallies_and_times_of_whole_rallies_are_no_other_unit() -> None:
    rows = written.entries([stroke for stroke in FINAL if stroke.stroke < 3], ("player", "shot", "seconds"))
    assert len(import_text(written.as_json(rows, {})).strokes) == len(rows)
    for row, stroke in zip(rows, FINAL, strict=False):
        row["seconds"] = str(20 * stroke.rally)
    assert "are these seconds" in said(import_text(written.as_json([{"rally": "1", **row} for row in rows[:2]], {})))


@pytest.mark.parametrize(("fps", "clock"), [("30000/1001", 33), ("29.97", 33), (25, 40), ("25 fps", 40), (50.0, 20)])
def test_rates_of_frames(fps: object, clock: int) -> None:
    strokes = [{"frame": 1000, "player": "a", "shot": "short-serve"}, {"frame": 1020, "player": "b", "shot": "lift"}]
    assert import_text(json.dumps({"fps": fps, "strokes": strokes})).strokes["clock"].to_pylist()[0] == clock
    for wrong in ("0/0", "1/0", "many", "-25", "1e400", "0", "9" * 400):
        assert f"fps {wrong!r:.50}; expected frames a second" in refusal(json.dumps({"fps": wrong, "strokes": strokes}))


# Annotations of ELAN.

EXPECTED_ENDINGS = [stroke.ending for stroke in FINAL if stroke.ending]


@pytest.mark.parametrize("dependent", [False, True])
@pytest.mark.parametrize("offset", [0, 60_000, -2_000])
def test_both_kinds_of_annotations_and_offsets_of_elan(dependent: bool, offset: int) -> None:
    rows = written.entries(FINAL, ("game", "rally", *TIMED))
    cleaned = import_text(written.as_elan(rows, dependent=dependent, offset=offset))
    assert cleaned.strokes["clock"].to_pylist() == [int(stroke.seconds) for stroke in FINAL]
    endings = [REASONS[reason] for reason in cleaned.strokes["reason"].to_pylist() if reason != REASONS.index("returned")]
    assert endings == EXPECTED_ENDINGS
    assert ("TIME_ORIGIN" in said(cleaned)) == (offset != 0)
    assert ", the first of" not in said(cleaned)


def test_the_offset_of_the_first_of_several_videos() -> None:
    rows = written.entries(FINAL, ("game", "rally", *TIMED))
    content = written.as_elan(rows, offset=60_000)
    for number, others in ((60_000, False), (61_000, True)):
        second = f'<MEDIA_DESCRIPTOR MEDIA_URL="b.mp4" TIME_ORIGIN="{number}"/></HEADER>'
        cleaned = import_text(content.replace("</HEADER>", second))
        assert cleaned.strokes["clock"].to_pylist() == [int(stroke.seconds) for stroke in FINAL]
        assert (", the first of 2 files with other offsets" in said(cleaned)) == others


def test_annotations_that_divide_another_one_and_slots_without_a_time() -> None:
    rows = written.entries(FINAL, ("game", "rally", *TIMED))
    for number, row in enumerate(rows):
        row["seconds"] = f"{2 * number + 1}"  # so that what lies between is known
    content = written.as_elan(rows, dependent=True)
    content = content.replace('<TIME_SLOT TIME_SLOT_ID="ts1" TIME_VALUE="1400"/>', '<TIME_SLOT TIME_SLOT_ID="ts1"/>')
    assert "times of 'strokes': 1 of" in said(import_text(content))
    last = f'<TIME_SLOT TIME_SLOT_ID="ts{content.count("<TIME_SLOT ") - 1}" TIME_VALUE'
    assert "has a time slot without a time" in refusal(content.replace(last, last.replace("TIME_VALUE", "X")))
    rally = [row for row in rows if row["game"] == row["rally"] == "1"]
    parts = "".join(
        f'<ANNOTATION><REF_ANNOTATION ANNOTATION_ID="{{0}}{k}" ANNOTATION_REF="r"{{{{{k}}}}}>'
        f"<ANNOTATION_VALUE>{{1[{k}]}}</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>"
        for k in range(len(rally))
    )
    tiers = "".join(
        f'<TIER TIER_ID="{name}">{parts.format(name[0], [row[column] for row in rally])}</TIER>'
        for name, column in (("strokes", "shot"), ("player", "player"), ("ending", "ending"))
    )
    times = '<TIME_SLOT TIME_SLOT_ID="a" TIME_VALUE="10000"/><TIME_SLOT TIME_SLOT_ID="b" TIME_VALUE="16000"/>'
    around = (
        '<TIER TIER_ID="rally"><ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="r" TIME_SLOT_REF1="a" TIME_SLOT_REF2="b">'
        "<ANNOTATION_VALUE>1</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION></TIER>"
    )
    text = f"<ANNOTATION_DOCUMENT><TIME_ORDER>{times}</TIME_ORDER>{tiers}{around}</ANNOTATION_DOCUMENT>"
    empty = text.format(*[""] * len(rally))
    cleaned = import_text(empty)
    assert cleaned.strokes["clock"].to_pylist() == [10 + int(6 * k / len(rally)) for k in range(len(rally))]
    assert "annotations divide that of another one evenly" in said(cleaned)
    assert "in another order" in refusal(text.format(*[' PREVIOUS_ANNOTATION="s1"'] * len(rally)))
    assert "refers to annotations that are not there" in refusal(empty.replace('ANNOTATION_REF="r"', 'ANNOTATION_REF="q"'))


def test_tiers_that_are_not_read_are_listed_in_both_forms_of_elan() -> None:
    rows = written.entries(FINAL, ("game", "rally", *TIMED))
    noted = [{**row, "mood": "calm"} for row in rows]
    assert "'mood'" in said(import_text(written.as_elan(noted, dependent=True)))
    sample = next((Path(__file__).parent / "samples").glob("*.eaf"))
    text = next(path for path in sample.parent.glob("2031*.eaf")).read_text()
    tier = '<TIER TIER_ID="Area"><ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="z" TIME_SLOT_REF1="ts1" TIME_SLOT_REF2="ts2">'
    more = (
        f"{tier}<ANNOTATION_VALUE>front left</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION></TIER></ANNOTATION_DOCUMENT>"
    )
    assert "'Area'" in said(import_text(text.replace("</ANNOTATION_DOCUMENT>", more)))
    assert "'Area'" not in said(import_text(text))


# Names that hold for a part of the file.


@pytest.mark.parametrize("ends", written.ENDS)
@pytest.mark.parametrize("form", ["csv", "json", "elan", "sportscode"])
def test_names_of_ends_are_exchanged_in_the_second_game_and_asked_for_in_the_third(ends: str, form: str) -> None:
    names = dict(zip(written.ENDS[ends], PLAYERS, strict=True))

    def content(strokes: Sequence[written.Written]) -> tuple[str, str]:
        rows = written.entries(strokes, ("game", "rally", *TIMED, "winner"), ends=ends)
        if form == "json":
            return written.as_json(rows, names), 'discipline = "WS"\n'
        write: dict[str, Callable[..., str]] = {
            "csv": written.as_csv,
            "elan": written.as_elan,
            "sportscode": written.as_sportscode,
        }
        return write[form](rows), spelled(names)

    cleaned = import_text(*content(FINAL))
    assert cleaned.strokes["player"].to_pylist() == [stroke.player.lower().replace(" ", "-") for stroke in FINAL]
    winners = [row["outcome"] == Outcome.WINNER for row in cleaned.strokes.to_pylist() if row["outcome"] != Outcome.RETURNED]
    assert winners == [stroke.winner == stroke.who for stroke in FINAL if stroke.ending]
    assert "exchanged in the second" in said(cleaned)
    third = written.match(4, "final", PLAYERS, games=(3,))
    assert "change ends in the third game" in refusal(*content(third))
    if form == "csv":  # which its user can correct
        assert "change ends in the third game" in refusal(*content([*FINAL, *third]))
    elif form != "json":
        cleaned = import_text(*content([*FINAL, *third]))
        assert set(cleaned.strokes["game"].to_pylist()) == {1, 2}
        assert "change ends in the third game" in said(cleaned)


def test_names_of_ends_given_for_each_game_and_other_things_at_ends() -> None:
    rows = written.entries(FINAL, ("game", "rally", *TIMED), ends="top")
    names = dict(zip(written.ENDS["top"], PLAYERS, strict=True))
    expected = [stroke.player.lower().replace(" ", "-") for stroke in FINAL]
    assert import_text(written.as_json(rows, names, by_game=True)).strokes["player"].to_pylist() == expected
    told = json.loads(written.as_json(rows, {})) | {"hands": {"top": "right", "bottom": "left"}, "score": {"top": 3, "bottom": 5}}
    cleaned = import_text(json.dumps(told))
    assert set(cleaned.strokes["player"].to_pylist()) == {"top", "bottom"}
    assert "names of the players: those of the ends" in said(cleaned)
    one_name = spelled({"top": PLAYERS[0]})
    assert "with one name nobody knows the other" in refusal(written.as_csv(rows), one_name)


@pytest.mark.parametrize(
    "name", ["nan", "None", "NULL", "NaT", "N/A", "#N/A", "NA", "<NA>", "#REF!", "unknown", "未知", "ukendt"]
)
@pytest.mark.parametrize("column", ["player", "match"])
def test_markers_of_missing_values_are_no_names(name: str, column: str) -> None:
    content = table(COLUMNS, (PLAYERS[1] if column == "player" else "final", name))
    assert f"line {3 if column == 'player' and FINAL[0].who == 0 else 2}: {column} {name!r}; expected a name" in refusal(content)


def test_a_person_with_such_a_name_is_mapped() -> None:
    content = table(COLUMNS, (PLAYERS[1], "Nan"))
    assert "map it in [values.player]" in refusal(content)
    assert "nan-li" in import_text(content, spelled({"Nan": "Nan Li"})).strokes["player"].to_pylist()


@pytest.mark.parametrize(
    "name", ["A / B", "A/B", "A & B", "A + B", "A and B", "A und B", "A dan B", "A; B", "A、B", "A - B", "A vs. B"]
)
def test_two_persons_are_no_player(name: str) -> None:
    assert "the name of one person, because the game is of singles" in refusal(table(COLUMNS, (PLAYERS[1], name)))


@pytest.mark.parametrize(
    "name", ["Anna-Lena Hyphen", "Hyphen, Anna", "Andersen", "Anna O'Hand", "Sand Og", "José Ortega y Gasset"]
)
def test_one_person_is_a_player(name: str) -> None:
    assert len(import_text(table(COLUMNS, (PLAYERS[1], f'"{name}"'))).strokes) == len(FINAL)


@pytest.mark.parametrize("name", ["server", "Receiver", "winner", "发球方"])
def test_roles_that_change_are_no_players(name: str) -> None:
    assert "this is another player in another rally" in refusal(table(COLUMNS, (PLAYERS[1], name)))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Søren Eksempel", "SOREN EKSEMPEL"),
        ("Lukas Weiß", "Lukas WEISS"),
        ("Łukasz Wzór", "Lukasz Wzor"),
        ("I\u015f\u0131l Örnek", "Isil Ornek"),
        ("Đorđe Primer", "Dorde Primer"),
        ("Ægir Dæmi", "AEGIR DAEMI"),
        ("Jörg Müller", "Joerg Mueller"),
        ("Åse Prøve", "Aase Proeve"),
        ("Þór Sýni", "Thor Syni"),
        ("Ann Cope", "\u0391nn \u0421\u043e\u0440\u0435"),  # Greek and Cyrillic
    ],
)
def test_one_player_in_other_letters_is_told(one: str, other: str) -> None:
    again = written.match(5, "semi-final", PLAYERS)
    rows = written.entries([*FINAL, *again], COLUMNS)
    for row in rows:
        name = one if row["match"] == "final" else other
        row |= {key: name for key in ("player", "winner") if row[key] == PLAYERS[0]}
    assert "are alike: are they one player" in said(import_text(written.as_csv(rows)))


# The same data under two keys.


@pytest.mark.parametrize("change", ["name", "players", "one stroke", "a game", "half"])
def test_one_match_under_two_names_is_told_and_not_fitted(
    change: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = written.entries(FINAL, COLUMNS)
    again = [{**row, "match": "league round 3"} for row in rows]
    if change == "players":
        again = [{k: v.replace("Anna", "Ada").replace("Berta", "Bea") for k, v in row.items()} for row in again]
    elif change == "one stroke":
        long = next(i for i, row in enumerate(again) if row["stroke"] == "3" and not row["ending"])
        again[long]["shot"] = "clear" if again[long]["shot"] != "clear" else "drive"
    elif change == "a game":
        again = [{**row, "match": "final", "game": str(int(row["game"]) + 2)} for row in again]
    elif change == "half":
        again = [row for row in again if row["game"] == "1"]
    cleaned = import_text(written.as_csv([*rows, *again]))
    assert "has the strokes of game 1 of 'final': are they one?" in said(cleaned)
    assert "are they one?" not in said(import_text(written.as_csv(rows)))
    (tmp_path / "own.csv").write_text(written.as_csv([*rows, *again]), encoding="utf-8")
    (tmp_path / "map.toml").write_text('discipline = "WS"', encoding="utf-8")
    out = tmp_path / "o.parquet"
    assert data.main(["import", str(tmp_path / "own.csv"), "--columns", str(tmp_path / "map.toml"), "--out", str(out)]) == 0
    capsys.readouterr()
    assert data.main(["validate", str(out)]) == 0
    assert "has the strokes of game 1 of 'final'" in capsys.readouterr().out
    from shuttle_marl.commands import dynamics

    assert dynamics.main(["fit", "--data", str(out), "--out", str(tmp_path / "m"), "--validation-share", "0.5"]) == 1
    assert "would count its strokes twice" in " ".join(capsys.readouterr().err.split())


# Values that cannot be read are not empty.

SHUTTLESET = """\
rally,ball_round,time,frame_num,roundscore_A,roundscore_B,player,type,aroundhead,backhand,hit_height,landing_area,lose_reason,getpoint_player
1,1,0:00:10,300,1,0,A,發短球,,,2,2,,
1,2,0:00:11,330,1,0,B,挑球,0,1,2,9.0,,
1,3,0:00:12,360,1,0,A,殺球,1,,1,5,對手落地致勝,A
2,1,0:00:30,900,1,1,A,發短球,0,0,2,2,,
2,2,0:00:31,930,1,1,B,推球,0,0,2,9,,
2,3,0:00:32,960,1,1,A,長球,0,0,1,15,出界,B
"""


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("0,1,2,9.0", "0,x,2,9.0", "unknown technique 'x'"), ("0,1,2,9.0", "2,1,2,9.0", "unknown technique '2'"),
        ("0,1,2,9.0", "0,1,3,9.0", "unknown height '3'"), ("0,1,2,9.0", "0,1,2,yy", "unknown area 'yy'"),
        ("0,1,2,9.0", "0,1,2,17", "unknown area '17'"), ("0:00:11", "0:11", "seconds '0:11' is not a number"),
        ("0:00:11", "0:00:71", "before that of the stroke before"), ("330", "33o", "frame '33o' is not a number"),
        ("致勝,A", "致勝,C", "winner 'C'; expected one of the players"),
        ("1,0,A,殺球", "1,o,A,殺球", "points_opponent 'o' is not a number"),
    ],
)  # fmt: skip
def test_unreadable_values_of_shuttleset_are_named_and_their_rally_is_dropped(old: str, new: str, says: str) -> None:
    fine = import_text(SHUTTLESET)
    assert fine.strokes["technique"].to_pylist()[:3] == [0, 1, 2]
    assert [AREAS[area] for area in fine.strokes["area"].to_pylist()[:2]] == [AREAS[2], AREAS[7]]
    assert fine.account.dropped == {}
    cleaned = import_text(SHUTTLESET.replace(old, new, 1))
    assert says in said(cleaned)
    assert set(cleaned.strokes["rally"].to_pylist()) == {2}
    assert cleaned.account.dropped == {"broken rally": 3}


def test_values_of_json_that_are_no_texts_are_listed() -> None:
    stroke = {"player": "a", "shot": "short-serve", "landing": [1, 2], "pose": {"x": 1}, "note": "good", "area": None}
    told = {
        "video_offset": 60,
        "start_time": 100,
        "strokes": [{**stroke, "time": 1}, {**stroke, "player": "b", "shot": "lift", "time": 2}],
    }
    text = said(import_text(json.dumps(told)))
    for key in ("landing", "pose", "note", "video_offset"):
        assert repr(key) in text
    assert "times of objects around, not added to those of strokes: 'seconds'" in text


# Words of several languages.

KLUB = """\
Gim,Reli,Pemain,Jenis pukulan,Hasil
1,1,Ayu,service,
1,1,Budi,lob,
1,1,Ayu,smash,out
"""


@pytest.mark.parametrize(
    ("header", "shot"),
    [
        ("Gim,Reli,Pemain,Jenis pukulan,Hasil", "clear"), ("Game,Rally,Player,Shot type,Result", "lift"),
        ("Game,Rally,Pemain,Pukulan,Hasil", "clear"), ("sæt,duel,spiller,slagtype,resultat", "lift"),
    ],
)  # fmt: skip
def test_headers_tell_the_language_of_a_word_and_the_other_meaning_is_listed(header: str, shot: str) -> None:
    cleaned = import_text(KLUB.replace(KLUB.splitlines()[0], header))
    assert SHOTS[cleaned.strokes["shot"].to_pylist()[1]] == shot
    assert f"'lob' as {shot}, by the language of the file; in another: {'lift' if shot == 'clear' else 'clear'}" in said(cleaned)
    mapped = 'discipline = "WS"\n[values.shot]\nlob = "lift"\n'
    assert "'lob' as" not in said(import_text(KLUB, mapped))


@pytest.mark.parametrize("zone", ["4", "4.0", "4,0", " 4.00 "])
def test_a_number_that_a_spreadsheet_gave_decimals_is_the_same_word(zone: str) -> None:
    rows = table((*COLUMNS[:6], "ending", "winner")).splitlines()
    rows = [f"{row},{cell}" for row, cell in zip(rows, ["zone", f'"{zone}"', *[""] * len(rows)], strict=False)]
    cleaned = import_text("\n".join(rows), 'discipline = "WS"\n[values.area]\n4 = "front-left"\n')
    assert cleaned.strokes["area"].to_pylist()[0] == AREAS.index("front-left")


# Scores.


@pytest.mark.parametrize("kind", written.SCORES)
@pytest.mark.parametrize("told", [(), ("ending",), ("winner",)])
def test_scores_may_be_of_one_player_in_each_match(kind: str, told: tuple[str, ...]) -> None:
    matches = [written.match(seed, f"m{seed}{' away' if seed % 2 else ''}", PLAYERS, rallies=12) for seed in range(4)]
    strokes = [stroke for each in matches for stroke in each]
    cleaned = import_text(table(("match", "game", "rally", "player", "shot", kind, *told), strokes=strokes))
    ends = [row for row in cleaned.strokes.to_pylist() if row["outcome"] != Outcome.RETURNED]
    for row, stroke in zip(ends, (stroke for stroke in strokes if stroke.ending), strict=True):
        assert row["outcome"] in ({Outcome.UNKNOWN} if kind.endswith("before") else set()) | {
            Outcome.WINNER if stroke.winner == stroke.who else Outcome.FAULT
        }


def test_a_score_with_several_readings_is_asked_for() -> None:
    one = [stroke for stroke in FINAL if stroke.game == stroke.rally == 1]
    assert "the score does not tell whose points are first" in refusal(table(("player", "shot", "one's after"), strokes=one))


# What a command reads it does not write.


def test_no_output_is_an_input(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    content, fields = table(), 'discipline = "WS"\n'
    Path("strokes.csv").write_text(content)
    Path("map.toml").write_text(fields)
    Path("hard.csv").hardlink_to("strokes.csv")
    Path("folder").mkdir()
    Path("folder/strokes.csv").write_text(content)
    assert data.main(["import", "strokes.csv", "--columns", "map.toml", "--out", "match.parquet"]) == 0
    table_before = Path("match.parquet").read_bytes()
    for main, arguments in (
        (report.main, "match.parquet --out match.parquet"),
        (report.main, f"match.parquet --out {tmp_path}/folder/../match.parquet"),
        (report.main, "strokes.csv --out hard.csv"),
        (report.main, "strokes.csv --columns map.toml --out map.toml"),
        (report.main, "match.parquet --out page.html --pdf page.html"),
        (data.main, "import strokes.csv --out strokes.csv --overwrite"),
        (data.main, "import strokes.csv --columns map.toml --out map.toml --overwrite"),
        (analysis.main, "folder/strokes.csv --out folder"),
        (analysis.main, "match.parquet --against folder/strokes.csv --out folder"),
    ):
        capsys.readouterr()
        assert main(arguments.split()) == 1, arguments
        assert "is not written, because it is" in " ".join(capsys.readouterr().err.split()), arguments
    assert Path("match.parquet").read_bytes() == table_before
    assert Path("strokes.csv").read_bytes() == Path("folder/strokes.csv").read_bytes() == content.encode()
    assert Path("map.toml").read_text() == fields
    assert not Path("page.html").exists()


# Names in metadata.


def test_no_name_is_left_in_a_pseudonymous_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rows = written.entries(FINAL, ("game", "rally", *TIMED))
    Path("Anna Example v Berta.csv").write_text(table())
    Path("Berta.eaf").write_text(written.as_elan([{**row, "Coach of Anna": "calm"} for row in rows]))
    Path("Berta.json").write_text(json.dumps([{**row, "sister of Berta": 1} for row in rows]))
    Path("map.toml").write_text('discipline = "WS"\n')
    for name in ("Anna Example v Berta.csv", "Berta.eaf", "Berta.json"):
        out = Path(name + ".parquet")
        flags = ["import", name, "--columns", "map.toml", "--anonymous", "--hand", "Anna Example=left", "--out", str(out)]
        assert data.main(flags) == 0
        told = pq.read_table(out)
        assert b"anna" not in repr((told.schema.metadata, told.to_pylist())).lower().encode(), name
        assert b"berta" not in repr((told.schema.metadata, told.to_pylist())).lower().encode(), name
        assert data.main(["validate", str(out)]) == 0
    assert data.main(["import", "Anna Example v Berta.csv", "--columns", "map.toml", "--out", "named.parquet"]) == 0
    assert analysis.main(["named.parquet", "--anonymous", "--against", "Anna Example v Berta.csv", "--out", "out"]) == 0
    for file in Path("out").iterdir():
        assert b"anna" not in file.read_bytes().lower() + file.name.lower().encode(), file


# BadmintonDB's published form.


def badminton_db(seed: int, nulls: int) -> str:
    """A match in the form of BadmintonDB's published JSON: some strokes have no time, some no player or type."""
    rng = random.Random(seed)
    points: dict[str, Any] = {}
    strokes = written.match(seed, "m", PLAYERS, rallies=14)
    keys = list(dict.fromkeys((stroke.game, stroke.rally) for stroke in strokes))
    unseen = set(rng.sample(range(len(strokes)), nulls))
    at = 0
    for number, key in enumerate(keys, 1):
        rally = [stroke for stroke in strokes if (stroke.game, stroke.rally) == key]
        first, last = rally[0], rally[-1]
        written_strokes = []
        for stroke in rally:
            gone = at in unseen
            kind = "Serve" if stroke.stroke == 1 else {"lift": "Net-Lift", "net-shot": "Net-Shot"}.get(stroke.shot, stroke.shot)
            written_strokes.append(
                {
                    "StrokeNum": stroke.stroke, "Player": f"T{stroke.who + 1}P1", "Camera": "normal",
                    "StrokeBegin": None if gone else stroke.seconds, "StrokeEnd": None if gone else stroke.seconds + 0.5,
                    "StrokeType": None if gone and at % 3 == 0 else kind,
                }
            )  # fmt: skip
            at += 1
        seats = {
            f"T{seat + 1}P1": {"Status": "server" if seat == first.server else "receiver", "Score": (0, first.game - 1)[seat],
                               "Point": first.before[seat], "Location": "top"}
            for seat in (0, 1)
        }  # fmt: skip
        cause = "end_miss" if last.ending == "landed" else "end_out"
        info = {"PointBegin": first.seconds, "PointEnd": None, "WonEnd": {"AtBegin": None, "AtEnd": None, "Cause": cause}}
        points[f"Point{number}"] = {
            "VideoInfo": {"Visibility": [], "Error": None},
            "PointInfo": {**info, **seats, "Rally": written_strokes},
        }
    return json.dumps(points)


@pytest.mark.parametrize(("seed", "nulls"), list(enumerate((2, 4, 6, 8, 10, 12, 14, 16, 18))))
def test_strokes_without_a_time_in_badminton_db(
    seed: int, nulls: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = badminton_db(seed, nulls)
    assert content.count('"StrokeBegin": null') == nulls
    (tmp_path / "m.json").write_text(content)
    assert data.main(["import", str(tmp_path / "m.json"), "--out", str(tmp_path / "o.parquet"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == told["kept"] + sum(told["dropped"].values()) == content.count("StrokeNum")
    strokes = read_matches(tmp_path / "o.parquet")
    assert 0 < int(strokes["clock"].null_count) <= nulls
    assert set(told["dropped"]) <= {"unknown shot type"}
    known = np.array(strokes["clock"].to_pylist(), dtype=float)
    assert known[~np.isnan(known)].max() > 60


def test_a_time_that_is_no_number_in_badminton_db_is_refused() -> None:
    assert "no point of BadmintonDB" in refusal(badminton_db(1, 2).replace('"StrokeBegin": null', '"StrokeBegin": "soon"', 1))
