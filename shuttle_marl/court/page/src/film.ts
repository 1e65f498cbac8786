// The film that is tagged: it goes on by itself, passes over what is not played, and has a bar of its rallies to seek in.

import { BEAT, nextPlay } from "./dead_time";
import { h, s } from "./dom";
import { decimal, say } from "./words";

const STEP = 1 / 30; // a step by frame [s]
const SCAN = 8; // speed at which the film is searched for motion
const SIZE = [96, 54] as const; // of the pictures that are compared
const ABOVE = 0.25; // players reach above the court by so much of the picture
const APART = 48; // labels of the bar that are closer are left out [px]

/** A rally of the film, from its first stroke to its last one [s]. */
export interface Span {
  from: number;
  to: number;
  label: string;
}

function clock(time: number): string {
  return `${Math.floor(time / 60)}:${decimal(time % 60, 1).padStart(4, "0")}`;
}

export class Film {
  readonly video = h("video", { src: "video", preload: "auto", playsinline: true, "aria-label": say("tag.video") });
  readonly bar: HTMLElement;
  private readonly time = h("output", {});
  private readonly slider = h("input", { type: "range", min: 0, step: 0.1, "aria-label": say("tag.bar") });
  private readonly marks = h("div", { class: "spans", "aria-hidden": "true" });
  private readonly curve = s("path", {});
  private motion: number[] = []; // of each beat, for what has been searched
  private spans: Span[] = [];
  private area: readonly [number, number, number, number] = [0, 0, 1, 1]; // part of the picture that is searched
  private scanned: HTMLVideoElement | null = null;
  private limit = Number.POSITIVE_INFINITY;
  private skippedFrom: number | null = null;

  /** `sought` is called when the person chooses another moment. */
  constructor(
    private readonly sought: () => void,
    private readonly tell: (text: string) => void,
  ) {
    const curve = s("svg", { viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" }, this.curve);
    this.bar = h("div", { class: "scrub" }, this.marks, curve, this.slider, this.time);
    this.video.addEventListener("timeupdate", () => this.passed());
    this.video.addEventListener("loadedmetadata", () => {
      this.video.playbackRate = 0.5;
      this.slider.max = String(this.video.duration);
      document.body.style.setProperty("--shape", String(this.video.videoWidth / this.video.videoHeight));
      this.draw();
    });
    this.slider.addEventListener("input", () => this.jump(Number(this.slider.value)));
    this.slider.addEventListener("pointerup", () => this.slider.blur()); // else it would keep the arrow keys
    new ResizeObserver(() => this.draw()).observe(this.bar);
  }

  get at(): number {
    return Math.round(1000 * this.video.currentTime) / 1000;
  }

  /** Goes on; stops by itself at a limit [s]. */
  go(limit = Number.POSITIVE_INFINITY): void {
    this.limit = limit;
    this.video.play().catch(() => {}); // a pause came first
  }

  toggle(): void {
    if (this.video.paused) {
      this.go();
    } else {
      this.video.pause();
    }
  }

  /** A frame forward or back. */
  step(by: number): void {
    this.jump(this.at + by * STEP);
  }

  /** Some seconds forward or back; the film plays on. */
  seek(by: number): void {
    this.limit = Number.POSITIVE_INFINITY;
    this.video.currentTime = Math.max(0, this.at + by);
  }

  /** Another moment, which the person looks at. */
  jump(time: number): void {
    this.video.pause();
    this.video.currentTime = Math.max(0, time);
    this.sought();
  }

  speed(by: number): void {
    this.video.playbackRate = Math.min(Math.max(this.video.playbackRate * by, 0.125), 4);
    this.passed();
  }

  /** Goes on to the next rally over time without play; `within`: only if play ends in so many seconds. */
  skip(within = Number.POSITIVE_INFINITY): void {
    const from = this.at;
    const to = nextPlay(this.motion, this.spans, from, within);
    if (to !== null) {
      this.skippedFrom = from;
      this.video.currentTime = to;
      this.tell(say("tag.skipped", { seconds: decimal(to - from, 0) }));
    }
    this.go();
  }

  /** Back to where time was skipped. */
  back(): void {
    if (this.skippedFrom !== null) {
      this.jump(this.skippedFrom);
      this.skippedFrom = null;
    }
  }

  /** Rallies so far; the part of the film that is ahead is searched for motion. */
  show(spans: Span[]): void {
    this.spans = spans;
    if (!this.scanned) {
      void this.scan();
    }
    this.draw();
  }

  /** Searches the court only, at corners as fractions of the picture: people move beside it as well. */
  crop(corners: readonly (readonly [number, number])[]): void {
    const [x, y] = [corners.map(([u]) => u), corners.map(([, v]) => v)];
    const [left, top] = [Math.max(0, Math.min(...x)), Math.max(0, Math.min(...y) - ABOVE)];
    const area = [left, top, Math.min(1, Math.max(...x)) - left, Math.min(1, Math.max(...y)) - top] as const;
    if (String(area) !== String(this.area)) {
      this.area = area;
      this.motion = [];
      void this.scan();
    }
  }

  /** Measures how much the picture changes, from the present moment on. */
  private async scan(): Promise<void> {
    this.scanned?.removeAttribute("src");
    const film = h("video", { src: "video", preload: "auto" });
    this.scanned = film;
    film.muted = true;
    film.currentTime = this.at;
    film.playbackRate = SCAN;
    const context = h("canvas", { width: SIZE[0], height: SIZE[1] }).getContext("2d", { willReadFrequently: true })!;
    const [left, top, width, height] = this.area;
    let before: Uint8ClampedArray | null = null;
    let beat = -1;
    const look = (_: number, { mediaTime }: VideoFrameCallbackMetadata) => {
      if (film !== this.scanned) {
        return; // another search has begun
      }
      film.requestVideoFrameCallback(look);
      const next = Math.floor(mediaTime / BEAT);
      if (next === beat) {
        return;
      }
      const [w, h] = [film.videoWidth, film.videoHeight];
      context.drawImage(film, left * w, top * h, width * w, height * h, 0, 0, ...SIZE);
      const { data } = context.getImageData(0, 0, ...SIZE);
      if (before) {
        const change = data.reduce((sum, value, at) => sum + Math.abs(value - before![at]!), 0) / data.length;
        for (let i = beat + 1; i <= next; i++) {
          this.motion[i] = change; // also of beats that the browser left out
        }
      }
      [before, beat] = [data, next];
      if (next % 20 === 0) {
        this.draw();
      }
    };
    film.requestVideoFrameCallback(look);
    film.addEventListener("ended", () => this.draw());
    await film.play().catch(() => {}); // nothing is skipped in a film that cannot be searched
  }

  private passed(): void {
    const { video, at, slider } = this;
    if (at >= this.limit && !video.paused) {
      video.pause();
    }
    const { label } = this.spans.find(({ from, to }) => from <= at && at <= to) ?? { label: say("tag.between") };
    this.time.textContent = say("tag.time", { time: clock(at), speed: video.playbackRate });
    slider.value = String(at);
    slider.setAttribute("aria-valuetext", say("tag.position", { time: clock(at), length: clock(video.duration || 0), label }));
  }

  private draw(): void {
    const { duration } = this.video;
    if (!duration) {
      return;
    }
    const width = this.bar.clientWidth;
    let free = 0;
    this.marks.replaceChildren(
      ...this.spans.map(({ from, to, label }) => {
        const left = (width * from) / duration;
        const text = left >= free ? label : "";
        free = text ? left + APART : free;
        return h("span", { style: `left:${(100 * from) / duration}%;width:${(100 * (to - from)) / duration}%` }, text);
      }),
    );
    const most = Math.max(...this.motion.filter(Number.isFinite), 1e-9);
    const points = this.motion.flatMap((value, i) => `${(i * BEAT) / duration},${1 - value / most}`);
    this.curve.setAttribute("d", points.length ? `M${points.join("L")}` : "");
    this.passed();
  }
}
