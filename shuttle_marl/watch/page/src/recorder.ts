// Films the court while it plays, in the browser itself.

const FORMATS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];
const RATE = 6_000_000; // bits a second

/** The kind of video that this browser can make, null if it makes none. */
export function filmFormat(): string | null {
  const able = typeof MediaRecorder !== "undefined" && "captureStream" in HTMLCanvasElement.prototype;
  return (able && FORMATS.find((format) => MediaRecorder.isTypeSupported(format))) || null;
}

export class Recorder {
  private running: MediaRecorder | null = null;

  constructor(private readonly done: (film: Blob, name: string) => void) {}

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

  /** Ends the film, if there is one. */
  stop(): void {
    this.running?.stop();
    this.running = null;
  }
}
