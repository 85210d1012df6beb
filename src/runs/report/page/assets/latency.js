// The latency of a planning call by round and part.

const TIMED = [
  ["environment", "environment"], ["image_encode", "image"], ["prefill", "prefill"], ["decode", "decode"],
  ["remote", "server"], ["reflection", "reflection"], ["other", "other"],
];

class Latency {
  constructor(node, onseek) {
    this.node = node;
    this.onseek = onseek;
    this.place = null;
  }

  open(replay) {
    this.replay = replay;
    this.place = null;
    this.node.hidden = !replay.calls.length;
  }

  at(iteration) {
    if (!this.replay?.calls.length) return;
    const place = callAt(this.replay, iteration);
    if (place === this.place) return;
    this.place = place;
    const call = this.replay.calls[place];
    if (!call) return void fill(this.node);
    const total = call.time.call.total || 1;
    fill(this.node,
      h("h4", {}, "Latency of this call", h("span", { class: "at" }, `${milliseconds(total)} ms`)),
      this.calls(place),
      h("div", { class: "waterfall" }, waterfall(call, total)),
      legend(call.time.call));
  }

  /** A bar for each call; its height is the latency. */
  calls(place) {
    const { calls } = this.replay;
    const max = Math.max(...calls.map((call) => call.time.call.total), 1e-9);
    return h("div", { class: "call-bars" }, calls.map((call, i) => h("button", {
      type: "button", "aria-current": i === place, title: `${fixed(call.at_s, 1)} s: ${milliseconds(call.time.call.total)} ms`,
      "aria-label": `Call at ${fixed(call.at_s, 1)} s`, onclick: () => this.onseek(call),
    }, h("i", { style: `height:${Math.max(4, (100 * call.time.call.total) / max)}%` }))));
  }
}

/** The rows of a call: the environment, then the rounds and the reflection of each attempt. */
function waterfall({ time, attempts }, total) {
  const rows = [];
  let at = 0;
  const row = (label, parts, first) => {
    const begin = at;
    const bars = parts.filter(([, ms]) => ms > 0).map(([kind, ms]) => {
      const bar = h("i", { class: `t-${kind}`, style: `left:${(100 * at) / total}%;width:${(100 * ms) / total}%`,
        title: `${kind.replace("_", " ")} ${milliseconds(ms)} ms` });
      at += ms;
      return bar;
    });
    rows.push(h("div", { class: first ? "first" : null }, h("span", { class: "what" }, label), h("span", { class: "lane" }, bars),
      h("span", { class: "ms" }, milliseconds(at - begin))));
  };
  row("environment", [["environment", time.call.environment]], false);
  time.attempts.forEach((attempt, i) => {
    attempt.rounds.forEach((round, k) => {
      const known = round.image_encode + round.prefill + round.decode + round.remote;
      const name = attempts[i]?.rounds[k]?.round.replace("_", " ") ?? `round ${k + 1}`;
      row(`${i + 1} ${name}`, [["image_encode", round.image_encode], ["prefill", round.prefill], ["decode", round.decode],
        ["remote", round.remote], ["other", Math.max(0, round.total - known)]], k === 0);
    });
    row(`${i + 1} reflection`, [["reflection", attempt.reflection]], false);
  });
  return rows;
}

function legend(parts) {
  const shown = TIMED.filter(([kind]) => kind === "other" || parts[kind] > 0);
  return h("p", { class: "legend" }, shown.map(([kind, label]) => h("span", {}, h("i", { class: `t-${kind}` }), label)));
}
