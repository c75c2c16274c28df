// Plots that zoom: every sample is here, each drawing shows the extremes of every pixel column.
"use strict";
(() => {
  const SECONDS = { s: 1, min: 60, h: 3600 };
  const MISSING = 65535, LEFT = 64, RIGHT = 12, HEIGHT = 120, NAMES = 18, BARE = 6, AXIS = 34;
  const COLOURS = ["--line-1", "--line-3", "--line-4", "--line-2"];
  // What is measured is grey and what a model says without looking is red, as in the pictures.
  const KNOWN = { measured: "--measured", reference: "--measured", model: "--line-2",
    before: "--line-2", simulated: "--line-2" };

  function inks(lines) {
    const free = COLOURS.filter((c) => !lines.some((line) => KNOWN[line.label] === c));
    let next = 0;
    return lines.map((line) => KNOWN[line.label] || free[next++ % free.length]);
  }

  async function inflated(text) {
    const packed = atob(text), bytes = new Uint8Array(packed.length);
    for (let i = 0; i < packed.length; i++) bytes[i] = packed.charCodeAt(i);
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // Differences of 16-bit numbers, all low bytes first, then all high ones.
  function levels(bytes) {
    const n = bytes.length >> 1, found = new Uint16Array(n);
    let value = 0;
    for (let i = 0; i < n; i++) {
      value = (value + bytes[i] + (bytes[n + i] << 8)) & 0xffff;
      found[i] = value;
    }
    return found;
  }

  async function decoded(plot) {
    if (plot.x.data) plot.x.values = new Float32Array((await inflated(plot.x.data)).buffer);
    for (const panel of plot.panels)
      for (const line of panel.lines) {
        line.levels = levels(await inflated(line.data));
        if (line.band) line.band.levels = levels(await inflated(line.band.data));
      }
    return plot;
  }

  const at = (x, i) => (x.values ? x.values[i] : x.start + i * x.step);

  function firstAfter(x, n, t) {
    if (!x.values) return Math.min(Math.max(Math.ceil((t - x.start) / x.step), 0), n);
    let low = 0, high = n;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (x.values[middle] < t) low = middle + 1; else high = middle;
    }
    return low;
  }

  const valueOf = (line, level) => line.low + (level / 65534) * (line.high - line.low);

  function ticks(low, high, about) {
    const raw = (high - low) / about, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw) || raw;
    const found = [];
    for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-9; t += step)
      found.push(Math.abs(t) < step * 1e-9 ? 0 : t);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return { found, digits: Math.min(digits, 9) };
  }

  // Lowest and highest level of every pixel column of the rows shown.
  function columns(plot, series, from, to, width) {
    const { x, n } = plot, low = new Int32Array(width).fill(-1), high = new Int32Array(width);
    const a = Math.max(firstAfter(x, n, from) - 1, 0), b = Math.min(firstAfter(x, n, to) + 1, n);
    const scale = (width - 1) / (to - from || 1);
    for (let i = a; i < b; i++) {
      const level = series.levels[i];
      if (level === MISSING) continue;
      const c = Math.min(Math.max(Math.round((at(x, i) - from) * scale), 0), width - 1);
      if (low[c] < 0) low[c] = high[c] = level;
      else if (level < low[c]) low[c] = level;
      else if (level > high[c]) high[c] = level;
    }
    return { low, high };
  }

  function start(root, plot) {
    const whole = [at(plot.x, 0), at(plot.x, plot.n - 1)];
    let view = whole.slice(), pointer = null, grip = null, waiting = false, marked = null;
    // Seconds from the log's first row are the same in all plots of one log.
    const clock = root.dataset.clock, unit = SECONDS[(plot.xLabel.match(/\[(\w+)\]/) || [])[1]] || 0;
    function point(t) {
      pointer = t;
      later();
      const at = t === null ? null : unit * (t - whole[0]);
      if (clock && unit) document.dispatchEvent(
        new CustomEvent("cellwise-point", { detail: { clock, at, from: root } }));
    }
    if (clock && unit) {
      document.addEventListener("cellwise-point", ({ detail }) => {
        if (detail.clock !== clock || detail.from === root) return;
        pointer = detail.at === null ? null : detail.at / unit + whole[0];
        later();
      });
      document.addEventListener("cellwise-look", ({ detail }) => {
        if (detail.clock !== clock) return;
        marked = [detail.from, detail.to].map((at) => at / unit + whole[0]);
        const room = Math.max(2 * (marked[1] - marked[0]), 0.01 * (whole[1] - whole[0]));
        show(marked[0] - room, marked[1] + room);
      });
    }
    const canvases = plot.panels.map((panel) => {
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", panel.label);
      root.append(canvas);
      return canvas;
    });
    const line = document.createElement("p");
    line.className = "readout";
    root.append(line);
    root.tabIndex = 0;

    function draw() {
      waiting = false;
      const began = performance.now(), style = getComputedStyle(document.documentElement);
      plot.panels.forEach((panel, k) =>
        drawPanel(canvases[k], panel, style, k === plot.panels.length - 1));
      readout();
      root.dataset.from = view[0];
      root.dataset.to = view[1];
      root.dataset.drawMs = (performance.now() - began).toFixed(1);
    }
    const later = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };

    function drawPanel(canvas, panel, style, last) {
      const ratio = window.devicePixelRatio || 1, wide = root.clientWidth;
      const above = panel.lines.length > 1 ? NAMES : BARE, tall = above + HEIGHT + (last ? AXIS : 6);
      canvas.style.height = `${tall}px`;
      canvas.width = Math.round(wide * ratio);
      canvas.height = Math.round(tall * ratio);
      const colour = (name) => style.getPropertyValue(name).trim();
      const pen = canvas.getContext("2d");
      pen.scale(ratio, ratio);
      pen.font = "11px system-ui, sans-serif";
      const width = Math.max(Math.round(wide - LEFT - RIGHT), 10);
      const height = HEIGHT, inked = inks(panel.lines).map((name) => colour(name));
      let along = LEFT + 2;
      const drawn = panel.lines.map((line) => ({
        line,
        seen: columns(plot, line, view[0], view[1], width),
        band: line.band && columns(plot, line.band, view[0], view[1], width),
      }));
      let low = Infinity, high = -Infinity;
      for (const { line, seen } of drawn)
        for (let c = 0; c < width; c++)
          if (seen.low[c] >= 0) {
            low = Math.min(low, valueOf(line, seen.low[c]));
            high = Math.max(high, valueOf(line, seen.high[c]));
          }
      if (!(low <= high)) { low = 0; high = 1; }
      const room = 0.06 * (high - low) || 0.05 * Math.abs(high) || 0.5;
      low -= room;
      high += room;
      const y = (v) => above + height * (1 - (v - low) / (high - low));
      axes(pen, panel, colour, { low, high, y, width, height, last, above });
      drawn.forEach(({ line, seen, band }, k) => {
        const ink = inked[k];
        pen.save();
        pen.beginPath();
        pen.rect(LEFT, above, width, height);
        pen.clip();
        if (band) shade(pen, line, seen, band, y, ink);
        trace(pen, line, seen, y, ink);
        pen.restore();
        if (panel.lines.length < 2) return;
        pen.fillStyle = ink;
        pen.fillRect(along, above - 9, 16, 2.5);
        pen.fillText(line.label, along + 21, above - 4);
        along += 39 + pen.measureText(line.label).width;
      });
      if (marked) alarm(pen, colour, height, width, above);
      if (pointer !== null || grip) mark(pen, colour, height, width, above);
      root.dataset.pointer = pointer === null ? "" : pointer;
    }

    function axes(pen, panel, colour, { low, high, y, width, height, last, above }) {
      pen.strokeStyle = colour("--grid");
      pen.fillStyle = colour("--muted");
      pen.lineWidth = 1;
      pen.textAlign = "right";
      const up = ticks(low, high, 5);
      for (const v of up.found) {
        pen.beginPath();
        pen.moveTo(LEFT, y(v));
        pen.lineTo(LEFT + width, y(v));
        pen.stroke();
        pen.fillText(v.toFixed(up.digits).replace("-", "\u2212"), LEFT - 6, y(v) + 4);
      }
      pen.textAlign = "center";
      const along = ticks(view[0], view[1], 8);
      for (const t of along.found) {
        const px = LEFT + (width * (t - view[0])) / (view[1] - view[0]);
        pen.beginPath();
        pen.moveTo(px, above);
        pen.lineTo(px, above + height);
        pen.stroke();
        if (last) pen.fillText(t.toFixed(along.digits), px, above + height + 14);
      }
      if (last) pen.fillText(plot.xLabel, LEFT + width / 2, above + height + 29);
      pen.save();
      pen.translate(11, above + height / 2);
      pen.rotate(-Math.PI / 2);
      pen.fillText(panel.label, 0, 0);
      pen.restore();
      pen.textAlign = "left";
    }

    function trace(pen, line, seen, y, ink) {
      pen.strokeStyle = ink;
      pen.lineWidth = 1.2;
      pen.beginPath();
      let joined = false;
      for (let c = 0; c < seen.low.length; c++) {
        if (seen.low[c] < 0) continue;
        const px = LEFT + c, top = y(valueOf(line, seen.high[c]));
        if (joined) pen.lineTo(px, top); else pen.moveTo(px, top);
        pen.lineTo(px, y(valueOf(line, seen.low[c])));
        joined = true;
      }
      pen.stroke();
    }

    function shade(pen, line, seen, band, y, ink) {
      pen.fillStyle = ink;
      pen.globalAlpha = 0.18;
      const wide = (c) => valueOf(line.band, band.high[c]);
      pen.beginPath();
      const shown = [...seen.low.keys()].filter((c) => seen.low[c] >= 0 && band.low[c] >= 0);
      shown.forEach((c, k) => {
        const py = y(valueOf(line, seen.high[c]) + wide(c));
        if (k) pen.lineTo(LEFT + c, py); else pen.moveTo(LEFT + c, py);
      });
      shown.reverse().forEach((c) => pen.lineTo(LEFT + c, y(valueOf(line, seen.low[c]) - wide(c))));
      pen.fill();
      pen.globalAlpha = 1;
    }

    function alarm(pen, colour, height, width, above) {
      const [from, to] = marked.map((t) =>
        Math.min(Math.max((width * (t - view[0])) / (view[1] - view[0]), 0), width));
      if (marked[1] < view[0] || marked[0] > view[1]) return;
      pen.fillStyle = colour("--warn");
      pen.globalAlpha = 0.25;
      pen.fillRect(LEFT + from - 1, above, to - from + 2, height);
      pen.globalAlpha = 1;
    }

    function mark(pen, colour, height, width, above) {
      const px = (t) => LEFT + (width * (t - view[0])) / (view[1] - view[0]);
      pen.fillStyle = pen.strokeStyle = colour("--muted");
      if (grip) {
        pen.globalAlpha = 0.15;
        pen.fillRect(px(Math.min(grip, pointer)), above,
          Math.abs(px(grip) - px(pointer)), height);
        pen.globalAlpha = 1;
      } else {
        pen.beginPath();
        pen.moveTo(px(pointer), above);
        pen.lineTo(px(pointer), above + height);
        pen.stroke();
      }
    }

    function readout() {
      const last = firstAfter(plot.x, plot.n, view[1]);
      const end = last < plot.n && at(plot.x, last) <= view[1] ? last + 1 : last;
      const rows = end - firstAfter(plot.x, plot.n, view[0]);
      let text = `${rows.toLocaleString("en")} of ${plot.n.toLocaleString("en")} samples`;
      if (pointer !== null) {
        const i = Math.min(firstAfter(plot.x, plot.n, pointer), plot.n - 1);
        text = `${plot.xLabel} ${at(plot.x, i).toPrecision(6)}`;
        for (const panel of plot.panels)
          for (const line of panel.lines)
            if (line.levels[i] !== MISSING)
              text += ` | ${line.label} ${valueOf(line, line.levels[i]).toPrecision(5)}`;
      }
      line.textContent = text;
    }

    function show(from, to) {
      const least = (whole[1] - whole[0]) * 1e-6 || 1e-9;
      if (to - from < least) to = from + least;
      view = [Math.max(from, whole[0]), Math.min(to, whole[1])];
      if (!(view[1] > view[0])) view = whole.slice();
      later();
    }
    const zoom = (factor, t = (view[0] + view[1]) / 2) =>
      show(t - (t - view[0]) * factor, t + (view[1] - t) * factor);
    const pan = (share) => {
      const span = view[1] - view[0];
      const from = Math.min(Math.max(view[0] + share * span, whole[0]), whole[1] - span);
      show(from, from + span);
    };
    const time = (event) => {
      const box = root.getBoundingClientRect();
      const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
      return view[0] + Math.min(Math.max(share, 0), 1) * (view[1] - view[0]);
    };

    root.addEventListener("wheel", (event) => {
      if (!(event.ctrlKey || document.activeElement === root)) return;
      event.preventDefault();
      zoom(event.deltaY > 0 ? 1.25 : 0.8, time(event));
    }, { passive: false });
    root.addEventListener("pointerdown", (event) => {
      grip = time(event);
      root.setPointerCapture(event.pointerId);
    });
    root.addEventListener("pointermove", (event) => point(time(event)));
    root.addEventListener("pointerup", (event) => {
      const [from, to] = [Math.min(grip, time(event)), Math.max(grip, time(event))];
      grip = null;
      if (to - from > 0.005 * (view[1] - view[0])) show(from, to); else later();
    });
    root.addEventListener("pointerleave", () => point(null));
    root.addEventListener("dblclick", () => show(...whole));
    root.addEventListener("keydown", (event) => {
      const does = { "+": () => zoom(0.5), "-": () => zoom(2), ArrowLeft: () => pan(-0.25),
        ArrowRight: () => pan(0.25), Escape: () => show(...whole) }[event.key];
      if (does) { event.preventDefault(); does(); }
    });
    new ResizeObserver(later).observe(root);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", later);
    draw();
  }

  async function all() {
    for (const root of document.querySelectorAll("div.trace")) {
      const source = document.getElementById(root.dataset.source);
      start(root, await decoded(JSON.parse(source.textContent)));
    }
    document.documentElement.dataset.plots = "ready";
  }
  all();
})();
