// The clock of a replay: play, stop, seek. The views listen to it.

class Player {
  constructor() {
    this.times = new Float64Array([0]);
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.listeners = [];
    this.changed = [];
  }

  /** Calls `listener(time, iteration)` after each change of the time. */
  onTime(listener) {
    this.listeners.push(listener);
  }

  /** Calls `listener(playing)` at each start and stop. */
  onState(listener) {
    this.changed.push(listener);
  }

  /** Opens a replay with these sample times. */
  open(times, time = 0) {
    this.pause();
    this.times = times;
    this.seek(time);
  }

  get end() {
    return this.times[this.times.length - 1];
  }

  /** The last sample up to the present time. */
  get iteration() {
    let low = 0;
    for (let high = this.times.length - 1; low < high;) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= this.time + 1e-6) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  seek(time) {
    this.time = Math.min(this.end, Math.max(0, time));
    const { iteration } = this;
    for (const listener of this.listeners) listener(this.time, iteration);
  }

  /** Moves forward by `samples`, or back if negative. */
  step(samples) {
    this.pause();
    const to = Math.min(this.times.length - 1, Math.max(0, this.iteration + samples));
    this.seek(this.times[to]);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.time >= this.end - 1e-6) this.seek(0);
    this.set(true);
    let last = null;
    const frame = (now) => {
      if (!this.playing) return;
      if (last !== null) this.seek(this.time + ((now - last) / 1000) * this.speed);
      last = now;
      if (this.time >= this.end) this.pause();
      else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  pause() {
    this.set(false);
  }

  set(playing) {
    if (this.playing === playing) return;
    this.playing = playing;
    for (const listener of this.changed) listener(playing);
  }
}
