// Views, theme and keys.

const KEYS = [
  ["1  2  3", "Overview, Histograms, Scenarios"], ["space", "play or stop"], ["←  →", "0.1 s back or forward; with shift 1 s"],
  ["↑  ↓", "previous or next scenario"], ["[  ]", "previous or next planning call"], ["Home  End", "start or end of the simulation"],
  ["+  −", "zoom; also with the mouse wheel"], ["0", "back to the ego and the initial zoom"], ["r", "heading up or north up"],
  ["t", "refused plans on or off"], ["e", "path of the recorded ego on or off"], ["l", "list of scenarios, on narrow screens"], ["d", "light or dark"], ["?", "this list"],
];

let scenarios = null;
let histograms = null;

/** `#overview`, `#histograms`, `#scenarios`, `#scenarios/RUN/NUMBER/SECONDS` or `#scenarios/type/TYPE`. */
async function route() {
  const [view, ...place] = decodeURIComponent(location.hash.slice(1)).split("/");
  const name = ["overview", "histograms", "scenarios"].includes(view) ? view : "overview";
  for (const section of document.querySelectorAll(".view")) section.hidden = section.id !== name;
  for (const link of document.querySelectorAll(".tabs a")) {
    link.toggleAttribute("aria-current", link.dataset.view === name);
  }
  document.body.dataset.view = name;
  if (name !== "scenarios") scenarios.player.pause();
  scenarios.openList(false);
  if (name === "histograms") await histograms.show();
  if (name === "scenarios") await openPlace(place);
}

async function openPlace([first, second, time]) {
  if (first === "type") {
    scenarios.list.find(spaced(second));
    const simulation = INDEX.simulations.find((d) => d.type === second && d.entrant === (scenarios.simulation?.entrant ?? INDEX.entrants[0]));
    return void await scenarios.open(simulation ?? INDEX.simulations[0]);
  }
  const wanted = INDEX.simulations.find((simulation) => simulation.run === Number(first) && simulation.number === Number(second) && second !== undefined);
  const simulation = wanted ?? scenarios.simulation ?? worstReplay();
  await scenarios.open(simulation, wanted ? Number(time) || 0 : scenarios.player.time);
  scenarios.bev.resize();
}

function theme(dark) {
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  scenarios?.bev.readColors();
  scenarios?.bev.draw();
  scenarios?.list.thumbnails.recolor();
}

/** The colors of the theme by the names of their properties, with the typeface. */
function themeColors() {
  const style = getComputedStyle(document.documentElement);
  const names = ["ground", "drivable", "road", "route", "centerline", "crosswalk", "stop", "ego", "vehicle", "bicycle", "pedestrian",
    "static", "tried", "expert", "ink", "ink-soft", "panel", "red", "green", "amber", "ghost", "sans"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function isDark() {
  return document.documentElement.dataset.theme === "dark";
}

function openHelp() {
  const dialog = document.getElementById("help");
  fill(dialog, h("h2", {}, "Keyboard"), h("table", {}, KEYS.map(([keys, what]) => h("tr", {},
    h("th", {}, keys.split("  ").map((key) => h("kbd", {}, key))), h("td", {}, what)))),
  h("form", { method: "dialog" }, h("button", {}, "Close")));
  if (!dialog.open) dialog.showModal();
}

/** The simulation that is shown first: of the first planner, the one with the lowest score, else any. */
function worstReplay() {
  const replays = worstFirst(INDEX.simulations.filter((simulation) => simulation.replay !== null));
  return replays.find(({ entrant }) => entrant === INDEX.entrants[0]) ?? replays[0] ?? INDEX.simulations[0];
}

/** Handles keys: some everywhere, some in a replay only. */
function keyed(event) {
  const typing = event.target.matches?.("input[type=search], select, textarea");
  if (typing || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const anywhere = {
    1: () => { location.hash = "overview"; }, 2: () => { location.hash = "histograms"; }, 3: () => { location.hash = "scenarios"; },
    d: () => theme(!isDark()), "?": openHelp,
  };
  const { player, bev } = scenarios;
  const toggle = (what) => () => scenarios.legend.toggle(what);
  const replaying = {
    " ": () => player.toggle(), ArrowLeft: () => player.step(event.shiftKey ? -10 : -1), ArrowRight: () => player.step(event.shiftKey ? 10 : 1),
    ArrowUp: () => scenarios.neighbor(-1), ArrowDown: () => scenarios.neighbor(1), "[": () => scenarios.call(-1), "]": () => scenarios.call(1),
    Home: () => player.seek(0), End: () => { player.pause(); player.seek(player.end); }, "+": () => bev.zoomBy(ZOOM.step), "=": () => bev.zoomBy(ZOOM.step),
    "-": () => bev.zoomBy(1 / ZOOM.step), 0: () => bev.recenter(), r: () => { bev.headingUp = !bev.headingUp; bev.draw(); },
    t: toggle("tried"), e: toggle("expert"), l: () => scenarios.openList(!scenarios.layout.classList.contains("listing")),
  };
  const action = anywhere[event.key] ?? (document.body.dataset.view === "scenarios" && scenarios.replay ? replaying[event.key] : null);
  if (!action) return;
  event.preventDefault();
  // A focused button would take the space bar for itself.
  if (event.key === " ") document.activeElement?.blur();
  action();
}

async function begin() {
  if (typeof DecompressionStream === "undefined") throw new Error("this browser cannot unpack the data of the page; use Chrome 111, Firefox 113, Safari 16.4 or later");
  theme(window.matchMedia("(prefers-color-scheme: dark)").matches);
  await loadIndex();
  showAbout();
  document.getElementById("theme").addEventListener("click", () => theme(!isDark()));
  document.getElementById("help-open").addEventListener("click", openHelp);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (event) => theme(event.matches));
  if (INDEX.simulations.length) await showViews();
  else showWaiting();
  document.body.dataset.ready = "true";
  if (LIVE) new Follower(document.getElementById("live-state")).follow();
}

/** Counts in the head of the page. */
function showAbout() {
  document.getElementById("about").textContent = `${counted(INDEX.scenarios.length, "scenario")}, ${counted(INDEX.simulations.length, "simulation")}`
    + (INDEX.replays < INDEX.simulations.length ? `, ${INDEX.replays} with replay` : "");
}

/** Builds the views. */
async function showViews() {
  scenarios = new Scenarios(document.getElementById("scenarios"));
  histograms = new Histograms(document.getElementById("histograms"));
  showOverview(document.getElementById("overview"));
  window.addEventListener("hashchange", () => route().catch(trouble));
  document.addEventListener("keydown", keyed, true);
  await route();
}

/** A run without a complete simulation, before there is anything to view. */
function showWaiting() {
  const overview = document.getElementById("overview");
  overview.hidden = false;
  fill(overview, h("div", { class: "page" }, runsLine(),
    h("p", { class: "waiting" }, "No simulation is complete yet. The page shows each as soon as it is.")));
}

function trouble(error) {
  const node = document.getElementById("trouble");
  node.hidden = false;
  node.textContent = `This page cannot be shown: ${error.message}`;
  console.error(error);
}

begin().catch(trouble);
