// The metrics' time series with their thresholds.

/** Size of the drawing area, which is stretched to the box. */
const SERIES_BOX = { width: 300, height: 100 };

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

  chart({ metric, unit, values, frames, low, high }, times) {
    const at = (i) => times[frames ? frames[i] : i] ?? times[times.length - 1];
    const known = values.filter((value) => value !== null);
    const limits = [low, high].filter((limit) => limit !== null && limit !== undefined);
    let [bottom, top] = [Math.min(...known, ...limits), Math.max(...known, ...limits)];
    if (!known.length) [bottom, top] = [0, 1];
    const room = (top - bottom || 1) * 0.08;
    [bottom, top] = [bottom - room, top + room];
    const x = (time) => (SERIES_BOX.width * time) / this.end;
    const y = (value) => SERIES_BOX.height * (1 - (value - bottom) / (top - bottom));
    const outside = (value) => value !== null && ((low !== null && value < low) || (high !== null && value > high));
    const drawing = s("svg", { viewBox: `0 0 ${SERIES_BOX.width} ${SERIES_BOX.height}`, preserveAspectRatio: "none", "aria-hidden": "true" },
      limits.map((limit) => s("line", { class: "limit", x1: 0, x2: SERIES_BOX.width, y1: y(limit), y2: y(limit) })),
      s("path", { class: "line", d: pathOf(values, (i) => x(at(i)), y, () => true) }),
      s("path", { class: "line outside", d: pathOf(values, (i) => x(at(i)), y, outside) }));
    const cursor = h("i", { class: "cursor" });
    const now = h("output", {}, "–");
    const bad = values.some(outside);
    const bounds = limits.length ? `, threshold ${limits.map(figure).join(" and ")}` : "";
    const plot = h("div", { class: "plot", title: `${metric}${bounds}`, onclick: (event) => {
      const box = plot.getBoundingClientRect();
      this.onseek(((event.clientX - box.left) / box.width) * this.end);
    } }, drawing, cursor);
    const node = h("figure", { class: bad ? "series bad" : "series" },
      h("figcaption", {}, h("span", { class: "name" }, seriesName(metric)), now, h("span", { class: "unit" }, unitOf(unit))), plot);
    const index = new Map(values.map((value, i) => [frames ? frames[i] : i, value]));
    return { node, cursor, now, value: (iteration) => index.get(iteration) };
  }

  /** Moves the cursors. */
  at(time, iteration) {
    for (const { cursor, now, value } of this.rows) {
      cursor.style.left = `${(100 * time) / this.end}%`;
      const present = value(iteration);
      now.textContent = present === null || present === undefined ? "–" : figure(present);
    }
  }
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

function seriesName(metric) {
  return spaced(metric.replace(/^ego_/, "").replace(/_along_expert_route|_within_bound|_compliance$/, ""));
}
