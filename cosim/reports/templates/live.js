// Sliders that simulate: what they change is computed by the modules in the page (simulation.js), and drawn in the page's charts.
(async () => {
  const { html, short, charts } = page, panel = document.getElementById("live"), status = panel.querySelector(".status"), get = (name) => panel.querySelector(name);
  panel.hidden = false;
  await new Promise((done) => (charts.length ? done() : addEventListener("charts", done, { once: true })));
  const { simulations, swept, fixed } = await Simulation.load(document.getElementById("module").textContent);
  const cells = [...document.querySelectorAll("[data-metric]")].map((cell) => ({ cell, name: cell.dataset.metric, text: cell.textContent, wasOver: cell.className === "over", ...JSON.parse(cell.dataset.shown) }));
  // runs side by side, or alternatives of one run, of which one is shown
  const isSwept = Object.keys({ ...swept, ...fixed }).length > 0, isCompared = cells.some(({ names }) => names), usuals = new Map(), state = new Map();
  const usual = (simulation) => { if (!usuals.has(simulation)) usuals.set(simulation, simulation.run()); return usuals.get(simulation); };
  let chosen = 0;
  const active = () => (isCompared ? simulations : [simulations[chosen]]);

  // a slider of all runs that have the key: the first's value, of which the others' are multiples; along it values are multiplied, but
  // added over the interval of a sweep and between accuracies
  const sliders = [], spread = 3, accuracy = { name: "accuracy", label: "accuracy", unit: "", factor: 1, value: 0, low: -2, high: 3, step: 1, of: new Map() };
  for (const simulation of simulations) for (const each of simulation.facts.sliders) {
    const [written, ...range] = swept[each.key] ?? [], known = sliders.find(({ name }) => name === each.name) ?? each, ratio = known.value / each.value;
    if (known === each) sliders.push(Object.assign(each, { of: new Map(), written, range: range.length ? range : null }));
    known.low = Math.max(known.low / known.value, each.low / each.value) * known.value;
    known.high = Math.min(known.high / known.value, each.high / each.value) * known.value;
    known.of.set(simulation, ratio === 1 ? (value) => value : (value) => +(value / ratio).toPrecision(6));
  }
  for (const each of sliders) {
    if (isCompared && each.of.size < simulations.length) each.label += ` (${[...each.of.keys()].map(({ facts }) => facts.option).join(", ")})`;
    if (each.range) {
      const [low, high] = [Math.min, Math.max].map((end) => end(...each.range, each.value));
      Object.assign(each, { low, high, step: (high - low) / 400 });
    }
    // values that differ between runs are shown as multiples
    if ([...each.of.values()].some((own) => own(each.value) !== each.value)) Object.assign(each, { factor: 1 / each.value, unit: "×" });
  }
  const all = [...sliders, accuracy];
  for (const simulation of simulations) accuracy.of.set(simulation, (value) => value);
  const placeOf = ({ value, step }, v) => (step ? v : Math.log(v / value) / Math.log(spread));
  const valueAt = ({ value, step }, at) => +(step ? at : value * spread ** at).toPrecision(4);
  const valuesOf = (simulation, changed = [...state]) => Object.fromEntries(changed.flatMap(([slider, value]) => (slider.of.has(simulation) ? [[slider.name, slider.of.get(simulation)(value)]] : [])));
  const simulated = (simulation, changed) => simulation.run(simulation.options(valuesOf(simulation, changed)));

  // the five that change the metrics of the first run most, and those of a sweep; the others folded away
  const influence = (slider, simulation) => {
    try {
      const before = usual(simulation).metrics, { metrics } = simulated(simulation, [[slider, 1.1 * slider.value]]);
      return Object.keys(before).reduce((sum, name) => sum + (before[name] && metrics[name] !== null ? Math.min(Math.abs(metrics[name] / before[name] - 1), 1) : 0), 0);
    } catch { return 0; }
  };
  // as far as so many instants go, about a second; a limit of time would order them otherwise on another machine
  let instants = 1e5;
  for (const each of sliders) {
    const [simulation] = each.of.keys();
    each.influence = (each.range ? 100 : 0) + (instants > 0 ? influence(each, simulation) : 0);
    instants -= usual(simulation).size;
  }
  sliders.sort((a, b) => b.influence - a.influence);
  const { facts } = simulations[0];
  const written = (slider) => {
    const value = state.get(slider) ?? slider.value, [{ step, tolerance }, ...others] = simulations.map((each) => each.settings(value));
    if (slider !== accuracy) return `${short(value * slider.factor, 4)} ${slider.unit}`.trim();
    const isSame = others.every((each) => each.step === step && each.tolerance === tolerance);
    return isSame ? `step ${short(1e3 * step, 3)} ms, tolerance ${short(tolerance, 2)}` : `step × ${2 ** value}, tolerance × ${short(10 ** value)}`;
  };
  const rounded = (value) => +value.toPrecision(6);
  const set = (slider, value) => {
    if (value === slider.value) state.delete(slider); else state.set(slider, value);
    slider.input.value = placeOf(slider, value);
    slider.input.ariaValueText = written(slider);
    if (slider.number) slider.number.value = rounded(value * slider.factor); else slider.output.textContent = written(slider);
  };
  // a value, or the end that it is beyond; whether it is within, but for being rounded to four digits
  const take = (slider, value) => {
    const [low, high] = [slider.low, slider.high].sort((a, b) => a - b), within = +Math.min(Math.max(value, low), high).toPrecision(7);
    set(slider, within);
    return Math.abs(within - value) <= 1e-3 * Math.abs(value);
  };
  const add = (slider, parent) => {
    const label = html("label", { title: slider.key || "" }, parent), start = placeOf(slider, slider.value), ends = [placeOf(slider, slider.low), placeOf(slider, slider.high)];
    html("span", {}, label, slider.label.replace(/[._]/g, "$&\u200b"));
    const step = slider.step ?? 0.005;
    slider.input = html("input", { type: "range", min: ends[0], max: ends[1], step, value: start, ariaLabel: slider.label, ariaValueText: written(slider) }, label);
    slider.input.addEventListener("input", () => { const at = +slider.input.value; take(slider, Math.abs(at - start) < 0.5 * step ? slider.value : valueAt(slider, at)); changed(); });
    if (slider === accuracy) return (slider.output = html("output", {}, label, written(slider)));
    // a field for any value, with steps to round ones
    const { factor } = slider, every = 10 ** Math.floor(Math.log10(Math.abs(slider.value * factor)) - 1), [low, high] = [slider.low, slider.high].map((each) => (each * factor) / every).sort((a, b) => a - b), field = html("span", {}, label);
    slider.number = html("input", { type: "number", step: rounded(every), min: rounded(Math.ceil(low) * every), max: rounded(Math.floor(high) * every), value: rounded(slider.value * factor), ariaLabel: `value of ${slider.label}` }, field);
    html("span", {}, field, ` ${slider.unit}`);
    slider.number.addEventListener("change", ({ target: { value } }) => {
      if (!value) set(slider, state.get(slider) ?? slider.value);
      else if (!take(slider, +(value / factor).toPrecision(7))) refused.push(`${slider.name}=${value}`);
      changed();
    });
  };
  const first = Math.max(5, sliders.filter((each) => each.range).length);
  sliders.slice(0, first).forEach((each) => add(each, get(".sliders")));
  if (!isCompared && simulations.length > 1) {
    const label = html("label", {}, get(".sliders"));
    html("span", {}, label, "input shaper");
    const select = html("select", { ariaLabel: "input shaper", onchange: () => { page.choose(+select.value); changed(); } }, label);
    simulations.forEach(({ facts: { option } }, i) => html("option", { value: i }, select, option || "as in the scene"));
    page.choose = (i) => {
      select.value = chosen = i;
      for (const each of sliders) { each.input.disabled = each.number.disabled = !each.of.has(simulations[i]); if (each.input.disabled) set(each, each.value); }
    };
  }
  add(accuracy, get(".sliders"));
  sliders.slice(first).forEach((each) => add(each, get(".more")));
  get(".more").parentElement.hidden = sliders.length <= first;
  page.choose?.(0);
  const remarks = html("p", { className: "remarks caption" });
  get(".alarm").before(remarks);
  const spectra = charts.filter(({ x }) => x.startsWith("frequency")).flatMap(({ panels }) => panels.map((each) => (each.recorded = { marks: each.marks, markers: each.markers })));
  // what stays as it was
  const remark = () => {
    const moved = [...state.keys()], isMoved = moved.some((each) => each.targets?.length && "frozen" in each), [{ facts: { fixed } }] = active();
    remarks.textContent = [
      fixed && `The duration stays as recorded: ${fixed}.`,
      active().some((simulation) => simulation.facts.sliders.some((each) => each.frozen && each.name in valuesOf(simulation))) && "Shapers, controllers and shapes of Timoshenko beams stay as they were designed, for the recorded robot; copies say so by an imperfection, parameter-error.",
      isMoved && spectra.some(({ marks }) => marks.length) && "Natural frequencies of the changed robot aren't known: the spectrum shows none.",
    ].filter(Boolean).join(" ");
    return isMoved;
  };

  // the robot in motion, at instants that are about equally spaced
  const moved = (motion, r) => {
    const { instants } = motion, [from] = r.time, last = r.time[r.size - 1], [ends, rigids] = [r.ends(0), r.rigids(0)], index = new Int32Array(instants);
    for (let f = 0, i = 0; f < instants; index[f++] = i) while (i < r.size - 1 && r.time[i] < from + ((last - from) * f) / (instants - 1)) i++;
    const row = (valueAt) => Float64Array.from(index, valueAt), rows = [row((i) => r.time[i]), ...rigids.map((each) => row((i) => each[i])), ...rigids.map((each, axis) => row((i) => ends[axis][i] - each[i]))];
    motion.legs.forEach((leg) => leg.signals.forEach((names, k) => {
      const all = names.map((name) => r.signal(name)), rigidAngle = (i) => (k ? 0 : motion.angle(leg, rigids.map((each) => each[i])));
      rows.push(row((i) => all.reduce((sum, each) => sum + each[i], -rigidAngle(i))));
    }));
    motion.take(rows);
  };

  // draw results; recorded curves stay as thin lines
  const sourcesOf = ({ panels }) => panels.flatMap(({ curves }) => curves.map((each) => each.source)).filter(Boolean), metricCurves = charts.flatMap(sourcesOf).map((each) => each.metric).filter(Boolean);
  const shown = new Set([...cells.filter((each) => each.factor).flatMap((each) => each.parts), ...metricCurves]), verdict = document.querySelector(".verdict"), sentences = [...verdict.childNodes];
  shown.add("residual_vibration_amplitude").add("residual_vibration_rms");
  // relative errors of the metrics as far as they are known
  let errors = {};
  const magnification = () => charts.flatMap((chart) => chart.panels).find((each) => each.motion)?.motion.magnification;
  let referenced = "";
  const sliderOf = (key) => sliders.find((each) => [each.written, each.key].includes(key));
  // what the page doesn't compute of a run: sentences, rows of tables, captions of charts
  const ofRuns = isSwept ? [] : [...document.querySelectorAll("tr:not(:has([data-metric])) :is(td.value, details td)"), ...charts.filter((each) => { const { motion } = each.panels[0]; return motion ? !simulations.some(({ facts: { place } }) => place === motion.run) : !sourcesOf(each).length; }).map(({ figure }) => figure.querySelector(".caption"))];
  const others = [...document.querySelectorAll(".lead"), ...ofRuns].filter((each) => each?.textContent.trim());
  const show = (results, isUsual) => {
    const [one] = results.values(), isMoved = remark();
    for (const each of others) each.classList.toggle("stale", !isUsual);
    for (const chart of charts) {
      const { motion } = chart.panels[0], mover = results.get(motion?.run);
      if (mover) chart.whenSeen(() => { const now = motion.time[motion.frame]; moved(motion, mover); motion.show(now); });
      // the joints' references are what they were unless their time changes
      if (chart.key === "references" && referenced === `${chosen} ${one.grid.key}`) continue;
      if (sourcesOf(chart).length) chart.whenSeen(() => {
        for (const each of chart.panels) {
          for (const curve of each.curves) {
            const { source } = curve, r = results.get(source?.run ?? 0);
            if (!source || !r) continue;
            if (source.metric) {
              const slider = sliderOf(source.key), value = r.metrics[source.metric];
              Object.assign(curve, { x: [slider ? state.get(slider) ?? slider.value : NaN], y: [value === null || value === undefined ? NaN : value * source.factor] });
              continue;
            }
            const options = { magnification: magnification(), most: each.xLimits?.[1] };
            const recorded = (curve.recorded ??= usual(isCompared ? r.simulation : simulations[0]).curve(source, options) ?? [curve.x, curve.y]);
            const [x, y] = isUsual ? recorded : r.curve(source, options) ?? recorded, ghost = !isUsual && !source.of.includes("reference");
            Object.assign(curve, { x, y, ghost: ghost && { x: recorded[0], y: recorded[1] } });
          }
          if (each.marks.length && chart.overTime && !isCompared) each.marks[0] = [one.duration, each.marks[0][1]];
          if (each.recorded) {
            // its highest peak if that is resolved, and no natural frequencies of another robot
            const { frequency, height, isResolved } = one.peak(each.curves.map(({ x, y }) => [x, y])), named = { colour: "var(--ink)", offset: [5, -4], x: frequency, y: height, text: `${short(frequency, 4)} Hz` };
            each.markers = isUsual ? each.recorded.markers : isResolved ? [named] : [];
            each.marks = isMoved ? [] : each.recorded.marks;
          }
          if (chart.key === "dwell") each.xLimits = [one.duration, one.time[one.size - 1]];
        }
        chart.redraw();
      });
    }
    referenced = `${chosen} ${one.grid.key}`;
    // what failed has no figures, and of a single run its end stands in place of the verdict
    const ended = !isCompared && one.failure && [alarming(one.isUnstable ? "Unstable. " : "Failed. "), `The results end at ${short(one.time[one.size - 1], 4)} s.`];
    verdict.replaceChildren(...(ended || sentences));
    const measured = (r) => (r.failure ? Object.fromEntries([...shown].map((name) => [name, null])) : (r.measured ?? r.measure(shown)));
    const metrics = new Map([...results].map(([place, r]) => [place, measured(r)])), zero = metrics.get(0);
    const larger = (values, parts) => parts.reduce((most, part) => (values?.[part] > (most ?? -1) ? values[part] : most), values?.[parts[0]]);
    // of lengths whole picometres, below which all is rounding
    const sound = (value, unit) => (value && unit === "mm" ? Math.trunc(1e12 * value) / 1e12 : value);
    // a figure in words; undefined if the page doesn't compute it
    const worded = ({ name, text, run, factor, unit, limit, digits, compared, phrases, stays, isError, parts = [name], names, failed, offset }) => {
      if (name === "state") { const { state: now } = results.get(run); return !now && stays && text ? undefined : now && `${now}. `; }
      if (name === "failures") { const bad = names.filter((_, place) => (results.has(place) ? results.get(place).state : failed.includes(place))); return bad.length ? `Unstable or failed: ${bad.join(", ")}. ` : ""; }
      if (name === "least") {
        const known = names.map((each, place) => [sound(larger(metrics.get(place), parts), unit), each]).filter(([value], place) => results.get(place)?.state === "" && value !== null && value !== undefined).sort((a, b) => a[0] - b[0]);
        return known[0]?.[0] !== known.at(-1)?.[0] ? `${known[0][1]} ${phrases}, ${short(known[0][0] * factor, 3)} ${unit}. ` : "";
      }
      if (name === "ringing") {
        const { residual_vibration_amplitude: most, residual_vibration_rms: rms } = metrics.get(run) ?? {}, r = results.get(run), peak = most >= 1e-12 && r.peak([0, 1].map((axis) => r.spectrum(axis)));
        return !peak ? "" : rms > offset * most && peak.height < (1 - offset) * most ? ", mostly an offset that stays" : peak.isResolved ? `, mostly at ${short(peak.frequency, 4)} Hz` : "";
      }
      if (name === "motor") { const [use, what, joint] = results.get(run).motorUse ?? []; return joint ? `; motor ${joint} needs ${short(100 * use, 3)} % of its ${what}` : ""; }
      const value = sound(larger(metrics.get(run), parts), unit), base = zero ? sound(larger(zero, parts), unit) : compared, error = Math.max(...parts.map((each) => errors[each] ?? 0));
      if (value === undefined) return undefined;
      if (isError) return "";
      const difference = typeof compared === "number" && base && value !== null ? ` (${value < base ? "" : "+"}${short((100 * (value - base)) / Math.abs(base), 3)} %)` : "";
      return value === null ? phrases[0] : phrases[value <= (limit ?? 0) ? 1 : 2].replace("{}", `${short(value * factor, Math.min(digits, error ? Math.max(-Math.floor(Math.log10(error)), 1) : digits))} ${unit}`.trim() + difference);
    };
    let recorded = !isUsual && others.length > 0;
    for (const each of cells) {
      const { cell, name, parts, text, run, limit, wasOver } = each, said = isUsual ? text : worded(each);
      cell.textContent = said ?? text;
      cell.classList.toggle("stale", said === undefined);
      const isOver = () => (name === "motor" ? results.get(run).motorUse?.[0] > 1 : limit ? larger(metrics.get(run), parts) > limit : ["state", "failures"].includes(name) && said);
      cell.classList.toggle("over", Boolean(isUsual || said === undefined ? wasOver : isOver()));
      recorded ||= said === undefined && text !== "";
    }
    get(".recorded").hidden = !recorded;
    const [failed, unstable] = ["Failed", "Unstable"].map((state) => [...results.values()].find((r) => r.state === state));
    alarm(isUsual ? "" : failed ? `The simulation fails with these values: ${failed.failure}. There are no figures of it; curves end where it failed.` : unstable ? "The loop is unstable with these values: the joints run away from their references." : "");
  };
  const alarming = (text) => html("span", { className: "over" }, null, text);
  const alarm = (text) => {
    const box = get(".alarm");
    box.hidden = !text;
    if (box.textContent !== text) box.textContent = text;
  };

  // the error of a result by a companion, where there is time
  let pending = 0, idle = 0, addressed = 0, refused = [];
  // but for what is rounding, below a nanometre for example
  const figureOf = (name) => cells.find(({ parts }) => parts?.includes(name)) ?? { label: name, negligible: 0 };
  const companion = (simulation, r) => {
    const given = simulation.options(valuesOf(simulation)), metrics = r.measure(shown);
    const finer = simulation.run({ ...given, step: (given.step ?? facts.step) / 2, tolerance: Math.max((given.tolerance ?? facts.tolerance) / 100, 1e-12) }).measure(shown);
    errors = Object.fromEntries(Object.keys(metrics).map((name) => [name, metrics[name] > 1e-9 && finer[name] && Math.abs(finer[name] - metrics[name]) > figureOf(name).negligible ? Math.abs(finer[name] / metrics[name] - 1) : 0]));
    show(new Map([[r.simulation.facts.place, r]]), false);
    const [worst, error] = Object.entries(errors).reduce((one, other) => (other[1] > one[1] ? other : one));
    const said = `within ${short(100 * error, 2)} % (${figureOf(worst).label}) of a run with half the step and a hundredth of the tolerance`;
    status.textContent = `${status.dataset.time}, metrics ${error > 0.1 ? `not even ${said}: such figures are of no use, and the step is too coarse` : said}`;
  };
  const timed = (results, isUsual) => `simulated in ${short(results.reduce((sum, each) => sum + each.elapsed, 0), 3)} ms${isUsual && facts.grid.times ? ", with all bits of the recording" : ""}`;
  const update = () => {
    pending = 0;
    errors = {};
    const began = performance.now(), isUsual = state.size === 0 && chosen === 0;
    try {
      const results = new Map(active().map((each) => [each.facts.place, state.size ? simulated(each) : usual(each)])), [r] = results.values();
      show(results, isUsual);
      const failed = [...results.values()].find((each) => each.failure);
      const outside = refused.length ? `There are values outside the sliders (${refused.join(", ")}). ` : "";
      refused = [];
      status.dataset.time = outside + timed([...results.values()], isUsual);
      status.textContent = status.dataset.time;
      clearTimeout(idle);
      if (!failed && !isCompared && !isUsual) idle = setTimeout(() => companion(active()[0], r), 300);
    } catch (error) {
      // nothing was simulated: no figures, and curves of earlier values pale
      for (const { cell } of cells) cell.textContent = "–";
      verdict.replaceChildren(alarming("Failed."));
      alarm(`The page can't simulate these values: ${error.message}. The curves are those of earlier values.`);
      status.textContent = "";
    }
    document.body.classList.toggle("outdated", get(".alarm").textContent.includes("earlier values"));
    page.redrawn = performance.now() - began;
    page.updates = (page.updates ?? 0) + 1;
  };
  const changed = () => {
    const parts = [...state].map(([slider, value]) => `${slider.name}=${value}`);
    if (chosen) parts.unshift(`shaper=${chosen}`);
    // which takes milliseconds, and browsers limit how often
    clearTimeout(addressed);
    addressed = setTimeout(() => {
      try { history.replaceState(null, "", parts.length ? `#${parts.join("&")}` : location.pathname + location.search); } catch { /* a notebook's frame has no address */ }
    }, 150);
    get(".reset-all").hidden = !parts.length;
    pending ||= requestAnimationFrame(update);
  };

  // the state as a command, or of runs side by side as commands, and as scenes
  const command = () => {
    if (!isCompared) return active()[0].command(valuesOf(active()[0]));
    // a run with changes has a folder with them in its name
    const folders = simulations.map((each) => {
      const changes = Object.entries(each.changes(valuesOf(each))).map(([key, value]) => `-${key}=${toml(value)}`).join("").replace(/[^\w.+=-]+/g, "_");
      return quoted(`results/${each.facts.option}${changes.slice(0, 150)}`);
    });
    return [...simulations.map((each, i) => `${each.command(valuesOf(each))} --out ${folders[i]}`), `flexfmu compare ${folders.join(" ")}`].join(" &&\n");
  };
  const copying = (button, text) => button.addEventListener("click", () => {
    Object.assign(get(".command"), { textContent: text(), hidden: false });
    navigator.clipboard?.writeText(text()).catch(() => {});
  });
  copying(get(".copy"), command);
  get(".copy").hidden = !simulations.every((each) => each.facts.origin);
  for (const each of isCompared ? simulations : simulations.slice(0, 1)) {
    const button = html("button", { type: "button", hidden: !each.facts.scene }, null, isCompared ? `copy ${each.facts.option} as scene` : "copy as scene");
    get(".reset-all").before(button, " ");
    copying(button, () => { const simulation = isCompared ? each : active()[0]; return simulation.scene(valuesOf(simulation)); });
  }
  get(".reset-all").addEventListener("click", () => { recorded(); changed(); });
  // a point of a sweep that was picked: values, and what is said of the others
  page.pick = (points) => {
    // of points that coincide one that has the page's values of what has no slider
    const other = ([values, text = ""]) => Object.entries(fixed).find(([key, own]) => (key in values ? +values[key].toPrecision(4) !== +own : text.includes(`${key}=`) && !`${text},`.includes(`${key}=${own},`)));
    const point = points.find((each) => !other(each)), [values] = point ?? points[0];
    const there = Object.entries(point ? values : {}).flatMap(([key, value]) => { const slider = sliderOf(key); return slider ? [[slider, value]] : []; });
    for (const [slider, value] of there) set(slider, +value.toPrecision(7));
    if (there.length) changed();
    if (there.length || !isSwept) return "";
    return (status.textContent = `This point isn't simulated: ${point ? "none of its values has a slider" : `${other(points[0]).join(" has no slider, and is ")} in the page`}.`);
  };
  const recorded = () => {
    for (const slider of [...state.keys()]) set(slider, slider.value);
    if (chosen) page.choose(0);
  };
  // the state that the address has, and what of it can't be
  const addressedState = ({ hash }) => {
    refused = hash.slice(1).split("&").filter((part) => {
      const [name, value] = part.split("="), slider = all.find((each) => each.name === name);
      if (name === "shaper" && simulations[+value] && page.choose) { page.choose(+value); return false; }
      if (!slider || slider.input.disabled || !isFinite(value) || !(slider === accuracy || value / slider.value > 0)) return part;
      return !take(slider, +value);
    });
  };
  // of the event, for an earlier state may be in the address by now
  addEventListener("hashchange", ({ newURL }) => { recorded(); addressedState(new URL(newURL)); changed(); });
  addressedState(location);
  show(new Map(active().map((each) => [each.facts.place, usual(each)])), true);
  if (state.size || chosen || refused.length) changed(); else status.textContent = timed(active().map(usual), true);
  page.live = { usual: usual(simulations[0]), state, sliders };
  panel.classList.add("ready");
})().catch((error) => {
  document.querySelector("#live .status").textContent = `This browser can't simulate: ${error.message}. All is as recorded.`;
});
