"""The page on phones, tablets and laptops: nothing overflows, nothing covers what must be seen, and the keyboard is enough."""

from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from shuttle_marl.pages.languages import LANGUAGES, Language, Texts

pytestmark = pytest.mark.slow

SIZES = ((390, 664), (390, 844), (844, 390), (820, 1180), (1280, 720), (1366, 768), (1680, 980))
PLACE = "#seed=5&a=bc&b=minimax&rally=1&stroke=3"
OVERFLOWS = """() => {
  const out = [], width = document.documentElement.clientWidth;
  for (const element of document.querySelectorAll('body *')) {
    if (element.closest('.spoken, dialog, svg, select, option, .top .what, .top h1, .tip')) continue;
    const style = getComputedStyle(element), box = element.getBoundingClientRect();
    if (style.display === 'none' || style.visibility === 'hidden' || !box.width || !box.height) continue;
    const name = `${element.tagName}.${element.className} ${element.textContent.slice(0, 30)}`;
    if (box.right > width + 1 || box.left < -1) out.push(`outside the window: ${name}`);
    const clips = style.overflowX === 'hidden' || style.overflowX === 'clip';
    if (clips && element.clientWidth && element.scrollWidth > element.clientWidth + 1) out.push(`clipped: ${name}`);
  }
  return out;
}"""
Box = tuple[float, float, float, float]
"""Left, top, right, bottom [px]."""


def box(viewer: Any, selector: str) -> Box:
    found = viewer.page.locator(selector).first.bounding_box()
    return found["x"], found["y"], found["x"] + found["width"], found["y"] + found["height"]


def boxes(viewer: Any, selector: str) -> list[Box]:
    script = "(all) => all.map((e) => { const b = e.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]; })"
    return [tuple(found) for found in viewer.page.locator(selector).evaluate_all(script)]


def disjoint(a: Box, b: Box) -> bool:
    return a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 1 or b[3] <= a[1] + 1


def inside(a: Box, b: Box) -> bool:
    return a[0] >= b[0] - 1 and a[1] >= b[1] - 1 and a[2] <= b[2] + 1 and a[3] <= b[3] + 1


def sized(viewer: Any, sizes: Sequence[tuple[int, int]] = SIZES) -> Iterator[Box]:
    """Give the page each size in turn, and draw it."""
    for width, height in sizes:
        viewer.page.set_viewport_size({"width": width, "height": height})
        viewer.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        viewer.page.evaluate("scrollTo(0, 0); window.viewer.draw()")
        assert viewer.page.evaluate(OVERFLOWS) == [], (width, height)
        yield 0, 0, width, height


def enter(viewer: Any, mode: str) -> None:
    viewer.page.locator(f"#tab-{mode}").click()
    viewer.until(lambda: viewer.state("turn" if mode == "play" else "analysis") is not None)
    if mode == "learn":
        viewer.page.locator(".quiz button").first.wait_for()
    viewer.until(lambda: viewer.state("mode") == mode and not viewer.press(*" " * viewer.state("playing")).state("playing"))


def test_nothing_overflows_and_nothing_is_covered(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}{PLACE}").analysed()
    for window in sized(viewer):  # the stroke that is shown is in the view of its list, and its probabilities are on the court
        if window[2] <= 760:
            viewer.page.locator(".moves").scroll_into_view_if_needed()
        assert inside(box(viewer, ".moves [aria-current]"), box(viewer, ".moves")), window
        assert viewer.page.locator(".chip").inner_text().count("%") == 2
    enter(viewer, "learn")
    for window in sized(viewer):
        court = box(viewer, ".court")
        for answer in boxes(viewer, ".quiz button"):
            assert inside(answer, window), window
            assert disjoint(answer, court), window
    viewer.page.set_viewport_size({"width": 1280, "height": 720})
    enter(viewer, "play")
    for window in sized(viewer):
        court = box(viewer, ".court")
        covers = [box(viewer, ".bug"), box(viewer, ".cameras"), *boxes(viewer, ".targets button, .shots button, .hit")]
        assert len(covers) >= 2 + 9 + 1 + 1
        assert viewer.page.locator(".chip:visible, .speed:visible, .pop:visible").count() == 0
        assert inside(court, window), window
        for outline in viewer.state("outlines"):
            assert inside(outline, court), (window, outline, court)
            assert all(disjoint(outline, cover) for cover in covers), (window, outline)
        for i, cover in enumerate(covers):
            assert inside(cover, window), (window, cover)
            assert all(disjoint(cover, other) for other in covers[:i]), window
    viewer.press("w")
    for window in sized(viewer):
        words, bug = box(viewer, ".words"), box(viewer, ".bug")
        assert words[2] - words[0] <= 800, "one column"
        assert bug[3] <= words[1], "the score is above"
        assert all(words[3] <= side[1] for side in boxes(viewer, ".side")), window


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_mode_fits_in_every_language(viewer: Any, served: Any, language: Language) -> None:
    viewer.open(f"{served.address}?language={language}{PLACE}").analysed()
    say = Texts(language)
    assert viewer.page.locator("html").get_attribute("lang") == say("language.tag")
    for mode in ("watch", "analyse", "learn", "play"):
        if mode != "watch":  # the page begins with it
            enter(viewer, mode)
        for _ in sized(viewer, ((390, 844), (1280, 720))):
            assert "undefined" not in viewer.page.inner_text("body")
        assert viewer.page.locator(f"#tab-{mode}").inner_text() == say(f"mode.{mode}")


def test_the_language_is_chosen_in_the_page_and_kept(viewer: Any, served: Any) -> None:
    page = viewer.page
    page.goto(f"{served.address}{PLACE}")
    with page.expect_navigation():
        page.get_by_label("Language").select_option("id")
    page.get_by_role("tab", name=Texts("id")("mode.learn")).wait_for()
    assert page.evaluate("location.hash").startswith("#seed=5")
    page.goto(f"{served.address}{PLACE.replace('5', '6')}")  # an address without a language
    page.get_by_role("tab", name=Texts("id")("mode.learn")).wait_for()
    assert page.locator("html").get_attribute("lang") == "id"
