"use strict";
// Charts by uPlot: curves, axes, cursors, zoom; marks and the robot are drawn here. What a chart shows stands beside it as JSON (chart.py). Charts over time share cursor and zoom.
const page = (() => {
  const charts = [], css = getComputedStyle(document.documentElement), clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const html = (name, properties, parent, text) => {
    const element = Object.assign(document.createElement(name), properties);
    if (text !== undefined) element.textContent = text;
    return parent ? parent.appendChild(element) : element;
  };
  const numbers = (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  };
  const colour = (name) => (name.startsWith("var(") ? css.getPropertyValue(name.slice(4, -1)) : name);
  // a number as Python's format g has it, with a true minus
  const short = (value, digits = 6) => {
    if (value === null || !isFinite(value)) return "–";
    const rounded = +value.toPrecision(digits), isPlain = rounded === 0 || (Math.abs(rounded) >= 1e-4 && Math.abs(rounded) < 1e6);
    return (isPlain ? String(rounded) : rounded.toExponential()).replace("e+", "e").replace(/-/g, "−");
  };
  const unitOf = (label) => (label.match(/\[(.*)\]/) || ["", ""])[1];
  // the place in ascending values that is nearest to one
  const nearest = (values, value) => {
    let low = 0, high = values.length - 1;
    while (low < high) { const middle = (low + high) >> 1; if (values[middle] < value) low = middle + 1; else high = middle; }
    return low && value - values[low - 1] < values[low] - value ? low - 1 : low;
  };
  const range = (low, high, margin, log) => {
    if (log) return range(Math.log10(low), Math.log10(high), margin).map((each) => 10 ** each);
    if (!(high > low)) [low, high] = low === high ? [low - (Math.abs(low) || 0.2) / 2, low + (Math.abs(low) || 0.2) / 2] : [0, 1];
    return [low - margin * (high - low), high + margin * (high - low)];
  };

  const curveOf = ({ x, y, more, ...given }) => ({ ...given, x: numbers(x), y: numbers(y), more: Object.keys(more), extra: Object.values(more).map(numbers) });

  // a curve's line, but for points within parts of a pixel; uPlot's own has steps of whole pixels where points are dense
  const paths = (u, number, first, last) => {
    const stroke = new Path2D(), [xs, ys] = u.data[number];
    const [atX, atY] = ["x", "y"].map((axis) => {
      const { min, max, distr } = u.scales[axis], of = distr === 3 ? Math.log : (v) => v, low = u.valToPos(min, axis, true), slope = (u.valToPos(max, axis, true) - low) / (of(max) - of(min));
      return (v) => low + slope * (of(v) - of(min));
    });
    for (let i = first, x = NaN, y = NaN; i <= last; i++) {
      const isThere = ys[i] !== null, nextX = isThere ? atX(xs[i]) : NaN, nextY = isThere ? atY(ys[i]) : NaN;
      if (Math.abs(nextX - x) + Math.abs(nextY - y) < 0.4) continue;
      if (isThere) { if (isNaN(x)) stroke.moveTo(nextX, nextY); else stroke.lineTo(nextX, nextY); }
      x = nextX; y = nextY;
    }
    return { stroke, flags: 1 };
  };

  class Panel {
    constructor(chart, { limits: xLimits, ...given }, number) {
      Object.assign(this, { chart, ...given, xLimits, number, isLast: number === chart.count - 1, curves: given.curves.map((each) => ({ ...curveOf(each), unit: unitOf(given.label) })) });
      this.log = { x: given.logarithmic.includes("x"), y: given.logarithmic.includes("y") };
      if (given.motion) this.motion = new Motion(this, given.motion);
    }
    // limits of what is drawn: of all of it, or of what is between two x
    limits(axis, between) {
      const isLog = this.log[axis];
      let low = Infinity, high = -Infinity;
      const take = (v) => { if (isFinite(v) && (!isLog || v > 0)) { low = Math.min(low, v); high = Math.max(high, v); } };
      const drawn = this.curves.filter((c) => !c.off).flatMap((c) => (c.ghost ? [c, c.ghost] : [c]));
      for (const c of drawn) for (let i = 0; i < c.x.length; i++) {
        if (!between || (c.x[i] >= between[0] && c.x[i] <= between[1])) take(c[axis][i]);
        // where a line crosses an end
        for (const end of between ?? []) if ((c.x[i] - end) * (c.x[i + 1] - end) < 0) take(c[axis][i] + (end - c.x[i]) / (c.x[i + 1] - c.x[i]) * (c[axis][i + 1] - c[axis][i]));
      }
      if (this.motion) this.motion.extent(axis).forEach(take);
      if (axis === "x" && this.xLimits) return this.xLimits;
      if (axis === "y" && this.level !== null && !between) take(this.level);
      const found = range(low, high, this.motion && axis === "y" ? 0.1 : axis === "y" || !this.is_function ? 0.05 : 0.01, isLog);
      if (axis === "y" && this.least !== null) found[0] = this.least;
      // room for the texts of marks
      const [from, to] = between ?? this.chart.limits ?? [];
      if (axis === "y" && this.marks.some(([x]) => x >= from && x <= to)) found[1] += (16 / (this.chart.height - 30)) * (found[1] - found[0]);
      return found;
    }
    build(width) {
      const { chart, is_to_scale: toScale } = this, axisOf = (label, size) => ({
        stroke: () => colour("var(--ink)"), grid: { stroke: () => colour("var(--line)"), width: 1 }, ticks: { stroke: () => colour("var(--grey)"), width: 1, size: 4 },
        font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", label, labelSize: label ? 18 : 0, size, labelGap: 0,
      });
      const label = this.label.replace("\n", " "), x = axisOf(this.isLast ? chart.x : "", this.isLast ? 34 : 12), y = axisOf(label, 58);
      // logarithmic axes have the ticks of linear ones within a decade, 1, 2 and 5 of few decades, of many the powers that there is room for
      const ticks = (axis, room) => ({
        values: (_, splits) => splits.map((v) => short(v, this.digits(axis))),
        ...(this.log[axis] && { filter: (_, all) => all, splits: (_, place, low, high, step) => {
          if (high < 10 * low) return Array.from({ length: Math.floor(high / step) - Math.ceil(low / step) + 1 }, (_, n) => +((Math.ceil(low / step) + n) * step).toPrecision(12));
          const first = Math.floor(Math.log10(low) + 1e-9), decades = Math.log10(high / low), every = Math.ceil(decades / room);
          const powers = Array.from({ length: Math.ceil(decades) + 2 }, (_, n) => first + n).filter((p) => p % every === 0);
          return powers.flatMap((p) => (decades < Math.min(room, 3) ? [1, 2, 5] : [1]).map((m) => +`${m}e${p}`)).filter((v) => v >= low && v <= high);
        } }),
      });
      Object.assign(y, ticks("y", (toScale ? 200 : chart.height) / 20));
      Object.assign(x, ticks("x", (width - 86) / 50), this.isLast ? {} : { values: (_, splits) => splits.map(() => "") });
      // as wide as the numbers of all panels, which have more digits after a zoom
      if (!toScale) y.size = (_, texts) => { this.room = 28 + 6.8 * Math.max(...(texts ?? []).map((each) => each.length)); return chart.room; };
      x.space = () => Math.max(50, 8 * this.digits("x") + 10);
      // panels are equally high, and the last one has the axis below
      const height = toScale ? this.scaled(width) : chart.height + (this.isLast && this.number ? 40 : 0);
      const scale = (axis) => ({ time: false, auto: false, distr: this.log[axis] ? 3 : 1, range: () => this.shown[axis] });
      this.shown ??= this.whole;
      this.plot?.destroy();
      this.plot = new uPlot({
        width, height, padding: [8, 20, 0, 0], legend: { show: false }, scales: { x: scale("x"), y: scale("y") }, axes: [x, y],
        mode: 2, pxAlign: 0, series: [null, ...this.lines.map((c) => this.series(c))],
        cursor: { y: !this.is_function, points: { show: false }, dataIdx: () => null, drag: { x: true, y: !this.is_function, setScale: false, uni: 10 }, bind: { dblclick: () => () => (chart.reset(), null) } },
        hooks: {
          draw: [() => this.draw()], setCursor: [(u) => u.cursor.event && this.pointed(u)],
          setSelect: [(u) => { if (u.select.width > 5) this.selected(u.select); u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false); }],
        },
      }, this.data(), this.box ??= html("div", { className: "panel" }, chart.body));
      // uPlot keeps clicks to itself whose cursor has moved by parts of a pixel
      let down = null;
      this.plot.over.addEventListener("pointermove", () => this.plot.syncRect(true));
      this.plot.over.addEventListener("pointerdown", (event) => (down = event));
      this.plot.over.addEventListener("pointerup", (event) => { if (!down || !this.chosen || Math.hypot(event.x - down.x, event.y - down.y) >= 4) return;
        const why = page.pick?.(this.chosen);
        if (why) chart.say(why); });
    }
    // as many as tell the numbers of an axis apart
    digits(axis) {
      const [low, high] = this.shown[axis];
      return this.log[axis] ? 5 : clamp(Math.ceil(Math.log10(Math.max(Math.abs(low), Math.abs(high)) / (high - low))) + 3, 5, 15);
    }
    get lines() { return this.curves.filter((c) => !(c.group === "pose" && this.motion)); }
    series({ off, width, opacity, dashes, colour: name }) {
      const facet = (scale) => ({ scale, auto: false });
      return { show: !off && width > 0, stroke: () => colour(name), points: { show: false }, paths, facets: [facet("x"), facet("y")], width, dash: dashes, alpha: opacity };
    }
    // the curves for uPlot; where there is no value a curve is broken
    data() {
      const isThere = (v) => isFinite(v) && (!this.log.y || v > 0), broken = (values) => (values.every(isThere) ? values : Array.from(values, (v) => (isThere(v) ? v : null)));
      return [null, ...this.lines.map((c) => [c.x, broken(c.y)])];
    }
    // the height at which both axes have one scale, and limits that fit it
    scaled(width) {
      const [x, y] = [this.whole.x, this.whole.y], across = width - 58 - 18 - 20, ratio = (y[1] - y[0]) / (x[1] - x[0]);
      const high = clamp(across * ratio, 120, 560);
      if (across * ratio > high) { const more = (across * (y[1] - y[0]) / high - (x[1] - x[0])) / 2; this.whole.x = [x[0] - more, x[1] + more]; }
      else if (across * ratio < high) { const more = (high / across * (x[1] - x[0]) - (y[1] - y[0])) / 2; this.whole.y = [y[0] - more, y[1] + more]; }
      return high + 34 + 18 + 8;
    }
    draw() {
      const { plot: u } = this, { ctx, bbox } = u, ratio = devicePixelRatio, at = (v, axis) => u.valToPos(v, axis, true);
      ctx.save();
      ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
      ctx.lineCap = ctx.lineJoin = "round"; ctx.font = `${12 * ratio}px system-ui, sans-serif`;
      const line = (points, stroke, width, dashes = [], opacity = 1) => {
        ctx.globalAlpha = opacity; ctx.strokeStyle = colour(stroke); ctx.lineWidth = width * ratio; ctx.setLineDash(dashes.map((each) => each * ratio));
        ctx.beginPath();
        let pen = false;
        for (const [x, y] of points) { if (isFinite(x) && isFinite(y)) { if (pen) ctx.lineTo(x, y); else ctx.moveTo(x, y); pen = true; } else pen = false; }
        ctx.stroke(); ctx.setLineDash([]); ctx.globalAlpha = 1;
      };
      const disc = (x, y, size, fill, opacity = 1, square = false) => {
        ctx.globalAlpha = opacity; ctx.fillStyle = colour(fill); ctx.beginPath();
        if (square) ctx.rect(x - size * ratio / 2, y - size * ratio / 2, size * ratio, size * ratio); else ctx.arc(x, y, size * ratio / 2, 0, 7);
        ctx.fill(); ctx.globalAlpha = 1;
      };
      const text = (content, x, y, align = "left", fill = "var(--ink)") => { ctx.textAlign = align; ctx.lineWidth = 4 * ratio; ctx.strokeStyle = colour("var(--card)"); ctx.strokeText(content, x, y); ctx.fillStyle = colour(fill); ctx.fillText(content, x, y); };
      // texts of marks in the first line that is free, in front of all lines
      const ends = [], isShown = ([x]) => x >= this.shown.x[0] && x <= this.shown.x[1];
      for (const [x] of this.marks.filter(isShown)) line([[at(x, "x"), bbox.top], [at(x, "x"), bbox.top + bbox.height]], "var(--grey)", 1, [5, 4]);
      this.marks.filter(isShown).forEach(([x, label]) => {
        const width = ctx.measureText(label).width, place = at(x, "x") + 4 * ratio, fits = place + width <= bbox.left + bbox.width;
        // beside its line: to the right, or else to the left
        const left = fits ? place : Math.max(place - 8 * ratio - width, bbox.left), free = ends.findIndex((end) => end < left), row = free < 0 ? ends.length : free;
        ends[row] = left + width + 4 * ratio;
        text(label, left, bbox.top + (12 + 13 * row) * ratio, "left", "var(--grey)");
      });
      if (this.level !== null) line([[bbox.left, at(this.level, "y")], [bbox.left + bbox.width, at(this.level, "y")]], "var(--grey)", 1, [5, 4]);
      for (const c of this.lines) if (c.fill && !c.off) {
        ctx.globalAlpha = c.fill; ctx.fillStyle = colour(c.colour); ctx.beginPath();
        for (let i = 0; i < c.x.length; i++) ctx.lineTo(at(c.x[i], "x"), at(c.y[i], "y"));
        ctx.fill(); ctx.globalAlpha = 1;
      }
      for (const c of this.lines) for (let i = 0; c.dot && !c.off && i < c.x.length; i++) {
        const x = at(c.x[i], "x"), y = at(c.y[i], "y");
        if (!isFinite(x) || !isFinite(y)) continue;
        if (c.dot === "disc") disc(x, y, 6, c.colour); else for (const s of [1, -1]) line([[x - 4 * ratio, y - 4 * s * ratio], [x + 4 * ratio, y + 4 * s * ratio]], c.colour, 1.6);
      }
      // those of the recording
      for (const { ghost, off, colour: name } of this.lines) if (ghost && !off) line(Array.from(ghost.x, (x, i) => [at(x, "x"), at(ghost.y[i], "y")]), name, 1, [2, 3], 0.6);
      for (const m of this.markers) {
        if (m.group === "pose" && this.motion) continue;
        const x = at(m.x, "x"), y = at(m.y, "y");
        if (m.size) disc(x, y, m.size, m.colour, m.opacity, m.shape === "square");
        if (m.text) text(m.text, x + m.offset[0] * ratio, y + m.offset[1] * ratio, m.anchor === "middle" ? "center" : m.anchor);
      }
      if (this.picked) disc(at(this.picked[0], "x"), at(this.picked[1], "y"), 9, "var(--second)", 0.7);
      this.motion?.draw(line, disc, at);
      ctx.restore();
    }
    pointed(u) {
      const { left, top } = u.cursor;
      if (left < 0) return;
      const x = u.posToVal(left, "x");
      if (this.is_function) return this.chart.overTime ? page.at(x) : this.chart.read(x);
      // the nearest point of a curve that is read
      let best = null, distance = 30 * 30;
      for (const c of this.curves) if (c.is_read && !c.off) for (let i = 0; i < c.x.length; i++) {
        const d = (u.valToPos(c.x[i], "x") - left) ** 2 + (u.valToPos(c.y[i], "y") - top) ** 2;
        if (d < distance) { distance = d; best = [c, i]; }
      }
      this.picked = best && [best[0].x[best[1]], best[0].y[best[1]]];
      // all that lie on it
      const isThere = (c, i) => c.is_read && !c.off && c.x[i] === this.picked[0] && c.y[i] === this.picked[1], pointAt = (c, i) => [Object.fromEntries(c.more.map((name, k) => [name.replace(/ \[.*\]/, ""), c.extra[k][i]])), `${c.label}, ${c.notes[i] ?? ""}`];
      this.chosen = best && this.curves.flatMap((c) => Array.from(c.x.keys()).filter((i) => isThere(c, i)).map((i) => pointAt(c, i)));
      this.chart.say(best ? this.told(...best) : "");
      if (best && best[0].more[0]?.startsWith("time")) page.at(best[0].extra[0][best[1]]);
      u.redraw(false);
    }
    told(c, i) {
      const values = c.more.length ? c.more.map((name, k) => [name, c.extra[k][i]]) : [[this.chart.x, c.x[i]], [this.label.replace("\n", " "), c.y[i]]];
      const said = values.map(([name, v]) => [name.replace(/ \[.*\]/, ""), `${short(v, 5)} ${unitOf(name)}`]).filter(([name]) => !c.label.includes(`${name}=`));
      return [c.label, ...said.map((each) => each.join(" ").trim()), c.notes[i]].filter(Boolean).join(" · ");
    }
    selected({ left, width, top, height }) {
      const { plot: u, chart } = this, x = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
      if (this.is_function) return chart.zoom(x);
      if (height < 5) return;
      this.show(x, [u.posToVal(top + height, "y"), u.posToVal(top, "y")]);
      chart.button.hidden = false;
    }
    // these limits, or all that is there
    show(x, y) {
      const { whole } = this;
      if (y && this.is_to_scale) { const middle = (y[0] + y[1]) / 2, half = (x[1] - x[0]) / (whole.x[1] - whole.x[0]) * (whole.y[1] - whole.y[0]) / 2; y = [middle - half, middle + half]; }
      this.shown = { x: x ?? whole.x, y: y ?? (x ? this.limits("y", x) : whole.y) };
      this.plot.batch(() => {
        // which sets the old limits of x again
        this.plot.redraw(true, true);
        for (const axis of ["x", "y"]) this.plot.setScale(axis, { min: this.shown[axis][0], max: this.shown[axis][1] });
      });
      if (this.chart.place !== undefined) this.mark(this.chart.place);
    }
    // a line through the panel at x
    mark(x) { this.plot.setCursor({ left: this.plot.valToPos(x, "x"), top: -10 }, false); }
  }

  class Chart {
    constructor(body) {
      const given = JSON.parse(body.querySelector("script").textContent);
      Object.assign(this, { body, key: given.key, x: given.x, height: given.height, count: given.panels.length, overTime: given.x.startsWith("time"), figure: body.parentElement });
      this.legend = html("div", { className: "legend" });
      body.prepend(this.legend);
      this.panels = given.panels.map((each, n) => new Panel(this, each, n));
      this.said = html("p", { className: "said" }, body);
      if (!this.panels[0].is_function) this.said.style.minHeight = "2.7em";
      this.button = html("button", { className: "reset", hidden: true, type: "button", onclick: () => this.reset() }, this.figure, "reset zoom");
      this.keys = [];
      const labels = [...new Set(this.panels.flatMap((panel) => panel.curves.map((c) => c.label)))].filter(Boolean);
      for (const label of labels) {
        const curves = this.panels.flatMap((panel) => panel.curves.filter((c) => c.label === label)), key = html("button", { className: "key", type: "button" }, this.legend);
        const sign = html("i", { className: curves[0].dot }, key);
        sign.style.background = curves[0].dashes.length ? `repeating-linear-gradient(90deg, ${curves[0].colour} 0 5px, transparent 5px 8px)` : curves[0].colour;
        html("span", {}, key, label);
        this.keys.push({ curves: curves.filter((c) => c.is_read), value: html("output", {}, key) });
        key.ariaPressed = "true";
        key.addEventListener("click", () => { const off = key.classList.toggle("off"); key.ariaPressed = String(!off); curves.forEach((c) => (c.off = off)); this.redraw(); });
      }
      body.tabIndex = 0;
      body.addEventListener("keydown", (event) => this.pressed(event));
      new ResizeObserver(() => { const width = Math.floor(body.clientWidth); if (width && width !== this.width) this.build(width); }).observe(body);
      this.build(Math.floor(body.clientWidth) || 480);
      new IntersectionObserver((all) => { this.isVisible = all[all.length - 1].isIntersecting; if (this.isVisible) this.later?.(); }, { rootMargin: "100px" }).observe(body);
    }
    // do it now, or when the chart comes into view
    whenSeen(act) {
      this.later = null;
      if (this.isVisible) act(); else this.later = () => { this.later = null; act(); };
    }
    // limits of all that is there
    measure() {
      const all = this.panels.map((panel) => panel.limits("x"));
      this.limits = [Math.min(...all.map((each) => each[0])), Math.max(...all.map((each) => each[1]))];
      for (const panel of this.panels) panel.whole = { x: this.limits, y: panel.limits("y") };
    }
    build(width) {
      this.width = width;
      this.measure();
      this.panels.forEach((panel) => panel.build(width));
      this.fit();
      // room for the values beside the names, so that nothing moves when they are shown
      const known = this.keys.map(({ value }) => value.textContent), put = (texts) => this.keys.forEach(({ value }, i) => (value.textContent = texts[i]));
      this.legend.style.minHeight = "";
      if (this.panels[0].is_function) put(this.keys.map(({ curves }) => curves.map((c) => `−0.12345 ${c.unit}`).join(", ")));
      this.legend.style.minHeight = `${this.legend.offsetHeight}px`;
      put(known);
    }
    // width of the vertical axes
    get room() { return Math.ceil(Math.max(58, ...this.panels.map((panel) => panel.room ?? 0))); }
    // the panels once more whose axis was drawn before that of another with longer numbers
    aligned() { for (const { plot } of this.panels) if (plot.axes[1]._size !== this.room) plot.redraw(false, true); }
    // new values of the curves
    redraw() {
      for (const panel of this.panels) { panel.plot.setData(panel.data(), false); panel.lines.forEach((c, i) => { panel.plot.series[i + 1].show = !c.off && c.width > 0; }); }
      if (!this.panels[0].is_to_scale) this.measure();
      this.fit();
    }
    // as much in view as before
    fit() {
      for (const panel of this.panels) panel.show(...(this.button.hidden ? [] : [panel.shown.x, panel.is_function ? null : panel.shown.y]));
      this.aligned();
    }
    // all that is there without limits
    zoom(x) {
      for (const chart of this.overTime ? charts.filter((each) => each.overTime) : [this]) {
        const inside = x && [clamp(x[0], ...chart.limits), clamp(x[1], ...chart.limits)];
        if (x && !(inside[1] > inside[0])) continue;
        chart.button.hidden = !x;
        chart.panels.forEach((panel) => panel.show(inside));
        chart.aligned();
      }
    }
    reset() { this.zoom(); }
    say(text) { this.said.textContent = text; }
    // values at x with their units beside the names of the curves, or in the sentence where these have no names, and a line through all panels
    read(x) {
      this.place = x;
      const near = 1e-3 * (this.limits[1] - this.limits[0]), isThere = (c) => c.x.length && x > c.x[0] - near && x < c.x[c.x.length - 1] + near;
      const said = (c) => (isThere(c) ? `${short(c.y[nearest(c.x, x)], 5)} ${c.unit}`.trim() : "–");
      for (const { curves, value } of this.keys) value.textContent = curves.map(said).join(", ");
      this.say(`${this.x.replace(/ \[.*/, "")} ${short(x, 4)} ${unitOf(this.x)}${this.keys.length ? "" : ` · ${said(this.panels[0].curves[0])}`}`);
      for (const panel of this.panels) panel.mark(x);
    }
    pressed(event) {
      const panel = this.panels[0], { x } = panel.shown, span = x[1] - x[0], middle = this.place ?? (x[0] + x[1]) / 2;
      const moves = { ArrowLeft: -0.01, ArrowRight: 0.01 }, zooms = { "+": 0.5, "-": 2 };
      if (event.key in moves && panel.is_function) { const to = clamp(middle + moves[event.key] * span, ...x); this.overTime ? page.at(to) : this.read(to); }
      else if (event.key in zooms && panel.is_function) this.zoom([middle - (middle - x[0]) * zooms[event.key], middle + (x[1] - middle) * zooms[event.key]]);
      else if (event.key === "0") this.reset();
      else return;
      event.preventDefault();
    }
  }

  // the mechanism over time: links that bend by their shapes; points of the rigid robot plus magnified deviations from them
  class Motion {
    constructor(panel, given) {
      Object.assign(this, { panel, ...given, frame: 0, times: given.magnification, playing: false, chains: [], count: 1 });
      // points of the proximal links, and those of the distal ones between elbow and end effector, which is the last of all
      this.count += this.legs.reduce((sum, { shapes: [one, other] }) => sum + one.length + other.length - 2, 0);
      let next = 0;
      for (const { shapes: [one, other] } of this.legs) {
        const own = Array.from({ length: one.length + other.length - 2 }, () => next++), parts = [own.slice(0, one.length), [...own.slice(one.length - 1), this.count - 1]];
        parts.forEach((points, k) => this.chains.push({ points, colour: this.links[k][0], width: this.links[k][1] }));
      }
      const { figure } = panel.chart, controls = html("div", { className: "controls" }, figure);
      this.button = html("button", { type: "button", onclick: () => this.play() }, controls, "play");
      const slider = (name, properties, changed) => {
        const label = html("label", {}, controls, name), input = html("input", { type: "range", ...properties, oninput: () => changed(+input.value) }, label);
        return [input, html("output", {}, label)];
      };
      const power = Math.log10(this.magnification);
      [this.slider, this.shownTime] = slider("time", { min: 0, step: 1, value: 0 }, (k) => { this.stop(); page.at(this.time[k]); });
      [, this.shownTimes] = slider("deflection", { min: 0, max: Math.max(3, power + 1), step: 0.01, value: power }, (p) => { this.times = 10 ** p; this.tell(); panel.chart.build(panel.chart.width); });
      this.take(given.rows.map(numbers));
      // a rigid robot has nothing to magnify, but for rounding
      if (this.deviation.every((each) => Math.abs(each) < 1e-12)) this.shownTimes.parentElement.remove();
      this.tell();
    }
    // the rigid robot's elbow and angle of a leg, the end effector being at x, y
    elbow({ base, side }, [x, y]) {
      const [one, other] = this.lengths, dx = x - base[0], dy = y - base[1], square = dx * dx + dy * dy, a = 0.5 + (one * one - other * other) / (2 * square), h = side * Math.sqrt(Math.max((one * one) / square - a * a, 0));
      return [base[0] + a * dx - h * dy, base[1] + a * dy + h * dx];
    }
    angle(leg, end) {
      const [x, y] = this.elbow(leg, end);
      return Math.atan2(y - leg.base[1], x - leg.base[0]);
    }
    // values at the instants: time, end effector of the rigid robot, its deviation, and what each leg's signals are: angle relative to the rigid robot's, elongation, modes
    take([time, x, y, dx, dy, ...others]) {
      const { count, legs, lengths: [length] } = this, instants = time.length, n = 2 * count * instants, rows = others.values();
      const moves = legs.map((leg) => { const [angle, elongation] = [rows.next().value, rows.next().value]; return { leg, angle, elongation, modes: leg.shapes.map((matrix) => matrix[0].map(() => rows.next().value)) }; });
      const link = ([x0, y0], [x1, y1], matrix, modes, i) => matrix.map((shape, k) => {
        const s = k / (matrix.length - 1), w = modes.reduce((sum, each, m) => sum + shape[m] * each[i], 0) / Math.hypot(x1 - x0, y1 - y0);
        return [x0 + s * (x1 - x0) - w * (y1 - y0), y0 + s * (y1 - y0) + w * (x1 - x0)];
      });
      const points = (i, isRigid) => {
        const rigid = [x[i], y[i]], end = isRigid ? rigid : [x[i] + dx[i], y[i] + dy[i]];
        return [...moves.flatMap(({ leg, angle, elongation, modes }) => {
          const { base, shapes } = leg, q = this.angle(leg, rigid) + (isRigid ? 0 : angle[i]), l = length + (isRigid ? 0 : elongation[i]), bent = isRigid ? [[], []] : modes;
          const proximal = link(base, [base[0] + l * Math.cos(q), base[1] + l * Math.sin(q)], shapes[0], bent[0], i);
          return [...proximal, ...link(proximal.at(-1), end, shapes[1], bent[1], i).slice(1, -1)];
        }), end].flat();
      };
      Object.assign(this, { time, instants, rigid: new Float64Array(n), deviation: new Float64Array(n) });
      for (let i = 0; i < instants; i++) {
        const rigid = points(i, true);
        this.rigid.set(rigid, 2 * i * count);
        this.deviation.set(points(i, false).map((v, k) => v - rigid[k]), 2 * i * count);
      }
      this.slider.max = instants - 1;
    }
    at(k, j) {
      const i = 2 * (k * this.count + j), { rigid, deviation, times } = this;
      return [rigid[i] + times * deviation[i], rigid[i + 1] + times * deviation[i + 1]];
    }
    // all places that any point reaches
    extent(axis) {
      const ends = (times) => {
        let low = Infinity, high = -Infinity;
        for (let i = axis === "x" ? 0 : 1; i < this.rigid.length; i += 2) { const v = this.rigid[i] + times * this.deviation[i]; low = v < low ? v : low; high = v > high ? v : high; }
        return [low, high];
      };
      const [low, high] = ends(0), all = ends(this.times);
      return [Math.max(all[0], low - (high - low)), Math.min(all[1], high + (high - low))];
    }
    tell() {
      this.slider.value = this.frame;
      this.shownTime.textContent = `${(1e3 * this.time[this.frame]).toFixed(0)} ms`;
      this.shownTimes.textContent = `${short(this.times, 3)} ×`;
    }
    show(time) {
      this.frame = nearest(this.time, time);
      this.tell();
      this.panel.plot?.redraw(false);
    }
    draw(line, disc, at) {
      const { count, frame, chains } = this, place = (k, j) => { const [x, y] = this.at(k, j); return [at(x, "x"), at(y, "y")]; };
      line(Array.from({ length: frame + 1 }, (_, k) => place(k, count - 1)), "var(--second)", 1);
      for (const chain of chains) line(chain.points.map((j) => place(frame, j)), chain.colour, chain.width);
      disc(...place(frame, count - 1), 8, "var(--second)");
    }
    stop() { this.playing = false; this.button.textContent = "play"; }
    play() {
      if (this.playing) return this.stop();
      this.playing = true;
      this.button.textContent = "pause";
      let before = performance.now(), time = this.time[this.frame];
      const step = (now) => {
        if (!this.playing) return;
        // what is in view takes as long as the whole
        const all = [this.time[0], this.time[this.instants - 1]], zoomed = charts.find((each) => each.overTime && !each.button.hidden);
        const [first, last] = zoomed ? zoomed.panels[0].shown.x.map((t) => clamp(t, ...all)) : all;
        time += (now - before) / 1e3 / this.slower * (last - first) / (all[1] - all[0]);
        before = now;
        if (!(time >= first && time <= last)) time = first;
        page.at(time);
        requestAnimationFrame(step);
      };
      requestAnimationFrame(step);
    }
  }

  addEventListener("DOMContentLoaded", () => {
    for (const body of document.querySelectorAll(".chart")) charts.push(new Chart(body));
    const again = () => charts.forEach((each) => each.redraw());
    for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", again);
    addEventListener("keydown", ({ key }) => { if (key === "Escape") for (const each of charts) if (!each.button.hidden) each.reset(); });
    addEventListener("beforeprint", () => charts.forEach((each) => each.later?.()));
    dispatchEvent(new Event("charts"));
  });
  return {
    charts, html, short, range,
    /** Shows an instant in all charts over time, and the robot then. */
    at(time) {
      for (const chart of charts) {
        if (chart.overTime) chart.read(clamp(time, ...chart.limits));
        for (const panel of chart.panels) panel.motion?.show(time);
      }
    },
  };
})();
