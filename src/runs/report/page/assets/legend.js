// The legend of the scene: what is drawn, in its colors. Some entries are switches.

/** Kinds of objects that are drawn alike. */
const STATIC_KINDS = ["traffic_cone", "barrier", "czone_sign", "generic_object"];

/** Key, words, swatch, and when the scene may show it. Keys of `Bev.show` are switches. */
const LEGEND = [
  ["ego", "ego", () => boxSwatch("--ego"), () => true],
  ["plan", "active plan, a dot each second", () => [lineSwatch("--ego", 3), s("circle", { cx: 17, cy: 6, r: 3, style: "fill:var(--ego)" })], () => true],
  ["tried", "refused plan with its score", () => lineSwatch("--tried", 4, "5 3"), ({ calls }) => calls.some((call) => call.attempts.some((_, i) => i !== acceptedAttempt(call)))],
  ["trail", "trail of the ego", () => lineSwatch("--ego", 1.4), () => true],
  ["expert", "recorded ego", () => [lineSwatch("--expert", 1.8, "2 3"), s("circle", { cx: 12, cy: 6, r: 3, style: "fill:none;stroke:var(--expert);stroke-width:1.6" })], ({ expert }) => expert.x.length > 1],
  ["ghost", "ghost: ego of another planner", () => s("rect", { x: 3, y: 2, width: 18, height: 8, rx: 2, style: "fill:none;stroke:var(--ghost);stroke-width:1.8" }), (_, ghost) => ghost],
  ["vehicle", "vehicle", () => boxSwatch("--vehicle"), hasKind("vehicle")],
  ["bicycle", "bicycle", () => boxSwatch("--bicycle"), hasKind("bicycle")],
  ["pedestrian", "pedestrian", () => s("circle", { cx: 12, cy: 6, r: 4.5, style: "fill:var(--pedestrian)" }), hasKind("pedestrian")],
  ["static", "static object", () => s("rect", { x: 7, y: 1.5, width: 9, height: 9, rx: 1, style: "fill:var(--static)" }), hasKind(...STATIC_KINDS)],
  ["arrow", "path in 0.8 s at this speed", () => s("path", { d: "M3 6H20M16 2.5L20 6L16 9.5", style: "fill:none;stroke:var(--ink);stroke-width:1.3" }), () => true],
  ["route", "route", () => areaSwatch("--route"), ({ map }) => map.has.route],
  ["road", "lane", () => areaSwatch("--road"), () => true],
  ["drivable", "other drivable area", () => areaSwatch("--drivable"), ({ map }) => map.has.drivable],
  ["crosswalk", "crosswalk", () => [5, 11, 17].map((x) => s("rect", { x, y: 1, width: 3.4, height: 10, style: "fill:var(--crosswalk);stroke:var(--line-strong);stroke-width:.6" })), ({ map }) => map.crosswalks.length > 0],
  ["stop", "stop line", () => s("rect", { x: 2, y: 4, width: 20, height: 4, style: "fill:var(--stop);stroke:var(--line-strong);stroke-width:.6" }), ({ map }) => map.has.stops],
  ["red", "red light", () => lightSwatch("--red", 7), hasLight("red")],
  ["yellow", "yellow light", () => lightSwatch("--amber", 4), hasLight("yellow")],
  ["green", "green light", () => lightSwatch("--green", 4), hasLight("green")],
];

function hasKind(...kinds) {
  return ({ agents }) => agents.some((agent) => kinds.includes(agent.kind));
}

function hasLight(color) {
  return ({ lights }) => lights.some(({ changes }) => changes.some(([, status]) => status === color));
}

function lineSwatch(color, width, dash = null) {
  return s("line", { x1: 1, x2: 23, y1: 6, y2: 6, style: `stroke:var(${color});stroke-width:${width}`, "stroke-dasharray": dash });
}

function boxSwatch(color) {
  return [s("rect", { x: 2, y: 1.5, width: 20, height: 9, rx: 2, style: `fill:var(${color})` }),
    s("rect", { x: 16, y: 3, width: 2.4, height: 6, style: "fill:var(--panel);opacity:.75" })];
}

function areaSwatch(color) {
  return s("rect", { x: 1, y: 0.5, width: 22, height: 11, style: `fill:var(${color});stroke:var(--line-strong);stroke-width:.6` });
}

function lightSwatch(color, width) {
  return s("line", { x1: 3, x2: 21, y1: 6, y2: 6, style: `stroke:var(${color});stroke-width:${width}` });
}

/** The legend below a scene. */
class SceneLegend {
  constructor(node, bev) {
    this.node = node;
    this.bev = bev;
  }

  /** Draws the entries of the open replay. */
  draw() {
    const { bev } = this;
    if (!bev.replay) return void fill(this.node);
    fill(this.node, LEGEND.filter(([, , , when]) => when(bev.replay, bev.ghost !== null)).map(([key, words, swatch]) => {
      const content = [s("svg", { viewBox: "0 0 24 12", width: 24, height: 12, "aria-hidden": "true" }, [swatch()].flat()), words];
      if (!(key in bev.show)) return h("span", { class: "entry" }, content);
      return h("button", { type: "button", class: "entry", "aria-pressed": String(bev.show[key]), title: `${bev.show[key] ? "Hide" : "Show"}: ${words}`, onclick: () => this.toggle(key) }, content);
    }));
  }

  toggle(key) {
    this.bev.show[key] = !this.bev.show[key];
    this.bev.draw();
    this.draw();
  }
}
