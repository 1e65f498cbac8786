"""The words of seven languages: two rallies written by hand need no map."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.data import DataError, Outcome
from shuttle_marl.data.column_map import COLUMNS, WORDS
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import REASONS
from shuttle_marl.data.words import LANGUAGES, Words, _file, bare, table
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import SHOTS

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
    return import_matches(folder / "rallies.csv")[0].strokes.to_pylist()


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


def test_what_could_mean_two_things_is_not_suggested() -> None:
    words = Words("shot", ())
    assert words.meant("serv short long") is None
    assert words.meant("xyzzy") is None
    assert Words("ending", ()).meant("forced eror") == "forced-error"


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
