/** FMI 2.0 for co-simulation in WebAssembly: a module without imports, its variables by name. */

const TYPES = { Real: Float64Array, Integer: Int32Array, Boolean: Int32Array };

export class Fmu {
  /** @param exports functions and memory of the module; @param model its guid, variables and default experiment. */
  constructor(exports, model) {
    this.exports = exports;
    this.model = model;
    exports._initialize?.();
  }

  /** Compiles a module: bytes, or a Response, also awaited here, as fetch gives it. */
  static async load(source, model) {
    const given = await source;
    if (given instanceof Response && !given.ok) throw new Error(`the module can't be fetched: ${given.url} gives status ${given.status}`);
    const bytes = given instanceof Response ? await given.arrayBuffer() : given;
    return new Fmu((await WebAssembly.instantiate(bytes)).instance.exports, model);
  }

  /** Memory of the module for so many bytes, zeros. */
  allocate(size) {
    const address = this.exports.malloc(size + 8);
    new Uint8Array(this.exports.memory.buffer, address, size + 8).fill(0);
    return address;
  }

  text(value) {
    const bytes = new TextEncoder().encode(value), address = this.allocate(bytes.length + 1);
    new Uint8Array(this.exports.memory.buffer, address).set(bytes);
    return address;
  }

  /** The last message of an instance. */
  get message() {
    const bytes = new Uint8Array(this.exports.memory.buffer, this.exports.wasm_message());
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  }

  instantiate(name = this.model.name) {
    return new Instance(this, name);
  }
}

/** One simulation. Its functions throw an Error with the module's message. */
export class Instance {
  constructor(fmu, name) {
    const { exports, model } = fmu;
    Object.assign(this, { fmu, groups: new Set(), texts: [name, model.guid].map((each) => fmu.text(each)) });
    this.component = exports.fmi2Instantiate(this.texts[0], 1, this.texts[1], 0, exports.wasm_callbacks(), 0, 0);
    if (!this.component) throw new Error(fmu.message);
  }

  call(name, ...values) {
    if (!this.component) throw new Error(`fmi2${name}: this instance was freed`);
    const status = this.fmu.exports[`fmi2${name}`](this.component, ...values);
    if (status > 1) throw new Error(`fmi2${name}: ${this.fmu.message || `status ${status}`}`);
  }

  /** Sets parameters and inputs by name; before `initialize` they are start values. */
  set(values) {
    for (const [name, value] of Object.entries(values)) {
      const group = this.group([name]);
      group.values[0] = value;
      group.write();
      group.free();
    }
    return this;
  }

  get(name) {
    const group = this.group([name]), [value] = group.read();
    group.free();
    return value;
  }

  /** Variables of one type that are often read or written together; a group belongs to its instance, and is freed with it. */
  group(names, order = 0) {
    return new Group(this, names, order);
  }

  /** Goes through initialisation mode. */
  initialize({ start = 0, stop = this.fmu.model.stopTime, tolerance = this.fmu.model.tolerance } = {}) {
    this.call("SetupExperiment", 1, tolerance, start, 1, stop);
    this.call("EnterInitializationMode");
    this.call("ExitInitializationMode");
    return this;
  }

  /** Advances from `time` by `step`, in seconds; after Discard as after a failure. */
  step(time, step) {
    this.call("DoStep", time, step, 1);
  }

  /** Gives the memory back; nothing can be called then. */
  free() {
    if (!this.component) return;
    this.fmu.exports.fmi2FreeInstance(this.component);
    this.component = 0;
    this.groups.forEach((each) => each.free());
    this.texts.forEach((each) => this.fmu.exports.free(each));
  }
}

/** Variables of an instance as one array; with an `order` their derivatives of that order. */
class Group {
  constructor(instance, names, order) {
    const { fmu } = instance, known = names.map((name) => fmu.model.variables[name]);
    const missing = names.find((name, i) => !known[i]);
    if (missing !== undefined) throw new Error(`there is no variable '${missing}'`);
    this.type = known[0]?.type ?? "Real";
    if (known.some(({ type }) => type !== this.type)) throw new Error(`${names.join(", ")} are of several types`);
    // values, references and orders behind each other
    const count = names.length, address = fmu.allocate(16 * count), references = address + 8 * count, orders = references + 4 * count;
    Object.assign(this, { instance, order, count, address, references, orders });
    new Uint32Array(fmu.exports.memory.buffer, references, count).set(known.map(({ reference }) => reference));
    new Int32Array(fmu.exports.memory.buffer, orders, count).fill(order);
    instance.groups.add(this);
  }

  /** Gives the memory back. */
  free() {
    if (this.instance.groups.delete(this)) this.instance.fmu.exports.free(this.address);
  }

  /** The numbers in the module's memory; get it anew after other calls, since memory grows. */
  get values() {
    return new TYPES[this.type](this.instance.fmu.exports.memory.buffer, this.address, this.count);
  }

  read() {
    const { instance, references, count, order, orders, address } = this;
    if (order) instance.call("GetRealOutputDerivatives", references, count, orders, address);
    else instance.call(`Get${this.type}`, references, count, address);
    return this.values;
  }

  write() {
    const { instance, references, count, order, orders, address } = this;
    if (order) instance.call("SetRealInputDerivatives", references, count, orders, address);
    else instance.call(`Set${this.type}`, references, count, address);
  }
}
