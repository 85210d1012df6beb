// Final scores with intervals and paired differences, and scores by scenario type.

/** Which scenes count, which entrant is subtracted and whether a person chose it (its label), and how types are shown. */
const COMPARED = { scope: "common", from: null, chosen: null, challenge: null, types: "chart" };

/** The comparison of a challenge. */
function comparisonOf(challenge) {
  return INDEX.comparisons.find((comparison) => comparison.challenge === challenge);
}

/** The scores of an entrant in a comparison, in the present scope; null if it has none. */
function scoresOf(comparison, entrant) {
  const own = comparison.entrants.find((each) => each.run === entrant.run && each.planner === entrant.planner);
  return own?.[hasScopes(comparison) ? COMPARED.scope : "all"] ?? null;
}

/** Whether some entrant completed scenes that another one did not. */
function hasScopes({ entrants, common }) {
  return common > 0 && entrants.some(({ all }) => (all?.scenes ?? 0) > common);
}

/** Score of one entrant minus that of another; null without a common scene. */
function differenceOf(comparison, entrant, from) {
  const place = ({ run, planner }) => comparison.entrants.findIndex((each) => each.run === run && each.planner === planner);
  const [one, other] = [place(entrant), place(from)];
  const found = comparison.differences.find((d) => d.of === one && d.from === other);
  if (found) return found;
  const inverse = comparison.differences.find((d) => d.of === other && d.from === one);
  return inverse ? { mean: -inverse.mean, low: -inverse.high, high: -inverse.low, scenes: inverse.scenes } : null;
}

/** PDM-Closed of a single run, else the first entrant. */
function usualReference() {
  const rules = INDEX.runs.length === 1 ? INDEX.entrants.find(({ planner }) => planner === "pdm-closed") : null;
  return rules ?? INDEX.entrants[0];
}

/** The section "Final scores". */
function finalScores() {
  COMPARED.from = INDEX.entrants.find(({ label }) => label === COMPARED.chosen) ?? usualReference();
  const node = h("section", { class: "final-scores" });
  const alsoInterplan = INDEX.metrics.some(({ kind }) => kind !== null) ? ", or interPlan's in scenes of its kinds" : "";
  const draw = () => fill(node,
    h("div", { class: "heading" }, h("h2", {}, "Final scores"), scopeChoice(redraw), referenceChoice(redraw)),
    scopeNote(),
    h("div", { class: "challenges" }, INDEX.challenges.map(scoreCard)),
    h("p", { class: "note" }, `nuPlan's score × 100${alsoInterplan}, the mean over scenes. The line around a dot and the numbers below a score are its 95 % bootstrap interval over scenes. `
      + "A difference is paired: only scenes that both planners completed count. Bold: its interval does not contain 0. Failed simulations do not count."));
  const redraw = () => {
    draw();
    document.dispatchEvent(new CustomEvent("scope"));
  };
  draw();
  return node;
}

function scopeChoice(redraw) {
  if (!INDEX.comparisons.some(hasScopes)) return null;
  return choice("Scenes", [{ value: "common", text: "common scenes" }, { value: "all", text: "all scenes" }], COMPARED.scope, (scope) => {
    COMPARED.scope = scope;
    redraw();
  });
}

function referenceChoice(redraw) {
  if (INDEX.entrants.length < 2) return null;
  return h("label", { class: "reference" }, "difference from ", h("select", { onchange: (event) => {
    COMPARED.from = INDEX.entrants[event.target.selectedIndex];
    COMPARED.chosen = COMPARED.from.label;
    redraw();
  } }, INDEX.entrants.map((entrant) => h("option", { selected: entrant === COMPARED.from }, entrant.label))));
}

/** How many scenes the entrants share. */
function scopeNote() {
  if (INDEX.entrants.length < 2) return null;
  const said = INDEX.comparisons.filter(({ entrants }) => entrants.length > 1).map((comparison) => {
    const { challenge, scenes, common, entrants } = comparison;
    const who = entrants.length === 2 ? "both planners" : `all ${entrants.length} planners`;
    const words = common === 0 ? `no scene was completed by ${who}; their scores are not comparable`
      : `${who} completed ${common === scenes ? (scenes === 1 ? "the scene" : `all ${scenes} scenes`) : `${common} of ${counted(scenes, "scene")}`}`;
    return { name: CHALLENGES[challenge].short, words };
  });
  if (!said.length) return null;
  const alike = said.every(({ words }) => words === said[0].words);
  const words = alike ? [said[0].words] : said.map(({ name, words: own }) => `${name}: ${own}`);
  const common = INDEX.comparisons.some(hasScopes);
  const scope = common ? (COMPARED.scope === "common" ? " Scores are on the common scenes." : " Scores are on all scenes that a planner completed.") : "";
  return h("p", { class: "scope-note" }, `${capital(words.join("; "))}.${scope}`);
}

/** The planners in a challenge: score, interval, difference. */
function scoreCard(challenge) {
  const comparison = comparisonOf(challenge);
  const rows = INDEX.entrants.map((entrant) => ({ entrant, scores: scoresOf(comparison, entrant) }));
  const known = rows.map(({ scores }) => scores).filter(Boolean);
  const axis = new ScoreAxis(known);
  return h("figure", { class: "score-card", "data-challenge": challenge },
    h("figcaption", {}, h("b", {}, CHALLENGES[challenge].short), " ", CHALLENGES[challenge].long),
    rows.map(({ entrant, scores }) => scoreRow(comparison, axis, entrant, scores)),
    h("div", { class: "score-row axis-row" }, h("span", { class: "who" }), axis.labels(), h("span", {}), h("span", {})));
}

function scoreRow(comparison, axis, entrant, scores) {
  const who = h("span", { class: "who", title: entrant.label }, h("i", { class: "dot", style: `background:${colorOf(entrant)}` }), entrant.label);
  if (!scores) return h("div", { class: "score-row" }, who, h("span", { class: "lane-of-scores" }), h("span", { class: "score-value" }, "–"), h("span", {}));
  const from = COMPARED.from;
  const difference = entrant === from ? null : differenceOf(comparison, entrant, from);
  const spread = difference && difference.scenes > 1;
  const clear = spread && (difference.low > 0 || difference.high < 0);
  return h("div", { class: "score-row", title: intervalWords(scores) }, who,
    h("span", { class: "lane-of-scores" }, axis.lines(), dotAndInterval(axis, scores, colorOf(entrant))),
    h("span", { class: "score-value" }, h("output", {}, fixed(scores.mean, 2)),
      h("small", {}, scores.scenes > 1 ? `${fixed(scores.low, 1)} to ${fixed(scores.high, 1)}` : counted(scores.scenes, "scene"))),
    INDEX.entrants.length < 2 ? h("span", {}) : h("span", { class: `difference${clear ? " clear" : ""}` },
      difference ? [h("output", {}, signed(difference.mean)), h("small", { title: counted(difference.scenes, "common scene") },
        spread ? `${signed(difference.low)} to ${signed(difference.high)}` : counted(difference.scenes, "scene"))] : h("small", {}, entrant === from ? "reference" : "no common scene")));
}

/** The section "By scenario type": a chart or numbers. */
function scenarioTypes(challenge) {
  const comparison = comparisonOf(challenge);
  const types = distinct(INDEX.simulations.filter((d) => d.challenge === challenge).map((d) => d.type)).sort();
  return COMPARED.types === "chart" ? typeChart(comparison, types) : h("div", { class: "scroll" }, typeTable(comparison, types));
}

function typeLink(type) {
  return h("a", { href: `#scenarios/type/${type}` }, type === UNKNOWN_TYPE ? "Recordings without a type" : capital(spaced(type)));
}

function scenesOfType(comparison, type) {
  return Math.max(0, ...INDEX.entrants.map((entrant) => scoresOf(comparison, entrant)?.types[type]?.scenes ?? 0));
}

/** A line of dots for each type, the planners below each other. */
function typeChart(comparison, types) {
  const of = (type) => INDEX.entrants.map((entrant) => ({ entrant, interval: scoresOf(comparison, entrant)?.types[type] })).filter(({ interval }) => interval);
  const axis = new ScoreAxis(types.flatMap((type) => of(type).map(({ interval }) => interval)));
  const axisRow = () => h("div", { class: "type-row axis-row" }, h("span", {}), h("span", {}), axis.labels());
  return h("figure", { class: "type-chart" },
    types.map((type) => h("div", { class: "type-row" }, h("span", { class: "type-name" }, typeLink(type)),
      h("span", { class: "count" }, counted(scenesOfType(comparison, type), "scene")),
      h("div", { class: "type-lanes" }, axis.lines(), of(type).map(({ entrant, interval }) =>
        h("div", { class: "type-lane", title: `${entrant.label}: ${intervalWords(interval)}` }, dotAndInterval(axis, interval, colorOf(entrant))))))),
    axisRow(), entrantLegend());
}

function entrantLegend() {
  return h("p", { class: "legend" }, INDEX.entrants.map((entrant) =>
    h("span", {}, h("i", { style: `background:${colorOf(entrant)}` }), entrant.label)));
}

function typeTable(comparison, types) {
  const head = h("tr", {}, h("th", {}, "type"), h("th", { class: "number" }, "scenes"), INDEX.entrants.map(entrantHead));
  const rows = types.map((type) => h("tr", {}, h("th", { scope: "row" }, typeLink(type)), h("td", { class: "number" }, scenesOfType(comparison, type)),
    INDEX.entrants.map((entrant) => {
      const interval = scoresOf(comparison, entrant)?.types[type];
      return tinted(interval ? interval.mean / 100 : null, interval && intervalWords(interval));
    })));
  return h("table", { class: "tinted" }, h("thead", {}, head), h("tbody", {}, rows));
}

/** The head of an entrant's column. */
function entrantHead(entrant) {
  return h("th", { class: "number entrant-head", title: entrant.label }, h("i", { class: "dot", style: `background:${colorOf(entrant)}` }), entrant.label);
}
