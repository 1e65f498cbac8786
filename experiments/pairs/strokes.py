"""Log-loss of faults, returns and contacts in unseen matches, with and without the players' offsets.

The **update** estimates the offsets again from the first game of each match: the prior is that of the fit, the players' posterior
of other matches and the nuisance effects of a match and its sides ("the form of the day"). It is judged on the later games.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, identity

from experiments.pairs.parts import Part
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.evaluate import difference_by_match, log_losses
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.mixed import MixedModel, posterior
from shuttle_marl.dynamics.models import judged, log_odds, sigmoid
from shuttle_marl.dynamics.skill import GROUP, VARIANCES, Predicted, deviations_in, shifts, slope_on_offset
from shuttle_marl.game.shipped import read_model_card
from shuttle_marl.game.skill import COMPONENTS, GROUPS, ROLES, Skill, load_skill


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Judged:
    """N strokes of one component in unseen matches.

    Attributes:
        label: ``[N]`` what happened.
        logit: ``[N]`` log-odds of the average game.
        shift: ``[N]`` offset of both players.
        updated: ``[N]`` the same after the first game of the match.
        known: ``[N]`` number of the two players with an offset.
        match: ``[N]`` match, by a number that no other has.
        later: ``[N]`` whether the stroke is of a later game than the first.
    """

    label: Bools
    logit: F64
    shift: F64
    updated: F64
    known: I64
    match: I64
    later: Bools


def components(parts: Sequence[Part]) -> dict[str, Any]:
    """Log-losses by component: of all strokes, by the number of players with an offset, and of the update."""
    out = {}
    for name in COMPONENTS:
        judged = [_judged(part, name, number) for number, part in enumerate(parts)]
        one = Judged(**{f.name: np.concatenate([getattr(j, f.name) for j in judged]) for f in dataclasses.fields(Judged)})
        everything = np.ones(len(one.label), dtype=np.bool_)
        out[name] = {
            **_compared(one, everything, one.shift),
            "offset": slope_on_offset(one.logit, one.shift, one.label, one.match),
            "both_seen": _compared(one, one.known == len(ROLES), one.shift),
            "one_unseen": _compared(one, one.known < len(ROLES), one.shift),
            "update": _compared(one, one.later, one.updated, one.shift),
        }
    return out


def predictions(models: FittedModels, rows: Rows, name: str) -> Predicted:
    """Strokes of a component with the predictions of the average player."""
    rows, label = judged(rows)[name]
    if name == "success":
        chance = models.fault_without_target(rows)
    else:
        chance = models.returned(rows.codes) if name == "return" else models.above(rows.codes)
    return Predicted(rows, label, log_odds(chance))


def _compared(one: Judged, which: Bools, shift: F64, than: F64 | None = None) -> dict[str, float]:
    """Log-loss without and with offsets, and the difference with its 95 % interval by match; NaN without strokes."""
    if not which.any():
        return dict.fromkeys(("rows", "average", "pair", "difference", "low", "high"), float("nan"))
    base = one.logit if than is None else one.logit + than
    losses = [log_losses(one.label[which], sigmoid(z[which])) for z in (base, one.logit + shift)]
    found = difference_by_match(losses[1], losses[0], one.match[which])
    return {
        "rows": int(which.sum()),
        "average": float(losses[0].mean()),
        "pair": float(losses[1].mean()),
        "difference": found["mean"],
        "low": found["low"],
        "high": found["high"],
    }


def _judged(part: Part, name: str, number: int) -> Judged:
    rows, first = part.unseen.strokes.rows, part.unseen.game == 1
    models, skill = FittedModels.load(part.folder), load_skill(part.folder)
    sd = deviations_in(read_model_card(part.folder))
    assert sd is not None
    opening, later = (predictions(models, rows.take(which), name) for which in (first, ~first))
    both = [(stage, shifts(skill, name, stage.rows)) for stage in (opening, later)]
    updated = [both[0][1], both[1][1] + _update(both[0], later.rows, skill, sd[COMPONENTS.index(name)], name)]
    names = np.array(skill.players)
    strokes = [stage.rows for stage, _ in both]
    return Judged(
        label=np.concatenate([stage.label for stage, _ in both]),
        logit=np.concatenate([stage.logit for stage, _ in both]),
        shift=np.concatenate([shift for _, shift in both]),
        updated=np.concatenate(updated),
        known=np.concatenate([sum(np.isin(getattr(r, role), names).astype(np.int64) for role in ROLES) for r in strokes]),
        match=np.concatenate([r.match.astype(np.int64) for r in strokes]) + number * len(rows.matches),
        later=np.repeat([False, True], [len(opening.label), len(later.label)]),
    )


def _update(opening: tuple[Predicted, F64], later: Rows, skill: Skill, sd: F64, name: str) -> F64:
    """``[N]`` change of the offsets of the strokes of later games by those of the first game of their match."""
    stage, shift = opening
    change = np.zeros(len(later))
    for match in np.unique(later.match):
        seen, judged = stage.rows.match == match, later.match == match
        players = np.unique(later.striker[judged]).tolist()
        if len(players) < len(ROLES):
            continue
        row, x = _effects(stage.rows.take(seen), players)
        model = MixedModel(
            x=x,
            row=row,
            offset=stage.logit[seen] + shift[seen],
            label=stage.label[seen],
            difference=csr_matrix(identity(x.shape[1])),
            component=np.zeros(x.shape[1], dtype=np.int64),
            scale=_prior_variances(players, later.matches[match], skill, sd, name),
        )
        found = posterior(model, np.ones(1))
        change[judged] = (x @ found.mode)[_effects(later.take(judged), players)[0]]
    return change


def _effects(rows: Rows, players: list[str]) -> tuple[I64, csr_matrix]:
    """Distinct row of each stroke, by striker and group, and ``[12, E]`` effects: 2 x 2 x 7 offsets, match, sides, groups."""
    groups = len(GROUPS)
    side, group = (index.ravel() for index in np.indices((2, groups)))
    offsets = 2 * len(ROLES) * (1 + groups)
    columns = [
        *(
            (player * len(ROLES) + role) * (1 + groups) + part
            for role, player in enumerate((side, 1 - side))
            for part in (0 * group, 1 + group)
        ),
        offsets + 0 * group,
        offsets + 1 + side,
        offsets + 3 + group,
    ]
    index = np.stack(columns, axis=1)
    x = csr_matrix(
        (np.ones(index.size), index.ravel(), np.arange(0, index.size + 1, len(columns))), shape=(len(side), offsets + 3 + groups)
    )
    return (rows.striker == players[1]) * groups + GROUP[rows.codes["shot"]].astype(np.int64), x


def _prior_variances(players: list[str], match: str, skill: Skill, sd: F64, name: str) -> F64:
    """``[E]`` prior variances of the effects of a match."""
    of = dict(zip(VARIANCES, sd**2, strict=True))
    groups = len(GROUPS)
    variances = []
    for player in players:
        for role, role_name in enumerate(ROLES):
            if player in skill.players:
                variances.append(skill.deviation[skill.knot(player, date_of(match)), COMPONENTS.index(name), role] ** 2)
            else:
                variances.append(np.r_[of[role_name], np.repeat(of[f"{role_name}_group"], groups)])
    return np.concatenate([*variances, [of["match"], of["side"], of["side"]], np.repeat(of["match_group"], groups)])
