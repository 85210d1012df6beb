// Scenarios: choose a simulation, play it, read its transcript.

class Scenarios {
  constructor(node) {
    this.node = node;
    this.player = new Player();
    this.simulation = null;
    this.wanted = null;
    this.filter = "";
    this.sort = "order";
    this.build();
  }

  build() {
    this.listNode = h("ol", { class: "scenario-list" });
    const search = h("input", { type: "search", placeholder: "Filter scenarios", "aria-label": "Filter scenarios", oninput: () => {
      this.filter = search.value.trim().toLowerCase().replaceAll(" ", "_");
      this.list();
    } });
    this.search = search;
    const sort = choice("Sort", [{ value: "order", text: "in order" }, { value: "score", text: "worst first" }], this.sort, (value) => {
      this.sort = value;
      this.list();
    });
    this.picker = h("div", { class: "picker" });
    this.chips = h("div", { class: "chips" });
    this.canvas = h("canvas", { tabindex: "0", "aria-label": "The scene from above" });
    this.clock = h("div", { class: "hud clock" });
    this.legend = h("div", { class: "hud bev-legend" }, ["ego", "vehicle", "bicycle", "pedestrian", "tried"].map((kind) =>
      h("span", {}, h("i", { class: `k-${kind}` }), kind === "tried" ? "refused plan" : kind)));
    this.absent = h("p", { class: "absent", hidden: true });
    this.controls = new Controls(this.player);
    this.seriesNode = h("div", { class: "series-panel" });
    this.transcriptNode = h("div", { class: "transcript", tabindex: "0", "aria-label": "Transcript" });
    this.latencyNode = h("div", { class: "latency", hidden: true });
    fill(this.node, h("div", { class: "scenarios" },
      h("aside", {}, h("div", { class: "list-head" }, search, sort), this.listNode),
      h("div", { class: "stage" }, this.picker, this.chips,
        h("div", { class: "bev" }, this.canvas, this.clock, this.legend, this.absent), this.controls.node, this.seriesNode),
      h("div", { class: "side" }, this.transcriptNode, this.latencyNode)));
    this.bev = new Bev(this.canvas);
    const seek = (time) => this.player.seek(time);
    const toCall = (call) => this.player.seek(this.player.times[call.iteration] ?? 0);
    this.series = new SeriesPanel(this.seriesNode, seek);
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
    });
    this.player.onState((playing) => {
      if (!playing) this.remember();
    });
  }

  showClock(time, iteration) {
    const { speed } = this.replay.ego;
    fill(this.clock, h("b", {}, `${time.toFixed(1)} s`), h("span", {}, `${Math.abs(speed[iteration]).toFixed(1)} m/s`));
  }

  /** The simulations of a scenario in the current challenge. */
  simulationsOf(scenario, challenge = this.simulation?.challenge ?? INDEX.challenges[0]) {
    return INDEX.simulations.filter((simulation) => simulation.scenario === scenario && simulation.challenge === challenge);
  }

  list() {
    const shown = this.simulation?.entrant ?? INDEX.entrants[0];
    const entries = INDEX.scenarios.map((scenario) => {
      const simulations = this.simulationsOf(scenario);
      return { scenario, simulations, own: simulations.find((simulation) => simulation.entrant === shown) };
    }).filter(({ scenario, simulations }) => simulations.length && `${scenario} ${simulations[0].type}`.toLowerCase().includes(this.filter));
    if (this.sort === "score") entries.sort((a, b) => (a.own?.score ?? -1) - (b.own?.score ?? -1));
    this.entries = entries;
    fill(this.listNode, entries.map(({ scenario, simulations, own }) => {
      const target = own ?? simulations[0];
      const current = scenario === this.simulation?.scenario;
      return h("li", { "aria-current": current, class: simulations.some((simulation) => simulation.replay !== null) ? null : "no-replay" },
        h("a", { href: `#scenarios/${target.run}/${target.number}` }, h("span", { class: "scenario-name" }, lastPart(scenario)),
          h("span", { class: "scores-line" }, simulations.map((simulation) => h("span", { title: `${simulation.entrant.label} ${percent(simulation.score)}`,
            class: simulation.score === 0 || simulation.error !== null ? "zero" : null },
          h("i", { style: `background:${colorOf(simulation.entrant)}` }), simulation.score === null ? "–" : (100 * simulation.score).toFixed(0))))));
    }));
    this.listNode.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest" });
  }

  /** Shows a simulation; `time` in seconds. */
  async open(simulation, time = 0) {
    if (this.simulation === simulation) return void (this.replay && this.player.seek(time));
    this.player.pause();
    this.simulation = simulation;
    this.replay = null;
    this.pick();
    this.list();
    const replay = await replayOf(simulation);
    if (this.simulation !== simulation) return;
    this.replay = replay;
    this.showChips();
    const empty = replay === null;
    for (const node of [this.controls.node, this.seriesNode, this.canvas, this.clock, this.legend]) node.hidden = empty;
    this.absent.hidden = !empty;
    this.node.dataset.simulation = `${simulation.run}/${simulation.number}`;
    if (empty) {
      this.bev.open(null);
      this.latencyNode.hidden = true;
      fill(this.absent, whyAbsent(simulation));
      fill(this.transcriptNode, h("p", { class: "quiet" }, "Without a replay there is no transcript."));
      return;
    }
    this.bev.open(replay);
    this.transcript.open(replay);
    this.latency.open(replay);
    this.series.open(replay);
    this.controls.open(replay);
    this.player.open(replay.times, time);
    this.bev.resize();
  }

  /** The menus for planner, challenge and ghost. */
  pick() {
    const { simulation } = this;
    const challenges = INDEX.simulations.filter((d) => d.scenario === simulation.scenario && d.entrant === simulation.entrant);
    const go = (target) => { if (target) location.hash = hashOf(target, this.player.time); };
    const select = (label, options, chosen, onchange) => h("label", { title: label }, label === "ghost" ? h("span", {}, label) : null,
      h("select", { "aria-label": label, onchange: (event) => onchange(options[event.target.selectedIndex].value) },
        options.map(({ text, value }) => h("option", { selected: value === chosen }, text))));
    const planners = this.simulationsOf(simulation.scenario, simulation.challenge);
    const others = planners.filter((other) => other !== simulation && other.replay !== null);
    fill(this.picker, h("h2", { title: simulation.scenario }, lastPart(simulation.scenario)),
      select("planner", planners.map((d) => ({ text: d.entrant.label, value: d })), simulation, go),
      select("challenge", challenges.map((d) => ({ text: CHALLENGES[d.challenge].plain, value: d })), simulation, go),
      others.length ? select("ghost", [{ text: "none", value: null }, ...others.map((d) => ({ text: d.entrant.label, value: d }))], null,
        async (other) => { this.bev.open(this.replay, other && await replayOf(other)); }) : null);
  }

  /** The score and its metrics. */
  showChips() {
    const { simulation } = this;
    const parts = scoredMetrics(simulation.challenge).map(({ name, weight }) => {
      const score = metricScore(simulation, name);
      const state = score === null ? "" : score >= 1 ? "" : score === 0 ? "zero" : "short";
      return h("span", { class: `chip ${state}`, title: `${name}, ${weight === null ? "multiplier" : `weight ${weight}`}` },
        labelOf(name), h("b", {}, score === null ? "–" : partFigure(score)));
    });
    fill(this.chips, h("span", { class: "chip total" }, "score", h("b", {}, percent(simulation.score))), parts);
  }

  /** Writes the place into the address, so that it can be shared. */
  remember() {
    if (this.simulation && !this.node.hidden) history.replaceState(null, "", hashOf(this.simulation, this.player.time));
  }

  /** Opens the previous or next scenario, with the same planner if possible. */
  neighbor(by) {
    const place = this.entries.findIndex(({ scenario }) => scenario === this.simulation?.scenario);
    const next = this.entries[place + by];
    if (next) location.hash = hashOf(next.own ?? next.simulations[0], 0);
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
  return `#scenarios/${simulation.run}/${simulation.number}${time > 0 ? `/${time.toFixed(1)}` : ""}`;
}

function lastPart(scenario) {
  return spaced(scenario.replace(/^generated\//, ""));
}

function whyAbsent(simulation) {
  if (simulation.error !== null) return `The simulation failed: ${simulation.error}`;
  if (simulation.absent === "size") return "The replay did not fit into the page. Write a page of fewer scenarios: planagent report RUN --scenario NAME.";
  if (simulation.absent === "scenario") return "This page has replays of other scenarios only.";
  return "The run has no replay of this simulation.";
}
