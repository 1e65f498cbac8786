// Sounds of a rally, synthesised; silent until the viewer asks for them.

const LOUD = 0.5;

export class Sound {
  private context: AudioContext | null = null;
  private noise: AudioBuffer | null = null;
  on = false;

  /** Switches the sound; returns whether it is on. */
  toggle(): boolean {
    this.on = !this.on;
    if (this.on && !this.context) {
      this.context = new AudioContext();
      const { sampleRate } = this.context;
      this.noise = this.context.createBuffer(1, 2 * sampleRate, sampleRate);
      const samples = this.noise.getChannelData(0);
      for (let i = 0; i < samples.length; i++) {
        samples[i] = 2 * Math.random() - 1;
      }
    }
    void (this.on ? this.context?.resume() : this.context?.suspend());
    return this.on;
  }

  /** A hit, sharper and louder with the speed of the shuttle [m/s]. */
  hit(speed: number): void {
    const force = Math.min(1, speed / 80);
    this.burst(900 + 2200 * force, 1.2, 0.05, 0.25 + 0.75 * force);
  }

  net(): void {
    this.burst(260, 0.8, 0.25, 0.6);
  }

  /** The shuttle on the floor. */
  bounce(): void {
    this.burst(700, 2, 0.06, 0.35);
  }

  /** Filtered noise that fades. */
  private burst(frequency: number, quality: number, seconds: number, loud: number): void {
    const { context, noise } = this;
    if (!this.on || !context) {
      return;
    }
    const source = new AudioBufferSourceNode(context, { buffer: noise });
    const filter = new BiquadFilterNode(context, { type: "bandpass", frequency, Q: quality });
    const gain = new GainNode(context, { gain: LOUD * loud });
    const { currentTime } = context;
    gain.gain.exponentialRampToValueAtTime(1e-4, currentTime + seconds);
    source.connect(filter).connect(gain).connect(context.destination);
    source.start(currentTime, Math.random());
    source.stop(currentTime + seconds);
  }
}
