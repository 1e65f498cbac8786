"""Makes the pages of the site on which rallies play: ``python -m docs.tools.live_pages``.

Each is a saved page of the live court, as ``shuttle_marl/court/page/src/share.ts`` writes it from the browser: script, style,
athletes, and the replies of the server, so it needs none. The match is the default one of the live court.
"""

import gzip
import html
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from docs.tools.markdown import ROOT
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.commands.watch import GAME, MatchOptions
from shuttle_marl.court.answers import Answers
from shuttle_marl.court.building import build
from shuttle_marl.court.match import PolicyTables
from shuttle_marl.court.messages import AnalysisRequest, HelloRequest, MatchRequest, RallyRequest, Request, StylesRequest
from shuttle_marl.court.plan import Plan
from shuttle_marl.court.staging import model_file
from shuttle_marl.court.staging.skeleton import ATHLETES
from shuttle_marl.game.shipped import load_game

FOLDER: Final = ROOT / "docs" / "site" / "extra" / "live"
"""Output folder, ignored by git."""
PAGES: Final = {"rally": (range(10, 11), 3), "match": (range(12), 1)}
"""Rallies and first stroke of each page, by its name. The motions of a page are exact, so a whole match would be large."""
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; media-src blob:; "
    "connect-src data: blob:; worker-src blob:; base-uri 'none'; form-action 'none'"
)
_LETTERS: Final = bytes(code for code in range(33, 127) if chr(code) not in '"\\<')
_WIDE: Final = 88
"""Values of 13 bits up to this one have room for a 14th."""


def base91(content: bytes) -> str:
    """basE91 in the alphabet of ``shuttle_marl/court/page/src/base91.ts``: 13 or 14 bits in two characters."""
    out, rest, bits = bytearray(), 0, 0
    for byte in content:
        rest |= byte << bits
        bits += 8
        if bits > 13:
            width = 14 if rest & 8191 <= _WIDE else 13
            value = rest & ((1 << width) - 1)
            rest >>= width
            bits -= width
            out += bytes((_LETTERS[value % 91], _LETTERS[value // 91]))
    if bits:
        out.append(_LETTERS[rest % 91])
        if bits > 7 or rest > 90:
            out.append(_LETTERS[rest // 91])
    return out.decode("ascii")


def saved_page(answers: Callable[[Request], bytes], plan: Plan, rallies: Iterable[int], stroke: int, built: Path) -> str:
    """HTML of a saved page.

    Args:
        answers: replies of the server, see :class:`shuttle_marl.court.answers.Answers`.
        plan: the match.
        rallies: numbers of the rallies that the page has.
        stroke: number of the stroke, from 1, of the first rally at which it opens.
        built: folder of the built page of the live court.
    """
    numbers = list(rallies)
    replies = {"styles": answers(StylesRequest(id=0, plan=plan, rally=numbers[0]))}
    for number in numbers:
        replies[f"rally {number}"] = answers(RallyRequest(id=0, plan=plan, rally=number))
        replies[f"analysis {number}"] = answers(AnalysisRequest(id=0, plan=plan, rally=number))
    if len(numbers) > 1:
        replies["match"] = answers(MatchRequest(id=0, plan=plan, rally=numbers[-1], partial=True))
    shared = {
        "hello": _packed(answers(HelloRequest(id=0))),
        "replies": {key: _packed(reply) for key, reply in replies.items()},
        "models": {name: _packed(model_file(name).read_bytes()) for name in ATHLETES},
    }
    address = f"#seed={plan.seed}&a={plan.sides[0].policy}&b={plan.sides[1].policy}&rally={numbers[0] + 1}&stroke={stroke}"
    title = html.escape(f"{plan.sides[0].policy} against {plan.sides[1].policy}")
    style = (built / "watch.css").read_text(encoding="utf-8").replace("</", "<\\/")
    script = (built / "watch.js").read_text(encoding="utf-8").replace("</script", "<\\/script").replace("<!--", "<\\!--")
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{title}</title>'
        f"<style>{style}</style></head><body>"
        f"<script>if (!location.hash) location.hash = {_safe(address)};</script>"
        f'<script type="application/json" id="shared">{_safe(shared)}</script>'
        f'<script type="module">{script}</script></body></html>'
    )


def _packed(reply: bytes) -> str:
    return base91(gzip.compress(reply, mtime=0))


def _safe(value: object) -> str:
    return json.dumps(value, ensure_ascii=False).replace("<", "\\u003c")


def main(*, out: Path = FOLDER) -> None:
    """Make the pages.

    Args:
        out: Folder for them.
    """
    built = build(lambda words: sys.stderr.write(f"{words}\n"))
    game = load_game(GAME)
    plan = MatchOptions().plan(game)
    answers = Answers(PolicyTables(game), plan)
    out.mkdir(parents=True, exist_ok=True)
    for name, (rallies, stroke) in PAGES.items():
        page = saved_page(answers, plan, rallies, stroke, built).encode()
        replace_file(out / f"{name}.html", page)
        sys.stdout.write(f"{out / name}.html: {len(page) / 1e6:.1f} MB\n")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.live_pages", description="Make the pages on which rallies play."))
