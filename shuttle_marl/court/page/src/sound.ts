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
    this.tone(420 + 500 * force, 0.06, 0.15 + 0.35 * force);
  }

  net(): void {
    this.burst(260, 0.8, 0.25, 0.6);
  }

  /** The shuttle on the floor. */
  bounce(): void {
    this.burst(700, 2, 0.06, 0.35);
    this.tone(160, 0.08, 0.3);
  }

  /** Applause after a rally; longer rallies get more. */
  crowd(strokes: number): void {
    const { context } = this;
    const loud = Math.min(1, 0.25 + strokes / 25);
    for (let i = 0; context && i < 40 * loud; i++) {
      this.burst(1100 + 900 * Math.random(), 1.5, 0.03, 0.06 * loud, 0.25 + 1.6 * Math.random());
    }
    this.burst(600, 0.6, 2.2, 0.07 * loud, 0.1);
  }

  /** Filtered noise that fades. */
  private burst(frequency: number, quality: number, seconds: number, loud: number, delay = 0): void {
    const { context, noise } = this;
    if (!this.on || !context) {
      return;
    }
    const source = context.createBufferSource();
    source.buffer = noise;
    const filter = context.createBiquadFilter();
    filter.type = "bandpass";
    filter.frequency.value = frequency;
    filter.Q.value = quality;
    source.connect(filter);
    this.play(source, filter, seconds, loud, delay, Math.random());
  }

  private tone(frequency: number, seconds: number, loud: number): void {
    if (this.on && this.context) {
      const source = this.context.createOscillator();
      source.frequency.value = frequency;
      this.play(source, source, seconds, loud, 0);
    }
  }

  private play(
    source: AudioScheduledSourceNode,
    last: AudioNode,
    seconds: number,
    loud: number,
    delay: number,
    from?: number,
  ): void {
    const context = this.context!;
    const gain = context.createGain();
    const begin = context.currentTime + delay;
    gain.gain.setValueAtTime(LOUD * loud, begin);
    gain.gain.exponentialRampToValueAtTime(1e-4, begin + seconds);
    last.connect(gain).connect(context.destination);
    if (source instanceof AudioBufferSourceNode && from !== undefined) {
      source.start(begin, from);
    } else {
      source.start(begin);
    }
    source.stop(begin + seconds);
  }
}
