// Texts of the page in the language of the viewer, from the catalogues that the reports use as well.

import en from "../../../reports/languages/en.json";
import id from "../../../reports/languages/id.json";
import zh from "../../../reports/languages/zh.json";

/** Texts of the page; the build leaves out those of the reports. */
type Catalogue = Omit<typeof en, "scout" | "match" | "drills" | "tactics" | "habit">;
type Language = keyof typeof CATALOGUES;
/** Key of a text, such as `page.score`. */
export type Key = { [Group in keyof Catalogue]: `${Group}.${string & keyof Catalogue[Group]}` }[keyof Catalogue];

const CATALOGUES = { en, id, zh } satisfies Record<string, Catalogue>;
const STORED = "shuttle_marl.language";

/** Language of the address, else the one chosen before, else that of the page, if it is not the default, or of the browser. */
export const language: Language =
  [
    new URLSearchParams(globalThis.location?.search).get("language"),
    stored(),
    globalThis.document?.documentElement.lang.slice(0, 2).replace("en", ""),
    ...(globalThis.navigator?.languages ?? []).map((name) => name.slice(0, 2)),
  ].find((name): name is Language => !!name && name in CATALOGUES) ?? "en";

const texts: Catalogue = CATALOGUES[language];
const NAMES: Record<string, string | string[]> = { ...texts.shots, ...texts.short_areas, ...texts.techniques };
const marks = new Map<number, Intl.NumberFormat>();

if (globalThis.document) {
  document.documentElement.lang = texts.language.tag;
}

function stored(): string | null {
  try {
    return localStorage.getItem(STORED);
  } catch {
    return null; // a browser that stores nothing
  }
}

/** Languages and their names. */
export const LANGUAGES = Object.entries(CATALOGUES).map(([name, { language }]) => [name, language.name] as const);

/** Opens the page again in a language, which the browser keeps. */
export function speak(name: string): void {
  try {
    localStorage.setItem(STORED, name);
  } catch {}
  const address = new URL(location.href);
  address.searchParams.set("language", name);
  history.replaceState(null, "", address);
  location.reload();
}

/** A text with its fields filled. */
export function say(key: Key, fields: Record<string, string | number> = {}): string {
  const [group, name] = key.split(/\.(.*)/, 2) as [string, string];
  const text = (texts as unknown as Record<string, Record<string, string>>)[group]![name]!;
  return text.replace(/\{(\w+)\}/g, (_, field: string) => String(fields[field]));
}

/** A shot type, an area or a technique: `cross-court-net-shot` → `cross-court net shot`. */
export function words(name: string): string {
  return [NAMES[name]!].flat()[0]!;
}

/** An area as the receiver sees it, in words, which name the side of the forehand. */
export function areaWords(name: string, receiver: string): string {
  const [depth, side] = name.split("-") as [string, string];
  const mirrored = receiver === "left" ? { right: "left", left: "right" }[side] : undefined;
  return words(`${depth}-${mirrored ?? side}`);
}

/** A number with so many decimals. */
export function decimal(value: number, digits: number): string {
  let format = marks.get(digits);
  if (!format) {
    format = new Intl.NumberFormat(texts.language.tag, { minimumFractionDigits: digits, maximumFractionDigits: digits });
    marks.set(digits, format);
  }
  return format.format(value);
}

/** A probability in percent with one decimal, so that close ones differ. */
export function points(p: number): string {
  return `${decimal(100 * p, 1)} %`;
}

/** Several texts with commas between them. */
export function listed(items: string[]): string {
  return items.join(texts.language.comma);
}
