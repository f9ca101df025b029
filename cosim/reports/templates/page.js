"use strict";
// Charts that zoom and show values, and the moving mechanism; a chart's data stands in its own attributes (see chart.py).
(() => {
  const SVG = "http://www.w3.org/2000/svg", MOST = 9, STEPS = [1, 2, 2.5, 5, 10];
  const numbers = text => {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0)), view = new DataView(bytes.buffer);
    return Float32Array.from({ length: bytes.length / 4 }, (_, i) => view.getFloat32(4 * i, true));
  };
  const make = (name, attributes, parent, text) => {
    const element = document.createElementNS(SVG, name);
    for (const key in attributes) element.setAttribute(key, attributes[key]);
    if (text !== undefined) element.textContent = text;
    return parent.appendChild(element);
  };
  const html = (name, properties, parent) => parent.appendChild(Object.assign(document.createElement(name), properties));
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  // an axis: values to positions and back, ticks and labels as axis.py has them
  const axis = (low, high, begin, end, log, room) => {
    const f = log ? Math.log10 : v => v, g = log ? v => 10 ** v : v => v;
    const scale = (end - begin) / (f(high) - f(low));
    return { low, high, begin, end, log, room, f, g, at: v => begin + (f(v) - f(low)) * scale, value: p => g(f(low) + (p - begin) / scale) };
  };
  const within = (axis, factors, exponents) =>
    exponents.flatMap(k => factors.map(m => +`${m}e${k}`)).filter(v => v >= axis.low * (1 - 1e-9) && v <= axis.high * (1 + 1e-9));
  const ticks = a => {
    const count = clamp(Math.floor(Math.abs(a.end - a.begin) / a.room), 1, MOST);
    if (a.log && a.high / a.low > 5) {
      const first = Math.floor(Math.log10(a.low)), last = Math.ceil(Math.log10(a.high)), every = Math.max(1, Math.ceil((last - first) / count));
      const exponents = Array.from({ length: last - first + 1 }, (_, i) => first + i).filter(k => k % every === 0);
      const found = [[1], [1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9]].map(factors => within(a, factors, exponents));
      return found.find(each => each.length > 2) || found[2];
    }
    const raw = (a.high - a.low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * STEPS.find(s => s * power >= raw * (1 - 1e-9));
    const first = Math.ceil(a.low / step - 1e-9), last = Math.floor(a.high / step + 1e-9);
    return Array.from({ length: last - first + 1 }, (_, i) => (first + i) * step);
  };
  // a number as Python's format g has it
  const short = (value, digits = 6) => {
    const exponent = value ? +value.toExponential(digits - 1).split("e")[1] : 0;
    const text = exponent < -4 || exponent >= digits ? value.toExponential(digits - 1) : value.toPrecision(digits);
    return text.replace(/(\.\d*?)0+(e|$)/, "$1$2").replace(/\.(e|$)/, "$1").replace(/e([+-])(\d)$/, "e$10$2").replace(/-/g, "−");
  };
  const labels = (a, values) => {
    const largest = Math.max(...values.map(Math.abs));
    if (a.log || !(largest >= 1e-4 && largest < 1e6) || values.length < 2) return values.map(v => short(v));
    const exact = 1e-3 * (values[1] - values[0]);
    let decimals = 0;
    while (decimals < 12 && values.some(v => Math.abs(v - +v.toFixed(decimals)) >= exact)) decimals++;
    return values.map(v => (v || 0).toFixed(decimals).replace("-", "−"));
  };

  // a panel: its axes, and its curves with their values
  const readCurve = element => {
    const more = JSON.parse(element.dataset.more || "[]"), all = numbers(element.dataset.xy), size = all.length / (2 + more.length);
    const channel = i => all.subarray(i * size, (i + 1) * size), dots = element.nextElementSibling;
    return {
      element, more, size, x: channel(0), y: channel(1), extra: more.map((_, i) => channel(2 + i)), label: element.dataset.label || "",
      notes: JSON.parse(element.dataset.notes || "[]"), colour: element.getAttribute("stroke"), isRead: element.classList.contains("curve"),
      dots: dots && /^(disc|cross)$/.test(dots.getAttribute("class")) ? dots : null,
    };
  };
  const readPanel = element => {
    const a = element.dataset.axes.split(" ").map(Number), names = JSON.parse(element.dataset.names);
    const panel = { element, names, curves: [...element.querySelectorAll("[data-xy]")].map(readCurve) };
    for (const flag of element.dataset.flags.split(" ")) panel[flag] = true;
    panel.x = panel.wholeX = axis(...a.slice(0, 5), 27);
    panel.y = panel.wholeY = axis(...a.slice(5), 18);
    return panel;
  };
  const drawn = (panel, curve, sign) => {
    let d = "", pen = "M";
    for (let i = 0; i < curve.size; i++) {
      const x = panel.x.at(curve.x[i]), y = panel.y.at(curve.y[i]);
      if (!isFinite(x) || !isFinite(y)) { pen = "M"; continue; }
      d += `${sign ? "M" : pen}${clamp(x, -1e4, 1e4).toFixed(1)} ${clamp(y, -1e4, 1e4).toFixed(1)}${sign || ""}`;
      pen = "L";
    }
    return d;
  };
  const draw = panel => {
    const { x, y, element } = panel, part = name => element.querySelector(name);
    const xs = ticks(x), ys = ticks(y), labelsX = labels(x, xs), labelsY = labels(y, ys);
    const join = (values, f) => values.map(f).join("");
    part(".grid").setAttribute("d", join(xs, v => `M${x.at(v)} ${y.begin}V${y.end}`) + join(ys, v => `M${x.begin} ${y.at(v)}H${x.end}`));
    part(".frame").setAttribute("d", `M${x.begin} ${y.end}V${y.begin}H${x.end}` + join(xs, v => `M${x.at(v)} ${y.begin}v3.5`) + join(ys, v => `M${x.begin} ${y.at(v)}h-3.5`));
    const group = part(".ticks"), style = { "font-size": 9, fill: "var(--ink)" };
    group.textContent = "";
    ys.forEach((v, i) => make("text", { x: x.begin - 7, y: y.at(v) + 3.42, "text-anchor": "end", ...style }, group, labelsY[i]));
    if (panel.last) xs.forEach((v, i) => make("text", { x: x.at(v), y: y.begin + 13.84, "text-anchor": "middle", ...style }, group, labelsX[i]));
    for (const curve of panel.curves) {
      curve.element.setAttribute("d", drawn(panel, curve));
      if (curve.dots) curve.dots.setAttribute("d", drawn(panel, curve, curve.dots.getAttribute("class") === "disc" ? "h0" : "m-2.5-2.5l5 5m0-5l-5 5"));
    }
    for (const each of element.querySelectorAll("[data-at]")) {
      const [u, v] = each.dataset.at.split(" "), left = u === "*" ? 0 : x.at(+u), down = v === "*" ? 0 : y.at(+v);
      each.setAttribute("transform", `translate(${left} ${down})`);
      const outside = (u !== "*" && (left < x.begin - 1 || left > x.end + 1)) || (v !== "*" && (down > y.begin + 1 || down < y.end - 1));
      each.style.display = outside ? "none" : "";
    }
    if (panel.motion) panel.motion();
  };
  const zoomed = (a, low, high) => axis(low, high, a.begin, a.end, a.log, a.room);
  // vertical limits of what is visible
  const fit = panel => {
    let low = Infinity, high = -Infinity;
    for (const c of panel.curves) if (!c.off) for (let i = 0; i < c.size; i++) {
      const v = c.y[i];
      if (c.x[i] < panel.x.low || c.x[i] > panel.x.high || !isFinite(v) || (panel.y.log && v <= 0)) continue;
      low = Math.min(low, v); high = Math.max(high, v);
    }
    if (!(high > low)) return;
    const { f, g } = panel.y, margin = 0.05 * (f(high) - f(low));
    panel.y = zoomed(panel.y, panel.zero ? 0 : g(f(low) - margin), g(f(high) + margin));
  };

  const chart = svg => {
    const panels = [...svg.querySelectorAll(".panel")].map(readPanel), figure = svg.parentElement;
    const tip = html("div", { className: "tip", hidden: true }, figure), cursor = make("g", { class: "cursor" }, svg);
    const reset = html("button", { className: "reset", hidden: true, textContent: "reset zoom" }, figure);
    let place = null, began = null;
    svg.tabIndex = 0;
    // limits: horizontal ones for all panels, vertical ones for the one that is zoomed or of what is visible
    const show = (x, y, chosen) => {
      for (const panel of panels) {
        panel.x = zoomed(panel.x, ...x);
        if (y && panel === chosen) panel.y = zoomed(panel.y, ...y); else if (!y) fit(panel);
        draw(panel);
      }
      reset.hidden = false; hide();
    };
    const whole = () => {
      for (const panel of panels) { panel.x = panel.wholeX; panel.y = panel.wholeY; draw(panel); }
      reset.hidden = true; hide();
    };
    const hide = () => { tip.hidden = true; cursor.textContent = ""; };
    const point = event => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const panelAt = p => panels.find(({ x, y }) => p.x >= x.begin - 4 && p.x <= x.end + 4 && p.y >= y.end - 4 && p.y <= y.begin + 4);
    const name = text => /^(.*) \[(.*)\]$/.exec(text) || [text, text, ""];
    const line = (text, value, colour) => {
      const row = html("div", {}, tip), [, what, unit] = name(text);
      if (colour) html("i", {}, row).style.background = colour;
      row.append(`${what} ${short(value)} ${unit}`.trim());
    };

    // values at a position: of all curves at the nearest time, or of the nearest point
    const nearest = (curve, panel, p) => {
      let best = -1, least = Infinity;
      for (let i = 0; i < curve.size; i++) {
        const dx = panel.x.at(curve.x[i]) - p.x, dy = panel.function ? 0 : panel.y.at(curve.y[i]) - p.y, distance = dx * dx + dy * dy;
        if (distance < least) { least = distance; best = i; }
      }
      return { curve, panel, i: best, distance: least };
    };
    const read = p => {
      hide();
      const panel = p && panelAt(p);
      if (!panel) return;
      let found = (panel.function ? panels : [panel]).flatMap(each => each.curves.filter(c => c.isRead && !c.off && c.size).map(c => nearest(c, each, p)));
      if (!found.length) return;
      const closest = found.reduce((a, b) => b.distance < a.distance ? b : a);
      if (!panel.function) found = [closest];
      tip.textContent = "";
      const { curve, i } = closest, left = panel.x.at(curve.x[i]);
      if (panel.function) {
        make("path", { d: panels.map(({ y }) => `M${left} ${y.begin}V${y.end}`).join(""), stroke: "var(--grey)", "stroke-width": 0.6 }, cursor);
        line(panel.names[0], curve.x[i]);
      } else if (curve.label) html("div", { textContent: curve.label }, tip);
      for (const { curve: c, panel: own, i: k } of found) {
        make("circle", { cx: own.x.at(c.x[k]), cy: own.y.at(c.y[k]), r: 2.6, fill: c.colour }, cursor);
        const [, what, unit] = name(own.names[1]);
        if (c.more.length) c.more.forEach((text, n) => line(text, c.extra[n][k], n ? "" : c.colour));
        else if (panel.function) line(`${panels.length > 1 || !c.label ? what : ""} ${c.label}`.trim() + ` [${unit}]`, c.y[k], c.colour);
        else { line(own.names[0], c.x[k], c.colour); line(own.names[1], c.y[k]); }
        if (c.notes[k]) html("div", { textContent: c.notes[k] }, tip);
      }
      tip.hidden = false;
      const box = svg.getBoundingClientRect(), frame = figure.getBoundingClientRect(), scale = box.width / svg.viewBox.baseVal.width;
      const x = box.left - frame.left + left * scale, room = frame.width - tip.offsetWidth - 4;
      tip.style.left = `${clamp(x + 12 > room ? x - tip.offsetWidth - 12 : x + 12, 4, Math.max(room, 4))}px`;
      tip.style.top = `${box.top - frame.top + Math.max(panel.y.end, p.y - 40) * scale}px`;
    };
    svg.addEventListener("pointerdown", event => {
      const p = point(event), panel = panelAt(p);
      if (!panel || event.button) return;
      began = { p, panel };
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", event => {
      place = point(event);
      if (!began) return read(place);
      hide();
      const { p, panel: { x, y, function: isFunction } } = began, [left, right] = [p.x, place.x].sort((a, b) => a - b), [top, bottom] = [p.y, place.y].sort((a, b) => a - b);
      make("rect", {
        x: left, width: right - left, y: isFunction ? y.end : top, height: isFunction ? y.begin - y.end : bottom - top, fill: "var(--first)", "fill-opacity": 0.15,
      }, cursor);
    });
    const stop = event => {
      if (!began) return;
      const { p, panel } = began, q = point(event);
      began = null;
      if (event.type === "pointercancel" || Math.abs(q.x - p.x) < 5) return read(q);
      const across = [p.x, q.x].map(v => panel.x.value(clamp(v, panel.x.begin, panel.x.end))).sort((a, b) => a - b);
      if (panel.function) return show(across);
      let up = [p.y, q.y].map(v => panel.y.value(clamp(v, panel.y.end, panel.y.begin))).sort((a, b) => a - b);
      // one scale for both axes: about the middle of what was chosen
      if (panel.scale) {
        const { x, y } = panel, middle = (up[0] + up[1]) / 2, half = (across[1] - across[0]) * (y.begin - y.end) / (x.end - x.begin) / 2;
        up = [middle - half, middle + half];
      } else if (Math.abs(q.y - p.y) < 5) return hide();
      show(across, up, panel);
    };
    svg.addEventListener("pointerup", stop);
    svg.addEventListener("pointercancel", stop);
    // what a finger has shown stays until it taps elsewhere
    svg.addEventListener("pointerleave", event => { if (!began && event.pointerType !== "touch") hide(); });
    document.addEventListener("pointerdown", event => { if (!svg.contains(event.target)) hide(); });
    svg.addEventListener("dblclick", whole);
    reset.addEventListener("click", whole);
    svg.addEventListener("keydown", event => {
      const { x, y } = panels[0], middle = { x: (x.begin + x.end) / 2, y: (y.begin + y.end) / 2 };
      const p = place && panelAt(place) ? place : middle, key = event.key;
      if (key === "Escape" || key === "0") whole();
      else if (key === "ArrowLeft" || key === "ArrowRight") read(place = { x: clamp(p.x + (key === "ArrowLeft" ? -3 : 3), x.begin, x.end), y: p.y });
      else if (key === "+" || key === "-") {
        const panel = panelAt(p), factor = key === "+" ? 0.5 : 2;
        const about = (a, at) => [a.value(at + factor * (a.begin - at)), a.value(at + factor * (a.end - at))];
        show(about(panel.x, p.x), panel.function ? null : about(panel.y, p.y), panel);
      } else return;
      event.preventDefault();
    });
    // a click on the legend hides a curve
    for (const key of svg.querySelectorAll(".key")) {
      const { x, y, width, height } = key.getBBox();
      key.setAttribute("role", "button");
      make("rect", { x, y, width, height, fill: "transparent" }, key);
      key.addEventListener("click", () => {
        const off = key.classList.toggle("off");
        for (const c of panels.flatMap(panel => panel.curves)) if (c.label === key.dataset.label) {
          c.off = off;
          for (const each of [c.element, c.dots]) if (each) each.style.display = off ? "none" : "";
        }
      });
    }
    for (const panel of panels) if (panel.element.dataset.motion) animate(svg, figure, panel);
  };

  // the mechanism over time: points of chains, the rigid robot's plus magnified deviations from them
  const animate = (svg, figure, panel) => {
    const { count, instants, chains, magnification, slower } = JSON.parse(panel.element.dataset.motion), all = numbers(panel.element.dataset.points);
    const time = all.subarray(0, instants), rigid = all.subarray(instants, instants + 2 * count * instants), deviation = all.subarray(instants + 2 * count * instants);
    const group = make("g", {}, panel.element.querySelector("[clip-path]")), thin = { fill: "none", "stroke-linecap": "round", "stroke-linejoin": "round" };
    const trace = make("path", { ...thin, stroke: "var(--second)", "stroke-width": 1 }, group);
    const lines = chains.map(c => make("path", { ...thin, stroke: `var(--${c.colour})`, "stroke-width": c.width }, group));
    const end = make("circle", { r: 3.5, fill: "var(--second)" }, group);
    let frame = 0, times = magnification, playing = false, last = 0;
    const controls = html("div", { className: "controls" }, figure);
    const play = html("button", { textContent: "play" }, controls);
    const slider = (name, properties) => {
      const label = html("label", { textContent: name }, controls), input = html("input", { type: "range", ...properties }, label);
      return [input, html("output", {}, label)];
    };
    const [at, shownAt] = slider("time", { min: 0, max: instants - 1, step: 1, value: 0 });
    const [by, shownBy] = slider("deflection", { min: 0, max: Math.max(3, Math.log10(magnification) + 1), step: 0.01, value: Math.log10(magnification) });
    const place = (k, j) => {
      const i = 2 * (k * count + j);
      return `${panel.x.at(rigid[i] + times * deviation[i]).toFixed(1)} ${panel.y.at(rigid[i + 1] + times * deviation[i + 1]).toFixed(1)}`;
    };
    panel.motion = () => {
      chains.forEach((chain, n) => lines[n].setAttribute("d", "M" + chain.points.map(j => place(frame, j)).join(" ")));
      trace.setAttribute("d", "M" + Array.from({ length: frame + 1 }, (_, k) => place(k, count - 1)).join(" "));
      const [x, y] = place(frame, count - 1).split(" ");
      end.setAttribute("cx", x); end.setAttribute("cy", y);
      shownAt.textContent = `${(1e3 * time[frame]).toFixed(0)} ms`;
      shownBy.textContent = `${short(times, 3)} ×`;
    };
    const step = now => {
      if (!playing) return;
      const span = time[instants - 1] - time[0], t = time[0] + ((now - last) / 1e3 / slower) % span;
      frame = Math.max(0, time.findIndex(each => each > t) - 1);
      at.value = frame;
      panel.motion();
      requestAnimationFrame(step);
    };
    const begin = () => svg.classList.add("animated");
    at.addEventListener("input", () => { begin(); playing = false; play.textContent = "play"; frame = +at.value; panel.motion(); });
    by.addEventListener("input", () => { begin(); times = 10 ** by.value; panel.motion(); });
    play.addEventListener("click", () => {
      begin();
      playing = !playing;
      play.textContent = playing ? "pause" : "play";
      last = performance.now() - 1e3 * slower * (time[frame] - time[0]);
      if (playing) requestAnimationFrame(step);
    });
    group.style.display = "";
    panel.motion();
    begin();
  };

  document.querySelectorAll("svg.chart").forEach(chart);
})();
