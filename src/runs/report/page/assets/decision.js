// The decision of a planning call: its outcome, what is executed, and why.

const ITERATIONS_A_SECOND = 10;

const OUTCOMES = {
  accepted: "accepted at once", rethought: "accepted after a rethink", exhausted: "all attempts refused",
  none: "no plan",
};

/** The executed attempt of a call, or null. */
function executedAttempt(call) {
  const { kind, attempt } = call.decision;
  return kind === "execute" || kind === "exhausted" ? attempt : null;
}

/** The first attempt that an attempt repeats, and whether with all its answers; null if it is new. */
function repeatOf(attempts, index) {
  const { code, rounds } = attempts[index];
  if (!code) return null;
  const before = attempts.slice(0, index);
  const answers = (attempt) => JSON.stringify(attempt.rounds.map((round) => round.answer));
  const whole = rounds.length ? before.findIndex((other) => other.code?.text === code.text && answers(other) === answers(attempts[index])) : -1;
  if (whole >= 0) return { of: whole, whole: true };
  const of = before.findIndex((other) => other.code?.text === code.text);
  return of < 0 ? null : { of, whole: false };
}

/** The accepted attempt of a call, or null. */
function acceptedAttempt({ decision }) {
  return decision.kind === "execute" ? decision.attempt : null;
}

/** Whether Reflection refused every attempt of a call. */
function allRefused({ decision, attempts }) {
  return decision.kind === "exhausted" || (attempts.length > 0 && ["worse", "outscored"].includes(decision.cause));
}

/** The outcome of a call: `accepted`, `rethought`, `exhausted` or `none`. */
function outcomeOf(call) {
  if (call.decision.kind === "execute") return call.attempts.length > 1 ? "rethought" : "accepted";
  return allRefused(call) ? "exhausted" : "none";
}

/** What is executed after a call, and why; `run` has the settings. */
function decisionWords(call, run) {
  const { decision, emergency_brakes: brakes, aborted_lane_change: aborted, evasion, iteration } = call;
  const words = {
    execute: () => `Attempt ${decision.attempt + 1} is executed.`,
    exhausted: () => refusedWords(call, run),
    keep_active_plan: () => (decision.cause === "worse" ? "The active plan is kept, because it is better than each attempt." : `The active plan is kept: ${decision.why}.`),
    brake: () => `The ego brakes: ${decision.why}.`,
    gated: () => "The call was skipped; PDM-Closed plans.",
    rule_based: () => (decision.cause === "outscored" ? "PDM-Closed plans, because its own proposal scores no less." : `PDM-Closed plans: ${decision.why}.`),
  };
  const kept = decision.kind === "exhausted" && aborted === iteration;
  return [words[decision.kind]?.() ?? decision.kind,
    kept ? "A refused plan must not begin a lane change, so the ego keeps its lane." : null,
    aborted == null || kept ? null : `Lane change aborted at ${(aborted / ITERATIONS_A_SECOND).toFixed(1)} s.`,
    evasion == null ? null : `The ego swerved into a lane beside for a person or a bicycle at ${(evasion / ITERATIONS_A_SECOND).toFixed(1)} s.`,
    call.handovers ? `A proposal of PDM-Closed drove in ${counted(call.handovers, "step")}, because it scored more than the plan, which scored less than the threshold.` : null,
    brakes ? `The emergency brake acted in ${counted(brakes, "step")}.` : null].filter(Boolean).join(" ");
}

/** The refused attempt that is executed, and why. */
function refusedWords({ decision, attempts }, run) {
  const number = decision.attempt + 1;
  const chosen = attempts[decision.attempt].reflection;
  const is = chosen ? `Attempt ${number}, with ${fixed(chosen.score, 2)},` : `Attempt ${number}`;
  const expected = ({ score, behaviors }) => behaviors?.expected ?? score;
  const among = (is) => chosen && attempts.some(({ reflection }) => reflection && is(reflection));
  const isBest = chosen && !among((one) => expected(one) > expected(chosen));
  const byMean = among((one) => one.score >= chosen.score && expected(one) < expected(chosen));
  const [first] = attempts;
  const oneCode = attempts.length > 1 && first.code && attempts.every(({ code }) => code?.text === first.code.text);
  const same = oneCode ? `All ${attempts.length} attempts have the same code. ` : "";
  const why = attempts.length === 1 || oneCode ? "there is no better plan" : run.after_max_exec === "last" || !isBest ? "it is the last one"
    : byMean ? "it scores most over what crossing traffic may do" : "no other attempt scores more";
  const monitored = run.monitoring ? " Monitoring scores it at every step and may execute a slower or lateral version, or a stop." : "";
  return `${same}${is} is executed all the same, because ${why}.${monitored}`;
}

/** The score that an attempt needs, and which threshold that is. */
function thresholdOf({ code, reflection }, simulation) {
  const { score, verdict } = reflection;
  const { keep_lane: keepLane, lane_change: laneChange, assist } = INDEX.runs[simulation.run].thresholds;
  if (code?.assistance) return { value: assist, note: "" };
  // A plan that reached the threshold and was refused, or the reverse, was held to that of lane changes and of staying in a blocked lane.
  const passes = score >= keepLane;
  return passes === (verdict === "execute") ? { value: keepLane, note: "" } : { value: laneChange, note: " for a lane change, or to stay in a blocked lane" };
}
