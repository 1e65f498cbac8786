// Dead time of a film: the picture changes less than in the known rallies.

export const BEAT = 0.25; // time between pictures that are compared [s]
const STILL = 0.5; // between the least motion and the usual one in rallies
const LEAST = 0.1; // share of the film that moves less than the least motion: a camera has noise
const AROUND = 5; // beats before and after, of which motion is the median: cuts of the film are no play
const PLAYS = 4; // beats that play lasts at least: a rally may be a serve and its return
const RESTS = 6; // beats that the absence of play lasts at least
const LEAD = 2.5; // shown before play begins [s]
const SETTLES = 0.5; // from the last stroke until players slow down [s]
const WORTH = 2; // shortest time that is skipped [s]

/** Time at which play begins again after it stops, or null: not within what is known of the motion, or not worth a jump.
 *
 * `motion` has the mean change of the picture in each beat, undefined where it is not known; `rallies` are known ones. Play that
 * stops later than `within` seconds after `from` is another rally, which is not skipped.
 */
export function nextPlay(
  motion: readonly (number | undefined)[],
  rallies: readonly { from: number; to: number }[],
  from: number,
  within: number,
): number | null {
  const beats = (from: number, to: number) => motion.slice(Math.ceil(from / BEAT), Math.floor(to / BEAT));
  const usual = quantile(
    rallies.flatMap(({ from, to }) => beats(from, to)),
    0.5,
  );
  const least = quantile(motion, LEAST);
  if (usual === undefined || least === undefined) {
    return null;
  }
  const level = least + STILL * (usual - least);
  const plays = motion.map((_, i) => quantile(motion.slice(Math.max(0, i - AROUND), i + AROUND + 1), 0.5)! > level);
  const first = Math.ceil((from + SETTLES) / BEAT);
  const stops = begins(plays, false, first);
  if (stops === null || stops * BEAT > from + within) {
    return null;
  }
  const again = begins(plays, true, stops);
  const to = again === null ? null : again * BEAT - LEAD;
  return to !== null && to - from >= WORTH ? to : null;
}

/** First beat at which a state lasts. */
function begins(plays: readonly boolean[], state: boolean, from: number): number | null {
  for (let i = from, lasts = 0; i < plays.length; i++) {
    lasts = plays[i] === state ? lasts + 1 : 0;
    if (lasts === (state ? PLAYS : RESTS)) {
      return i - lasts + 1;
    }
  }
  return null;
}

function quantile(values: readonly (number | undefined)[], share: number): number | undefined {
  const known = values.filter((value): value is number => value !== undefined).sort((a, b) => a - b);
  return known[Math.floor(known.length * share)];
}
