// Elements, numbers and names.

/** An element with attributes and children. `on…` attributes are listeners; null children are ignored. */
function h(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  return completed(node, attributes, children);
}

/** The same for SVG. */
function s(tag, attributes = {}, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  return completed(node, attributes, children);
}

function completed(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "style") node.style.cssText = value;
    else node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}

/** Replaces the children of an element. */
function fill(node, ...children) {
  node.replaceChildren(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}

/** A score in [0, 1] times 100; a dash for none. */
function percent(score) {
  return score === null || score === undefined ? "–" : (100 * score).toFixed(2);
}

/** Milliseconds with three digits. */
function milliseconds(ms) {
  if (ms === null || ms === undefined) return "–";
  if (ms < 0.1) return ms.toFixed(4);
  if (ms < 10) return ms.toFixed(2);
  return ms < 100 ? ms.toFixed(1) : ms.toFixed(0);
}

/** A number for a chart, with few digits. */
function figure(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 100) return value.toFixed(0);
  if (size >= 10) return value.toFixed(1);
  return tidy(value.toFixed(2));
}

/** A part of a score: 0 and 1 without decimals. */
function partFigure(value) {
  return value === 0 || value === 1 ? String(value) : value.toFixed(2);
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
  if (name in known) return known[name];
  const bracket = /\[([^\]]*)\]/.exec(name || "");
  if (bracket) return known[bracket[1]] ?? bracket[1];
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
