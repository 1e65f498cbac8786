// State of the page for tests and scripts.

import type { Player } from "./player";
import type { Shown } from "./rallies";
import type { Screen } from "./screen";
import type { Stage } from "./stage";
import type { Timeline } from "./timeline";

export function state(
  shown: Shown | null,
  course: Timeline,
  player: Player,
  screen: Screen,
  stage: Stage | null,
  times: object,
): Record<string, unknown> {
  const rally = shown?.rally ?? null;
  return {
    ready: rally !== null,
    mode: screen.mode,
    rally: course.number,
    names: rally?.names,
    points: rally?.points,
    games: rally?.games,
    after: rally?.after,
    server: rally?.server,
    from_right: rally?.from_right,
    ends_changed: rally?.ends_changed,
    before: rally?.before,
    winner: rally?.winner,
    strokes: rally?.strokes.map((stroke) => stroke.stroke),
    contacts: rally?.strokes.map((stroke) => stroke.time),
    strikers: rally?.strokes.map((stroke) => stroke.seat),
    stroke: player.stroke,
    time: player.time,
    duration: player.duration,
    playing: player.playing,
    speed: player.speed,
    turn: screen.board.turn,
    selected: screen.board.selected ?? null,
    position: screen.board.position,
    waited: rally?.strokes.map((stroke) => stroke.waited),
    person: course.person,
    friend: course.friend?.now ?? null,
    asked: screen.learn.current,
    camera: stage?.camera,
    shot: stage?.shot,
    flipped: stage?.flipped,
    lite: stage?.lite,
    target: stage?.targetArea ?? null,
    shuttle: shown ? shown.motion.shuttleAt(player.time, [0, 0, 0]) : null,
    hips: shown ? [0, 1].map((seat) => shown.motion.hipsAt(player.time, seat, [0, 0, 0])) : null,
    rackets: [stage?.sweetSpot(0) ?? null, stage?.sweetSpot(1) ?? null],
    match: screen.match.shown,
    outlines: [stage?.outline(0) ?? null, stage?.outline(1) ?? null],
    analysis: screen.analysis,
    plan: course.plan,
    link: course.link(player.stroke),
    figures: stage?.figures,
    ...times,
  };
}
