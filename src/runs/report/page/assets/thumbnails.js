// Thumbnails of scenarios: the roads and the recorded ego's path, its first heading up.

/** Size of the drawing, pixels of the page. */
const THUMBNAIL = { width: 56, height: 42 };
/** Space around the path and smallest extent of the view, meters. */
const THUMBNAIL_M = { margin: 14, extent: 48 };

class Thumbnails {
  constructor() {
    /** Scenarios by canvas, and canvases by scenario: a list that is drawn again keeps its pictures. */
    this.drawn = new Map();
    this.canvases = new Map();
    // A list of many scenarios unpacks the maps of those in view only.
    this.observer = new IntersectionObserver((seen) => seen.filter((each) => each.isIntersecting).forEach(({ target }) => {
      this.observer.unobserve(target);
      this.draw(target).catch(trouble);
    }), { rootMargin: "120px" });
  }

  /** A canvas that draws itself when it comes into view. */
  of(scenario) {
    const known = this.canvases.get(scenario);
    if (known && !known.dataset.drawn) this.observer.observe(known);
    if (known) return known;
    const ratio = Math.max(2, window.devicePixelRatio || 1);
    const canvas = h("canvas", { class: "thumbnail", width: THUMBNAIL.width * ratio, height: THUMBNAIL.height * ratio, "aria-hidden": "true" });
    this.drawn.set(canvas, scenario);
    this.canvases.set(scenario, canvas);
    this.observer.observe(canvas);
    return canvas;
  }

  /** Draws all again, in the colors of the theme. */
  recolor() {
    for (const canvas of this.drawn.keys()) {
      delete canvas.dataset.drawn;
      if (canvas.isConnected) this.observer.observe(canvas);
    }
  }

  async draw(canvas) {
    const scenario = this.drawn.get(canvas);
    const sketch = sketchOf(scenario);
    if (!sketch) return;
    const { map: number = null } = INDEX.simulations.find((d) => d.scenario === scenario && d.map !== null) ?? {};
    const map = number === null ? null : await mapOf(number);
    const colors = themeColors();
    const context = canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colors.ground;
    context.fillRect(0, 0, canvas.width, canvas.height);
    const scale = this.place(context, canvas, sketch);
    if (map) {
      for (const [area, color] of [[map.drivable, colors.drivable], [map.lanes, colors.road], [map.route, colors.route]]) {
        context.fillStyle = color;
        context.fill(area);
      }
    }
    context.strokeStyle = context.fillStyle = colors.ego;
    context.lineWidth = 5 / scale;
    context.lineJoin = context.lineCap = "round";
    context.beginPath();
    sketch.x.forEach((x, i) => (i ? context.lineTo(x, sketch.y[i]) : context.moveTo(x, sketch.y[i])));
    context.stroke();
    context.beginPath();
    context.arc(sketch.x[0], sketch.y[0], 6 / scale, 0, 7);
    context.fill();
    canvas.dataset.drawn = "true";
  }

  /** Sets the transform from map meters; returns pixels per meter. */
  place(context, canvas, sketch) {
    const turn = Math.PI / 2 - headingAt(sketch, false);
    const [sin, cos] = [Math.sin(turn), Math.cos(turn)];
    const across = [...sketch.x].map((x, i) => cos * x - sin * sketch.y[i]);
    const up = [...sketch.x].map((x, i) => sin * x + cos * sketch.y[i]);
    const extent = (values) => Math.max(THUMBNAIL_M.extent, Math.max(...values) - Math.min(...values) + 2 * THUMBNAIL_M.margin);
    const middle = (values) => (Math.max(...values) + Math.min(...values)) / 2;
    const scale = Math.min(canvas.width / extent(across), canvas.height / extent(up));
    const [x, y] = [middle(across), middle(up)];
    context.setTransform(scale * cos, -scale * sin, -scale * sin, -scale * cos, canvas.width / 2 - scale * x, canvas.height / 2 + scale * y);
    return scale;
  }
}
