// Scenarios: choose a simulation, play it, read its transcript.

/** Time between two changes of the address while a replay plays, milliseconds; browsers refuse many changes. */
const ADDRESS_MS = 400;

class Scenarios {
  constructor(node) {
    this.node = node;
    this.player = new Player();
    this.simulation = null;
    this.replay = null;
    /** The simulation of the ghost. */
    this.haunted = null;
    this.addressed = 0;
    this.build();
  }

  build() {
    const aside = h("aside", { "aria-label": "Scenarios" });
    this.picker = h("div", { class: "picker" });
    this.chips = h("div", { class: "chips" });
    this.canvas = h("canvas", { tabindex: "0", "aria-label": "The scene from above" });
    this.clock = h("div", { class: "hud clock" });
    this.legendNode = h("div", { class: "scene-legend", "aria-label": "Legend" });
    this.absent = h("p", { class: "absent", hidden: true });
    this.controls = new Controls(this.player);
    this.seriesNode = h("div", { class: "series-panel" });
    this.transcriptNode = h("div", { class: "transcript", tabindex: "0", "aria-label": "Transcript" });
    this.latencyNode = h("div", { class: "latency", hidden: true });
    this.layout = h("div", { class: "scenarios", "data-panel": "transcript" },
      aside,
      h("div", { class: "stage" }, this.picker, this.chips,
        h("div", { class: "bev" }, this.canvas, this.clock, this.absent), this.controls.node, this.legendNode,
        this.panels(), this.seriesNode),
      h("div", { class: "side" }, this.transcriptNode, this.latencyNode),
      h("button", { type: "button", class: "shade", "aria-label": "Close the list", onclick: () => this.openList(false) }));
    fill(this.node, this.layout);
    this.list = new ScenarioList(aside);
    aside.addEventListener("click", (event) => {
      if (event.target.closest("a")) this.openList(false);
    });
    this.bev = new Bev(this.canvas);
    this.legend = new SceneLegend(this.legendNode, this.bev);
    this.listen();
  }

  /** On narrow screens: which panel is below the scene. */
  panels() {
    const options = [{ value: "transcript", text: "Transcript" }, { value: "latency", text: "Latency" }, { value: "series", text: "Metrics over time" }];
    const group = choice("Panel", options, "transcript", (panel) => { this.layout.dataset.panel = panel; });
    group.classList.add("panels");
    return group;
  }

  listen() {
    const toCall = (call) => this.player.seek(this.player.times[call.iteration] ?? 0);
    this.series = new SeriesPanel(this.seriesNode, (time) => this.player.seek(time));
    this.latency = new Latency(this.latencyNode, toCall);
    this.transcript = new Transcript(this.transcriptNode, { onseek: toCall, onmark: (attempt) => {
      this.bev.marked = attempt;
      this.bev.draw();
    } });
    this.player.onTime((time, iteration) => {
      if (!this.replay) return;
      this.transcript.at(iteration);
      this.latency.at(iteration);
      this.series.at(time, iteration);
      this.bev.at(time);
      this.showClock(time, iteration);
      this.remember();
    });
    this.player.onState((playing) => {
      if (!playing) this.remember();
    });
  }

  /** Opens or closes the list where it lies over the scene. */
  openList(open) {
    this.layout.classList.toggle("listing", open);
  }

  showClock(time, iteration) {
    const { speed } = this.replay.ego;
    fill(this.clock, h("b", {}, `${fixed(time, 1)} s`), h("span", {}, `${Math.abs(speed[iteration]).toFixed(1)} m/s`));
  }

  /** Shows a simulation; `time` in seconds. */
  async open(simulation, time = 0) {
    if (this.simulation === simulation) return void (this.replay && this.player.seek(time));
    this.player.pause();
    this.simulation = simulation;
    this.replay = null;
    this.haunted = null;
    this.pick();
    this.list.mark(simulation);
    const replay = await replayOf(simulation);
    if (this.simulation !== simulation) return;
    this.replay = replay;
    this.showChips();
    const empty = replay === null;
    for (const node of [this.controls.node, this.seriesNode, this.canvas, this.clock, this.legendNode]) node.hidden = empty;
    this.absent.hidden = !empty;
    this.node.dataset.simulation = `${simulation.run}/${simulation.number}`;
    this.bev.open(replay);
    this.legend.draw();
    if (empty) {
      this.latencyNode.hidden = true;
      fill(this.absent, whyAbsent(simulation));
      fill(this.transcriptNode, h("p", { class: "quiet" }, "Without a replay there is no transcript."));
      return;
    }
    this.transcript.open(replay);
    this.latency.open(replay);
    this.series.open(replay);
    this.controls.open(replay);
    this.player.open(replay.times, time);
    this.bev.resize();
  }

  /** Shows the present index after a change, without moving the reader. */
  async refresh() {
    const before = this.simulation;
    if (!before) return;
    const now = INDEX.simulations.find((d) => d.run === before.run && d.number === before.number && d.scenario === before.scenario);
    if (!now || now.replay !== before.replay) {
      // It is gone, or was simulated again.
      this.simulation = null;
      const other = now ?? INDEX.simulations.find((d) => d.replay !== null) ?? INDEX.simulations[0];
      await this.open(other, now ? this.player.time : 0);
      return;
    }
    this.simulation = now;
    if (this.replay) this.replay.simulation = now;
    this.list.refresh(now);
    // An open menu would close.
    if (!this.picker.contains(document.activeElement)) this.pick();
  }

  /** The name, and the menus for planner, challenge and ghost. */
  pick() {
    const { simulation, haunted } = this;
    const same = (d) => d.scenario === simulation.scenario;
    const challenges = INDEX.simulations.filter((d) => same(d) && d.entrant === simulation.entrant);
    const planners = INDEX.simulations.filter((d) => same(d) && d.challenge === simulation.challenge);
    const others = planners.filter((other) => other !== simulation && other.replay !== null);
    const go = (target) => { if (target) location.hash = hashOf(target, this.player.time); };
    const select = (label, options, chosen, onchange) => h("label", { class: `${label}-choice`, title: label }, h("span", {}, label),
      h("select", { "aria-label": label, onchange: (event) => onchange(options[event.target.selectedIndex].value) },
        options.map(({ text, value }) => h("option", { selected: value === chosen }, text))));
    const ghost = others.find((d) => haunted && d.run === haunted.run && d.number === haunted.number) ?? null;
    const { name, detail } = nameOf(simulation);
    fill(this.picker,
      h("button", { type: "button", class: "list-open", onclick: () => this.openList(true) }, "☰ Scenarios"),
      h("div", { class: "scenario-title", title: simulation.scenario }, h("h2", {}, name), h("p", { class: "quiet" }, detail)),
      select("planner", planners.map((d) => ({ text: d.entrant.label, value: d })), simulation, go),
      challenges.length > 1 ? select("agents", challenges.map((d) => ({ text: CHALLENGES[d.challenge].plain, value: d })), simulation, go) : null,
      others.length ? select("ghost", [{ text: "none", value: null }, ...others.map((d) => ({ text: d.entrant.label, value: d }))], ghost,
        (other) => this.haunt(other).catch(trouble)) : null);
  }

  /** Adds the ego of another simulation, or removes it. */
  async haunt(other) {
    this.haunted = other;
    const ghost = other && await replayOf(other);
    this.bev.open(this.replay, ghost);
    this.legend.draw();
  }

  /** The score and its metrics. */
  showChips() {
    const { simulation } = this;
    const parts = scoredMetrics(simulation).map(({ name, weight }) => {
      const score = metricScore(simulation, name);
      const state = score === null ? "" : score >= 1 ? "whole" : score === 0 ? "zero" : "short";
      return h("span", { class: `chip ${state}`, title: `${name}, ${weight === null ? "multiplier" : `weight ${weight}`}` },
        labelOf(name), h("b", {}, score === null ? "–" : partFigure(score)));
    });
    const whole = parts.filter((part) => part.classList.contains("whole")).length;
    fill(this.chips, h("span", { class: "chip total" }, "score", h("b", {}, percent(simulation.score))), parts,
      whole ? h("span", { class: "chip others" }, `${whole} of ${parts.length} metrics`, h("b", {}, "1")) : null);
  }

  /** Writes the moment into the address, so that it can be shared. */
  remember() {
    if (!this.simulation || this.node.hidden) return;
    const wait = this.player.playing ? ADDRESS_MS - (performance.now() - this.addressed) : 0;
    if (wait > 0) return;
    this.addressed = performance.now();
    clearTimeout(this.addressing);
    const address = location.hash;
    // Scrubbing changes the time more often than browsers let a page change its address. Meanwhile the person may go elsewhere.
    this.addressing = setTimeout(() => {
      if (!this.node.hidden && location.hash === address) history.replaceState(null, "", hashOf(this.simulation, this.player.time));
    }, this.player.playing ? 0 : ADDRESS_MS / 4);
  }

  /** Opens the previous or next scenario, with the same planner if possible. */
  neighbor(by) {
    const next = this.list.neighbor(by);
    if (next) location.hash = hashOf(next, 0);
  }

  /** Seeks the previous or next planning call. */
  call(by) {
    const calls = this.replay?.calls ?? [];
    if (!calls.length) return;
    const place = callAt(this.replay, this.player.iteration);
    const target = calls[Math.min(calls.length - 1, Math.max(0, place + by))];
    this.player.pause();
    this.player.seek(this.player.times[target.iteration]);
  }
}

function hashOf(simulation, time) {
  return `#scenarios/${simulation.run}/${simulation.number}${time > 0 ? `/${fixed(time, 1)}` : ""}`;
}

function whyAbsent(simulation) {
  if (simulation.error !== null) return `The simulation failed: ${simulation.error}`;
  if (simulation.absent === "size") return "The replay did not fit into the page. Write a page of fewer scenarios: planagent report RUN --scenario NAME.";
  if (simulation.absent === "scenario") return "This page has replays of other scenarios only.";
  return "The run has no replay of this simulation.";
}
