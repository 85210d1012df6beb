// The metrics' time series with axes, units and thresholds.

/** Size of the drawing area, which is stretched to the box. */
const SERIES_BOX = { width: 300, height: 100 };
/** Height of the drawing area and of a number beside it, pixels of the page. */
const SERIES_PX = { height: 48, number: 12 };
/** Titles of series whose metric has another name than its values. */
const SERIES_TITLES = {
  ego_speed: "speed", speed_limit_compliance: "over the speed limit", ego_progress_along_expert_route: "progress along the expert's route",
  time_to_collision_within_bound: "time to collision", driving_direction_compliance: "progress along the lanes in 1 s",
};

class SeriesPanel {
  constructor(node, onseek) {
    this.node = node;
    this.onseek = onseek;
    this.rows = [];
  }

  open(replay) {
    const speed = { metric: "ego_speed", unit: "meters_per_second", values: [...replay.ego.speed], low: null, high: null };
    const order = [speed, ...replay.series.filter(bounded), ...replay.series.filter((series) => !bounded(series))];
    this.end = replay.times[replay.times.length - 1] || 1;
    this.rows = order.map((series) => this.chart(series, replay.times));
    fill(this.node, this.rows.map((row) => row.node));
  }

  chart(series, times) {
    const { metric, values, frames, low, high } = series;
    const at = (i) => times[frames ? frames[i] : i] ?? times[times.length - 1];
    const scale = new SeriesScale(series);
    const x = (time) => (SERIES_BOX.width * time) / this.end;
    const y = (value) => SERIES_BOX.height * (1 - scale.at(value));
    const outside = (value) => value !== null && ((low !== null && value < low) || (high !== null && value > high));
    const line = (kind, value) => s("line", { class: kind, x1: 0, x2: SERIES_BOX.width, y1: y(value), y2: y(value) });
    const seconds = ticks(0, this.end, 5);
    const drawing = s("svg", { viewBox: `0 0 ${SERIES_BOX.width} ${SERIES_BOX.height}`, preserveAspectRatio: "none", "aria-hidden": "true" },
      scale.marks.map((mark) => line("grid", mark)),
      seconds.map((time) => s("line", { class: "grid", x1: x(time), x2: x(time), y1: 0, y2: SERIES_BOX.height })),
      scale.limits.map((limit) => line("limit", limit)),
      s("path", { class: "line", d: pathOf(values, (i) => x(at(i)), y, () => true) }),
      s("path", { class: "line outside", d: pathOf(values, (i) => x(at(i)), y, outside) }));
    const cursor = h("i", { class: "cursor" });
    const now = h("output", {}, "–");
    const plot = h("div", { class: "plot", title: `${metric}: ${thresholdWords(scale)}`, onclick: (event) => {
      const box = plot.getBoundingClientRect();
      this.onseek(((event.clientX - box.left) / box.width) * this.end);
    } }, drawing, cursor);
    const node = h("figure", { class: values.some(outside) ? "series bad" : "series" },
      h("figcaption", {}, h("span", { class: "name", title: thresholdWords(scale) }, seriesTitle(metric)), now, h("span", { class: "unit" }, scale.unit)),
      h("div", { class: "y-axis", "aria-hidden": "true" }, scale.marks.map((mark) =>
        h("span", { style: `bottom:${(100 * scale.at(mark)).toFixed(1)}%` }, axisFigure(mark)))),
      plot,
      h("div", { class: "x-axis", "aria-hidden": "true" }, seconds.map((time, i) =>
        h("span", { style: `left:${((100 * time) / this.end).toFixed(1)}%` }, i === seconds.length - 1 ? `${axisFigure(time)} s` : axisFigure(time)))));
    const index = new Map(values.map((value, i) => [frames ? frames[i] : i, value]));
    return { node, cursor, now, value: (iteration) => index.get(iteration), words: scale.overLimit ? overWords : figure };
  }

  /** Moves the cursors. */
  at(time, iteration) {
    for (const { cursor, now, value, words } of this.rows) {
      cursor.style.left = `${(100 * time) / this.end}%`;
      const present = value(iteration);
      now.textContent = present === null || present === undefined ? "–" : words(present);
    }
  }
}

/** The vertical axis of a series. */
class SeriesScale {
  constructor({ metric, unit, values, low, high }) {
    this.unit = unitOf(unit);
    /** The values are amounts over a limit, so the threshold 0 says nothing. */
    this.overLimit = metric === "speed_limit_compliance";
    this.limits = this.overLimit ? [] : [low, high].filter((limit) => limit !== null && limit !== undefined);
    const known = values.filter((value) => value !== null).concat(this.limits);
    let [bottom, top] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
    if (top - bottom < 1e-6) [bottom, top] = bottom === 0 ? [0, 1] : [bottom - 0.5, top + 0.5];
    const room = (top - bottom) * 0.08;
    [this.bottom, this.top] = [bottom - room, top + room];
    const few = ticks(bottom, top, 4);
    this.marks = sparse(few.length > 1 ? few : ticks(bottom, top, 6), this.top - this.bottom);
  }

  /** Place of a value: 0 at the bottom, 1 at the top. */
  at(value) {
    return (value - this.bottom) / (this.top - this.bottom);
  }
}

/** Every second of marks whose numbers would touch. */
function sparse(marks, span) {
  const step = marks[1] - marks[0];
  if (marks.length < 3 || (SERIES_PX.height * step) / span >= SERIES_PX.number) return marks;
  return sparse(marks.filter((mark) => Math.round(mark / step) % 2 === 0), span);
}

function thresholdWords({ limits, unit, overLimit }) {
  if (overLimit) return "meters per second over the speed limit; 0 while the ego keeps it";
  if (!limits.length) return "without threshold";
  return `threshold ${limits.map(figure).join(" and ")}${unit ? ` ${unit}` : ""}`;
}

/** An amount over a limit: a dash for none. */
function overWords(value) {
  return value > 0 ? `+${figure(value)}` : "kept";
}

/** A number on an axis, as short as it can be. */
function axisFigure(value) {
  return String(Number(value.toPrecision(3)));
}

function bounded(series) {
  return series.low !== null || series.high !== null;
}

/** A path through the values that `take` accepts, with gaps at the others; a single value is a short stroke. */
function pathOf(values, x, y, take) {
  let path = "";
  let drawing = false;
  values.forEach((value, i) => {
    const taken = value !== null && take(value);
    if (taken) path += `${drawing ? "L" : "M"}${x(i).toFixed(1)} ${y(value).toFixed(1)}${drawing ? "" : "h.5"}`;
    drawing = taken;
  });
  return path;
}

function seriesTitle(metric) {
  const words = spaced(metric.replace(/^ego_/, "").replace(/_within_bound|_compliance$/, ""));
  return SERIES_TITLES[metric] ?? words.replace(/^lon /, "longitudinal ").replace(/^lat /, "lateral ");
}
