"""Files of other programs, and words of seven languages: read without a map, with what was inferred and lost."""

import json
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.commands.data import main
from shuttle_marl.data import DataError, Outcome, read_matches
from shuttle_marl.data.column_map import COLUMNS, WORDS
from shuttle_marl.data.inference import read_score, winners_by_score
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.readers.reading import spans_around
from shuttle_marl.data.schema import REASONS, Cleaned, violations
from shuttle_marl.data.words import LANGUAGES, Words, _file, bare, table
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import SHOTS

SAMPLES = Path(__file__).parent / "samples"
CLUB = "2031-01-1F-WS-Ada ALPHA (ABC)-Bea BETA (XYZ)-Club Open-1080p"
FILES = {
    "ShuttleSet": "Ada_ALPHA_Bea_BETA_Club_Open_2031.csv",
    "BadmintonDB JSON": f"{CLUB}.json",
    "BadmintonDB ELAN": f"{CLUB}.eaf",
    "ELAN": "club.eaf",
    "JSON of a video pipeline": "strokes.json",
    "Sportscode XML": "sportscode.xml",
    "CSV": "rallies.csv",
}


def read(name: str, columns: Path | None = None) -> Cleaned:
    return import_matches(SAMPLES / FILES[name], columns)


def words(strokes: pa.Table, name: str, of: Sequence[str]) -> list[str | None]:
    return [None if code is None else of[code] for code in strokes[name].to_pylist()]


@pytest.mark.parametrize("name", FILES)
def test_each_format_is_recognised_and_accounted_for(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # The content tells the format, not the name of the file.
    path = tmp_path / "file.bin"
    path.write_bytes((SAMPLES / FILES[name]).read_bytes())
    assert main(["import", str(path), "--out", str(tmp_path / "o.parquet"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["format"] == name
    assert told["rows"] == told["kept"] + sum(told["dropped"].values())
    assert told["kept"] >= 5
    assert told["inferred"]
    assert told["lost"] or name == "CSV"
    assert main(["validate", str(tmp_path / "o.parquet")]) == 0
    assert read_matches(tmp_path / "o.parquet").num_rows == told["kept"]
    capsys.readouterr()
    assert main(["import", str(path)]) == 0
    text = capsys.readouterr().out
    assert all(f"not in the file: {sentence}" in text for sentence in told["lost"])


def test_badminton_db_is_the_same_as_json_and_elan(tmp_path: Path) -> None:
    strokes, elan = read("BadmintonDB JSON").strokes, read("BadmintonDB ELAN").strokes
    assert strokes.equals(elan.set_column(0, strokes.schema.field("match"), strokes["match"]))
    assert set(strokes["player"].to_pylist()) == {"ada-alpha", "bea-beta"}
    assert set(strokes["discipline"].to_pylist()) == {"WS"}
    first = strokes.slice(0, 5)  # its sixth stroke was a fault of unknown type
    assert words(first, "shot", SHOTS) == ["short-serve", "lift", "smash", "block", "net-shot"]
    assert first["technique"].to_pylist() == [0, 0, 0, 1, 1]
    assert words(first, "area", AREAS) == ["front-right", "back-centre", "middle-left", "front-left", None]
    assert first["confidence"].to_pylist() == pytest.approx([0.48, 0.28, 0.57, 0.41, None])
    assert first["inferred"].to_pylist() == ["shot area", "height area", "height area", "height area", "height"]
    assert first["player"].to_pylist()[0] == "bea-beta"
    assert (first["points"][0].as_py(), first["points_opponent"][0].as_py()) == (1, 0)
    ends = [row for row in strokes.to_pylist() if row["outcome"] != Outcome.RETURNED]
    assert [REASONS[row["reason"]] for row in ends] == ["landed", "misjudged", "out", "out"]
    assert sorted(set(strokes["game"].to_pylist())) == [1, 2]
    told = json.loads((SAMPLES / FILES["BadmintonDB JSON"]).read_text())
    told["Point2"]["PointInfo"]["WonEnd"]["Cause"] = "end_lucky"
    told["Point3"]["PointInfo"]["WonEnd"]["Cause"] = "end_out"  # the score says that its striker won
    told["Point1"]["PointInfo"]["Rally"][1] |= {"Player": None, "StrokeType": None}
    path = tmp_path / f"{CLUB}.json"
    path.write_text(json.dumps(told))
    cleaned = import_matches(path)
    ends = [row for row in cleaned.strokes.to_pylist() if row["outcome"] != Outcome.RETURNED]
    assert [REASONS[row["reason"]] for row in ends] == ["landed", "unknown", "out", "out"]
    assert [row["outcome"] for row in ends[:2]] == [Outcome.WINNER] * 2
    assert cleaned.account.dropped == {"unknown shot type": 2}


def test_a_pipeline_misses_strokes_and_knows_no_endings(tmp_path: Path) -> None:
    strokes = read("JSON of a video pipeline").strokes
    rallies = [(row["rally"], row["stroke"]) for row in strokes.to_pylist()]
    # The reply to the second serve is missing, and its number.
    assert rallies == [(1, 1), (1, 2), (1, 3), (1, 4), (1, 5), (2, 1), (2, 3), (3, 1), (3, 2), (3, 3), (3, 4)]
    assert words(strokes, "shot", SHOTS)[:5] == ["short-serve", "lift", "smash", "block", "net-shot"]
    assert strokes["outcome"].to_pylist()[4] == Outcome.FAULT  # bottom serves next
    assert strokes["outcome"].to_pylist()[-1] == Outcome.UNKNOWN
    confidence = strokes["confidence"].to_pylist()
    assert confidence[0] == pytest.approx(0.95 * 0.30)  # of the program, times that of the area where a lift is met
    assert confidence[4] == pytest.approx(0.83)
    assert strokes["frame"].to_pylist()[:2] == [300, 327]
    assert strokes["clock"].to_pylist()[0] == 10
    (tmp_path / "map.toml").write_text('discipline = "WS"\n[values.player]\ntop = "Ada"\nbottom = "Bea"\n')
    named = read("JSON of a video pipeline", tmp_path / "map.toml").strokes
    assert set(named["player"].to_pylist()) == {"ada", "bea"}
    assert set(named["discipline"].to_pylist()) == {"WS"}


def test_a_pipeline_with_rallies_names_and_results(tmp_path: Path) -> None:
    rally = {
        "result": "unforced error", "score": "0-1",
        "shots": [{"frame": 30, "stroke_type": "top_short service"}, {"frame": 60, "stroke_type": "bottom_lob"},
                  {"frame": 95, "stroke_type": "top_smash"}],
    }  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps({"fps": 25, "players": {"top": "Ada", "bottom": "Bea"}, "rallies": [rally]}))
    cleaned = import_matches(tmp_path / "a.json")
    strokes = cleaned.strokes
    assert strokes["player"].to_pylist() == ["ada", "bea", "ada"]
    assert strokes["outcome"].to_pylist() == [0, 0, Outcome.FAULT]
    assert strokes["forced"].to_pylist() == [None, None, False]
    assert strokes["points"].to_pylist() == [0, 1, 0]
    assert cleaned.provenance["lost"] == ["hand unknown, played as right-handed: ada, bea (2 of 2 players)"]


def test_sportscode_and_elan_by_the_words_of_their_labels_and_tiers() -> None:
    strokes = read("Sportscode XML").strokes
    assert words(strokes, "shot", SHOTS) == ["short-serve", "lift", "smash", "long-serve", "clear", "drop"]
    assert words(strokes, "area", AREAS)[1:3] == ["back-left", "middle-right"]
    assert strokes["technique"].to_pylist()[0] == 1
    assert strokes["rally"].to_pylist() == [1, 1, 1, 2, 2, 2]
    assert strokes["forced"].to_pylist()[-1] is False
    assert strokes["clock"].to_pylist() == [9, 10, 11, 29, 30, 31]
    danish = read("ELAN").strokes
    assert words(danish, "shot", SHOTS) == ["short-serve", "lift", "smash", "long-serve", "drop", "net-shot"]
    assert words(danish, "reason", REASONS)[2::3] == ["landed", "net"]


TIMES = st.integers(0, 12)


@given(spans=st.lists(st.tuples(TIMES, TIMES), max_size=12), moments=st.lists(TIMES, max_size=12))
def test_a_stroke_lies_in_the_last_interval_around_it(spans: list[tuple[int, int]], moments: list[int]) -> None:
    spans.sort()
    expected = [max((i for i, (a, b) in enumerate(spans, 1) if a <= moment <= b), default=0) for moment in moments]
    assert spans_around(spans, moments) == expected


XML = '<?xml version="1.0"?>{doctype}<file><ALL_INSTANCES>{inside}</ALL_INSTANCES></file>'
STROKE = '{"frame": 1, "player": "top", "stroke_type": "smash"}'


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (XML.format(doctype='<!DOCTYPE f [<!ENTITY a "x">]>', inside="&a;"), "document type declaration"),
        (XML.format(doctype='<!DOCTYPE f SYSTEM "file:///etc/passwd">', inside=""), "document type declaration"),
        (XML.format(doctype="", inside="<a>" * 100 + "</a>" * 100), "too deep"),
        (XML.format(doctype="", inside="<instance><start>x</start><code>smash</code></instance>"), "expected seconds"),
        (XML.format(doctype="", inside="<instance><start>1</start><end>2</end><code>goal</code></instance>"), "no strokes"),
        ("<a><b></a>", "no readable XML"),
        ("<html></html>", "expected annotations of ELAN, or instances of Sportscode"),
        ("<ANNOTATION_DOCUMENT></ANNOTATION_DOCUMENT>", "tiers none; expected Strokes, and Points or Player"),
        ("[" * 100_000, "no readable JSON"),
        ('{"a": NaN}', "no readable JSON"),
        ('[{"shot": "smash", "player": "a", "player": "b"}]', "no readable JSON .the entry 'player' stands there twice"),
        ("{" + ",".join(f'"{i}":1' for i in range(200_000)) + ',"0":2}', "the entry '0' stands there twice"),
        ('{"a": [1, 2]}', "JSON without strokes"),
        ('{"Point1": {"PointInfo": {"T1P1": 3}}}', "Point1: no point of BadmintonDB"),
        ('{"Point1": {"PointInfo": {"T1P1": {"Point": 1e999}, "T2P1": {}}}}', "Point1: no point of BadmintonDB"),
        (f"[{STROKE.replace('1', '9' * 900, 1)}]", "has 1 players .top."),
        (f"[{STROKE.replace('1', chr(34) + chr(0xB2) + chr(34), 1)}]", "has 1 players .top."),
        (f"[{STROKE.replace('smash', 'x' * 5000)}]", "more than 1,000 characters in stroke 1"),
        (f"[{STROKE.replace('smash', 'somersault')}]", "stroke 1: unknown shot 'somersault'"),
        (f"[{STROKE.replace('top', chr(92) + 'u0007')}]", "expected a name"),
        ("PK\x03\x04", "save the sheet as CSV"),
    ],
)
def test_hostile_and_foreign_files(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / "f").write_text(content)
    with pytest.raises(DataError, match=says):
        import_matches(tmp_path / "f")


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("BadmintonDB JSON", '"StrokeNum": 2', '"StrokeNum": 7', "stroke 2: StrokeNum 7 of stroke 2 of its point"),
        ("BadmintonDB JSON", '"receiver"', '"server"', "stroke 1: T2P1 serves, and T1P1 is a 'server'"),
        ("BadmintonDB JSON", '"end_fault"', '"end_tea"', "cause 'end_tea' is unknown, or contradicts who won by the score"),
        ("BadmintonDB JSON", '"end_fault"', '"end_lucky"', "cause 'end_lucky' is unknown, or contradicts who won by the score"),
        ("BadmintonDB JSON", '"Player": "T1P1"', '"Player": "T3P1"', "stroke 2: player 'T3P1'; expected T1P1 or T2P1"),
        ("ShuttleSet", "3000,1,1,A", "3000,5,1,A", "line 5: the score is not that of the last stroke of its rally"),
        ("ShuttleSet", "2100,1,0,A,1", "2100,1,0,A,2", "line 2: server '2'; expected 1 for the first stroke"),
        ("ShuttleSet", "挑球,,,2,7", "挑球,,,2,8", "line 3: hit_area is not the landing_area of the stroke before"),
        ("Sportscode XML", "<group>Hand</group>", "<group>Shot</group>", "line 10: shot 'BH' beside 'Low serve'"),
        ("ELAN", 'TIER_ID="Kommentar"', 'TIER_ID="Player"', "another one of the same meaning: 'Player'"),
        (
            "CSV",
            "1-0\n1;Bea;lob;rear left;;",
            "0-1\n1;Bea;lob;rear left;;1-0",
            "line 3: the score is not that of the last stroke of its rally",
        ),
        ("JSON of a video pipeline", '"bottom"', '"top"', "a player strikes twice in a row: 3 times"),
        ("CSV", "shot;zone", "shot;stroke type", "columns that the map does not name are not read: 'stroke type'"),
    ],
)
def test_what_a_file_says_twice_is_compared(tmp_path: Path, name: str, old: str, new: str, says: str) -> None:
    content = (SAMPLES / FILES[name]).read_text()
    assert old in content
    for text, expected in ((content, False), (content.replace(old, new, 1), True)):
        (tmp_path / FILES[name]).write_text(text)
        found = import_matches(tmp_path / FILES[name])
        assert (
            any(says in sentence for sentence in (*found.warnings, *found.provenance["lost"], *found.provenance["inferred"]))
            == expected
        )


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(FILES)), st.integers(0, 20_000), st.binary(max_size=3), st.booleans())
def test_damage_is_told_or_accounted_for(name: str, at: int, junk: bytes, cut: bool) -> None:
    content = (SAMPLES / FILES[name]).read_bytes()
    at %= len(content)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "f"
        path.write_bytes(content[:at] + junk + (b"" if cut else content[at + len(junk) :]))
        error, cleaned = None, None
        try:
            cleaned = import_matches(path)
        except DataError as caught:
            error = caught
        if error is not None:
            assert str(path) in str(error)
            return
    account = cleaned.account
    assert account.strokes == account.strokes_kept + sum(account.dropped.values())
    assert account.strokes_kept == cleaned.strokes.num_rows
    assert list(violations(cleaned.strokes)) == []


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.integers(0, 1), min_size=3, max_size=12).filter(lambda won: len(set(won)) == 2),
    st.integers(0, 2),
    st.booleans(),
    st.integers(0, 1),
)
def test_scores_are_read_in_any_convention(won: list[int], order: int, before: bool, server: int) -> None:
    points, scores, servers, after = [0, 0], [], [], []
    for winner in won:
        start = tuple(points)
        points[winner] += 1
        shown = start if before else tuple(points)
        first = (0, 1, server)[order]
        scores.append((shown[first], shown[1 - first]))
        servers.append(server)
        after.append(tuple(points))
        server = winner
    told = [*won[:-1], won[-1]]
    fresh, zero = np.arange(len(won)) == 0, np.zeros(len(won), np.int64)
    found, winners, reading = winners_by_score(scores, fresh, np.array(servers), np.array(told), zero, zero)
    assert found == after, reading
    assert winners.tolist() == ([*won[:-1], -1] if before else won)
    assert read_score("5\u20133") == read_score(" 5 : 3 ") == (5, 3)
    assert read_score("05-Mar") is None


RALLIES = {
    "en": """Rally,Player,Shot,Area,Hand,Result,Score
        1,Ada,low serve,front centre,bh,,
        1,Bea,net lift,rear left,fh,,
        1,Ada,jump smash,mid right,fh,winner,1-0
        2,Ada,flick serve,back right,bh,,
        2,Bea,drop shot,front left,fh,,
        2,Ada,net shot,,fh,unforced error,1-1""",
    "zh": """回合,球员,球种,落点,正反手,结果,比分
        1,张三,发小球,前场中路,反手,,
        1,李四,挑球,后场左侧,正手,,
        1,张三,杀球,中场右侧,正手,得分,1-0
        2,张三,发高远球,右后,反手,,
        2,李四,吊球,左前,正手,,
        2,张三,搓球,,正手,非受迫性失误,1-1""",
    "ja": """ラリー,選手,ショット,エリア,フォアバック,結果,スコア
        1,佐藤,ショートサーブ,前 センター,バック,,
        1,鈴木,ロブ,左奥,フォア,,
        1,佐藤,ジャンピングスマッシュ,右中,フォア,得点,1-0
        2,佐藤,ロングサービス,右後ろ,バックハンド,,
        2,鈴木,カット,左前,フォアハンド,,
        2,佐藤,ヘアピン,,フォア,アンフォーストエラー,1-1""",
    "ko": """랠리,선수,샷,구역,포백,결과,점수
        1,김,숏 서비스,앞 가운데,백핸드,,
        1,이,언더클리어,뒤 왼쪽,포핸드,,
        1,김,점프 스매싱,중간 오른쪽,포핸드,득점,1-0
        2,김,롱서브,오른쪽 뒤,백핸드,,
        2,이,드롭,왼쪽 앞,포핸드,,
        2,김,헤어핀,,포핸드,자범실,1-1""",
    "id": """Reli,Pemain,Jenis Pukulan,Daerah,Tangan,Hasil,Skor
        1,Ani,servis pendek,depan tengah,backhand,,
        1,Budi,lob bawah,belakang kiri,forehand,,
        1,Ani,smes,tengah kanan,forehand,poin,1-0
        2,Ani,servis panjang,kanan belakang,backhand,,
        2,Budi,dropshot,kiri depan,forehand,,
        2,Ani,netting,,forehand,mati sendiri,1-1""",
    "da": """Duel,Spiller,Slag,Felt,Hånd,Resultat,Stilling
        1,Åse,kort serv,for midt,baghånd,,
        1,Bo,lob,bag venstre,forhånd,,
        1,Åse,hopsmash,midt højre,forhånd,vinderslag,1-0
        2,Åse,svipserv,højre bag,baghånd,,
        2,Bo,drop,venstre for,forhånd,,
        2,Åse,netdrop,,forhånd,uprovokeret fejl,1-1""",
    "hi": """रैली,खिलाड़ी,शॉट,क्षेत्र,हाथ,परिणाम,स्कोर
        1,आशा,शॉर्ट सर्व,आगे बीच,बैकहैंड,,
        1,बीना,लिफ्ट,पीछे बाएं,फोरहैंड,,
        1,आशा,जंप स्मैश,मध्य दाएं,फोरहैंड,विनर,1-0
        2,आशा,हाई सर्व,दाएं पीछे,बैकहैंड,,
        2,बीना,ड्रॉप,बाएं आगे,फोरहैंड,,
        2,आशा,नेट शॉट,,फोरहैंड,अनफोर्स्ड एरर,1-1""",
}


def rows_of(folder: Path, text: str, delimiter: str = ",") -> list[dict[str, Any]]:
    (folder / "rallies.csv").write_text("\n".join(line.strip() for line in text.splitlines()).replace(",", delimiter))
    return import_matches(folder / "rallies.csv").strokes.to_pylist()


@pytest.mark.parametrize(("language", "delimiter"), list(zip(LANGUAGES, ",;,;,;,", strict=True)))
def test_two_rallies_in_each_language_need_no_map(tmp_path: Path, language: str, delimiter: str) -> None:
    rows = rows_of(tmp_path, RALLIES[language], delimiter)
    assert [SHOTS[row["shot"]] for row in rows] == ["short-serve", "lift", "smash", "long-serve", "drop", "net-shot"]
    areas = ["front-centre", "back-left", "middle-right", "back-right", "front-left"]
    assert [AREAS[row["area"]] for row in rows[:5]] == areas
    assert [row["technique"] for row in rows] == [1, 0, 0, 1, 0, 0]
    assert [row["outcome"] for row in rows[2::3]] == [Outcome.WINNER, Outcome.FAULT]
    assert [REASONS[row["reason"]] for row in rows[2::3]] == ["landed", "unknown"]
    assert [row["forced"] for row in rows] == [None] * 5 + [False]
    assert [(row["points"], row["points_opponent"]) for row in rows[2::3]] == [(1, 0), (1, 1)]
    assert {row["match"] for row in rows} == {"rallies"}
    assert len({row["player"] for row in rows}) == 2


def test_a_lob_is_a_lift_in_english_and_a_clear_in_indonesian(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, RALLIES["id"].replace("lob bawah", "lob").replace("smes", "lob"))
    assert [SHOTS[row["shot"]] for row in rows[1:3]] == ["clear", "clear"]
    rows = rows_of(tmp_path, RALLIES["en"].replace("net lift", "lob"))
    assert SHOTS[rows[1]["shot"]] == "lift"


@pytest.mark.parametrize(
    ("word", "meaning"),
    [("low serv", "short-serve"), ("lng serve", "long-serve"), ("stick smsh", "half-smash"), ("hairpn", "net-shot"),
     ("スマッシ", "smash"), ("net lft", "lift")],
)  # fmt: skip
def test_a_misspelt_word_means_one_of_its_own_kind(tmp_path: Path, word: str, meaning: str) -> None:
    assert Words("shot", ()).meant(word) == meaning
    place = "low serve" if meaning.endswith("serve") else "net shot"
    with pytest.raises(DataError, match=f"unknown Shot '{word}'; did you mean {meaning}"):
        rows_of(tmp_path, RALLIES["en"].replace(place, word))


def test_the_table_has_every_meaning_in_every_language_once() -> None:
    everything = _file()
    for kind in ("shot", "height", "technique", "ending", "forced", "discipline", "side", "depth", "side_of_area"):
        for meaning, words in everything[kind].items():
            assert set(words) == set(LANGUAGES), (kind, meaning)
            assert all(words.values())
    for kind in ("column", *WORDS):
        known = COLUMNS if kind == "column" else WORDS[kind]
        assert set(everything[kind]) <= set(known)
        for language, meant in table(kind).items():
            assert set(meant.values()) <= set(known), (kind, language)
    for kind in {*WORDS, "column"} - {"area"}:
        meanings: dict[tuple[str, str], set[str]] = defaultdict(set)
        for meaning, words in everything[kind].items():
            for language, spellings in words.items():
                for spelling in spellings:
                    meanings[language, bare(spelling)].add(meaning)
        assert {word: found for word, found in meanings.items() if len(found) > 1} == {}, kind
    areas: dict[tuple[str, str], set[str]] = defaultdict(set)
    for depth, of_depth in everything["depth"].items():
        for side, of_side in everything["side_of_area"].items():
            for language in LANGUAGES:
                for a in of_depth[language]:
                    for b in of_side[language]:
                        areas[language, bare(a + b)].add(f"{depth}-{side}")
                        areas[language, bare(b + a)].add(f"{depth}-{side}")
    assert {word: found for word, found in areas.items() if len(found) > 1} == {}


@pytest.mark.parametrize(
    ("score", "first"),
    [("1:0|1:1", "1st"), ("0-1|1-1", "other"), ("0-0|1-0", "before"), ("1\u20130|1\u20131", "dash")],
)
def test_scores_in_one_column(tmp_path: Path, score: str, first: str) -> None:
    one, two = score.split("|")
    rows = rows_of(tmp_path, RALLIES["en"].replace("1-0", one).replace("1-1", two))
    assert [(row["points"], row["points_opponent"]) for row in rows[2::3]] == [(1, 0), (1, 1)], first
    with pytest.raises(DataError, match="did a spreadsheet make it a date"):
        rows_of(tmp_path, RALLIES["en"].replace("1-0", "01-Jan"))


def test_the_score_or_who_serves_next_tells_who_won(tmp_path: Path) -> None:
    plain = RALLIES["en"].replace("winner", "").replace("unforced error", "")
    rows = rows_of(tmp_path, plain.replace("Result", "note"))
    assert [row["outcome"] for row in rows[2::3]] == [Outcome.WINNER, Outcome.FAULT]
    nothing = plain.replace("Result", "note").replace("Score", "more").replace("1-0", "").replace("1-1", "")
    rows = rows_of(tmp_path, nothing)
    assert [row["outcome"] for row in rows[2::3]] == [Outcome.WINNER, Outcome.UNKNOWN]
    assert rows[2]["inferred"].split() == ["height", "outcome"]


def test_rallies_begin_with_a_serve(tmp_path: Path) -> None:
    text = "\n".join(line.strip().partition(",")[2] for line in RALLIES["en"].splitlines())
    rows = rows_of(tmp_path, text)
    assert [(row["rally"], row["stroke"]) for row in rows] == [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)]
    bare_serves = rows_of(tmp_path, text.replace("low serve", "serve").replace("flick serve", "Serve"))
    assert [SHOTS[row["shot"]] for row in bare_serves[::3]] == ["short-serve", "long-serve"]
