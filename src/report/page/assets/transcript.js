// Prompts, answers, planner codes and scores of the last planning call.

/** The parts of Reflection's score, in order. */
const PARTS = [
  ["no_collision", "collision"], ["drivable_area", "area"], ["driving_direction", "direction"],
  ["progress", "progress"], ["time_to_collision", "TTC"], ["comfort", "comfort"],
];

const ITERATIONS_A_SECOND = 10;

const OUTCOMES = {
  accepted: "accepted at once", rethought: "accepted after a rethink", exhausted: "all attempts refused",
  none: "no plan",
};

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
        h("h3", {}, `Planning call ${place + 1} of ${replay.calls.length}`, h("span", { class: "at" }, `${call.at_s.toFixed(1)} s`)),
        h("p", { class: `outcome ${outcome}` }, OUTCOMES[outcome], h("span", { class: "quiet" }, decisionWords(call)))),
      h("div", { class: "turn" }, h("button", go(-1), "‹"), h("button", go(1), "›")));
    const seen = this.showSeen(call);
    const attempts = call.attempts.map((attempt, i) => this.showAttempt(attempt, i, executed));
    fill(this.node, head, seen, ...attempts);
  }

  /** The image and the text of the model's prompt. */
  showSeen(call) {
    const image = this.replay.images[call.iteration];
    const source = image ? `data:image/png;base64,${image}` : null;
    const picture = image && h("button", { type: "button", class: "thumb", title: "The BEV map of the prompt",
      onclick: () => openPicture(source) }, h("img", { src: source, alt: "BEV map of the prompt", width: 72, height: 72 }));
    const text = call.scene_text && h("details", { class: "scene-text" },
      h("summary", {}, "Scene as text"), h("pre", {}, call.scene_text));
    return h("div", { class: "seen" }, picture, text);
  }

  showAttempt(attempt, i, executed) {
    const { reflection, code } = attempt;
    const isExecuted = i === executed;
    const threshold = INDEX.runs[this.replay.simulation.run].threshold;
    const judged = reflection
      ? h("span", { class: `verdict ${reflection.verdict}` }, h("b", {}, reflection.score.toFixed(2)),
        reflection.verdict === "execute" ? ` ≥ ${threshold} execute` : ` < ${threshold} rethink`)
      : h("span", { class: "verdict" }, "no reflection");
    const attributes = { class: `attempt ${isExecuted ? "executed" : ""}`, onmouseenter: () => this.onmark(i), onmouseleave: () => this.onmark(null) };
    return h("article", attributes,
      h("header", {}, h("h4", {}, `Attempt ${i + 1}`), isExecuted ? h("span", { class: "executed-tag" }, "executed") : null, judged),
      code ? h("code", { class: "planner-code" }, code.text) : h("p", { class: "quiet" }, "no planner code"),
      reflection ? partsTable(reflection.parts) : null,
      attempt.errors.length ? h("ul", { class: "errors" }, attempt.errors.map((error) => h("li", {}, errorWords(error)))) : null,
      h("ol", { class: "rounds" }, attempt.rounds.map(showRound)));
  }
}

function decisionWords({ decision, emergency_brakes: brakes, aborted_lane_change: aborted }) {
  const braked = brakes ? `; the emergency brake acted in ${counted(brakes, "step")}` : "";
  const words = {
    execute: () => `attempt ${decision.attempt + 1} is executed`,
    exhausted: () => `attempt ${decision.attempt + 1} is executed`,
    keep_active_plan: () => `the active plan is kept: ${decision.why}`,
    brake: () => `the ego brakes: ${decision.why}`,
    gated: () => "call skipped; PDM-Closed plans",
    rule_based: () => `PDM-Closed plans: ${decision.why}`,
  };
  const back = aborted == null ? "" : `; lane change aborted at ${(aborted / ITERATIONS_A_SECOND).toFixed(1)} s`;
  return (words[decision.kind]?.() ?? decision.kind) + back + braked;
}

/** The text of an error. */
function errorWords(error) {
  return typeof error === "string" ? error : error.message ?? JSON.stringify(error);
}

function partsTable(parts) {
  return h("dl", { class: "parts" }, PARTS.map(([key, label]) => {
    const value = parts[key];
    return h("div", { class: value < 1 ? (value === 0 ? "zero" : "short") : null }, h("dt", {}, label), h("dd", {}, partFigure(value)));
  }));
}

function showRound(round) {
  const prompt = h("details", {}, h("summary", {}, "prompt"), h("pre", {}, round.prompt));
  return h("li", {}, h("div", { class: "round-head" }, h("span", { class: "round-name" }, round.round), prompt), h("p", { class: "answer" }, round.answer));
}

function openPicture(source) {
  const dialog = document.getElementById("picture");
  fill(dialog, h("img", { src: source, alt: "BEV map of the prompt" }), h("form", { method: "dialog" }, h("button", {}, "Close")));
  dialog.showModal();
}
