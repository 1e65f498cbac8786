"""The players of the two data sets and their disciplines."""

from typing import Final

WOMEN: Final = frozenset(
    {
        "aakarshi-kashyap",
        "akane-yamaguchi",
        "an-se-young",
        "busanan-ongbamrungphan",
        "carolina-marin",
        "chen-yufei",
        "evgeniya-kosetskaya",
        "gregoria-mariska-tunjung",
        "he-bingjiao",
        "mia-blichfeldt",
        "michelle-li",
        "neslihan-yigit",
        "pornpawee-chochuwong",
        "pusarla-v-sindhu",
        "ratchanok-intanon",
        "supanida-katethong",
        "wang-zhi-yi",
    }
)
"""Identifiers of the players of women's singles."""

MEN: Final = frozenset(
    {
        "anders-antonsen",
        "anthony-sinisuka-ginting",
        "chen-long",
        "chico-aura-dwi-wardoyo",
        "chou-tien-chen",
        "hans-kristian-solberg-vittinghus",
        "jonatan-christie",
        "kenta-nishimoto",
        "kento-momota",
        "kidambi-srikanth",
        "kodai-naraoka",
        "kunlavut-vitidsarn",
        "lakshya-sen",
        "lee-cheuk-yiu",
        "lee-zii-jia",
        "li-shi-feng",
        "liew-daren",
        "loh-kean-yew",
        "lu-guang-zu",
        "ng-ka-long-angus",
        "prannoy-h-s",
        "rasmus-gemke",
        "sameer-verma",
        "shi-yuqi",
        "viktor-axelsen",
        "zhao-jun-peng",
    }
)
"""Identifiers of the players of men's singles."""


def player_id(name: str) -> str:
    """Identifier of a player as the data sets spell them: ``'CHEN Yufei'`` and ``'Chen Yufei'`` give ``chen-yufei``."""
    words = name.replace(".", " ").replace("-", " ").lower().split()
    return "-".join(words)


def discipline(player: str) -> str | None:
    """``MS``, ``WS``, or None for a player of neither list."""
    if player in WOMEN:
        return "WS"
    return "MS" if player in MEN else None
