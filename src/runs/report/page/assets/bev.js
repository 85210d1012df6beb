// The scene from above: map, lights, agents, the ego, its plan, and the refused plans.

/** Initial zoom, its limits (pixels per meter) and its step. */
const ZOOM = { start: 6, min: 1.5, max: 40, step: 1.25 };
/** Width of the map's lines, meters. */
const CENTERLINE_M = 0.15;
/** Period of a crosswalk's stripes, meters. */
const STRIPE_M = 1.2;
/** Agents above this speed (m/s) have an arrow, as long as their path in ARROW_S seconds. */
const MOVING = 0.5;
const ARROW_S = 0.8;

class Bev {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.zoom = ZOOM.start;
    this.pan = { x: 0, y: 0 };
    this.headingUp = true;
    this.show = { plan: true, tried: true, trail: true, expert: false };
    this.marked = null;
    this.replay = null;
    this.ghost = null;
    this.time = 0;
    this.readColors();
    this.listen();
  }

  /** Reads the colors of the theme; call it after a change. */
  readColors() {
    this.colors = themeColors();
    this.stripes = this.stripePattern();
    this.font = `12px ${this.colors.sans || "sans-serif"}`;
  }

  listen() {
    const { canvas } = this;
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoomBy(event.deltaY < 0 ? ZOOM.step : 1 / ZOOM.step);
    }, { passive: false });
    let from = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = { x: event.clientX - this.pan.x, y: event.clientY - this.pan.y };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.pan = { x: event.clientX - from.x, y: event.clientY - from.y };
      this.draw();
    });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("dblclick", () => this.recenter());
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.canvas;
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    this.draw();
  }

  zoomBy(factor) {
    this.zoom = Math.min(ZOOM.max, Math.max(ZOOM.min, this.zoom * factor));
    this.draw();
  }

  recenter() {
    this.pan = { x: 0, y: 0 };
    this.zoom = ZOOM.start;
    this.draw();
  }

  /** Shows a replay; `ghost` is another replay of the same scenario, or null. */
  open(replay, ghost = null) {
    this.replay = replay;
    this.ghost = ghost;
    this.marked = null;
    this.draw();
  }

  /** Moves to a time in seconds. */
  at(time) {
    this.time = time;
    this.draw();
  }

  draw() {
    const { context, canvas, colors } = this;
    const ratio = window.devicePixelRatio || 1;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colors.ground;
    context.fillRect(0, 0, canvas.width, canvas.height);
    if (!this.replay || !canvas.width) return;
    const moment = momentAt(this.replay, this.time);
    const ego = center(moment);
    const turn = this.headingUp ? Math.PI / 2 - ego.heading : 0;
    const zoom = this.zoom * ratio;
    const [sin, cos] = [Math.sin(turn) * zoom, Math.cos(turn) * zoom];
    const middle = { x: canvas.width / 2 + this.pan.x * ratio, y: canvas.height * (this.headingUp ? 0.6 : 0.5) + this.pan.y * ratio };
    // From map meters, y up, to pixels, y down: a rotation about the ego, then a flip.
    this.onto = [cos, -sin, -sin, -cos, middle.x - cos * ego.x + sin * ego.y, middle.y + sin * ego.x + cos * ego.y];
    context.setTransform(...this.onto);
    context.lineJoin = "round";
    this.drawMap();
    this.drawLights(moment.iteration);
    this.drawPaths(moment);
    for (const agent of this.replay.agents) this.drawAgent(agent, moment);
    if (this.ghost) this.drawGhost();
    this.drawBox(ego, INDEX.vehicle.length, INDEX.vehicle.width, colors.ego, true);
    const speed = Math.abs(this.replay.ego.speed[moment.iteration]);
    if (speed >= MOVING) this.drawArrow(ego, ego.heading, speed);
    this.drawScores(moment);
    this.drawScale(ratio);
  }

  drawMap() {
    const { context, colors } = this;
    const { map } = this.replay;
    context.fillStyle = colors.drivable;
    context.fill(map.drivable, "evenodd");
    context.fillStyle = colors.road;
    context.fill(map.lanes);
    context.fillStyle = colors.route;
    context.fill(map.route);
    context.lineWidth = CENTERLINE_M;
    context.strokeStyle = colors.centerline;
    context.stroke(map.centerlines);
    // Faint: many cross in a junction.
    context.globalAlpha = 0.45;
    context.stroke(map.connectors);
    context.globalAlpha = 1;
    context.fillStyle = this.stripes;
    for (const crosswalk of map.crosswalks) context.fill(crosswalk);
    context.fillStyle = colors.stop;
    context.fill(map.stops);
  }

  /** A pattern of stripes in meters. */
  stripePattern() {
    const tile = document.createElement("canvas");
    tile.width = tile.height = 16;
    const drawing = tile.getContext("2d");
    drawing.fillStyle = this.colors.crosswalk;
    drawing.fillRect(0, 0, 16, 9);
    const pattern = this.context.createPattern(tile, "repeat");
    pattern.setTransform(new DOMMatrix().scale(STRIPE_M / 16));
    return pattern;
  }

  /** A bar across the start of each connector with a light; red bars are wider, for color-blind readers. */
  drawLights(iteration) {
    const { context, colors } = this;
    for (const { lane, changes } of this.replay.lights) {
      const last = changes.filter(([at]) => at <= iteration).pop();
      const start = this.replay.map.starts.get(lane);
      if (!last || !last[1] || last[1] === "unknown" || !start || start.x.length < 2) continue;
      const [dx, dy] = [start.x[1] - start.x[0], start.y[1] - start.y[0]];
      const size = Math.hypot(dx, dy) || 1;
      const [nx, ny] = [(-dy / size) * 1.5, (dx / size) * 1.5];
      context.beginPath();
      context.moveTo(start.x[0] - nx, start.y[0] - ny);
      context.lineTo(start.x[0] + nx, start.y[0] + ny);
      context.strokeStyle = { red: colors.red, yellow: colors.amber, green: colors.green }[last[1]];
      context.lineWidth = last[1] === "red" ? 0.9 : 0.45;
      context.stroke();
    }
  }

  /** The trail of the ego, the path of the recorded ego, the refused plans and the active plan. */
  drawPaths(moment) {
    const { context, colors, replay, show } = this;
    const thin = 1.6 / this.zoom;
    if (show.expert) this.drawExpert(moment);
    if (show.trail) this.drawLine(replay.ego, 0, moment.iteration + 1, colors.ego, thin, []);
    const call = replay.calls[callAt(replay, moment.iteration)];
    const accepted = call ? acceptedAttempt(call) : null;
    if (call && show.tried) {
      call.tracks.forEach((track, i) => {
        if (!track || (i === accepted && this.marked !== i)) return;
        // Wider than the plan, which often covers it.
        const wide = (this.marked === i ? 7 : 5) / this.zoom;
        this.drawLine(track, 0, track.x.length, colors.tried, wide, [1.2, 0.8]);
      });
    }
    const plan = replay.plans[moment.iteration];
    if (show.plan && plan) {
      this.drawLine(plan, 0, plan.x.length, colors.ego, 3 / this.zoom, []);
      context.fillStyle = colors.ego;
      for (let i = 2; i < plan.x.length; i += 2) {
        context.beginPath();
        context.arc(plan.x[i], plan.y[i], 3 / this.zoom, 0, 7);
        context.fill();
      }
    }
  }

  /** The path of the recorded ego, with a circle where it is now. */
  drawExpert({ iteration }) {
    const { context, colors, replay } = this;
    const { x, y } = replay.expert;
    this.drawLine(replay.expert, 0, x.length, colors.expert, 2 / this.zoom, [0.5, 0.7]);
    const now = Math.min(iteration, x.length - 1);
    if (now < 0) return;
    context.beginPath();
    context.arc(x[now], y[now], 5 / this.zoom, 0, 7);
    context.lineWidth = 2 / this.zoom;
    context.stroke();
  }

  drawLine({ x, y }, from, to, color, width, dash) {
    const { context } = this;
    context.beginPath();
    for (let i = from; i < to; i++) i > from ? context.lineTo(x[i], y[i]) : context.moveTo(x[i], y[i]);
    context.strokeStyle = color;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke();
    context.setLineDash([]);
  }

  /** The scores of the refused plans: over all else, where they cover least. */
  drawScores(moment) {
    const { replay } = this;
    const call = replay.calls[callAt(replay, moment.iteration)];
    if (!call || !this.show.tried) return;
    const shown = call.tracks.map((track, i) => ({ track, score: call.attempts[i]?.reflection?.score, i }))
      .filter(({ track, score, i }) => track && score !== undefined && (i !== acceptedAttempt(call) || this.marked === i));
    if (!shown.length) return;
    const boxes = replay.agents.map((agent) => this.boxOf(agent, moment)).filter(Boolean);
    drawScoreLabels(this, shown, [...boxes, { ...center(moment), length: INDEX.vehicle.length, width: INDEX.vehicle.width }]);
  }

  /** The box of an agent; null if there is none at this moment. */
  boxOf(agent, { iteration, share }) {
    if (iteration < agent.from || iteration > agent.to) return null;
    const i = iteration - agent.from;
    const j = Math.min(i + 1, agent.x.length - 1);
    const { length, width } = agent;
    return { x: mix(agent.x, i, j, share), y: mix(agent.y, i, j, share), heading: mix(agent.heading, i, j, share), length, width };
  }

  drawAgent(agent, moment) {
    const pose = this.boxOf(agent, moment);
    if (!pose) return;
    const i = moment.iteration - agent.from;
    const color = this.colors[agent.kind] ?? this.colors.static;
    if (agent.kind === "pedestrian") {
      this.context.beginPath();
      this.context.arc(pose.x, pose.y, Math.max(agent.length, agent.width, 0.8) / 2, 0, 7);
      this.context.fillStyle = color;
      this.context.fill();
    } else {
      this.drawBox(pose, agent.length, agent.width, color, agent.kind === "vehicle" || agent.kind === "bicycle");
    }
    const speed = Math.hypot(agent.vx[i], agent.vy[i]);
    if (speed >= MOVING) this.drawArrow(pose, Math.atan2(agent.vy[i], agent.vx[i]), speed);
  }

  /** A box, with a mark at its front. */
  drawBox({ x, y, heading }, length, width, color, front) {
    const { context } = this;
    context.save();
    context.translate(x, y);
    context.rotate(heading);
    context.fillStyle = color;
    context.beginPath();
    context.roundRect(-length / 2, -width / 2, length, width, Math.min(0.35, width / 4));
    context.fill();
    if (front) {
      context.fillStyle = this.colors.panel;
      context.globalAlpha = 0.75;
      context.fillRect(length * 0.2, -width * 0.36, length * 0.12, width * 0.72);
    }
    context.restore();
  }

  drawArrow({ x, y }, heading, speed) {
    const { context } = this;
    const length = ARROW_S * speed;
    const head = Math.min(0.9, length / 2);
    context.save();
    context.translate(x, y);
    context.rotate(heading);
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(length, 0);
    context.moveTo(length - head, head * 0.6);
    context.lineTo(length, 0);
    context.lineTo(length - head, -head * 0.6);
    context.strokeStyle = this.colors.ink;
    context.lineWidth = 1.2 / this.zoom;
    context.stroke();
    context.restore();
  }

  /** The ego of the ghost: an outline and its trail. */
  drawGhost() {
    const { context, ghost, colors } = this;
    const moment = momentAt(ghost, this.time);
    const color = colors.ghost;
    this.drawLine(ghost.ego, 0, moment.iteration + 1, color, 1.6 / this.zoom, [0.6, 0.6]);
    const { x, y, heading } = center(moment);
    context.save();
    context.translate(x, y);
    context.rotate(heading);
    context.strokeStyle = color;
    context.lineWidth = 2 / this.zoom;
    const { length, width } = INDEX.vehicle;
    context.strokeRect(-length / 2, -width / 2, length, width);
    context.restore();
  }

  drawScale(ratio) {
    const { context, canvas, colors } = this;
    const meters = [2, 5, 10, 20, 50].find((length) => length * this.zoom >= 60) ?? 100;
    const [x, y] = [14, canvas.height / ratio - 14];
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.strokeStyle = colors["ink-soft"];
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(x, y - 4);
    context.lineTo(x, y);
    context.lineTo(x + meters * this.zoom, y);
    context.lineTo(x + meters * this.zoom, y - 4);
    context.stroke();
    context.font = this.font;
    context.fillStyle = colors["ink-soft"];
    context.fillText(`${meters} m`, x + 6, y - 6);
  }
}
