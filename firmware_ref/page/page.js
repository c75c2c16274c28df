"use strict";
/* The estimator as WebAssembly beside a reader of CSV and four plots. `page` is what tests look at. */
const page = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const by = (id) => document.getElementById(id);
  const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const SAMPLE = 16, OUTPUT = 24, OUTLOOK = 24;  // bytes, as in cellwise_ekf.h
  const CHECKPOINTS = 1500;  // states that are kept, and remaining times that are shown
  const LOAD_S = 60;  // the load that goes on is the mean of so long
  const GAP_S = 60, GAP_INTERVALS = 10;  // a pause is a gap beyond both
  const EVEN = 0.02;  // intervals that differ by less from the step need no resampling
  const found = { ready: false };
  let wasm = null, raw = null;

  /* ---- a file into columns ---- */
  const KINDS = {
    time: [/[Tt]ime|^t$|^t[ _[(]|[Ee]lapsed|[Zz]eit/, { ms: 1e-3, min: 60, h: 3600 }],
    current: [/^(i|curr?ent|strom|amps?|courant)(?![a-z])|current|^i[ _[(]/i, { mA: 1e-3 }],
    voltage: [/^(u|v|volt(age)?|spannung)(?![a-z])|voltage/i, { mV: 1e-3 }],
    temperature: [/temp|deg ?C|°C|_C$/i, { K: 1 }],
  };
  function wrong(what, expected, action) {
    throw new Error(`Found ${what}; expected ${expected}. ${action}`);
  }
  function table(text) {
    const lines = text.split(/\r\n|\n|\r/).filter((line) => line.trim() !== "");
    const mark = ["\t", ";", ","].find((c) => lines.slice(0, 40).some((line) => line.includes(c))) ?? ",";
    const decimal = mark !== "," && /\d,\d/.test(lines[Math.min(lines.length - 1, 50)] ?? "");
    const number = (cell) => {
      const plain = cell.trim().replace(/^"|"$/g, "");
      return plain === "" ? NaN : +(decimal ? plain.replace(",", ".") : plain);
    };
    const head = lines.findIndex((line, k) => k + 1 < lines.length && line.includes(mark) &&
      line.split(mark).some((c) => Number.isNaN(number(c)) && c.trim() !== "") &&
      lines[k + 1].split(mark).filter((c) => Number.isFinite(number(c))).length >= 3);
    if (head < 0) wrong("no row of names above rows of numbers", "a CSV file with time, current and voltage",
      "Write one with `cellwise convert LOG -o log.csv`.");
    const names = lines[head].split(mark).map((c) => c.trim().replace(/^"|"$/g, ""));
    const rows = lines.length - head - 1;
    const columns = names.map(() => new Float64Array(rows));
    for (let k = 0; k < rows; k++) {
      const cells = lines[head + 1 + k].split(mark);
      for (let c = 0; c < names.length; c++) columns[c][k] = c < cells.length ? number(cells[c]) : NaN;
    }
    return { names, columns, rows };
  }
  function choose(kind, names) {
    const exact = { time: "time_s", current: "current_A", voltage: "voltage_V", temperature: "temperature_C" };
    const at = names.indexOf(exact[kind]);
    return at >= 0 ? at : names.findIndex((name) => KINDS[kind][0].test(name));
  }
  function column(kind) {
    const at = +by(`c-${kind}`).value;
    if (at < 0) return null;
    const unit = raw.names[at].match(/(?:[_\[( \/])(ms|min|h|mA|mV|K)[\])]?$/)?.[1];
    const scale = KINDS[kind][1][unit] ?? 1, add = unit === "K" && kind === "temperature" ? -273.15 : 0;
    return scale === 1 && add === 0 ? raw.columns[at] : raw.columns[at].map((x) => x * scale + add);
  }

  /* ---- columns into samples at the time step, as `samples_of` of the Python makes them ---- */
  function samplesOf(time, current, voltage, temperature) {
    const n = time.length, dt = data.dt_s;
    if (n < 2) wrong(`${n} rows`, "at least two", "Open a longer log.");
    let even = true;
    const gaps = [];
    const usual = median(time);
    for (let k = 1; k < n; k++) {
      const step = time[k] - time[k - 1];
      if (!(step >= 0)) wrong(`a time that is missing or runs backwards in row ${k + 1}`, "rising times", "Sort or correct the rows.");
      if (step > Math.max(GAP_S, GAP_INTERVALS * usual)) gaps.push(k);
      else if (Math.abs(step - dt) > EVEN * dt) even = false;
    }
    const parts = even ? [rowByRow(time, current, voltage, temperature)]
      : [0, ...gaps].map((first, p) => resampled(time, current, voltage, temperature, first, gaps[p] ?? n));
    const size = parts.reduce((sum, part) => sum + part.length, 0);
    const memory = new ArrayBuffer(size * SAMPLE);
    const real = new Float32Array(memory), count = new Uint32Array(memory);
    let k = 0;
    const start = time[0];
    for (const part of parts) {
      for (let j = 0; j < part.length; j++, k++) {
        real[4 * k] = part.current[j];
        real[4 * k + 1] = part.voltage[j];
        real[4 * k + 2] = part.temperature ? part.temperature[j] : data.temperature_C;
        count[4 * k + 3] = part.sequence ? part.sequence[j] : Math.round((part.time[j] - start) / dt);
      }
    }
    return { memory, real, count, size };
  }
  function median(time) {
    const steps = new Float64Array(time.length - 1);
    for (let k = 0; k < steps.length; k++) steps[k] = time[k + 1] - time[k];
    return steps.sort()[steps.length >> 1];
  }
  function rowByRow(time, current, voltage, temperature) {
    const sequence = new Uint32Array(time.length);
    for (let k = 1; k < time.length; k++) sequence[k] = sequence[k - 1] + Math.round((time[k] - time[k - 1]) / data.dt_s);
    return { length: time.length, current, voltage, temperature, sequence };
  }
  /* Mean current of each step, charge kept; last voltage and temperature, none where there is none. */
  function resampled(time, current, voltage, temperature, first, end) {
    const dt = data.dt_s, length = Math.floor((time[end - 1] - time[first]) / dt + 1e-9) + 1;
    const part = { length, time: new Float64Array(length), current: new Float64Array(length),
      voltage: new Float64Array(length), temperature: temperature && new Float64Array(length) };
    let row = first, charge = 0, before = 0, held = 0;
    for (let k = 0; k < length; k++) {
      const at = time[first] + k * dt;
      while (row + 1 < end && time[row + 1] <= at + 1e-9) {
        row++;
        held = Number.isNaN(current[row]) ? held : current[row];
        charge += held * (time[row] - time[row - 1]);
      }
      let now = charge;
      if (row + 1 < end) {
        const next = Number.isNaN(current[row + 1]) ? held : current[row + 1];
        now += next * Math.max(at - time[row], 0);
      }
      if (k === 0) held = Number.isNaN(current[first]) ? 0 : current[first];
      part.time[k] = at;
      part.current[k] = k === 0 ? held : (now - before) / dt;
      part.voltage[k] = k === 0 || time[row] > at - dt + 1e-9 ? voltage[row] : NaN;
      if (temperature) part.temperature[k] = temperature[row];
      before = now;
    }
    return part;
  }

  /* ---- the estimator ---- */
  function socOf(volts) {
    const ocv = data.ocv_V;
    let k = ocv.findIndex((v) => v >= volts);
    if (k < 0) return 1;
    if (k === 0) return 0;
    return (k - 1 + (volts - ocv[k - 1]) / (ocv[k] - ocv[k - 1])) / (ocv.length - 1);
  }
  /* Addresses in the module's memory: its tables, a state, an outlook, the samples, their outputs. */
  function placed(n) {
    const { exports } = wasm, state = (exports.__heap_base.value + 15) & ~15;
    const ahead = (state + data.state_bytes + 15) & ~15, ins = ahead + OUTLOOK + 8, outs = ins + n * SAMPLE;
    const missing = outs + n * OUTPUT - exports.memory.buffer.byteLength;
    if (missing > 0) exports.memory.grow(Math.ceil(missing / 65536));
    return { exports, model: exports.cellwise_cell.value, state, ahead, ins, outs };
  }
  function estimate(samples, soc0, std0) {
    const n = samples.size, at = placed(n), { exports, model, state, ins, outs } = at;
    const memory = exports.memory.buffer;
    new Uint8Array(memory, ins, n * SAMPLE).set(new Uint8Array(samples.memory));
    const began = performance.now();
    exports.cellwise_init(model, state, soc0, Math.max(std0 * std0, 1e-11));
    const every = Math.max(1, Math.ceil(n / CHECKPOINTS)), kept = [], left = [];
    for (let k = 0; k < n; k += every) {
      kept.push(new Uint8Array(memory.slice(state, state + data.state_bytes)));
      exports.cellwise_rows(model, state, ins + k * SAMPLE, outs + k * OUTPUT, Math.min(every, n - k));
      left.push(remaining(at, samples, Math.min(k + every, n) - 1));
    }
    const took = performance.now() - began;
    const out = memory.slice(outs, outs + n * OUTPUT);
    return { ms: took, every, kept, left, real: new Float32Array(out), count: new Uint32Array(out), size: n };
  }
  function remaining({ exports, model, state, ahead }, samples, at) {
    let sum = 0, many = 0;
    for (let k = Math.max(0, at + 1 - Math.max(1, Math.round(LOAD_S / data.dt_s))); k <= at; k++) {
      const amps = samples.real[4 * k];
      if (Number.isFinite(amps)) { sum += amps; many++; }
    }
    if (!(sum > many * data.least_load_A)) return [NaN, NaN, NaN];  // at rest or charging
    exports.cellwise_remaining(model, state, sum / many, 1, ahead);
    return [...new Float32Array(exports.memory.buffer, ahead, 3)];
  }
  /* Remaining time of any sample: from the state that was kept before it. */
  function leftAt(k) {
    const { result, samples } = found, at = placed(samples.size);
    const block = Math.floor(k / result.every), first = block * result.every;
    new Uint8Array(at.exports.memory.buffer, at.state, data.state_bytes).set(result.kept[block]);
    at.exports.cellwise_rows(at.model, at.state, at.ins + first * SAMPLE, at.outs + first * OUTPUT, k + 1 - first);
    return remaining(at, samples, k);
  }

  /* ---- what is shown ---- */
  function say(text, bad = false) { by("said").textContent = text; by("said").classList.toggle("wrong", bad); }
  function attempt(work) {
    try { work(); } catch (error) { by("found").hidden = true; say(error.message, true); document.documentElement.dataset.page = "refused"; }
  }
  function take(text, name) {
    attempt(() => {
      raw = table(text);
      found.name = name;
      for (const kind of Object.keys(KINDS)) {
        const none = kind === "temperature" ? [["-1", "none"]] : [];
        by(`c-${kind}`).replaceChildren(...[...none, ...raw.names.map((label, k) => [String(k), label])]
          .map(([value, label]) => new Option(label, value)));
        const at = choose(kind, raw.names);
        if (at < 0 && kind !== "temperature") wrong(`no column of ${kind} among ${raw.names.join(", ")}`, `one named ${kind}`,
          "Rename it: time_s, current_A, voltage_V.");
        by(`c-${kind}`).value = String(at);
      }
      by("charging").checked = false;
      by("fields").classList.add("there");
      run();
    });
  }
  function run() {
    attempt(() => {
      const sign = by("charging").checked ? -1 : 1;
      const current = column("current");
      const samples = samplesOf(column("time"), sign < 0 ? current.map((i) => -i) : current, column("voltage"), column("temperature"));
      const first = samples.real.findIndex((v, k) => k % 4 === 1 && Number.isFinite(v));
      if (first < 0) wrong("no voltage", "volts of one cell", "Choose another column.");
      const stated = by("soc0").value;
      const soc0 = stated === "" ? socOf(samples.real[first]) : +stated / 100;
      found.samples = samples;
      found.result = estimate(samples, soc0, +by("std0").value / 100);
      found.view = [0, samples.size - 1];
      by("at").max = samples.size - 1;
      by("found").hidden = false;
      const hours = (samples.count[4 * samples.size - 1] * data.dt_s / 3600).toFixed(2);
      const far = Math.abs(samples.real[first] - data.ocv_V.at(-1) / 2 - data.ocv_V[0] / 2) > data.ocv_V.at(-1) - data.ocv_V[0];
      say(`${found.name}: ${samples.size.toLocaleString("en")} samples of ${data.dt_s} s, ${hours} h, estimated in ` +
        `${found.result.ms.toFixed(0)} ms` + (far ? ". These are not the volts of one such cell." : ""), far);
      go(samples.size - 1);
      document.documentElement.dataset.page = "done";
    });
  }
  const seconds = (s) => s >= 5940 ? `${(s / 3600).toFixed(1)} h` : s >= 99 ? `${(s / 60).toFixed(0)} min` : `${s.toFixed(0)} s`;
  function go(k) {
    const { samples, result } = found;
    k = Math.max(0, Math.min(k, samples.size - 1));
    found.at = k;
    by("at").value = k;
    const [soc, variance, , innovation] = result.real.subarray(6 * k, 6 * k + 4), band = 2 * Math.sqrt(variance);
    by("t-soc").textContent = `${(100 * soc).toFixed(1)} %`;
    by("t-band").textContent = `${(100 * Math.max(soc - band, 0)).toFixed(1)} to ${(100 * Math.min(soc + band, 1)).toFixed(1)} %`;
    const [left, low, high] = leftAt(k);
    found.left = left;
    by("t-left").textContent = Number.isNaN(left) ? "no load" : `${seconds(left)} (${seconds(low)} to ${seconds(high)})`;
    const bits = result.count[6 * k + 5], voltage = samples.real[4 * k + 1];
    by("t-innovation").textContent = Number.isNaN(voltage) ? "no voltage" : `${(1000 * innovation).toFixed(1)} mV`;
    by("t-time").textContent = seconds(samples.count[4 * k + 3] * data.dt_s);
    const names = Object.entries(data.status).filter(([, bit]) => bits & bit).map(([name]) => name.toLowerCase().replaceAll("_", " "));
    by("status").textContent = `sample ${k + 1} of ${samples.size}` + (names.length ? `: ${names.join(", ")}` : "");
    draw();
  }
  const PLOTS = {
    soc: { title: "SOC [%]", y: (k) => 100 * found.result.real[6 * k],
      half: (k) => 200 * Math.sqrt(found.result.real[6 * k + 1]) },
    voltage: { title: "voltage [V]: measured,", second: "predicted", y: (k) => found.samples.real[4 * k + 1], other: (k) => found.result.real[6 * k + 2] },
    left: { title: "remaining at the load of the last minute [h]", clip: 0.95, y: (k) => found.result.left[Math.floor(k / found.result.every)][0] / 3600,
      low: (k) => found.result.left[Math.floor(k / found.result.every)][1] / 3600,
      high: (k) => found.result.left[Math.floor(k / found.result.every)][2] / 3600 },
    current: { title: "current [A], positive on discharge", y: (k) => found.samples.real[4 * k] },
  };
  const LEFT = 52, BELOW = 22, ABOVE = 20;
  function draw() {
    const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(`--${name}`).trim();
    for (const canvas of document.querySelectorAll("canvas")) plot(canvas, PLOTS[canvas.dataset.plot], colour);
  }
  /* Lowest and highest of what falls on each pixel: a spike of one sample is seen. */
  function extent(read, first, last, wide) {
    const low = new Float64Array(wide).fill(NaN), high = new Float64Array(wide).fill(NaN), step = (last - first + 1) / wide;
    for (let x = 0; x < wide; x++) {
      const from = first + Math.floor(x * step), to = Math.max(from, Math.min(last, first + Math.ceil((x + 1) * step) - 1));
      for (let k = from; k <= to; k++) {
        const v = read(k);
        if (Number.isFinite(v)) { if (!(v >= low[x])) low[x] = v; if (!(v <= high[x])) high[x] = v; }
      }
    }
    return { low, high };
  }
  function plot(canvas, what, colour) {
    const scale = devicePixelRatio || 1, box = canvas.getBoundingClientRect(), [first, last] = found.view;
    canvas.width = box.width * scale;
    canvas.height = box.height * scale;
    const c = canvas.getContext("2d");
    c.scale(scale, scale);
    const wide = Math.max(10, Math.floor(box.width - LEFT - 8)), tall = box.height - ABOVE - BELOW;
    const line = extent(what.y, first, last, wide), other = what.other && extent(what.other, first, last, wide);
    const low = what.half ? extent((k) => Math.max(what.y(k) - what.half(k), 0), first, last, wide).low : what.low ? extent(what.low, first, last, wide).low : null;
    const high = what.half ? extent((k) => Math.min(what.y(k) + what.half(k), 100), first, last, wide).high : what.high ? extent(what.high, first, last, wide).high : null;
    const all = [line.low, line.high, low, high, other?.low, other?.high].filter(Boolean).flatMap((a) => [...a]).filter(Number.isFinite);
    let bottom = Math.min(...all), top = Math.max(...all);
    if (what.clip && all.length) {  // next to no load lasts next to for ever
      bottom = 0;
      top = 1.2 * Float64Array.from(line.low.filter(Number.isFinite)).sort().at(Math.floor(what.clip * (line.low.filter(Number.isFinite).length - 1)));
    }
    if (!all.length) { bottom = 0; top = 1; }
    if (!(top > bottom)) { top += 0.5; bottom -= 0.5; }
    const y = (v) => ABOVE + tall * (1 - (Math.min(v, top) - bottom) / (top - bottom));
    c.font = "12px system-ui, sans-serif";
    c.fillStyle = colour("muted");
    const title = all.length ? what.title : `${what.title}: none`;
    if (what.second) c.fillStyle = colour("accent");
    c.fillText(title, LEFT, 13);
    if (what.second) { c.fillStyle = colour("other"); c.fillText(what.second, LEFT + c.measureText(`${title} `).width, 13); c.fillStyle = colour("muted"); }
    const unit = 10 ** Math.floor(Math.log10((top - bottom) / 2)), step = unit * ([1, 2, 5].find((m) => (top - bottom) / (m * unit) <= 5) ?? 10);
    for (let v = Math.ceil(bottom / step) * step; v <= top + 1e-9 * step; v += step) {
      c.strokeStyle = colour("grid");
      c.beginPath(); c.moveTo(LEFT, y(v)); c.lineTo(LEFT + wide, y(v)); c.stroke();
      c.textAlign = "right";
      c.fillText(v.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))), LEFT - 6, y(v) + 4);
    }
    const hours = (k) => found.samples.count[4 * k + 3] * data.dt_s / 3600;
    for (const share of [0, 0.5, 1]) {
      c.textAlign = share === 0 ? "left" : share === 1 ? "right" : "center";
      c.fillText(`${hours(Math.round(first + share * (last - first))).toFixed(2)} h`, LEFT + share * wide, box.height - 5);
    }
    c.textAlign = "left";
    if (low && high) {
      c.fillStyle = colour("band");
      for (let x = 0; x < wide; x++) if (Number.isFinite(low[x])) c.fillRect(LEFT + x, y(high[x]), 1, Math.max(1, y(low[x]) - y(high[x])));
    }
    for (const [each, name] of [[line, "accent"], [other, "other"]]) {
      if (!each) continue;
      c.strokeStyle = colour(name);
      c.lineWidth = 1.3;
      c.beginPath();
      for (let x = 0, pen = false; x < wide; x++) {
        if (!Number.isFinite(each.low[x])) { pen = false; continue; }
        if (pen) c.lineTo(LEFT + x, y(each.high[x])); else c.moveTo(LEFT + x, y(each.high[x]));
        c.lineTo(LEFT + x, y(each.low[x]) + 0.01);
        pen = true;
      }
      c.stroke();
    }
    const at = LEFT + wide * (found.at - first) / Math.max(last - first, 1);
    c.strokeStyle = colour("muted");
    c.lineWidth = 1;
    if (at >= LEFT && at <= LEFT + wide) { c.beginPath(); c.moveTo(at, ABOVE); c.lineTo(at, ABOVE + tall); c.stroke(); }
    canvas.sampleAt = (x) => Math.round(first + Math.max(0, Math.min(1, (x - LEFT) / wide)) * (last - first));
  }

  /* ---- hands ---- */
  function read(file) {
    document.documentElement.dataset.page = "reading";
    file.text().then((text) => take(text, file.name), () => say(`Found ${file.name}, which cannot be read; expected a CSV file. Open another.`, true));
  }
  function save(bytes, name) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([bytes], { type: "application/zip" }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
  by("file").addEventListener("change", (event) => { if (event.target.files[0]) read(event.target.files[0]); });
  by("package").addEventListener("click", () => save(bytesOf(data.package), data.package_name));
  by("example").addEventListener("click", () => {
    const values = new Float32Array(bytesOf(data.example).buffer), rows = values.length / 2;
    const lines = ["time_s,current_A,voltage_V"];
    for (let k = 0; k < rows; k++) lines.push(`${k * data.dt_s},${values[2 * k]},${values[2 * k + 1]}`);
    take(lines.join("\n"), data.example_name);
  });
  for (const id of ["c-time", "c-current", "c-voltage", "c-temperature", "charging", "soc0", "std0"]) by(id).addEventListener("change", run);
  by("at").addEventListener("input", (event) => go(+event.target.value));
  for (const button of document.querySelectorAll("[data-step]")) button.addEventListener("click", () => go(found.at + +button.dataset.step));
  const drop = by("drop");
  for (const name of ["dragenter", "dragover", "dragleave", "drop"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      drop.classList.toggle("over", name === "dragenter" || name === "dragover");
      if (name === "drop" && event.dataTransfer.files[0]) read(event.dataTransfer.files[0]);
    });
  }
  for (const canvas of document.querySelectorAll("canvas")) {
    let from = null;
    canvas.addEventListener("pointerdown", (event) => { from = event.offsetX; });
    canvas.addEventListener("pointerup", (event) => {
      const [a, b] = [canvas.sampleAt(from), canvas.sampleAt(event.offsetX)].sort((p, q) => p - q);
      if (Math.abs(event.offsetX - from) > 6 && b - a > 2) { found.view = [a, b]; draw(); } else go(b);
    });
    canvas.addEventListener("dblclick", () => { found.view = [0, found.samples.size - 1]; draw(); });
  }
  addEventListener("resize", () => { if (found.result) draw(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (found.result) draw(); });
  WebAssembly.instantiate(bytesOf(data.wasm)).then(({ instance }) => {
    wasm = instance;
    found.ready = true;
    document.documentElement.dataset.page = "ready";
  }, (error) => say(`This browser does not run the estimator: ${error.message}`, true));
  return Object.assign(found, { take, go, data, estimate, samplesOf });
})();
