// Readable names of scenarios: nuPlan's type where there is one, else what the recorded ego does.

/** Changes of heading, degrees: less is straight, less is a bend, less is a turn. */
const TURNS = { straight: 20, bend: 50, turn: 140 };
/** The direction of a path's ends is taken over this distance, meters. */
const END_M = 4;
/** A shorter path is standing, meters. */
const STANDING_M = 2;
/** The type of recordings without one. */
const UNKNOWN_TYPE = "unknown";

/** The recorded ego's path of a scenario with its length and duration; null if no run has a replay of it. */
function sketchOf(scenario) {
  INDEX.sketches ??= new Map(INDEX.simulations.filter((d) => d.sketch).map((d) => [d.scenario, { ...points(d.sketch),
    meters: d.sketch.meters, seconds: d.sketch.ms / 1000 }]));
  return INDEX.sketches.get(scenario) ?? null;
}

/** Name and detail of a simulation's scenario, for people. */
function nameOf(simulation) {
  const { scenario, type } = simulation;
  const generated = /^generated\/([^/]+)\/([^~]+)(?:~(.+))?$/.exec(scenario);
  if (generated) {
    const [, kind, seed, change] = generated;
    const where = `generated, seed ${seed.replace("/", ", traffic ")}`;
    return change ? { name: capital(spaced(change)), detail: `${spaced(kind)}, ${where}` } : { name: capital(spaced(kind)), detail: where };
  }
  const known = type && type !== UNKNOWN_TYPE;
  const sketch = sketchOf(scenario);
  const path = sketch && `${sketch.meters < STANDING_M ? "" : `${sketch.meters} m in `}${fixed(sketch.seconds, 0)} s`;
  const name = known ? capital(spaced(type)) : sketch ? capital(maneuver(sketch)) : scenario;
  return { name, detail: [path, scenario === name ? null : scenario].filter(Boolean).join(", ") };
}

/** Name and detail in one line. */
function titleOf(simulation) {
  const { name, detail } = nameOf(simulation);
  return detail ? `${name} (${detail})` : name;
}

/** What a path does: it stands, goes straight, bends or turns. */
function maneuver(sketch) {
  if (sketch.meters < STANDING_M) return "standing";
  const turned = (180 / Math.PI) * wrapped(headingAt(sketch, true) - headingAt(sketch, false));
  const side = turned > 0 ? "left" : "right";
  const size = Math.abs(turned);
  if (size < TURNS.straight) return "straight";
  if (size < TURNS.bend) return `${side} bend`;
  return size < TURNS.turn ? `${side} turn` : "U-turn";
}

/** The heading of a path at its start or its end. */
function headingAt({ x, y }, atEnd) {
  const order = [...x.keys()];
  if (atEnd) order.reverse();
  const [first] = order;
  const far = order.find((i) => Math.hypot(x[i] - x[first], y[i] - y[first]) >= END_M) ?? order[order.length - 1];
  const [from, to] = atEnd ? [far, first] : [first, far];
  return Math.atan2(y[to] - y[from], x[to] - x[from]);
}

/** An angle in (−π, π]. */
function wrapped(angle) {
  return Math.atan2(Math.sin(angle), Math.cos(angle));
}

function capital(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}
