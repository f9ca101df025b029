// A run in the page: the module has robot, blocks and master (flexfmu.cosim.exchange.live); here are the motion's points and the metrics.
// a line of JSON, whose arrays are places in the bytes behind it; equal ones are the same
const unpacked = async (text) => {
  const stream = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer()), end = bytes.indexOf(10) + 1, known = {};
  const array = ({ array, at, size }) => (known[[array, at, size]] ??= new globalThis[array](bytes.slice(end + at, end + at + size).buffer));
  return JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)), (key, value) => (value?.array ? array(value) : value));
};
// a signal from the differences of order 6 of its bits
const summed = (differences) => {
  const bits = differences.slice();
  for (let order = 0; order < 6; order++) for (let n = 1; n < bits.length; n++) bits[n] += bits[n - 1];
  return new Float64Array(bits.buffer);
};
const POSITION = ["end_effector.position.x", "end_effector.position.y"], ENDS = 5, ORDERS = 10, FACTORIALS = Array.from({ length: ORDERS }, (_, k) => { let f = 1; while (k > 1) f *= k--; return f; });
const FIRST_BENDING = "link11.bending[1]", accelerationOf = (name) => (name.includes("position") ? name.replace("position", "acceleration") : `der(${name},2)`);

// a value as TOML has it in one line; text for a shell; a dotted key's places
const toml = (value) => {
  if (Array.isArray(value)) return `[${value.map(toml).join(", ")}]`;
  if (typeof value !== "object") return JSON.stringify(value);
  return `{ ${Object.entries(value).map(([key, each]) => `${/^[\w-]+$/.test(key) ? key : JSON.stringify(key)} = ${toml(each)}`).join(", ")} }`;
};
const quoted = (text) => (/^[\w./+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
const put = (data, key, value) => {
  const places = key.match(/[^.[\]]+/g);
  places.reduce((found, name, i) => (i === places.length - 1 ? (found[name] = value) : (found[name] ??= {})), data);
};

class Simulation {
  /** The runs that a page has, and what it sweeps. */
  static async load(text) {
    const { runs, swept, fixed } = await unpacked(text), modules = new Map(), simulations = [];
    for (const facts of runs) {
      const { module } = facts;
      if (!modules.has(module)) modules.set(module, await WebAssembly.compile(module));
      simulations.push(new Simulation(facts, (await WebAssembly.instantiate(modules.get(module))).exports));
    }
    return { simulations, swept, fixed };
  }

  constructor(facts, exports) {
    Object.assign(this, { facts, exports, memory: exports.memory, kept: new Map(), fmu: new Fmu(exports, facts.model) });
    const { grid, task, analysis } = facts;
    Object.assign(this, { joints: this.table(grid.knots), task: this.table(task), usual: grid.times && this.recorded(grid) });
    this.analysis = Object.fromEntries(Object.entries(analysis).map(([m, { matrices, quadratures }]) => {
      const quadrature = ([k, all]) => [k, { points: all[0].length, tables: all.map((each) => this.put(each)) }];
      return [m, { matrices: matrices.map((each) => this.put(each)), quadratures: Object.fromEntries(Object.entries(quadratures).map(quadrature)) }];
    }));
  }

  // communication points of the recording with all bits
  recorded({ times, marked, due, scales, begins: signals, jumps, before }) {
    const row = signals.length, begins = new Float64Array(row * times.length), values = new Map([...new Set(signals)].map((each) => [each, summed(each)]));
    signals.forEach((each, i) => values.get(each).forEach((value, n) => (begins[n * row + i] = value)));
    const ends = begins.slice();
    jumps.forEach((n, i) => ends.set(before.subarray(i * row, (i + 1) * row), n * row));
    return { key: this.key(), marked, due, ...this.table({ times, begins, ends, scales }) };
  }
  key({ step = this.facts.step, stretch = 1 } = {}) {
    return `${step} ${stretch}`;
  }

  // memory that is kept under a name from run to run, and grows
  area(name, size) {
    const known = this.kept.get(name);
    if (known && known.size >= size) return known.address;
    if (known) this.exports.free(known.address);
    const address = this.fmu.allocate(1.5 * size);
    this.kept.set(name, { address, size: 1.5 * size });
    return address;
  }
  view(Type, address, count) {
    return new Type(this.memory.buffer, address, count);
  }
  put(values, name) {
    const address = name ? this.area(name, values.byteLength) : this.fmu.allocate(values.byteLength);
    this.view(values.constructor, address, values.length).set(values);
    return address;
  }

  // motions by their limits at some times, [point][order][variable], and the polynomials between these
  table({ times, begins, ends = begins, scales }) {
    const steps = times.length - 1, row = begins.length / times.length, variables = row / ENDS;
    if (!scales) {
      scales = new Float64Array(ORDERS * steps);
      for (let n = 0; n < steps; n++) for (let k = 0, power = 1; k < ORDERS; k++, power *= times[n + 1] - times[n]) scales[n * ORDERS + k] = power / FACTORIALS[k];
    }
    const found = this.area("polynomials", 2 * begins.byteLength);
    this.exports.live_hermite(steps, variables, this.put(begins, "begins"), this.put(ends, "ends"), this.put(scales, "scales"), found);
    const polynomials = this.view(Float64Array, found, 2 * begins.length).slice().fill(0, 2 * row * steps);
    polynomials.set(begins.subarray(row * steps), 2 * row * steps);
    return { times, begins, ends, polynomials, row, variables };
  }

  // derivatives to order 4 of a table at a time, [order][variable]; at a jump from the left or the right
  evaluate({ times, polynomials, variables }, time, isLeft, found, at = 0) {
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (isLeft ? times[middle] < time : times[middle] <= time) low = middle; else high = middle - 1;
    }
    const h = low === times.length - 1 ? 0 : time - times[low];
    for (let v = 0; v < variables; v++) for (let order = 0; order < ENDS; order++) {
      let sum = 0;
      for (let k = ORDERS - 1; k >= order; k--) sum = sum * (h / (k - order + 1)) + polynomials[(low * ORDERS + k) * variables + v];
      found[at + order * variables + v] = sum;
    }
  }

  // communication points for another step, duration or sample times: ticks, breakpoints and sample instants
  grid({ step, stretch }) {
    const { facts, joints } = this, { duration, clocks, breakpoints } = facts, end = duration * stretch, stop = end + (facts.stop - duration), near = 1e-6 * step;
    const marks = breakpoints.map((t) => t * stretch), points = [0, stop, ...marks.filter((t) => t > 0 && t < stop - near)], due = [];
    for (const [time, offset, instants] of clocks) {
      const all = instants.filter((t) => t < stop + near);
      for (let k = 0; time && offset + k * time < stop + near; k++) all.push(offset + k * time);
      due.push(all.sort((a, b) => a - b));
      points.push(...all);
    }
    for (let n = 1; n * step < stop - near; n++) points.push(n * step);
    points.sort((a, b) => a - b);
    const times = Float64Array.from(points.filter((t, i) => !i || t - points[i - 1] > near));
    const flagged = (list) => {
      const flags = new Uint8Array(times.length);
      let i = 0;
      for (const t of list) { while (i < times.length && times[i] < t - near) i++; if (i < times.length) flags[i] = 1; }
      return flags;
    };
    const flags = due.map(flagged), marked = flagged([0, ...marks, stop]);
    flags.forEach((each) => each.forEach((flag, i) => (marked[i] |= flag)));
    // the references, whose time is stretched
    const { row, variables } = joints, begins = new Float64Array(times.length * row), ends = new Float64Array(times.length * row);
    const own = (t) => (t < end - near ? t / stretch : duration + Math.max(t - end, 0));
    const factors = Array.from({ length: row }, (_, i) => stretch ** -(Math.floor(i / variables) + Math.floor((3 * (i % variables)) / variables)));
    times.forEach((t, n) => {
      const snapped = breakpoints.find((each) => Math.abs(each * stretch - t) <= near) ?? own(t);
      this.evaluate(joints, snapped, false, begins, n * row);
      this.evaluate(joints, snapped, true, ends, n * row);
      for (let i = 0; i < row; i++) { begins[n * row + i] *= factors[i]; ends[n * row + i] *= factors[i]; }
    });
    return { key: this.key({ step, stretch }), marked, due: flags, ...this.table({ times, begins, ends }) };
  }

  // communication step and tolerance for an accuracy
  settings(accuracy) {
    const { step, tolerance } = this.facts;
    return { step: +(step * 2 ** accuracy).toPrecision(6), tolerance: +(tolerance * 10 ** accuracy).toPrecision(6) };
  }
  /** What `run` takes for values of sliders by their names; that of "accuracy" is a power of 2 of the step and of 10 of the tolerance. */
  options(values) {
    const parameters = {}, found = { parameters }, { sliders, duration } = this.facts;
    if (values.accuracy) Object.assign(found, this.settings(values.accuracy));
    if ("duration" in values) found.stretch = values.duration / duration;
    for (const { name, value, targets } of sliders) if (name in values) for (const [target, start, power] of targets) parameters[target] = start === value && power === 1 ? values[name] : start * (values[name] / value) ** power;
    return found;
  }
  /** The same as keys of the scene; where other parts were designed for the robot, the real one's values stand beside the assumed ones. */
  changes(values) {
    const { sliders, scene } = this.facts, moved = sliders.filter(({ name }) => name in values), keys = (all) => Object.fromEntries(all.map(({ key, name }) => [key, values[name]]));
    const found = {}, real = keys(moved.filter((each) => each.frozen)), last = scene.imperfection?.at(-1);
    if (Object.keys(real).length) {
      const error = { kind: "parameter-error", parameters: { ...last?.parameters, ...real } };
      found.imperfection = [...(scene.imperfection ?? []).slice(0, last?.kind === error.kind ? -1 : undefined), error];
    }
    if (values.accuracy) for (const [key, value] of Object.entries(this.settings(values.accuracy))) found[`cosimulation.${key}`] = value;
    return { ...found, ...keys(moved.filter((each) => !each.frozen)) };
  }
  /** The command line for the same values; empty without a scene file. */
  command(values) {
    const { origin, settings } = this.facts;
    return origin && ["flexfmu run", quoted(origin), ...[...settings, ...Object.entries(this.changes(values))].map(([key, value]) => `--set ${quoted(`${key}=${toml(value)}`)}`)].join(" ");
  }
  /** The scene file for the same values. */
  scene(values) {
    const all = structuredClone(this.facts.scene), isTable = (each) => each && typeof each === "object" && !Array.isArray(each);
    for (const [key, value] of Object.entries(this.changes(values))) put(all, key, structuredClone(value));
    const lines = (table) => Object.entries(table).map(([key, each]) => `${key} = ${toml(each)}\n`).join("");
    const parts = Object.entries(all).map(([key, each]) => (isTable(each) ? `\n[${key}]\n${lines(each)}` : isTable(each[0]) ? each.map((one) => `\n[[${key}]]\n${lines(one)}`).join("") : lines({ [key]: each })));
    return parts.sort((a, b) => (a[0] === "\n") - (b[0] === "\n")).join("");
  }

  /** Simulates with `parameters` of robot and blocks; `tolerance`, `step` and `stretch` of the duration where they differ. */
  run({ parameters = {}, tolerance = this.facts.tolerance, step = this.facts.step, stretch = 1 } = {}) {
    const { facts, exports } = this, key = this.key({ step, stretch });
    const grid = [this.usual, this.known].find((each) => each?.key === key) ?? (this.known = this.grid({ step, stretch }));
    const count = grid.times.length, capacity = count + grid.marked.reduce((sum, each) => sum + each, 1) + 1;
    // tables of the points, which stay in memory while runs have the same
    if (grid !== this.loaded) {
      const { polynomials: announced, ends: ended, marked, due } = grid, tables = { announced, ended, times: grid.times, marked, instants: new Uint8Array(count).fill(1) };
      due.forEach((flags, i) => (tables[`due${i}`] = flags));
      this.places = Object.fromEntries(Object.entries(tables).map(([name, values]) => [name, this.put(values, name)]));
      this.loaded = grid;
    }
    const { times, marked, instants } = this.places;
    const width = facts.channels.reduce((sum, [, n]) => sum + n, 1), rows = this.area("rows", 8 * width * capacity);
    // the image, with parameters of blocks, relocated
    const base = this.put(facts.image, "image"), words = (place) => this.view(Uint32Array, base + place, 1);
    const bases = { ...this.places, image: base };
    for (const [place, name, offset] of facts.words) words(place)[0] = name === "function" ? exports.live_function(offset) : bases[name] + offset;
    const starts = { ...facts.starts };
    for (const [name, value] of Object.entries(parameters)) {
      if (name in facts.blocks) this.view(Float64Array, base + facts.blocks[name], 1)[0] = value; else starts[name] = value;
    }
    // the program, and that of initialisation, whose only step has no length
    const program = this.area("program", 4 * 12), progress = this.area("progress", 16), channels = this.area("channels", 12 * facts.channels.length), active = this.area("active", 4);
    let at = rows + 8 * capacity;
    facts.channels.forEach(([place, n], i) => { this.view(Uint32Array, channels + 12 * i, 3).set([base + place, at, n]); at += 8 * n * capacity; });
    let robot, size = 0, failure = "";
    const go = ([[advance, n], [exchange, m]], points, when) => {
      this.view(Uint32Array, program, 12).set([base + advance, base + exchange, n, m, channels, facts.channels.length, capacity, ...when, rows, active]);
      this.view(Uint32Array, progress, 4).set([0, size, 0, 0]);
      const isBad = exports.master_run(program, points, progress);
      size = this.view(Uint32Array, progress, 4)[1];
      if (isBad) throw new Error(this.fmu.message || "a signal is not a number");
    };
    const begin = this.put(Float64Array.of(0, 0), "begin"), yes = this.put(Uint8Array.of(1, 1), "yes"), no = this.put(Uint8Array.of(0, 0), "no");
    const started = performance.now();
    facts.script.forEach((part, i) => {
      if (part === "create") {
        robot = this.fmu.instantiate("plant").set(starts);
        words(facts.handle)[0] = robot.component;
      } else if (part === "initialize") robot.initialize({ stop: grid.times[count - 1], tolerance });
      else go([[0, 0], part], 1, [begin, yes, i === facts.script.length - 1 ? yes : no]);
    });
    try { go([facts.advance, facts.exchange], count - 1, [times, marked, instants]); } catch (error) { failure = error.message; }
    const elapsed = performance.now() - started;
    robot.free();
    const all = this.view(Float64Array, rows, width * capacity).slice();
    const rest = this.restAt(starts);
    return new Result(this, { all, capacity, size, elapsed, failure, stretch, rest, grid, starts });
  }

  // where the end effector rests at the end of the motion
  restAt(starts) {
    const { fmu, facts } = this, robot = fmu.instantiate("plant").set({ ...starts, ...facts.rest, initial: facts.static });
    try {
      robot.initialize({ stop: 1, tolerance: facts.tolerance });
      return POSITION.map((name) => robot.get(name));
    } finally { robot.free(); }
  }
}

// what a run has recorded, and what it is worth
class Result {
  constructor(simulation, found) {
    Object.assign(this, found, { simulation });
    this.duration = simulation.facts.duration * this.stretch;
    this.time = this.row(0);
  }
  row(k) {
    return this.all.subarray(k * this.capacity, k * this.capacity + this.size);
  }
  /** A signal, or its derivative, by its name in results.csv. */
  signal(name, order = 0) {
    const known = this.simulation.facts.rows[name];
    if (!known) return undefined;
    return known[1].length > order ? this.row(known[1][order]) : new Float64Array(this.size);
  }
  ends(order) {
    return POSITION.map((name) => this.signal(name, order));
  }
  rigids(order) {
    const planned = this.planned("task");
    return ((this.known ??= {})[order] ??= [0, 1].map((axis) => this.time.map((_, i) => planned(i, order, axis))));
  }
  index(time, isAfter = false) {
    let n = 0;
    while (n < this.size && (isAfter ? this.time[n] <= time + 1e-9 : this.time[n] < time - 1e-9)) n++;
    return n;
  }
  /** What a curve shows, as [x, y]: a signal times a factor, or what is derived from it (`source` in chart.py). */
  curve({ of, factor = 1 }, { magnification = 1, most } = {}) {
    const { time } = this, scaled = (values) => values.map((v) => v * factor), distance = (one, other) => one[0].map((x, i) => Math.hypot(x - other[0][i], one[1][i] - other[1][i]));
    if (of === "deviation") return [time, scaled(distance(this.ends(0), this.rigids(0)))];
    if (of === "acceleration") { const n = this.index(this.duration, true); return [time.subarray(0, n), distance(this.ends(2), this.rigids(2)).subarray(0, n)]; }
    if (of === "vibration") { const n = this.index(this.duration); return [time.subarray(n), scaled(distance(this.ends(0), [0, 1].map((k) => new Float64Array(this.size).fill(this.rest[k]))).subarray(n))]; }
    if (of === "rigid path") return this.rigids(0);
    if (of === "path") { const ends = this.ends(0); return this.rigids(0).map((each, k) => each.map((v, i) => v + magnification * (ends[k][i] - v))); }
    if (of.startsWith("spectrum")) { const [x, y] = this.spectrum("xy".indexOf(of.at(-1)), most); return [x, scaled(y)]; }
    if (of.endsWith(".error")) { const joint = of.slice(0, -5), reference = this.signal(`${joint}reference.position`); return [time, this.signal(`${joint}position`).map((q, i) => factor * (q - reference[i]))]; }
    const values = this.signal(of);
    return values && [time, factor === 1 ? values : scaled(values)];
  }
  spectrum(axis, most = Infinity) {
    const [x, y] = ((this.spectra ??= [])[axis] ??= this.transformed(axis)), shown = Math.ceil(most / x[1]);
    return [x, y].map((each) => each.slice(0, shown));
  }
  // Hann window, mean removed, zeros appended to four times the length, as spectrum.py has it
  transformed(axis) {
    const n = this.index(this.duration), time = this.time.subarray(n), values = this.ends(0)[axis].subarray(n), last = time.length - 1, count = Math.round((time[last] - time[0]) / this.simulation.facts.step);
    if (!(count >= 8)) return [[], []];
    const step = (time[last] - time[0]) / count, all = new Float64Array(count + 1);
    for (let i = 0, at = 0; i <= count; i++) {
      const t = time[0] + i * step;
      while (at < last - 1 && time[at + 1] < t) at++;
      const h = time[at + 1] - time[at];
      all[i] = h ? values[at] + (values[at + 1] - values[at]) * Math.min((t - time[at]) / h, 1) : values[at + 1];
    }
    const window = all.map((_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / count)), total = window.reduce((a, b) => a + b, 0), mean = all.reduce((sum, v, i) => sum + v * window[i], 0) / total;
    const size = 2 ** Math.ceil(Math.log2(4 * (count + 1))), re = new Float64Array(size), im = new Float64Array(size);
    all.forEach((v, i) => { let j = 0; for (let bit = 1, k = i; bit < size; bit <<= 1, k >>= 1) j = (j << 1) | (k & 1); re[j] = (v - mean) * window[i]; });
    for (let half = 1; half < size; half <<= 1) for (let k = 0; k < half; k++) {
      const c = Math.cos((-Math.PI * k) / half), s = Math.sin((-Math.PI * k) / half);
      for (let i = k; i < size; i += 2 * half) { const j = i + half, x = c * re[j] - s * im[j], y = c * im[j] + s * re[j]; re[j] = re[i] - x; im[j] = im[i] - y; re[i] += x; im[i] += y; }
    }
    return [Float64Array.from({ length: size / 2 }, (_, i) => i / (size * step)), Float64Array.from({ length: size / 2 }, (_, i) => (2 * Math.hypot(re[i], im[i])) / total)];
  }
  /** The highest peak of spectra, from a parabola through the logarithms of three neighbours; resolved with two periods in the dwell. */
  peak(spectra) {
    const all = spectra.map(([x, y]) => ({ x, y, i: y.reduce((best, v, i) => (v > y[best] ? i : best), 0) })), { x, y, i } = all.reduce((one, other) => ((other.y[other.i] ?? 0) > (one.y[one.i] ?? 0) ? other : one));
    const inner = y[i - 1] > 0 && y[i + 1] > 0, [left, top, right] = [-1, 0, 1].map((k) => Math.log(y[i + k])), shift = inner ? (0.5 * (left - right)) / (left - 2 * top + right) : 0;
    const frequency = x[i] + shift * (x[1] - x[0]), height = inner ? Math.exp(top - 0.25 * (left - right) * shift) : y[i] ?? 0;
    return { frequency, height, isResolved: frequency * (this.time[this.size - 1] - this.duration) >= 2 };
  }
  // the instants at which segments from a time to a time begin, the same for all runs over one grid
  chosen(from, to) {
    const { time, size, grid } = this, key = `${size} ${from} ${to}`;
    const found = (grid.chosen ??= {});
    if (!found[key]) {
      const all = [];
      for (let i = 0; i + 1 < size; i++) if (time[i + 1] > time[i]) { const middle = 0.5 * (time[i] + time[i + 1]); if (middle > from && middle < to) all.push(i); }
      const duration = Float64Array.from(all, (i) => time[i + 1] - time[i]), total = duration.reduce((sum, each) => sum + each, 0);
      found[key] = { places: Int32Array.from(all), duration, total, start: Float64Array.from(all, (i) => time[i]) };
    }
    return found[key];
  }
  // derivatives at both ends of the segments, less those of something else
  segments(names, orders, from, to, offset) {
    const { places, duration, total, start } = this.chosen(from, to), n = places.length, c = names.length, left = new Float64Array(orders * n * c), right = new Float64Array(orders * n * c);
    for (let k = 0; k < orders; k++) for (let channel = 0; channel < c; channel++) {
      const name = names[channel], values = k < 3 ? this.signal(name, k) : this.signal(accelerationOf(name), k - 2);
      for (let s = 0, at = k * n * c + channel; s < n; s++, at += c) { const i = places[s]; left[at] = values[i]; right[at] = values[i + 1]; }
      if (offset) for (let s = 0, at = k * n * c + channel; s < n; s++, at += c) { const i = places[s]; left[at] -= offset(i, k, channel); right[at] -= offset(i + 1, k, channel); }
    }
    return { n, c, orders, left, right, duration, total, start };
  }
  // derivatives of a planned motion by instant, order and variable; the first of two equal instants is the left limit
  planned(name) {
    const { simulation, stretch, duration, time, size, grid } = this, table = simulation[name], { row, variables } = table;
    const key = `planned ${name} ${size}`, factors = Array.from({ length: ENDS }, (_, k) => stretch ** -k);
    if (grid[key]) return grid[key];
    const all = new Float64Array(size * row), last = table.times.at(-1), near = 1e-9 * duration;
    for (let i = 0; i < size; i++) {
      const isLeft = i + 1 < size && time[i] === time[i + 1], isIn = time[i] < duration - near || (isLeft && time[i] <= duration + near);
      simulation.evaluate(table, isIn ? Math.min(time[i] / stretch, last) : last + 1, isLeft, all, i * row);
    }
    return (grid[key] = (i, order, variable) => factors[order] * all[i * row + order * variables + variable]);
  }
  /** What went wrong, as a page says it; empty if nothing did. */
  get state() {
    return (this.trouble ??= this.failure ? "Failed" : this.isUnstable ? "Unstable" : "");
  }
  /** Whether the loop is unstable: the joints' velocities are far off, or their errors grow or stay in the dwell (run_checks.py). */
  get isUnstable() {
    const { speed, beyond, beforeFailure, atRest, onTheMove, growth, lasting } = this.simulation.facts.divergence, { time, size, duration, starts } = this;
    if (!beyond) return false;
    const fall = Math.sqrt(Math.hypot(starts["gravity.x"] ?? 0, starts["gravity.y"] ?? 0) / starts["proximal.length"]), usual = Math.max(speed / this.stretch, fall);
    const pairs = ["joint1.", "joint2."].map((name) => [this.signal(`${name}velocity`), this.signal(`${name}reference.velocity`)]).filter((pair) => pair[0] && pair[1]);
    const thirds = [0, 0, 0], span = time[size - 1] - duration;
    let largest = 0;
    for (let i = 0; i < size; i++) {
      const error = Math.max(...pairs.map(([one, other]) => Math.abs(one[i] - other[i]))) / usual, third = Math.floor((3 * (time[i] - duration)) / span);
      largest = Math.max(largest, error);
      if (third >= 0) thirds[Math.min(third, 2)] = Math.max(thirds[Math.min(third, 2)], error);
    }
    const [first, middle, last] = thirds;
    return largest > (this.failure ? beforeFailure : beyond) || (last > atRest && last >= growth * first && last >= middle && middle >= first) || (last > onTheMove && last >= lasting * first);
  }
  /** The largest use of a motor's limits, as [share, limit, joint], from torques, speeds and accelerations at the run's points (motors.py). */
  get motorUse() {
    const { time, starts } = this, uses = this.simulation.facts.motors.flatMap((motor, j) => {
      const [torque, speed, acceleration] = ["torque", "velocity", "acceleration"].map((what) => this.signal(`joint${j + 1}.${what}`) ?? this.signal(`joint${j + 1}.reference.${what}`));
      const { gear_ratio: ratio, gear_efficiency: efficiency, rotor_inertia: rotor } = motor, most = (values) => values.reduce((a, b) => Math.max(a, Math.abs(b)), 0);
      const shaft = torque.map((each, i) => {
        const load = each - (starts.motor_inertia ?? 0) * acceleration[i];
        return (load * efficiency ** -Math.sign(load * speed[i])) / ratio + rotor * ratio * acceleration[i];
      });
      const square = shaft.reduce((sum, each, i) => (i ? sum + 0.5 * (time[i] - time[i - 1]) * (each ** 2 + shaft[i - 1] ** 2) : 0), 0), rms = Math.sqrt(square / time.at(-1));
      return [[most(shaft) / motor.peak_torque, "peak torque", j + 1], [rms / motor.continuous_torque, "RMS torque", j + 1], [(ratio * most(speed)) / motor.maximum_speed, "speed", j + 1]];
    });
    return uses.sort((a, b) => b[0] - a[0])[0];
  }
  // the C of the metrics, ready for segments
  analysed(segments) {
    const { simulation } = this, { n, c, orders, left, right, duration } = segments, { matrices } = simulation.analysis[orders];
    const area = (name, size) => simulation.area(`metrics ${name}`, size), put = (values, name) => simulation.put(values, `metrics ${name}`), signal = area("signal", 64);
    if (simulation.analysed === segments) return signal;
    const arrays = [put(duration, "duration"), put(left, "left"), put(right, "right"), ...matrices, area("terms", 16 * orders * n * c)];
    const words = [n, c, orders, n * c, n * c, ...arrays, ...["ends", "bounds", "errors"].map((name) => area(name, 8 * n)), area("jumps", 8 * c * (n + 1)), area("kept", 4 * n)];
    simulation.view(Uint32Array, signal, 16).set(words);
    simulation.exports.metrics_prepare(signal);
    simulation.analysed = segments;
    return signal;
  }
  // what the reductions of `RecordedSignal` and `RecordedPower` (metrics.py) give of segments
  reduced(segments, how, argument = 0) {
    const { simulation } = this, { exports } = simulation, signal = this.analysed(segments), result = simulation.area("metrics result", 64), values = () => simulation.view(Float64Array, result, 7).slice();
    const { total } = segments;
    if (segments.isPower) {
      if (!segments.parts) { exports.metrics_parts(signal, result); segments.parts = values(); }
      const [most, least, positive, negative] = segments.parts, all = { peak: [least, 0, most], energy: [negative, positive - negative, positive], mean: [0, (positive - negative) / total] };
      return all[how][argument + 1];
    }
    if (how === "peak") { exports.metrics_peak(signal, result); return values()[0]; }
    if (how === "root_mean_square") {
      const { points, tables } = simulation.analysis[segments.orders].quadratures[argument], quadrature = simulation.area("metrics quadrature", 24);
      simulation.view(Uint32Array, quadrature, 6).set([points, argument, ...tables]);
      exports.metrics_products(signal, quadrature, result);
      return Math.sqrt(values()[0] / total);
    }
    // settling time
    const segment = simulation.area("metrics segment", 4), theta = simulation.area("metrics theta", 8), { start, duration, n } = segments;
    if (!exports.metrics_last_above(signal, argument, segment, theta)) return 0;
    const last = simulation.view(Uint32Array, segment, 1)[0], at = start[last] + simulation.view(Float64Array, theta, 1)[0] * duration[last];
    return at < start[n - 1] + duration[n - 1] ? at - start[0] : null;
  }
  // segments of a signal by the names that `RecordedSolution` (metrics.py) has; null without a dwell, 0 for a rigid link, and undefined
  // for a signal that the page doesn't know
  signalSegments(method, joint) {
    const { duration } = this, motion = [0, duration], cycle = [-1, Infinity], over = (name, m, range, ...offset) => (this.signal(name) ? this.segments([name], m, ...range, ...offset) : undefined);
    const speed = `joint${joint}.${this.signal(`joint${joint}.velocity`) ? "" : "reference."}velocity`;
    const rigid = (range) => this.segments(POSITION, 5, ...range, this.planned("task"));
    const tracking = (range) => { const planned = this.planned("joints"); return over(`joint${joint}.position`, 5, range, (i, k) => planned(i, k, joint - 1)); };
    return {
      torque: () => over(`joint${joint}.torque`, 3, motion),
      tip_deflection: () => over(`link${joint}1.tip_deflection`, 3, motion) ?? 0,
      modal_deflection: () => over(FIRST_BENDING, this.signal(accelerationOf(FIRST_BENDING)) ? 5 : 3, motion) ?? 0,
      path_error: () => rigid([0, Infinity]),
      path_error_in_motion: () => rigid(motion),
      residual_vibration: () => { const found = this.segments(POSITION, 5, duration, Infinity, (i, k, channel) => (k ? 0 : this.rest[channel])); return found.n ? found : null; },
      tracking_error: () => tracking([0, Infinity]),
      tracking_error_in_motion: () => tracking(motion),
      duty_torque: () => over(`joint${joint}.torque`, 3, cycle),
      duty_speed: () => over(speed, 3, cycle),
      duty_power: () => {
        const [one, other] = [this.part("duty_torque", joint), this.part("duty_speed", joint)], { n } = one ?? {};
        // by Leibniz' rule
        const product = (u, v) => {
          const w = new Float64Array(3 * n);
          for (let a = 0, b = n, c = 2 * n; a < n; a++, b++, c++) { w[a] = u[a] * v[a]; w[b] = u[b] * v[a] + u[a] * v[b]; w[c] = u[c] * v[a] + 2 * u[b] * v[b] + u[a] * v[c]; }
          return w;
        };
        return one && other && { ...one, isPower: true, left: product(one.left, other.left), right: product(one.right, other.right) };
      },
    }[method]?.();
  }
  part(method, joint) {
    const parts = (this.parts ??= {}), key = `${method} ${joint}`;
    return key in parts ? parts[key] : (parts[key] = this.signalSegments(method, joint));
  }
  /** The metrics by name, as `summary.json` has them. */
  get metrics() {
    return (this.measured ??= this.measure());
  }
  /** Those of the metrics that are among some names; all that the page knows without names. */
  measure(names) {
    const { metrics, band } = this.simulation.facts, found = {};
    for (const [name, [method, [joint], how]] of Object.entries(metrics)) {
      if (names && !names.has(name)) continue;
      const [reduction, argument] = method === "settling_time" ? ["settling", band] : how, s = this.part(method === "settling_time" ? "residual_vibration" : method, joint);
      if (reduction === "final" && s) { const at = s.right.length - (s.orders - argument) * s.n * s.c + (s.n - 1) * s.c; found[name] = Math.hypot(...s.right.subarray(at, at + s.c)); }
      else if (s !== undefined) found[name] = s ? this.reduced(s, reduction, argument) : s;
    }
    return found;
  }
}
globalThis.Simulation = Simulation;
