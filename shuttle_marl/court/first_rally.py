"""The first rally of the match that the page shows by default, staged in advance.

A server whose compiled code is not cached needs half a minute before it can stage a rally; the page shows this one at once.
``python -m docs.tools.first_rally`` writes the file again, after a change of the game, of the agents or of the staging.
"""

import gzip
from pathlib import Path
from typing import Final

import msgspec

from shuttle_marl.base.files import content_hash
from shuttle_marl.court.messages import RallyReply
from shuttle_marl.court.plan import Plan
from shuttle_marl.court.stager import Stager
from shuttle_marl.game.pairs import looks_of
from shuttle_marl.game.tables import Game

FILE: Final = Path(__file__).with_name("first_rally.bin")


class FirstRally(msgspec.Struct, frozen=True):
    """A rally that is staged.

    Attributes:
        key: of what the rally depends on.
    """

    key: str
    reply: RallyReply
    motion: bytes


def first_key(game: Game, plan: Plan, stager: Stager) -> str:
    """Hash of the game, the plan of the match, and the appearance of the players."""
    first, second = plan.sides_in(0)
    looks = stager.looks(looks_of(game, (first.policy, second.policy)))
    return content_hash(msgspec.json.encode([game.hash, plan.key.decode(), looks.athletes, looks.hands]))


def shipped_rally(key: str) -> FirstRally | None:
    """The shipped rally; None: it is another one."""
    found = msgspec.msgpack.decode(gzip.decompress(FILE.read_bytes()), type=FirstRally)
    return found if found.key == key else None
