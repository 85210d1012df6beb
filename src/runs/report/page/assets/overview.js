// Overview: runs, final scores, times, scores by scenario type and by metric; failed simulations and the lowest scores.

/** Rows of a list before "Show all". */
const FIRST_ROWS = 12;
/** The lists that show all rows. */
const WHOLE_LISTS = new Set();

/** Ends the listeners of the last overview. */
let overviewEvents = null;

function showOverview(node) {
  overviewEvents?.abort();
  overviewEvents = new AbortController();
  if (!INDEX.challenges.includes(COMPARED.challenge)) COMPARED.challenge = INDEX.challenges[0];
  fill(node, h("div", { class: "page" },
    runsLine(),
    finalScores(),
    h("h2", {}, "Simulations and times"), figures(),
    scoresInDetail(),
    h("h2", {}, "Failed simulations"), failedSimulations(),
    h("h2", {}, "Lowest scores"), lowestScores()));
}

function runsLine() {
  return h("ul", { class: "runs" }, INDEX.runs.map((run) => h("li", {}, h("b", {}, run.name),
    h("span", {}, [run.model ? `model ${run.model}` : null, run.seed === null ? null : `seed ${run.seed}`, `started ${run.started}`,
      run.simulations < run.planned ? `${run.simulations} of ${run.planned} simulations completed` : counted(run.simulations, "simulation"),
      `planagent ${run.version}`].filter(Boolean).join(" · ")))));
}

function entrantCell(entrant) {
  return h("th", { scope: "row" }, h("i", { class: "dot", style: `background:${colorOf(entrant)}` }), entrant.label);
}

/** Counts and times of the planners. */
function figures() {
  const unplanned = (d) => (d.failed_calls ?? 0) + Object.values(d.unreadable_calls ?? {}).reduce((total, count) => total + count, 0);
  // Most runs need no such columns.
  const lost = INDEX.simulations.some((d) => unplanned(d) > 0) ? ["without a plan", "calls without a plan"] : [];
  const heads = ["simulations", "failed", ...lost.slice(0, 1), "score 0", "planning calls", "refused calls", ...lost.slice(1), "ms/step", "ms/call p50", "p95"];
  const rows = INDEX.entrants.map((entrant) => {
    const own = INDEX.simulations.filter((simulation) => simulation.entrant === entrant);
    const sum = (of) => own.reduce((total, simulation) => total + (of(simulation) ?? 0), 0);
    const calls = sum((d) => d.planning_calls);
    const timing = INDEX.timings.find((row) => row.run === entrant.run && row.planner === entrant.planner);
    const values = [own.length, own.filter((d) => d.error !== null).length,
      ...lost.slice(0, 1).map(() => own.filter((d) => d.without_plan).length), own.filter((d) => d.score === 0).length,
      calls || "–", calls ? sum((d) => d.refused_calls) : "–", ...lost.slice(1).map(() => (calls ? sum(unplanned) : "–")),
      milliseconds(timing?.mean_iteration_ms), milliseconds(timing?.planning_call_ms?.p50), milliseconds(timing?.planning_call_ms?.p95)];
    return h("tr", {}, entrantCell(entrant), values.map((value, i) => h("td", { class: "number", "data-head": heads[i] }, String(value))));
  });
  const titles = {
    "refused calls": "Planning calls in which Reflection refused all attempts",
    "without a plan": "Simulations with planning calls of which none gave a plan",
    "calls without a plan": "Planning calls without an answer, or with one that gave no plan",
  };
  return h("div", { class: "scroll" }, h("table", { class: "figures stacking" },
    h("thead", {}, h("tr", {}, h("th", {}, "planner"), heads.map((name) => h("th", { class: "number", title: titles[name] }, name)))), h("tbody", {}, rows)));
}

/** Scores by type and by metric in one challenge. */
function scoresInDetail() {
  const node = h("div", {});
  const challenges = INDEX.challenges.map((value) => ({ value, text: CHALLENGES[value].short, title: CHALLENGES[value].long }));
  const challengeChoice = () => (challenges.length < 2 ? null : choice("Challenge", challenges, COMPARED.challenge, (challenge) => {
    COMPARED.challenge = challenge;
    draw();
  }));
  const draw = () => fill(node,
    h("div", { class: "heading" }, h("h2", {}, "By scenario type"),
      choice("Form", [{ value: "chart", text: "chart" }, { value: "table", text: "numbers" }], COMPARED.types, (form) => {
        COMPARED.types = form;
        draw();
      }), challengeChoice()),
    scenarioTypes(COMPARED.challenge),
    h("div", { class: "heading" }, h("h2", {}, "By metric"), challengeChoice()),
    h("div", { class: "scroll" }, metricMeans(COMPARED.challenge)),
    h("p", { class: "note" }, "Means over all completed scenes × 100; the lower, the stronger the tint."));
  document.addEventListener("scope", draw, { signal: overviewEvents.signal });
  draw();
  return node;
}

/** A cell; the lower the score in [0, 1], the darker. */
function tinted(score, title = null) {
  const share = score === null ? 0 : Math.min(1, (1 - score) / 0.6);
  return h("td", { class: "number", style: `--share:${(100 * share).toFixed(0)}%`, title }, percent(score));
}

function metricMeans(challenge) {
  const head = h("tr", {}, h("th", {}, "metric"), h("th", { class: "number" }, "weight"), INDEX.entrants.map(entrantHead));
  const rows = metricsOf(challenge).map((metric) => h("tr", {},
    h("th", { scope: "row", title: metric.name }, capital(metricTitle(metric.name))),
    h("td", { class: "number quiet" }, metric.weights.map((weight) => weight ?? "×").join(" or ")),
    INDEX.entrants.map((entrant) => {
      const own = INDEX.simulations.filter((d) => d.entrant === entrant && d.challenge === challenge && d.score !== null);
      return tinted(mean(own.map((simulation) => metricScore(simulation, metric.name)).filter((value) => value !== null)));
    })));
  return h("table", { class: "tinted" }, h("thead", {}, head), h("tbody", {}, rows));
}

function simulationLink(simulation) {
  return h("a", { href: hashOf(simulation, 0), title: simulation.scenario }, titleOf(simulation));
}

function failedSimulations() {
  const failed = INDEX.simulations.filter((simulation) => simulation.error !== null);
  if (!failed.length) return h("p", { class: "quiet" }, "No simulation failed.");
  return simulationList(failed, "error", (simulation) => simulation.error);
}

/** Completed simulations with a score below 100, the lowest first. */
function lowestScores() {
  const completed = INDEX.simulations.filter((simulation) => simulation.score !== null);
  const lower = worstFirst(completed).filter((simulation) => simulation.score < 1);
  if (!completed.length) return h("p", { class: "quiet" }, "No simulation is complete.");
  if (!lower.length) return h("p", { class: "quiet" }, "Every simulation has a score of 100.");
  return simulationList(lower, "because of", whyLow, (simulation) => percent(simulation.score));
}

/** The metrics that made a score 0, else those below 1 with their values. */
function whyLow(simulation) {
  if (simulation.score === 0 && simulation.zeroed_by.length) return simulation.zeroed_by.map(metricTitle).join(", ");
  const below = scoredMetrics(simulation).filter(({ name }) => (metricScore(simulation, name) ?? 1) < 1);
  return below.map(({ name }) => `${metricTitle(name)} ${partFigure(metricScore(simulation, name))}`).join(", ");
}

function simulationList(simulations, last, words, score = null) {
  const body = h("tbody", {});
  const row = (simulation) => h("tr", {}, h("td", {}, simulationLink(simulation)), entrantCell(simulation.entrant),
    h("td", { title: CHALLENGES[simulation.challenge].long, "data-head": "challenge" }, CHALLENGES[simulation.challenge].short),
    score ? h("td", { class: "number", "data-head": "score" }, score(simulation)) : null, h("td", { "data-head": last }, words(simulation)));
  const first = WHOLE_LISTS.has(last) ? simulations.length : FIRST_ROWS;
  body.append(...simulations.slice(0, first).map(row));
  const table = h("table", { class: "list stacking" }, h("thead", {}, h("tr", {}, ["scenario", "planner", "challenge", score ? "score" : null, last].filter(Boolean).map((name) => h("th", { class: name === "score" ? "number" : null }, name)))), body);
  if (simulations.length <= first) return h("div", { class: "scroll" }, table);
  const button = h("button", { type: "button", class: "more", onclick: () => {
    WHOLE_LISTS.add(last);
    body.append(...simulations.slice(first).map(row));
    button.remove();
  } }, `Show all ${simulations.length}`);
  return h("div", {}, h("div", { class: "scroll" }, table), button);
}
