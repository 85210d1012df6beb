// Play, scrub, speed: the row under the scene.

const SPEEDS = [0.25, 0.5, 1, 2, 4];

class Controls {
  constructor(player) {
    this.player = player;
    this.button = h("button", { type: "button", class: "play", "aria-label": "Play", title: "Play (space)", onclick: () => player.toggle() }, "▶");
    this.slider = h("input", { type: "range", min: 0, max: 1, step: 0.05, value: 0, "aria-label": "Time", oninput: () => {
      player.pause();
      player.seek(Number(this.slider.value));
    } });
    this.ticks = h("div", { class: "ticks" });
    this.time = h("output", { class: "time" }, "0.0");
    this.speed = h("select", { "aria-label": "Speed", title: "Speed", onchange: () => { player.speed = SPEEDS[this.speed.selectedIndex]; } },
      SPEEDS.map((speed) => h("option", { selected: speed === 1 }, `${speed}×`)));
    this.node = h("div", { class: "controls" }, this.button, h("div", { class: "track" }, this.ticks, this.slider), this.time, this.speed);
    player.onTime((time) => {
      this.slider.value = time;
      this.time.textContent = `${fixed(time, 1)} / ${fixed(player.end, 1)} s`;
    });
    player.onState((playing) => {
      this.button.textContent = playing ? "❚❚" : "▶";
      this.button.setAttribute("aria-label", playing ? "Stop" : "Play");
    });
  }

  open(replay) {
    const end = replay.times[replay.times.length - 1] || 1;
    this.slider.max = end;
    fill(this.ticks, replay.calls.map((call) => h("i", {
      class: outcomeOf(call), style: `left:${(100 * (replay.times[call.iteration] ?? 0)) / end}%`,
      title: `Planning call at ${fixed(call.at_s, 1)} s: ${OUTCOMES[outcomeOf(call)]}`,
    })));
  }
}
