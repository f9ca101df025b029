// Sliders that simulate: what they change is computed by the module in the page (simulation.js), and drawn in the page's charts.
(async () => {
  const { html, short, charts } = page, panel = document.getElementById("live"), status = panel.querySelector(".status");
  await new Promise((done) => (charts.length ? done() : addEventListener("charts", done, { once: true })));
  const simulation = await Simulation.load(document.getElementById("module").textContent), { facts } = simulation, usual = simulation.run();
  const state = new Map(), rows = panel.querySelector(".sliders"), more = panel.querySelector(".more"), POSITION = ["end_effector.position.x", "end_effector.position.y"];

  // what the state of the sliders is for a run
  const options = () => {
    const parameters = {}, found = { parameters };
    for (const [slider, value] of state) {
      if (slider.name === "duration") found.stretch = value / facts.duration;
      else if (slider.name === "accuracy") Object.assign(found, { step: facts.step * 2 ** value, tolerance: facts.tolerance * 10 ** value });
      else for (const each of slider.targets) parameters[each] = value * (slider.sign ?? 1);
    }
    return found;
  };

  // sliders: the five that change the metrics most, the others folded away
  const influence = (slider) => {
    try {
      const value = slider.value * 1.1, changed = simulation.run(slider.name === "duration" ? { stretch: 1.1 } : { parameters: Object.fromEntries(slider.targets.map((each) => [each, value * (slider.sign ?? 1)])) });
      const { metrics } = changed, before = usual.metrics;
      return Object.keys(before).reduce((sum, name) => sum + (before[name] && metrics[name] !== null ? Math.min(Math.abs(metrics[name] / before[name] - 1), 1) : 0), 0);
    } catch { return 0; }
  };
  const spread = 3, accuracy = { name: "accuracy", label: "accuracy", unit: "", value: 0 };
  const sliders = facts.sliders.map((each) => ({ ...each, influence: influence(each) })).sort((a, b) => b.influence - a.influence);
  const written = (slider, value) => (slider === accuracy ? `step ${short(1e3 * facts.step * 2 ** value, 3)} ms, tolerance ${short(facts.tolerance * 10 ** value, 2)}` : `${short(value, 4)} ${slider.unit}`.trim());
  const add = (slider, parent) => {
    const label = html("label", { title: slider.key || "" }, parent), isAccuracy = slider === accuracy;
    html("span", {}, label, slider.label);
    slider.input = html("input", { type: "range", min: isAccuracy ? -2 : -1, max: isAccuracy ? 3 : 1, step: isAccuracy ? 1 : 0.005, value: 0, ariaLabel: slider.label }, label);
    slider.output = html("output", {}, label, written(slider, slider.value));
    slider.input.addEventListener("input", () => {
      const at = +slider.input.value;
      if (at === 0) state.delete(slider); else state.set(slider, isAccuracy ? at : +(slider.value * spread ** at).toPrecision(4));
      slider.output.textContent = written(slider, state.get(slider) ?? slider.value);
      changed();
    });
  };
  sliders.slice(0, 5).forEach((each) => add(each, rows));
  add(accuracy, rows);
  sliders.slice(5).forEach((each) => add(each, more));
  more.parentElement.hidden = sliders.length <= 5;

  // curves of a result by the key of their chart: for each panel its curves as [x, y]
  const kept = {}, distance = (one, other) => one[0].map((x, i) => Math.hypot(x - other[0][i], one[1][i] - other[1][i]));
  const curves = {
    references: (r) => ["position", "velocity", "acceleration"].map((kind) => [1, 2].map((j) => [r.time, r.signal(`joint${j}.reference.${kind}`)])),
    torques: (r) => [[1, 2].map((j) => [r.time, r.signal(`joint${j}.torque`)])],
    tracking: (r) => [[1, 2].map((j) => [r.time, r.signal(`joint${j}.position`).map((q, i) => 1e3 * (q - r.signal(`joint${j}.reference.position`)[i]))])],
    deflections: (r) => [[1, 2].filter((j) => r.signal(`link${j}1.tip_deflection`)).map((j) => [r.time, r.signal(`link${j}1.tip_deflection`).map((v) => 1e3 * v)])],
    position: (r) => [[[r.time, distance(r.ends(0), r.rigids(0)).map((v) => 1e3 * v)]]],
    acceleration: (r) => { const n = r.index(r.duration, true); return [[[r.time.subarray(0, n), distance(r.ends(2), r.rigids(2)).subarray(0, n)]]]; },
    dwell: (r) => { const n = r.index(r.duration); return [[[r.time.subarray(n), distance(r.ends(0), [0, 1].map((k) => new Float64Array(r.size).fill(r.rest[k]))).subarray(n).map((v) => 1e6 * v)]]]; },
    spectrum: (r) => [[0, 1].map((k) => r.spectrum(k))],
    path: (r) => {
      const times = charts.flatMap((chart) => chart.panels).find((each) => each.motion)?.motion.magnification ?? 1, [ends, rigids] = [r.ends(0), r.rigids(0)];
      return [[rigids, [0, 1].map((k) => rigids[k].map((v, i) => v + times * (ends[k][i] - v)))]];
    },
  };
  // a computed curve of the recording is kept
  for (const [key, all] of Object.entries(curves)) curves[key] = (r) => (r === usual ? (kept[key] ??= all(r)) : all(r));
  Object.assign(Result.prototype, {
    ends(order) { return POSITION.map((name) => this.signal(name, order)); },
    rigids(order) { return (this.known ??= {})[order] ??= [0, 1].map((k) => Float64Array.from({ length: this.size }, (_, i) => this.rigid[i * 2 * ENDS + 2 * order + k])); },
    index(time, isAfter = false) { let n = 0; while (n < this.size && (isAfter ? this.time[n] <= time + 1e-9 : this.time[n] < time - 1e-9)) n++; return n; },
    // Hann window, mean removed, zeros appended to four times the length, as spectrum.py has it
    spectrum(axis) {
      const n = this.index(this.duration), time = this.time.subarray(n), values = this.ends(0)[axis].subarray(n), last = time.length - 1, count = Math.round((time[last] - time[0]) / facts.step);
      if (count < 8) return [[], []];
      const step = (time[last] - time[0]) / count, all = new Float64Array(count + 1);
      for (let i = 0, at = 0; i <= count; i++) { const t = time[0] + i * step; while (at < last - 1 && time[at + 1] < t) at++; const h = time[at + 1] - time[at]; all[i] = h ? values[at] + (values[at + 1] - values[at]) * Math.min((t - time[at]) / h, 1) : values[at + 1]; }
      const window = all.map((_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / count)), total = window.reduce((a, b) => a + b, 0), mean = all.reduce((sum, v, i) => sum + v * window[i], 0) / total;
      const size = 2 ** Math.ceil(Math.log2(4 * (count + 1))), re = new Float64Array(size), im = new Float64Array(size);
      all.forEach((v, i) => { let j = 0; for (let bit = 1, k = i; bit < size; bit <<= 1, k >>= 1) j = (j << 1) | (k & 1); re[j] = (v - mean) * window[i]; });
      for (let half = 1; half < size; half <<= 1) for (let k = 0; k < half; k++) {
        const c = Math.cos((-Math.PI * k) / half), s = Math.sin((-Math.PI * k) / half);
        for (let i = k; i < size; i += 2 * half) { const j = i + half, x = c * re[j] - s * im[j], y = c * im[j] + s * re[j]; re[j] = re[i] - x; im[j] = im[i] - y; re[i] += x; im[i] += y; }
      }
      const shown = Math.min(size / 2, Math.ceil((charts.find((chart) => chart.key === "spectrum")?.panels[0].xLimits?.[1] ?? 1 / step) * size * step));
      return [Float64Array.from({ length: shown }, (_, i) => i / (size * step)), Float64Array.from({ length: shown }, (_, i) => (1e6 * 2 * Math.hypot(re[i], im[i])) / total)];
    },
  });

  // the robot in motion: points along its links, the rigid robot's and the deviations, at the animation's instants
  const moved = (motion, r) => {
    const { robot } = facts, { count } = motion, instants = (motion.instants = 121), all = new Float32Array(instants * (1 + 4 * count)), from = r.time[r.size - 1] - Math.min(r.time[r.size - 1], robot.longest);
    const ends = r.ends(0), rigids = r.rigids(0), signal = (...names) => names.map((name) => r.signal(name)).find(Boolean);
    const bent = robot.shapes.map(({ signals, matrix }) => ({ matrix, found: signals.map((name) => r.signal(name)) }));
    for (let f = 0, i = 0; f < instants; f++) {
      const t = from + ((r.time[r.size - 1] - from) * f) / (instants - 1), put = (j, k, rigid, point) => { const at = instants + 2 * (f * count + j) + k; all[at] = rigid; all[at + 2 * count * instants] = point - rigid; };
      while (i < r.size - 1 && r.time[i] < t) i++;
      all[f] = r.time[i];
      let j = 0;
      robot.bases.forEach((base, leg) => {
        const along = (from, to, { matrix, found }, first, last, rigidFrom, rigidTo) => {
          const x = to[0] - from[0], y = to[1] - from[1], length = Math.hypot(x, y), n = matrix.length;
          for (let k = first; k < last; k++) {
            const s = k / (n - 1), w = matrix[k].reduce((sum, shape, m) => sum + shape * found[m][i], 0), put2 = [from[0] + s * x - (w * y) / length, from[1] + s * y + (w * x) / length];
            for (const axis of [0, 1]) put(j, axis, rigidFrom[axis] + s * (rigidTo[axis] - rigidFrom[axis]), put2[axis]);
            if (k === n - 1) tip = put2;
            j++;
          }
        };
        const reference = signal(`joint${leg + 1}.reference.position`)[i], angle = (signal(`joint${leg + 1}.position`) ? signal(`joint${leg + 1}.position`)[i] : reference) + (signal(`joint${leg + 1}.twist`)?.[i] ?? 0);
        const length = robot.length + (signal(`link${leg + 1}1.elongation`)?.[i] ?? 0), at = (l, q) => [base[0] + l * Math.cos(q), base[1] + l * Math.sin(q)], elbow = at(robot.length, reference);
        const [proximal, distal] = [bent[2 * leg], bent[2 * leg + 1]], end = [ends[0][i], ends[1][i]], rigidEnd = [rigids[0][i], rigids[1][i]];
        let tip = at(length, angle);
        along(base, tip, proximal, 0, proximal.matrix.length, base, elbow);
        along(tip, end, distal, 1, distal.matrix.length - 1, elbow, rigidEnd);
      });
      for (const axis of [0, 1]) put(count - 1, axis, rigids[axis][i], ends[axis][i]);
    }
    motion.take(all);
    motion.slider.max = instants - 1;
  };

  // draw a result; recorded curves stay as thin lines, and references are what they were unless their time changes
  const shown = new Set([...document.querySelectorAll("[data-metric]")].map((tile) => tile.dataset.metric));
  let referenced = "";
  const show = (r, isUsual) => {
    for (const chart of charts) {
      const isShown = chart.key in curves && (chart.key !== "dwell" && chart.key !== "spectrum" || r.time[r.size - 1] > r.duration);
      const { motion } = chart.panels[0];
      if (motion) chart.whenSeen(() => { const now = motion.time[motion.frame]; moved(motion, r); motion.show(now); });
      if (chart.key === "references" && referenced === r.grid.key) continue;
      if (isShown) chart.whenSeen(() => {
        const recorded = isUsual || chart.key === "references" ? null : curves[chart.key](usual);
        curves[chart.key](r).forEach((list, n) => list.forEach(([x, y], i) => {
          const curve = chart.panels[n].curves[i];
          if (curve) Object.assign(curve, { x, y, ghost: recorded && { x: recorded[n][i][0], y: recorded[n][i][1] } });
        }));
        for (const each of chart.panels) {
          if (each.marks.length && chart.overTime) each.marks[0] = [r.duration, each.marks[0][1]];
          if (chart.key === "dwell") each.xLimits = [r.duration, r.time[r.size - 1]];
        }
        chart.redraw(true);
      });
    }
    referenced = r.grid.key;
    const metrics = r.measure(shown), verdict = document.querySelector(".verdict");
    verdict.dataset.recorded ??= verdict.textContent;
    verdict.textContent = (isUsual ? "" : "As recorded: ") + verdict.dataset.recorded;
    for (const tile of document.querySelectorAll("[data-metric]")) {
      const { factor, unit, text, limit } = JSON.parse(tile.dataset.shown), value = metrics[tile.dataset.metric];
      if (!(tile.dataset.metric in metrics)) continue;
      tile.parentElement.classList.toggle("over", limit !== null && value > limit);
      tile.textContent = isUsual ? text : value === null ? "–" : `${short(value * factor, 5)} ${unit}`.trim();
    }
    return metrics;
  };

  // the error of a result by a companion, where there is time
  let pending = 0, idle = 0;
  const companion = (given, r, metrics) => {
    const finer = simulation.run({ ...given, step: (given.step ?? facts.step) / 2, tolerance: Math.max((given.tolerance ?? facts.tolerance) / 100, 1e-12) }).measure(shown);
    const errors = Object.keys(metrics).map((name) => (metrics[name] && finer[name] ? Math.abs(finer[name] / metrics[name] - 1) : 0));
    status.textContent = `${status.dataset.time}, metrics within ${short(Math.max(...errors, 1e-12), 2)} of a run with half the step and a hundredth of the tolerance`;
  };
  const update = () => {
    pending = 0;
    const began = performance.now(), given = options(), isUsual = state.size === 0;
    try {
      const r = isUsual ? usual : simulation.run(given), metrics = show(r, isUsual);
      status.dataset.time = `simulated in ${short(r.elapsed, 3)} ms`;
      status.textContent = r.failure ? `${status.dataset.time}: ${r.failure}` : status.dataset.time;
      clearTimeout(idle);
      if (!r.failure) idle = setTimeout(() => companion(given, r, metrics), 300);
    } catch (error) { status.textContent = error.message; }
    page.redrawn = performance.now() - began;
    page.updates = (page.updates ?? 0) + 1;
  };
  let addressed = 0;
  const changed = () => {
    const text = [...state].map(([slider, value]) => `${slider.name}=${value}`).join("&");
    // which takes milliseconds, and browsers limit how often
    clearTimeout(addressed);
    addressed = setTimeout(() => {
      try { history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search); } catch { /* a notebook's frame has no address */ }
    }, 150);
    panel.querySelector(".reset-all").hidden = !state.size;
    pending ||= requestAnimationFrame(update);
  };
  const command = () => `flexfmu run ${facts.name}${[...state].map(([slider, value]) => {
    if (slider === accuracy) return ` --step ${+(facts.step * 2 ** value).toPrecision(6)} --tolerance ${+(facts.tolerance * 10 ** value).toPrecision(6)}`;
    return slider.key ? ` --set '${slider.key}=${slider.vector ? slider.vector.replace("*", value * (slider.sign ?? 1)) : value}'` : "";
  }).join("")}`;
  const copy = panel.querySelector(".copy");
  copy.addEventListener("click", async () => {
    const text = command();
    copy.nextElementSibling.textContent = text;
    await navigator.clipboard?.writeText(text).catch(() => {});
  });
  panel.querySelector(".reset-all").addEventListener("click", () => {
    for (const slider of [...state.keys()]) { slider.input.value = 0; slider.output.textContent = written(slider, slider.value); }
    state.clear();
    changed();
  });
  // the state that the address has
  for (const part of location.hash.slice(1).split("&")) {
    const [name, value] = part.split("="), slider = [...sliders, accuracy].find((each) => each.name === name);
    if (!slider || !isFinite(+value)) continue;
    state.set(slider, +value);
    slider.input.value = slider === accuracy ? value : Math.log(value / slider.value) / Math.log(spread);
    slider.output.textContent = written(slider, +value);
  }
  show(usual, true);
  if (state.size) changed(); else status.textContent = `simulated in ${short(usual.elapsed, 3)} ms, with all bits of the recording`;
  page.live = { simulation, usual, update, state, sliders, command };
  panel.classList.add("ready");
})().catch((error) => {
  document.querySelector("#live .status").textContent = `This browser can't simulate: ${error.message}. All is as recorded.`;
});
