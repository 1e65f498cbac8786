// Records the court as a video in the browser.

const FORMATS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];
const RATE = 6_000_000; // [bit/s]

/** Video format that this browser supports, or null. */
export function filmFormat(): string | null {
  const able = typeof MediaRecorder !== "undefined" && "captureStream" in HTMLCanvasElement.prototype;
  return (able && FORMATS.find((format) => MediaRecorder.isTypeSupported(format))) || null;
}

export class Recorder {
  private running: MediaRecorder | null = null;

  constructor(private readonly done: (film: Blob, name: string) => void) {}

  get isRunning(): boolean {
    return this.running !== null;
  }

  start(canvas: HTMLCanvasElement, name: string): void {
    const parts: Blob[] = [];
    const recorder = new MediaRecorder(canvas.captureStream(50), { mimeType: filmFormat()!, videoBitsPerSecond: RATE });
    recorder.ondataavailable = ({ data }) => parts.push(data);
    recorder.onstop = () => {
      recorder.stream.getTracks().forEach((track) => track.stop());
      this.done(new Blob(parts, { type: "video/webm" }), name);
    };
    recorder.start();
    this.running = recorder;
  }

  /** Stops a running recording. */
  stop(): void {
    this.running?.stop();
    this.running = null;
  }
}
