// Axes, and rows of means with their intervals.

/** Round values from `low` to `high`, at most `most` of them. */
function ticks(low, high, most) {
  const span = high - low || 1;
  // Wild values have no round ones between them.
  if (!Number.isFinite(span) || !Number.isFinite(low)) return [];
  const rough = span / Math.max(1, most - 1);
  const size = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * size).find((candidate) => candidate >= rough - 1e-9);
  const values = [];
  for (let k = Math.ceil(low / step - 1e-9), n = 0; k * step <= high + 1e-9 * span && n < 2 * most + 2; k++, n++) values.push(Number((k * step).toFixed(10)));
  return values;
}

/** An axis of scores from a round number below the lowest value to 100. */
class ScoreAxis {
  constructor(intervals) {
    const lowest = Math.min(90, ...intervals.map(({ low }) => low).filter(Number.isFinite));
    this.low = Math.max(0, 10 * Math.floor(lowest / 10));
    this.marks = ticks(this.low, 100, 6);
  }

  /** Place of a score, percent of the width. */
  at(score) {
    return (100 * (score - this.low)) / (100 - this.low);
  }

  /** The lines behind a row. */
  lines() {
    return this.marks.map((mark) => h("i", { class: "grid-line", style: `left:${this.at(mark).toFixed(2)}%` }));
  }

  /** The numbers below the rows. */
  labels() {
    return h("div", { class: "score-axis", "aria-hidden": "true" }, this.marks.map((mark) =>
      h("span", { style: `left:${this.at(mark).toFixed(2)}%` }, String(mark))));
  }
}

/** A mean as a dot with its interval as a line. */
function dotAndInterval(axis, { mean: value, low, high }, color) {
  return [
    h("i", { class: "interval", style: `left:${axis.at(low).toFixed(2)}%;width:${(axis.at(high) - axis.at(low)).toFixed(2)}%;background:${color}` }),
    h("i", { class: "mean-dot", style: `left:${axis.at(value).toFixed(2)}%;background:${color}` }),
  ];
}

/** A mean with its interval, in words. */
function intervalWords({ mean: value, low, high, scenes }) {
  const n = counted(scenes, "scene");
  return scenes > 1 ? `${fixed(value, 2)}, 95 % interval ${fixed(low, 2)} to ${fixed(high, 2)}, ${n}` : `${fixed(value, 2)}, ${n}`;
}

/** A number with its sign; no sign on zero. */
function signed(value) {
  const text = Math.abs(value).toFixed(2);
  return text === "0.00" ? text : `${value > 0 ? "+" : "−"}${text}`;
}
