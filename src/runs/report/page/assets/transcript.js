// Prompts, answers, planner codes and scores of the last planning call.

/** The parts of Reflection's score, in order. */
const PARTS = [
  ["no_collision", "collision"], ["drivable_area", "area"], ["driving_direction", "direction"],
  ["progress", "progress"], ["time_to_collision", "TTC"], ["comfort", "comfort"],
];

/** What is executed behind a list of waypoints. */
const ONWARD = "Behind the last waypoint the ego keeps its speed along its lane.";

class Transcript {
  /** Calls `onmark(attempt | null)` when the pointer enters or leaves an attempt, `onseek(call)` to show another call. */
  constructor(node, { onmark, onseek }) {
    this.node = node;
    this.onmark = onmark;
    this.onseek = onseek;
    this.replay = null;
    this.place = null;
  }

  open(replay) {
    this.replay = replay;
    this.place = null;
    if (!replay.calls.length) this.showNone();
  }

  /** Shows the last call up to an iteration. */
  at(iteration) {
    if (!this.replay?.calls.length) return;
    const place = callAt(this.replay, iteration);
    if (place === this.place) return;
    this.place = place;
    this.onmark(null);
    if (place < 0) fill(this.node, h("p", { class: "quiet" }, "No planning call yet."));
    else this.showCall(this.replay.calls[place]);
    this.node.scrollTop = 0;
  }

  showNone() {
    const { planner } = this.replay.simulation;
    fill(this.node, h("p", { class: "quiet" }, `${planner} uses no language model: it made no planning calls.`));
  }

  showCall(call) {
    const { replay, place } = this;
    this.node.dataset.iteration = call.iteration;
    const executed = executedAttempt(call);
    const outcome = outcomeOf(call);
    const go = (by) => ({
      type: "button", class: "plain", "aria-label": by < 0 ? "Previous call" : "Next call",
      disabled: !replay.calls[place + by], onclick: () => this.onseek(replay.calls[place + by]),
    });
    const head = h("header", { class: "call-head" },
      h("div", {},
        h("h3", {}, `Planning call ${place + 1} of ${replay.calls.length}`, h("span", { class: "at" }, `${fixed(call.at_s, 1)} s`)),
        h("p", { class: `outcome ${outcome}` }, OUTCOMES[outcome])),
      h("div", { class: "turn" }, h("button", go(-1), "‹"), h("button", go(1), "›")));
    const seen = this.showSeen(call);
    const decided = h("p", { class: `decision ${outcome}` }, decisionWords(call, INDEX.runs[replay.simulation.run]));
    const attempts = call.attempts.map((attempt, i) => this.showAttempt(call, i, executed));
    fill(this.node, head, decided, seen, ...attempts);
  }

  /** The image and the text of the model's prompt. */
  showSeen(call) {
    const image = this.replay.images[call.iteration];
    const source = image ? `data:image/png;base64,${image}` : null;
    const picture = image && h("button", { type: "button", class: "thumb", title: "The BEV map of the prompt",
      onclick: () => openPicture(source) }, h("img", { src: source, alt: "BEV map of the prompt", width: 72, height: 72 }));
    const text = call.scene_text && h("details", { class: "scene-text" },
      h("summary", {}, "Scene as text"), h("pre", {}, call.scene_text));
    return h("div", { class: "seen" }, picture, h("div", { class: "scene-texts" }, text, showKey(this.replay.key)));
  }

  showVerdict(attempt) {
    const { reflection } = attempt;
    if (!reflection) return h("span", { class: "verdict" }, "no reflection");
    const { value, note } = thresholdOf(attempt, this.replay.simulation);
    const passes = reflection.verdict === "execute";
    return h("span", { class: `verdict ${reflection.verdict}` }, h("b", {}, fixed(reflection.score, 2)),
      value === null ? null : ` ${passes ? "≥" : "<"} ${value}${note}`, h("em", {}, passes ? "accepted" : "refused"));
  }

  showAttempt(call, i, executed) {
    const attempt = call.attempts[i];
    const { reflection, code } = attempt;
    const repeat = attempt.is_further ? null : repeatOf(call.attempts, i);
    const isRefused = reflection?.verdict === "rethink";
    const state = i === executed ? (isRefused ? "refused executed" : "executed") : "";
    const tag = i === executed ? h("span", { class: "executed-tag" }, isRefused ? "executed although refused" : "executed") : null;
    const attributes = { class: `attempt ${state}`, onmouseenter: () => this.onmark(i), onmouseleave: () => this.onmark(null) };
    return h("article", attributes,
      h("header", {}, h("h4", {}, `Attempt ${i + 1}${attempt.is_further ? ": further codes, of the agent itself" : ""}`), tag, this.showVerdict(attempt)),
      repeat ? h("p", { class: "repeats" }, repeatWords(repeat)) : null,
      repeat ? null : code ? h("code", { class: "planner-code" }, code.text) : h("p", { class: "quiet" }, "no plan was read"),
      code?.waypoints && i === executed ? h("p", { class: "onward" }, ONWARD) : null,
      reflection && !repeat ? partsTable(reflection.parts) : null,
      reflection && !repeat ? showBehaviors(reflection) : null,
      attempt.proposals?.length ? proposalsTable(attempt.proposals) : null,
      attempt.errors.length ? h("ul", { class: "errors" }, attempt.errors.map((error) => h("li", {}, errorWords(error)))) : null,
      repeat?.whole ? h("details", {}, h("summary", {}, "prompts and answers"), showRounds(attempt)) : showRounds(attempt));
  }
}

/** What the words of compact texts mean; none for texts in sentences. */
function showKey(tables) {
  if (!tables.length) return null;
  const words = (text) => text.split("`").map((part, i) => (i % 2 ? h("code", {}, part) : part));
  const rows = ({ title, rows }) => h("table", {},
    h("thead", {}, h("tr", {}, h("th", {}, words(title)), h("th", {}, "meaning"))),
    h("tbody", {}, rows.map(([word, meaning]) => h("tr", {}, h("td", {}, words(word)), h("td", {}, words(meaning))))));
  return h("details", { class: "text-key" }, h("summary", {}, "Key to the compact texts"), tables.map(rows));
}

function showRounds({ rounds }) {
  return h("ol", { class: "rounds" }, rounds.map(showRound));
}

function repeatWords({ of, whole }) {
  return whole ? `The model repeated attempt ${of + 1}: the same answers, the same code and the same score.`
    : `The model wrote the code of attempt ${of + 1} again, after other answers.`;
}

/** The text of an error. */
function errorWords(error) {
  return typeof error === "string" ? error : error.message ?? JSON.stringify(error);
}

/** The score of a plan where crossing traffic does not keep its course; nothing where that changes no score. */
function showBehaviors({ score, behaviors }) {
  if (!behaviors || [behaviors.yields, behaviors.insists].every((other) => fixed(other, 2) === fixed(score, 2))) return null;
  return h("p", { class: "behaviors" }, `if crossing traffic yields ${fixed(behaviors.yields, 2)}, if it insists ${fixed(behaviors.insists, 2)}`);
}

/** The lines that an attempt proposed, the likeliest first, with their scores by what crossing traffic does. */
function proposalsTable(proposals) {
  const cells = ({ reflection }) => [reflection?.score, reflection?.behaviors?.yields, reflection?.behaviors?.insists]
    .map((score) => h("td", {}, score === undefined ? "-" : fixed(score, 2)));
  const row = (proposal) => h("tr", {}, h("td", {}, h("code", {}, proposal.code.text)), cells(proposal));
  const head = h("tr", {}, ["code", "score", "yields", "insists"].map((word) => h("th", {}, word)));
  return h("details", {}, h("summary", {}, `${proposals.length} proposals`),
    h("table", { class: "proposals" }, h("thead", {}, head), h("tbody", {}, proposals.map(row))));
}

function partsTable(parts) {
  return h("dl", { class: "parts" }, PARTS.map(([key, label]) => {
    const value = parts[key];
    return h("div", { class: value < 1 ? (value === 0 ? "zero" : "short") : null }, h("dt", {}, label), h("dd", {}, partFigure(value)));
  }));
}

function showRound(round) {
  const prompt = h("details", {}, h("summary", {}, "prompt"), h("pre", {}, round.prompt));
  return h("li", {}, h("div", { class: "round-head" }, h("span", { class: "round-name" }, round.round.replace("_", " ")), prompt), h("p", { class: "answer" }, round.answer), showTool(round.tool));
}

/** The tool that a round called, and what it gave. */
function showTool(tool) {
  if (!tool) return null;
  return h("details", { class: tool.failed ? "tool failed" : "tool", open: tool.failed },
    h("summary", {}, h("code", {}, `${tool.function} ${tool.arguments}`), tool.failed ? " was refused" : null), h("pre", {}, tool.result));
}

function openPicture(source) {
  const dialog = document.getElementById("picture");
  fill(dialog, h("img", { src: source, alt: "BEV map of the prompt" }), h("form", { method: "dialog" }, h("button", {}, "Close")));
  dialog.showModal();
}
