// Histograms of the metrics' scores and statistics, by planner.

/** Number of bars. */
const BINS = 20;
const HISTOGRAM = { width: 300, row: 34 };

class Histograms {
  constructor(node) {
    this.node = node;
    this.statistics = null;
    this.challenge = INDEX.challenges[0];
    this.group = "Scores";
  }

  async show() {
    if (!this.statistics) {
      // A server sends them with the index, so that both are of one moment.
      this.statistics = INDEX.statistics ?? await unpack("statistics");
      this.build();
    }
  }

  /** Forgets the statistics of an index before the present one. */
  forget() {
    this.statistics = null;
    if (!INDEX.challenges.includes(this.challenge)) this.challenge = INDEX.challenges[0];
  }

  build() {
    const groups = ["Scores", ...distinct(this.statistics.columns.map((column) => column.category))];
    const challenges = INDEX.challenges.map((value) => ({ value, text: CHALLENGES[value].short, title: CHALLENGES[value].long }));
    this.cards = h("div", { class: "cards" });
    fill(this.node, h("div", { class: "page" },
      h("div", { class: "heading" }, h("h2", {}, "Distributions"),
        choice("Group", groups.map((value) => ({ value, text: value })), this.group, (group) => { this.group = group; this.draw(); }),
        challenges.length > 1 ? choice("Challenge", challenges, this.challenge, (c) => { this.challenge = c; this.draw(); }) : null,
        h("p", { class: "legend" }, INDEX.entrants.map((entrant) => h("span", {}, h("i", { style: `background:${colorOf(entrant)}` }), entrant.label)))),
      h("p", { class: "note" }, "Each row is a planner; a bar's height is its share of that planner's simulations. The line and the number at the right are the mean."),
      this.cards));
    this.draw();
  }

  draw() {
    const cards = this.group === "Scores" ? this.scores() : this.numbers();
    fill(this.cards, cards.filter(Boolean));
    if (!this.cards.children.length) fill(this.cards, h("p", { class: "quiet" }, "No simulation has such a metric."));
  }

  rows(valueOf) {
    return INDEX.entrants.map((entrant) => {
      const own = INDEX.simulations.filter((simulation) => simulation.entrant === entrant && simulation.challenge === this.challenge);
      return { entrant, values: own.map(valueOf).filter((value) => value !== null && value !== undefined) };
    }).filter(({ values }) => values.length);
  }

  scores() {
    const final = histogramCard("Final score", "", "", this.rows((simulation) => simulation.score), [0, 1]);
    const parts = metricsOf(this.challenge).map(({ name }) =>
      histogramCard(capital(metricTitle(name)), name, "", this.rows((simulation) => metricScore(simulation, name)), [0, 1]));
    return [final, ...parts];
  }

  numbers() {
    const place = new Map(INDEX.simulations.map((simulation, i) => [simulation, i]));
    return this.statistics.columns.flatMap((column, c) => {
      if (column.category !== this.group) return [];
      const rows = this.rows((simulation) => this.statistics.rows[place.get(simulation)][c]);
      return [histogramCard(capital(spaced(column.statistic)), column.metric, unitOf(column.unit), rows, null)];
    });
  }
}

/** One statistic: a histogram for each planner, on the same axis. */
function histogramCard(title, subtitle, unit, rows, range) {
  if (!rows.length) return null;
  const all = rows.flatMap((row) => row.values);
  let [low, high] = range ?? [Math.min(...all), Math.max(...all)];
  if (high - low < 1e-9) [low, high] = [low - 0.5, high + 0.5];
  const bins = rows.map(({ values }) => shares(values, low, high));
  const max = Math.max(...bins.flat());
  const { width, row: height } = HISTOGRAM;
  const charts = rows.map(({ entrant, values }, i) => {
    const bars = bins[i].map((share, k) => (share > 0 ? s("rect", {
      x: (width * k) / BINS + 0.75, width: width / BINS - 1.5, y: height - (height * share) / max, height: (height * share) / max,
      style: `fill:${colorOf(entrant)}`,
    }, s("title", {}, `${figure(low + ((high - low) * k) / BINS)} to ${figure(low + ((high - low) * (k + 1)) / BINS)} ${unit}: ${(100 * share).toFixed(0)} % of ${values.length}`)) : null));
    const at = (width * (mean(values) - low)) / (high - low);
    return h("div", { class: "histogram-row" },
      s("svg", { viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: "none", role: "img", "aria-label": `${entrant.label}, mean ${figure(mean(values))}` },
        bars, s("line", { class: "mean", x1: at, x2: at, y1: 0, y2: height }), s("line", { class: "base", x1: 0, x2: width, y1: height, y2: height })),
      h("span", { class: "mean-value", title: `${entrant.label}: mean of ${values.length}` }, figure(mean(values))));
  });
  return h("figure", { class: "card" }, h("figcaption", {}, h("b", {}, title), unit ? h("span", { class: "unit" }, unit) : null,
    subtitle && subtitle.replaceAll("_", " ") !== title ? h("small", {}, subtitle) : null), charts,
  h("div", { class: "axis", "aria-hidden": "true" }, ticks(low, high, 5).map((mark) => h("span", { style: `left:${((100 * (mark - low)) / (high - low)).toFixed(1)}%` }, axisFigure(mark)))),
  h("p", { class: "axis-title" }, range ? "score" : unit || "value"));
}

/** The shares of the values in bins of equal width. */
function shares(values, low, high) {
  const counts = new Array(BINS).fill(0);
  for (const value of values) {
    const bin = Math.floor((BINS * (value - low)) / (high - low));
    counts[Math.min(BINS - 1, Math.max(0, bin))] += 1;
  }
  return counts.map((count) => count / values.length);
}
