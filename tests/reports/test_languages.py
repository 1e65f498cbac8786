"""Every language has every text that is used, and no other; its words of badminton are those of the readers of files."""

import datetime
import re
from fnmatch import fnmatchcase
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

import shuttle_marl
from shuttle_marl.data.matches import event
from shuttle_marl.data.words import bare, table
from shuttle_marl.game.court import AREA_WORDS, AREAS
from shuttle_marl.game.shipped import Estimate, default_game
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.reports.languages import FOLDER, LANGUAGES, Language, speaking
from shuttle_marl.reports.pages import Drill, drills
from shuttle_marl.reports.waits import Place, Wait, differences
from shuttle_marl.reports.words import Words, of_100, signed

PACKAGE = Path(shuttle_marl.__file__).parent
SOURCES = (PACKAGE / "reports", PACKAGE / "commands" / "scout.py", PACKAGE / "court" / "page" / "src")
VOCABULARIES = {"shots": SHOTS, "areas": AREAS, "short_areas": AREAS, "techniques": TECHNIQUES, "heights": HEIGHTS}
REPORTS = ("brief", "areas", "directions", "whose", "scout", "drills", "habit", "match", "waits")
OTHERS: list[Language] = [language for language in LANGUAGES if language != "en"]


def texts(language: Language) -> dict[str, str]:
    """Texts by key; those of a shot type are one."""
    groups = Words(language).groups
    return {
        f"{group}.{name}": text if isinstance(text, str) else " / ".join(text)
        for group, members in groups.items()
        for name, text in members.items()
    }


def fields(text: str) -> set[str]:
    return {f"{name}:{form}" for _, name, form, _ in Formatter().parse(text) if name is not None}


def source(*parts: Path) -> str:
    files = [path for part in parts for path in ([part] if part.is_file() else part.rglob("*"))]
    return "\n".join(path.read_text(encoding="utf-8") for path in files if path.suffix in (".py", ".j2", ".ts"))


def test_each_file_is_a_language() -> None:
    assert {path.stem for path in FOLDER.glob("*.json")} == set(LANGUAGES)


@pytest.mark.parametrize("language", OTHERS)
def test_a_language_has_the_texts_and_the_fields_of_english(language: Language) -> None:
    english, other = texts("en"), texts(language)
    assert [*other] == [*english]
    assert {key: text for key, text in other.items() if not text.strip()} == {}
    differ = {
        key: (fields(text), fields(other[key]))
        for key, text in english.items()
        if key != "language.date" and fields(text) != fields(other[key])
    }
    assert differ == {}


def test_every_text_that_is_used_exists_and_every_text_is_used() -> None:
    code = source(*SOURCES)
    groups, keys = "|".join(Words("en").groups), texts("en").keys()
    # Keys as they are written, with a star for each part that is computed.
    found = re.findall(rf"""["'`]((?:{groups})\.(?:[\w -]|\$?\{{[^}}"]*\}})+)["'`]""", code)
    written = {re.sub(r"\$?\{[^}]*\}", "*", key) for key in found}
    whole = {key for key in written if "*" not in key and not key.endswith((".html", ".css", ".js"))}
    assert len(whole) > 150
    assert whole - keys == set()
    partial = [key for key in written if "*" in key]
    assert [key for key in partial if not any(fnmatchcase(name, key) for name in keys)] == []
    for group, vocabulary in VOCABULARIES.items():
        assert [*Words("en").groups[group]] == [*vocabulary]
    own = {key for key in keys if key.startswith("language.") or key.partition(".")[0] in {*VOCABULARIES, "players"}}
    # What is computed is a word of the code: its whole name, or the part that varies.
    words = set(re.findall(r"[\w?!]+", code + source(PACKAGE / "game")))
    patterns = [re.compile(re.escape(key).replace(r"\*", "(.+)")) for key in partial]
    told = {
        key
        for key in keys
        if any({*re.split("[ -]", " ".join(match.groups()))} <= words for each in patterns if (match := each.fullmatch(key)))
    }
    assert keys - whole - own - told == set()


@pytest.mark.parametrize("language", LANGUAGES)
def test_words_of_badminton_are_those_that_readers_know(language: Language) -> None:
    groups = Words(language).groups
    for kind, group in (("shot", "shots"), ("technique", "techniques")):
        known = table(kind)[language]
        for meaning, text in groups[group].items():
            word = text[0] if isinstance(text, list) else text
            assert known.get(bare(word)) == meaning, (word, meaning)


def test_areas_of_the_page_are_those_of_other_texts() -> None:
    assert tuple(Words("en").groups["short_areas"].values()) == AREA_WORDS


def test_numbers_and_dates() -> None:
    with speaking("id"):
        assert [of_100(0.1234, 1), signed(-0.012), signed(0.0001)] == ["12,3", "-1,2", "0,0"]
    assert "(1.234 pukulan)" in Words("id")("scout.fault_line", shots="x", share=1, usual=2, strokes=1234)
    assert (
        Words("en")("match.lengths_lead", mean=9.25, longest=1000) == "Rallies lasted 9.2 strokes on average, the longest 1000."
    )
    day = datetime.date(2021, 7, 3)
    assert [Words(language)("scout.today", date=day) for language in LANGUAGES] == [
        "skill as of 2021-07-03",
        "水平截至2021年7月3日",
        "kemampuan per 03/07/2021",
    ]
    assert of_100(0.1234, 1) == "12.3"


@pytest.mark.parametrize("language", LANGUAGES)
def test_reports_speak_of_forehand_and_backhand(language: Language) -> None:
    """Only the captions of drawings say what is left and right in them."""
    said = {key: text for key, text in texts(language).items() if key.partition(".")[0] in REPORTS}
    sides = re.compile(r"\b(left|(?<!is )right(?! in )|kiri|kanan)\b|[左右]", re.IGNORECASE)
    assert [key for key, text in said.items() if sides.search(re.sub(r"\{[^}]*\}", "", text))] == []


WIDE = Estimate(0.5, 0.375, 0.625)


def test_names_of_players_and_events() -> None:
    say = Words("en")
    assert [say.player(name) for name in ("viktor-axelsen", "club", "Ada-Bo", "a-1", "li-na")] == [
        *("Viktor Axelsen", "club", "Ada-Bo", "a-1", "Li Na")
    ]
    for name in ("Viktor_AXELSEN_Kento_MOMOTA_Open_2020_Final", "Open_2020_Kento_MOMOTA_Viktor_AXELSEN_Final"):
        assert event(name, ("viktor-axelsen", "kento-momota")) == "Open 2020 Final"
    assert (say.capital("a smash"), say.capital("")) == ("A smash", "")
    assert [say.shot("smash", form) for form in (0, 1, 2, 9)] == ["smash", "a smash", "smashes", "smashes"]


def test_drills_are_the_first_three_of_different_kinds() -> None:
    catalogue = default_game().catalogue
    clear, lift, drop, smash = (
        np.flatnonzero(catalogue.shot == SHOTS.index(name)) for name in ("clear", "lift", "drop", "smash")
    )
    asked = [clear[0], clear[1], lift[0], drop[0], drop[1], smash[0]]
    found = drills(catalogue, ((3, 1, int(stroke)) for stroke in asked))
    assert found == [Drill(SHOTS[3], 1, int(stroke)) for stroke in (clear[0], lift[0], drop[0])]
    assert drills(catalogue, [(-1, -1, 0)]) == [Drill(None, -1, 0)]
    assert drills(catalogue, []) == []


def test_a_difference_of_a_match_is_said_of_one_player() -> None:
    """That of the other one is the same; of two players of different matches both are said."""

    def wait(player: int, shot: str) -> Wait:
        depth, side = (Place(mean=each, difference=each, p=0.01, clear=True) for each in (Estimate(-0.25, -0.4, -0.125), WIDE))
        return Wait(player=player, shot=shot, strokes=50, others=60, positions=(1.0,) + 8 * (0.0,), depth=depth, side=side)

    found = [wait(0, "smash"), wait(1, "smash"), wait(1, "lift")]
    said = [(each.wait.player, each.wait.shot, each.kind, each.value) for each in differences(found, match=True)]
    assert said == [
        (0, "smash", "forehand", 0.5),
        (1, "lift", "forehand", 0.5),
        (0, "smash", "closer", 0.25),
        (1, "lift", "closer", 0.25),
    ]
    assert len(differences(found, match=False)) == 6
