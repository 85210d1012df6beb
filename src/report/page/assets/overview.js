// Overview: final scores by planner and challenge, by scenario type and by metric; failed simulations.

/** Rows of a list before "Show all". */
const FIRST_ROWS = 12;

function showOverview(node) {
  const challenge = INDEX.challenges[0];
  const metricTable = h("div", {});
  const show = (chosen) => fill(metricTable, metricMeans(chosen));
  show(challenge);
  const options = INDEX.challenges.map((value) => ({ value, text: CHALLENGES[value].short, title: CHALLENGES[value].long }));
  fill(node, h("div", { class: "page" },
    runsLine(),
    h("h2", {}, "Final scores"),
    h("div", { class: "scroll" }, finalScores()),
    h("p", { class: "note" }, `nuPlan's scores × 100, mean over scenarios (${INDEX.challenges.map((c) => `${CHALLENGES[c].short}: ${CHALLENGES[c].long}`).join("; ")}). `
      + "Failed simulations do not count. The bars begin at 0; the best of a column is bold."),
    h("h2", {}, "By scenario type"),
    h("div", { class: "scroll" }, scenarioTypes()),
    h("div", { class: "heading" }, h("h2", {}, "By metric"), options.length > 1 ? choice("Challenge", options, challenge, show) : null),
    h("div", { class: "scroll" }, metricTable),
    h("h2", {}, "Failed simulations"), failedSimulations(),
    h("h2", {}, "Simulations with score 0"), zeroSimulations()));
}

function runsLine() {
  return h("ul", { class: "runs" }, INDEX.runs.map((run) => h("li", {}, h("b", {}, run.name),
    h("span", {}, [run.model ? `model ${run.model}` : null, `seed ${run.seed}`, `started ${run.started}`,
      run.simulations < run.planned ? `${run.simulations} of ${run.planned} simulations completed` : counted(run.simulations, "simulation"),
      `planagent ${run.version}`].filter(Boolean).join(" · ")))));
}

function aggregate(entrant, challenge, type = null) {
  return INDEX.aggregates.find((row) => row.run === entrant.run && row.planner === entrant.planner
    && row.challenge === challenge && (row.scenario_type ?? null) === type);
}

function entrantCell(entrant) {
  return h("th", { scope: "row" }, h("i", { class: "dot", style: `background:${colorOf(entrant)}` }), entrant.label);
}

function finalScores() {
  const best = Object.fromEntries(INDEX.challenges.map((challenge) =>
    [challenge, Math.max(...INDEX.entrants.map((entrant) => aggregate(entrant, challenge)?.score ?? -1))]));
  const head = h("tr", {}, h("th", {}, "planner"),
    INDEX.challenges.map((c) => h("th", { class: "number", title: CHALLENGES[c].long }, CHALLENGES[c].short)),
    ["simulations", "failed", "score 0", "ms/step", "ms/call p50", "p95"].map((name) => h("th", { class: "number" }, name)));
  const rows = INDEX.entrants.map((entrant) => {
    const simulations = INDEX.simulations.filter((simulation) => simulation.entrant === entrant);
    const timing = INDEX.timings.find((row) => row.run === entrant.run && row.planner === entrant.planner);
    const number = (text) => h("td", { class: "number" }, text);
    return h("tr", {}, entrantCell(entrant),
      INDEX.challenges.map((c) => {
        const score = aggregate(entrant, c)?.score ?? null;
        return h("td", { class: score !== null && score === best[c] ? "number gauge best" : "number gauge" },
          h("i", { style: `width:${100 * (score ?? 0)}%;background:${colorOf(entrant)}` }), h("span", {}, percent(score)));
      }),
      number(simulations.length), number(simulations.filter((d) => d.error !== null).length), number(simulations.filter((d) => d.score === 0).length),
      number(milliseconds(timing?.mean_iteration_ms)), number(milliseconds(timing?.planning_call_ms?.p50)), number(milliseconds(timing?.planning_call_ms?.p95)));
  });
  return h("table", { class: "scores" }, h("thead", {}, head), h("tbody", {}, rows));
}

function scenarioTypes() {
  const types = distinct(INDEX.simulations.map((simulation) => simulation.type)).sort();
  const groups = h("tr", {}, h("th", {}), h("th", {}), INDEX.entrants.map((entrant) =>
    h("th", { colspan: INDEX.challenges.length, class: "group" }, h("i", { class: "dot", style: `background:${colorOf(entrant)}` }), entrant.label)));
  const head = h("tr", {}, h("th", {}, "type"), h("th", { class: "number" }, "n"), INDEX.entrants.flatMap(() =>
    INDEX.challenges.map((c) => h("th", { class: "number", title: CHALLENGES[c].long }, CHALLENGES[c].short))));
  const rows = types.map((type) => {
    const count = distinct(INDEX.simulations.filter((simulation) => simulation.type === type).map((simulation) => simulation.scenario)).length;
    return h("tr", {}, h("th", { scope: "row" }, h("a", { href: `#scenarios/type/${type}` }, spaced(type))), h("td", { class: "number" }, count),
      INDEX.entrants.flatMap((entrant) => INDEX.challenges.map((c) => tinted(aggregate(entrant, c, type)?.score ?? null))));
  });
  return h("table", { class: "tinted" }, h("thead", {}, groups, head), h("tbody", {}, rows));
}

/** A cell; the lower the score, the darker. */
function tinted(score) {
  const share = score === null ? 0 : Math.min(1, (1 - score) / 0.6);
  return h("td", { class: "number", style: `--share:${(100 * share).toFixed(0)}%` }, percent(score));
}

function metricMeans(challenge) {
  const metrics = scoredMetrics(challenge);
  const weight = ({ weight: value }) => (value === null ? "×" : `${value}`);
  const head = h("tr", {}, h("th", {}, "planner"), metrics.map((metric) => h("th", { class: "number", title: metric.name },
    labelOf(metric.name), h("small", {}, metric.weight === null ? "multiplier" : `weight ${weight(metric)}`))));
  const rows = INDEX.entrants.map((entrant) => {
    const own = INDEX.simulations.filter((d) => d.entrant === entrant && d.challenge === challenge && d.score !== null);
    return h("tr", {}, entrantCell(entrant), metrics.map((metric) =>
      tinted(mean(own.map((simulation) => metricScore(simulation, metric.name)).filter((value) => value !== null)))));
  });
  return h("table", { class: "tinted" }, h("thead", {}, head), h("tbody", {}, rows));
}

function simulationLink(simulation) {
  const name = `${simulation.scenario}`;
  return h("a", { href: `#scenarios/${simulation.run}/${simulation.number}` }, name);
}

function failedSimulations() {
  const failed = INDEX.simulations.filter((simulation) => simulation.error !== null);
  if (!failed.length) return h("p", { class: "quiet" }, `None of the ${counted(INDEX.simulations.length, "simulation")} failed.`);
  return simulationList(failed, ["error"], (simulation) => [h("td", {}, simulation.error)]);
}

function zeroSimulations() {
  const zero = INDEX.simulations.filter((simulation) => simulation.score === 0);
  if (!zero.length) return h("p", { class: "quiet" }, "None.");
  return simulationList(zero, ["zeroed by"], (simulation) => [h("td", {}, simulation.zeroed_by.map(spaced).join(", "))]);
}

function simulationList(simulations, more, cells) {
  const body = h("tbody", {});
  const row = (simulation) => h("tr", {}, h("td", {}, simulationLink(simulation)), entrantCell(simulation.entrant),
    h("td", { title: CHALLENGES[simulation.challenge].long }, CHALLENGES[simulation.challenge].short), cells(simulation));
  body.append(...simulations.slice(0, FIRST_ROWS).map(row));
  const table = h("table", { class: "list" }, h("thead", {}, h("tr", {}, ["scenario", "planner", "challenge", ...more].map((name) => h("th", {}, name)))), body);
  if (simulations.length <= FIRST_ROWS) return table;
  const button = h("button", { type: "button", class: "more", onclick: () => {
    body.append(...simulations.slice(FIRST_ROWS).map(row));
    button.remove();
  } }, `Show all ${simulations.length}`);
  return h("div", {}, table, button);
}
