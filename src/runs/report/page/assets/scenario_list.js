// The list of scenarios: thumbnail, name and scores of each, with a filter and an order.

class ScenarioList {
  constructor(node) {
    this.node = node;
    this.filter = "";
    this.sort = "score";
    this.entries = [];
    this.current = null;
    this.thumbnails = new Thumbnails();
    this.search = h("input", { type: "search", placeholder: "Filter scenarios", "aria-label": "Filter scenarios", oninput: () => this.find(this.search.value) });
    const sort = choice("Sort", [{ value: "score", text: "worst first" }, { value: "order", text: "in order" }], this.sort, (value) => {
      this.sort = value;
      this.draw();
    });
    this.listNode = h("ol", { class: "scenario-list" });
    fill(node, h("div", { class: "list-head" }, this.search, sort), this.listNode);
  }

  /** Shows the scenarios with a text in their names. */
  find(text) {
    this.search.value = text;
    this.filter = text.trim().toLowerCase().replaceAll("_", " ");
    this.draw();
  }

  /** Marks the scenario of a simulation. */
  mark(simulation) {
    this.current = simulation;
    this.draw();
  }

  /** Shows the present index, where the reader is in the list. */
  refresh(simulation) {
    const { scrollTop } = this.listNode;
    this.mark(simulation);
    this.listNode.scrollTop = scrollTop;
  }

  draw() {
    const shown = this.current?.entrant ?? INDEX.entrants[0];
    const challenge = this.current?.challenge ?? INDEX.challenges[0];
    const entries = INDEX.scenarios.map((scenario) => {
      const simulations = INDEX.simulations.filter((d) => d.scenario === scenario && d.challenge === challenge);
      return { scenario, simulations, own: simulations.find((simulation) => simulation.entrant === shown) };
    });
    const holds = ({ simulations: [first] }) => first && `${titleOf(first)} ${first.scenario} ${first.type}`.toLowerCase().replaceAll("_", " ").includes(this.filter);
    this.entries = entries.filter(holds);
    if (this.sort === "score") this.entries.sort((a, b) => (a.own?.score ?? -1) - (b.own?.score ?? -1));
    fill(this.listNode, this.entries.map((entry) => this.row(entry)));
    if (!this.entries.length) fill(this.listNode, h("li", { class: "quiet nothing" }, "No scenario has this in its name."));
    this.listNode.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest" });
  }

  row({ scenario, simulations, own }) {
    const target = own ?? simulations[0];
    const { name, detail } = nameOf(target);
    const current = scenario === this.current?.scenario;
    return h("li", { "aria-current": current, class: simulations.some((simulation) => simulation.replay !== null) ? null : "no-replay" },
      h("a", { href: hashOf(target, 0), title: scenario }, this.thumbnails.of(scenario),
        h("span", { class: "scenario-words" }, h("span", { class: "scenario-name" }, name), h("span", { class: "scenario-detail" }, detail),
          h("span", { class: "scores-line" }, simulations.map((simulation) => h("span", { title: `${simulation.entrant.label} ${percent(simulation.score)}`,
            class: simulation.score === 0 || simulation.error !== null ? "zero" : null },
          h("i", { style: `background:${colorOf(simulation.entrant)}` }), simulation.score === null ? "–" : (100 * simulation.score).toFixed(0)))))));
  }

  /** The simulation of the scenario before or after the current one. */
  neighbor(by) {
    const place = this.entries.findIndex(({ scenario }) => scenario === this.current?.scenario);
    const next = this.entries[place + by];
    return next ? next.own ?? next.simulations[0] : null;
  }
}
