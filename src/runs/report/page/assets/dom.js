// Elements, numbers and names.

/** Characters that a browser obeys instead of showing them: controls, writing direction, tags. Rust has the same list (`visible.rs`). */
const HIDDEN = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u061c\u180e\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\u{e0000}-\u{e007f}]/gu;
/** Attributes that a browser shows or reads out. */
const READ = ["title", "aria-label", "alt", "placeholder", "data-words"];

/** A text with its hidden characters as escapes. */
function visible(text) {
  const escaped = (unit) => `\\u${unit.charCodeAt(0).toString(16).padStart(4, "0")}`;
  return String(text).replace(HIDDEN, (found) => found.split("").map(escaped).join(""));
}

/** Children of an element: texts are shown, null is ignored. */
function children(list) {
  return list.flat().filter((child) => child !== null && child !== undefined).map((child) => (child instanceof Node ? child : visible(child)));
}

/** An element with attributes and children. `on…` attributes are listeners; null children are ignored. */
function h(tag, attributes = {}, ...inside) {
  const node = document.createElement(tag);
  return completed(node, attributes, inside);
}

/** The same for SVG. */
function s(tag, attributes = {}, ...inside) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  return completed(node, attributes, inside);
}

function completed(node, attributes, inside) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "style") node.style.cssText = value;
    else node.setAttribute(name, value === true ? "" : READ.includes(name) ? visible(value) : value);
  }
  node.append(...children(inside));
  return node;
}

/** Replaces the children of an element. */
function fill(node, ...inside) {
  node.replaceChildren(...children(inside));
  return node;
}

/** A number with decimals; a dash for what is none. A wild one is short. */
function fixed(value, digits) {
  if (typeof value !== "number" || !Number.isFinite(value)) return "–";
  return Math.abs(value) < 1e12 ? value.toFixed(digits) : value.toExponential(2);
}

/** A score in [0, 1] times 100; a dash for none. */
function percent(score) {
  return score === null || score === undefined ? "–" : fixed(100 * score, 2);
}

/** Milliseconds with three digits. */
function milliseconds(ms) {
  if (ms === null || ms === undefined) return "–";
  if (ms < 0.1) return fixed(ms, 4);
  if (ms < 10) return fixed(ms, 2);
  return fixed(ms, ms < 100 ? 1 : 0);
}

/** A number for a chart, with few digits. */
function figure(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 100) return fixed(value, 0);
  if (size >= 10) return value.toFixed(1);
  return tidy(value.toFixed(2));
}

/** A part of a score: 0 and 1 without decimals. */
function partFigure(value) {
  return value === 0 || value === 1 ? String(value) : fixed(value, 2);
}

/** No minus before zero. */
function tidy(text) {
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text;
}

/** A count with its word. */
function counted(count, word) {
  return `${count.toLocaleString("en")} ${word}${count === 1 ? "" : "s"}`;
}

/** The symbol of nuPlan's unit. */
function unitOf(name) {
  const known = {
    meters: "m", meters_per_second: "m/s", meters_per_second_squared: "m/s²", meters_per_second_cubed: "m/s³",
    radians_per_second: "rad/s", radians_per_second_squared: "rad/s²", boolean: "", bool: "", count: "", float: "",
    ratio: "", seconds: "s",
  };
  if (Object.hasOwn(known, name)) return known[name];
  const bracket = /\[([^\]]*)\]/.exec(name || "");
  if (bracket) return Object.hasOwn(known, bracket[1]) ? known[bracket[1]] : bracket[1];
  return name || "";
}

/** A name without underscores. */
function spaced(name) {
  return name.replaceAll("_", " ");
}

const CHALLENGES = {
  closed_loop_nonreactive_agents: { short: "NR", long: "closed loop, non-reactive agents", plain: "non-reactive" },
  closed_loop_reactive_agents: { short: "R", long: "closed loop, reactive agents", plain: "reactive" },
  open_loop_boxes: { short: "OL", long: "open loop", plain: "open loop" },
};

/** A group of buttons; one is pressed. */
function choice(label, options, chosen, onchoose) {
  const group = h("div", { class: "choice", role: "group", "aria-label": label });
  const press = (value) => {
    for (const button of group.children) button.setAttribute("aria-pressed", button.dataset.value === String(value));
  };
  for (const { value, text, title } of options) {
    const attributes = { type: "button", "data-value": value, title, onclick: () => { press(value); onchoose(value); } };
    group.append(h("button", attributes, text));
  }
  press(chosen);
  return group;
}

/** The values without duplicates, in order. */
function distinct(values) {
  return [...new Set(values)];
}

function mean(values) {
  return values.length ? values.reduce((sum, value) => sum + value, 0) / values.length : null;
}
