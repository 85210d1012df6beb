// The data of the page: an index of runs and simulations, and packed replays.

/** Units of the delta-coded values of a replay: meters, radians, m/s. */
const LENGTH = 0.01;
const ANGLE = 0.001;
const RATE = 0.01;
const VELOCITY = 0.1;
/** Maximum number of unpacked replays. */
const MAX_UNPACKED = 24;

/** Whether a server has the data of the page (`planagent serve`). */
const LIVE = document.getElementById("live") !== null;

/** The index; filled by `loadIndex`. */
let INDEX = null;

/** The value in a packed element: base64 of gzip of JSON. The server of a live page has it by the same name. */
async function unpack(id) {
  if (LIVE) return received(id);
  const text = document.getElementById(id).textContent.trim();
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).json();
}

/** Asks the server for a value. */
async function received(name) {
  const response = await fetch(`data/${name}`, { cache: "no-store" });
  if (!response.ok) throw new Error((await response.text()).trim());
  return response.json();
}

/** Reads the index and gives each simulation its entrant: a planner of a run. */
async function loadIndex() {
  INDEX = await unpack("index");
  const inSeveral = (planner) => INDEX.runs.filter((run) => run.planners.includes(planner)).length > 1;
  INDEX.entrants = [];
  // The order of the runs, so that colors stay while simulations finish in any order.
  const named = INDEX.runs.flatMap((run, i) => run.planners.map((planner) => `${i} ${planner}`));
  const placeOf = (run, planner) => named.indexOf(`${run} ${planner}`);
  for (const simulation of INDEX.simulations) {
    let entrant = INDEX.entrants.find((known) => known.run === simulation.run && known.planner === simulation.planner);
    if (!entrant) {
      const { planner, run } = simulation;
      const label = inSeveral(planner) ? `${planner} · ${INDEX.runs[run].name}` : planner;
      entrant = { run, planner, label, place: placeOf(run, planner) };
      INDEX.entrants.push(entrant);
    }
    const { id, scenario_type: type, score = null, error = null } = simulation;
    Object.assign(simulation, { entrant, scenario: id, type, score, error });
  }
  INDEX.entrants.sort((one, other) => one.place - other.place);
  const challenges = distinct(INDEX.simulations.map((simulation) => simulation.challenge));
  for (const challenge of challenges) CHALLENGES[challenge] ??= ownAgents(challenge);
  const order = Object.keys(CHALLENGES);
  INDEX.challenges = challenges.sort((one, other) => order.indexOf(one) - order.indexOf(other));
  INDEX.scenarios = distinct(INDEX.simulations.map((simulation) => simulation.id));
}

/** The words for a closed loop with agents under a policy of the user, which is no challenge of nuPlan's. */
function ownAgents(challenge) {
  const name = challenge.replace(/^closed_loop_own_agents_/, "");
  return { short: name, long: `closed loop, agents under the policy ${name}; no challenge of nuPlan`, plain: name };
}

/** Simulations by their scores, failed ones and the lowest first. */
function worstFirst(simulations) {
  return [...simulations].sort((one, other) => (one.score ?? -1) - (other.score ?? -1));
}

/** The color of an entrant: one of eight that color-blind readers can tell apart (Okabe and Ito). */
function colorOf(entrant) {
  return `var(--c${entrant.place % 8})`;
}

/** The metrics of the score of a simulation: interPlan's in a modified scenario of its kinds. */
function scoredMetrics(simulation) {
  const list = simulation.challenge === "open_loop_boxes" ? "open_loop" : "closed_loop";
  return INDEX.metrics.filter((metric) => metric.list === list && metric.kind === simulation.kind);
}

/** The metrics of the scores of a challenge by name, nuPlan's first, with all weights that they have there; the weight of a multiplier is null. */
function metricsOf(challenge) {
  const used = new Set(INDEX.simulations.filter((simulation) => simulation.challenge === challenge).flatMap(scoredMetrics));
  const weights = new Map();
  for (const metric of INDEX.metrics.filter((metric) => used.has(metric))) {
    weights.set(metric.name, (weights.get(metric.name) ?? new Set()).add(metric.weight));
  }
  return [...weights].map(([name, of]) => ({ name, weights: [...of].sort((one, other) => (one ?? 0) - (other ?? 0)) }));
}

/** The short label of a metric. */
function labelOf(name) {
  return INDEX.metrics.find((metric) => metric.name === name)?.label ?? spaced(name);
}

/** The words for a metric where there is room. */
function metricTitle(name) {
  const known = {
    no_ego_at_fault_collisions: "no at-fault collision", drivable_area_compliance: "drivable area", driving_direction_compliance: "driving direction",
    ego_is_making_progress: "making progress", time_to_collision_within_bound: "time to collision", speed_limit_compliance: "speed limit",
    ego_progress_along_expert_route: "progress along the expert's route", ego_is_comfortable: "comfort",
    ego_sorts_construction_zone: "past the construction zone", ego_sorts_stopped_vehicle: "past the stopped vehicle",
    ego_sorts_jaywalking_pedestrian: "past the pedestrian",
  };
  return Object.hasOwn(known, name) ? known[name] : spaced(name);
}

/** The score of a metric of a simulation. */
function metricScore(simulation, name) {
  return Object.hasOwn(simulation, name) ? simulation[name] : null;
}

/** The values of delta-coded integers. */
function undelta(deltas, unit) {
  const values = new Float64Array(deltas.length);
  let sum = 0;
  deltas.forEach((delta, i) => {
    sum += delta;
    values[i] = sum * unit;
  });
  return values;
}

function points({ x, y }) {
  return { x: undelta(x, LENGTH), y: undelta(y, LENGTH) };
}

/** Unpacked replays by their numbers in the index. */
const unpacked = new Map();

/** The replay of a simulation; null if the page has none. */
async function replayOf(simulation) {
  if (simulation.replay === null) return null;
  const number = simulation.replay;
  if (!unpacked.has(number)) {
    unpacked.set(number, readReplay(simulation));
    if (unpacked.size > MAX_UNPACKED) unpacked.delete(unpacked.keys().next().value);
  }
  return unpacked.get(number);
}

async function readReplay(simulation) {
  const [packed, map, images] = await Promise.all([
    unpack(`simulation-${simulation.replay}`),
    mapOf(simulation.map),
    simulation.images === null ? {} : unpack(`images-${simulation.images}`),
  ]);
  const { replay, calls, series, key } = packed;
  const { ego } = replay;
  return {
    simulation, map, images,
    times: undelta(replay.times_ms, 1e-3),
    ego: {
      ...points(ego), heading: undelta(ego.heading, ANGLE), speed: undelta(ego.speed, RATE),
      acceleration: undelta(ego.acceleration, RATE), yawRate: undelta(ego.yaw_rate, RATE),
    },
    expert: points(replay.expert),
    agents: replay.agents.map((agent) => ({
      token: agent.token, kind: agent.kind, from: agent.from, to: agent.from + agent.x.length - 1,
      length: agent.length * LENGTH, width: agent.width * LENGTH, ...points(agent),
      heading: undelta(agent.heading, ANGLE), vx: undelta(agent.vx, VELOCITY), vy: undelta(agent.vy, VELOCITY),
    })),
    lights: replay.lights,
    plans: replay.plans.map(points),
    calls: calls.map((call) => {
      const tracks = replay.calls.find((track) => track.iteration === call.iteration)?.attempts ?? [];
      return { ...call, tracks: tracks.map((track) => (track ? points(track) : null)) };
    }),
    series, key,
  };
}

const maps = new Map();

/** A map with its outlines as paths in meters; simulations share it. */
function mapOf(number) {
  if (!maps.has(number)) maps.set(number, unpack(`map-${number}`).then(outlined));
  return maps.get(number);
}

function outlined(map) {
  const ring = (path, { x, y }) => {
    x.forEach((at, i) => (i ? path.lineTo(at, y[i]) : path.moveTo(at, y[i])));
    path.closePath();
  };
  const line = (path, { x, y }) => x.forEach((at, i) => (i ? path.lineTo(at, y[i]) : path.moveTo(at, y[i])));
  const drawn = { drivable: new Path2D(), lanes: new Path2D(), route: new Path2D(), centerlines: new Path2D(),
    connectors: new Path2D(), crosswalks: [], stops: new Path2D(), starts: new Map() };
  for (const rings of map.drivable) for (const each of rings) ring(drawn.drivable, points(each));
  for (const lane of map.lanes) {
    const centerline = points(lane.centerline);
    ring(drawn.lanes, points(lane.ring));
    if (lane.on_route) ring(drawn.route, points(lane.ring));
    line(lane.kind === "connector" ? drawn.connectors : drawn.centerlines, centerline);
    drawn.starts.set(lane.id, centerline);
  }
  for (const each of map.crosswalks) {
    const path = new Path2D();
    ring(path, points(each));
    drawn.crosswalks.push(path);
  }
  for (const each of map.stop_lines) ring(drawn.stops, points(each));
  drawn.has = { route: map.lanes.some((lane) => lane.on_route), drivable: map.drivable.length > 0, stops: map.stop_lines.length > 0 };
  return drawn;
}
