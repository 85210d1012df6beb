// The scores of the refused plans: labels at the ends of the plans, as in the pictures of `planagent render`.

/** Letters, space around them, and distance from the end of the plan, pixels. */
const LABEL = { letters: 12, padding: 3, away: 8, same: 6 };
/** Directions in which a label may lie from the end of its plan, the first is preferred; and how far it may move away. */
const LABEL_DIRECTIONS = [[1, 0], [-1, 0], [1, -1], [-1, -1], [1, 1], [-1, 1], [0, -1], [0, 1]];
const LABEL_STEPS = [1, 2.4, 4];

/** Draws the scores of plans, `{ track, score }`; `boxes` are in meters. */
function drawScoreLabels(bev, shown, boxes) {
  const { context, canvas, colors } = bev;
  const ratio = window.devicePixelRatio || 1;
  const onto = new DOMMatrix(bev.onto);
  const pixel = (x, y) => {
    const at = new DOMPoint(x, y).matrixTransform(onto);
    return { x: at.x / ratio, y: at.y / ratio };
  };
  const [width, height] = [canvas.width / ratio, canvas.height / ratio];
  const taken = boxes.map((box) => boundsOf(box, pixel));
  context.save();
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.font = `bold ${bev.font}`;
  context.textBaseline = "middle";
  for (const { end, words } of scoreLabels(shown, pixel)) {
    const size = [context.measureText(words).width + 2 * LABEL.padding, LABEL.letters + 2 * LABEL.padding];
    const area = labelPlace(end, size, taken, width, height);
    context.fillStyle = colors.panel;
    context.globalAlpha = 0.92;
    context.fillRect(area.left, area.top, ...size);
    context.globalAlpha = 1;
    context.strokeStyle = context.fillStyle = colors.tried;
    context.lineWidth = 1;
    context.strokeRect(area.left, area.top, ...size);
    context.fillText(words, area.left + LABEL.padding, (area.top + area.bottom) / 2 + 0.5);
    taken.push(area);
  }
  context.restore();
}

/** The ends of the plans with the words of their labels. Equal plans share a label, which says how many they are. */
function scoreLabels(shown, pixel) {
  const labels = [];
  for (const { track: { x, y }, score } of shown) {
    const end = pixel(x[x.length - 1], y[y.length - 1]);
    const known = labels.find((label) => label.score === fixed(score, 2) && Math.hypot(label.end.x - end.x, label.end.y - end.y) < LABEL.same);
    if (known) known.count += 1;
    else labels.push({ end, score: fixed(score, 2), count: 1 });
  }
  return labels.map(({ end, score, count }) => ({ end, words: count > 1 ? `${score} (${count} times)` : score }));
}

/** The place of a label: inside the picture, where it covers least of what is taken. */
function labelPlace(end, [wide, high], taken, width, height) {
  const margin = LABEL.away / 2;
  const within = (value, low, length) => Math.min(length - margin, Math.max(low + margin, value));
  const [x, y] = [within(end.x, 0, width), within(end.y, 0, height)];
  let best = null;
  for (const step of LABEL_STEPS) {
    for (const [right, down] of LABEL_DIRECTIONS) {
      const left = Math.min(width - margin - wide, Math.max(margin, x + right * (step * LABEL.away + wide / 2) - wide / 2));
      const top = Math.min(height - margin - high, Math.max(margin, y + down * (step * LABEL.away + high / 2) - high / 2));
      const area = { left, top, right: left + wide, bottom: top + high };
      const covers = taken.reduce((sum, other) => sum + overlap(area, other), 0);
      if (!best || covers < best.covers) best = { covers, area };
    }
  }
  return best.area;
}

/** The bounds of a box, in pixels. */
function boundsOf({ x, y, heading, length, width }, pixel) {
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  const corners = [[1, 1], [1, -1], [-1, 1], [-1, -1]].map(([ahead, aside]) => {
    const [forward, left] = [(ahead * length) / 2, (aside * width) / 2];
    return pixel(x + cos * forward - sin * left, y + sin * forward + cos * left);
  });
  const [across, down] = [corners.map((corner) => corner.x), corners.map((corner) => corner.y)];
  return { left: Math.min(...across), right: Math.max(...across), top: Math.min(...down), bottom: Math.max(...down) };
}

function overlap(one, other) {
  const width = Math.min(one.right, other.right) - Math.max(one.left, other.left);
  const height = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
  return Math.max(0, width) * Math.max(0, height);
}
