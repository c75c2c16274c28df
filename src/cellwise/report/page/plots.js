// Plots over time: every sample is here, each drawing shows the extremes of every pixel column.
// Beside them: links that show a time in the plots of its log, and tables that sort.
"use strict";
(() => {
  const SECONDS = { s: 1, min: 60, h: 3600 };
  const MISSING = 65535, LEFT = 64, RIGHT = 12, HEIGHT = 130, NAMES = 18, BARE = 6, AXIS = 34;
  const COLOURS = ["--line-1", "--line-3", "--line-4", "--line-2"];
  // What is measured is grey and what a model says without looking is red.
  const KNOWN = { measured: "--measured", reference: "--measured", model: "--line-2",
    before: "--line-2", simulated: "--line-2", predicted: "--line-2" };

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
      for (const line of panel.lines)
        for (const series of [line, ...(line.band || [])])
          series.levels = levels(await inflated(series.data));
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

  const valueOf = (series, level) => series.low + (level / 65534) * (series.high - series.low);
  const signed = (text) => text.replace("-", "\u2212");

  function ticks(low, high, about) {
    const raw = (high - low) / about, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw) || raw;
    const found = [];
    for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-9; t += step)
      found.push(Math.abs(t) < step * 1e-9 ? 0 : t);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return { found, digits: Math.min(digits, 9) };
  }

  // Lowest and highest value of every pixel column of the rows shown; NaN where nothing is.
  function columns({ x, n }, series, [from, to], width) {
    const low = new Float64Array(width).fill(NaN), high = new Float64Array(width).fill(NaN);
    const a = Math.max(firstAfter(x, n, from) - 1, 0), b = Math.min(firstAfter(x, n, to) + 1, n);
    const scale = (width - 1) / (to - from || 1);
    for (let i = a; i < b; i++) {
      const level = series.levels[i];
      if (level === MISSING) continue;
      const c = Math.min(Math.max(Math.round((at(x, i) - from) * scale), 0), width - 1);
      const value = valueOf(series, level);
      if (!(low[c] <= value)) low[c] = value;
      if (!(high[c] >= value)) high[c] = value;
    }
    return { low, high };
  }

  const least = (values) => values.reduce((a, b) => (b < a ? b : a), Infinity);
  const most = (values) => values.reduce((a, b) => (b > a ? b : a), -Infinity);

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
        const room = Math.max(0.5 * (marked[1] - marked[0]), 0.002 * (whole[1] - whole[0]));
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
      root.dataset.pointer = pointer === null ? "" : pointer;
      root.dataset.marked = marked === null ? "" : marked;
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
      const inked = inks(panel.lines).map(colour);
      const drawn = panel.lines.map((line) => ({
        seen: columns(plot, line, view, width),
        band: line.band && line.band.map((edge) => columns(plot, edge, view, width)),
      }));
      const ends = (of) => [Math.min(...of.map((s) => least(s.low))), Math.max(...of.map((s) => most(s.high)))];
      const [lowest, highest] = ends(drawn.map(({ seen }) => seen));
      let [low, high] = ends(drawn.flatMap(({ seen, band }) => [seen, ...(band || [])]));
      if (!(low <= high)) { low = 0; high = 1; }
      // Of the whole log a few peaks or a wide band do not set the axis; zoomed in, they do.
      const all = view[0] === whole[0] && view[1] === whole[1], limits = (all && panel.most) || [-Infinity, Infinity];
      [low, high] = [Math.max(low, limits[0]), Math.min(high, limits[1])];
      const beyond = [lowest, highest].filter((v) => v < limits[0] || v > limits[1]);
      const room = 0.06 * (high - low) || 0.05 * Math.abs(high) || 0.5;
      low -= room;
      high += room;
      const frame = { width, above, left: LEFT, tall: HEIGHT, low, high, last,
        y: (v) => above + HEIGHT * (1 - (v - low) / (high - low)),
        px: (t) => LEFT + (width * (t - view[0])) / (view[1] - view[0]) };
      axes(pen, panel, colour, frame);
      pen.save();
      pen.beginPath();
      pen.rect(LEFT, above, width, HEIGHT);
      pen.clip();
      drawn.forEach(({ seen, band }, k) => {
        if (band) shade(pen, band, frame.y, inked[k]);
        trace(pen, seen, frame.y, inked[k]);
      });
      pen.restore();
      if (beyond.length) {
        const said = `off scale: up to ${beyond.map((v) => signed(v.toPrecision(3))).join(" and ")}`;
        const from = LEFT + width - pen.measureText(said).width;
        pen.fillStyle = colour("--paper");
        pen.fillRect(from - 4, above, LEFT + width - from + 4, 16);
        pen.fillStyle = colour("--muted");
        pen.fillText(said, from, above + 12);
      }
      let along = LEFT + 2;
      if (panel.lines.length > 1) panel.lines.forEach(({ label }, k) => {
        pen.fillStyle = inked[k];
        pen.fillRect(along, above - 9, 16, 2.5);
        pen.fillText(label, along + 21, above - 4);
        along += 39 + pen.measureText(label).width;
      });
      if (marked) stripe(pen, colour("--warn"), 0.25, frame, marked);
      if (grip !== null) stripe(pen, colour("--muted"), 0.15, frame, [grip, pointer]);
      else if (pointer !== null) stripe(pen, colour("--muted"), 1, frame, [pointer, pointer]);
    }

    function axes(pen, panel, colour, { low, high, y, px, width, last, above }) {
      pen.strokeStyle = colour("--grid");
      pen.fillStyle = colour("--muted");
      pen.lineWidth = 1;
      const line = (x1, y1, x2, y2) => {
        pen.beginPath();
        pen.moveTo(x1, y1);
        pen.lineTo(x2, y2);
        pen.stroke();
      };
      pen.textAlign = "right";
      const up = ticks(low, high, 5);
      for (const v of up.found) {
        line(LEFT, y(v), LEFT + width, y(v));
        pen.fillText(signed(v.toFixed(up.digits)), LEFT - 6, y(v) + 4);
      }
      pen.textAlign = "center";
      const along = ticks(view[0], view[1], Math.min(8, width / 60));
      for (const t of along.found) {
        line(px(t), above, px(t), above + HEIGHT);
        if (last) pen.fillText(t.toFixed(along.digits), px(t), above + HEIGHT + 14);
      }
      if (last) pen.fillText(plot.xLabel, LEFT + width / 2, above + HEIGHT + 29);
      pen.save();
      pen.translate(11, above + HEIGHT / 2);
      pen.rotate(-Math.PI / 2);
      pen.fillText(panel.label, 0, 0);
      pen.restore();
      pen.textAlign = "left";
    }

    function trace(pen, { low, high }, y, ink) {
      pen.strokeStyle = ink;
      pen.lineWidth = 1.2;
      pen.beginPath();
      let joined = false;
      for (let c = 0; c < low.length; c++) {
        if (Number.isNaN(low[c])) continue;
        if (joined) pen.lineTo(LEFT + c, y(high[c])); else pen.moveTo(LEFT + c, y(high[c]));
        pen.lineTo(LEFT + c, y(low[c]));
        joined = true;
      }
      pen.stroke();
    }

    function shade(pen, [lower, upper], y, ink) {
      pen.fillStyle = ink;
      pen.globalAlpha = 0.18;
      pen.beginPath();
      const shown = [...lower.low.keys()].filter((c) => lower.low[c] <= upper.high[c]);
      shown.forEach((c) => pen.lineTo(LEFT + c, y(upper.high[c])));
      shown.reverse().forEach((c) => pen.lineTo(LEFT + c, y(lower.low[c])));
      pen.fill();
      pen.globalAlpha = 1;
    }

    function stripe(pen, ink, alpha, { px, width, above, tall }, times) {
      if (Math.max(...times) < view[0] || Math.min(...times) > view[1]) return;
      const [from, to] = times.map((t) => Math.min(Math.max(px(t), LEFT), LEFT + width))
        .sort((a, b) => a - b);
      pen.fillStyle = ink;
      pen.globalAlpha = alpha;
      pen.fillRect(from - 0.5, above, to - from + 1, tall);
      pen.globalAlpha = 1;
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
    root.addEventListener("pointercancel", () => { grip = null; later(); });
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

  // A link of a notice: every plot of its log shows the time it names, marked.
  const plotOf = (clock) =>
    [...document.querySelectorAll("div.trace")].find((root) => root.dataset.clock === clock);
  for (const link of document.querySelectorAll("button.jump")) {
    const { clock, from, to } = link.dataset;
    if (!plotOf(clock)) { link.replaceWith(...link.childNodes); continue; }
    link.addEventListener("click", (event) => {
      event.preventDefault();
      document.dispatchEvent(
        new CustomEvent("cellwise-look", { detail: { clock, from: +from, to: +to } }));
      plotOf(clock).scrollIntoView({ block: "start" });
    });
  }

  // A click on the head of a column puts the rows of a table in its order; again, the other way round.
  for (const table of document.querySelectorAll("table.sort")) {
    const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
    const text = (row, k) => row.cells[k].textContent.trim();
    const number = (row, k) => parseFloat(text(row, k).replace("\u2212", "-").replace(/\s/g, ""));
    heads.forEach((head, k) => {
      head.tabIndex = 0;
      const sort = () => {
        const down = head.getAttribute("aria-sort") !== "descending";
        for (const one of heads) one.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const numbers = head.classList.contains("n");
        const order = (a, b) => numbers ? number(b, k) - number(a, k)
          : text(b, k).localeCompare(text(a, k));
        const known = (row) => !numbers || !Number.isNaN(number(row, k));
        const rows = [...body.rows], sorted = rows.filter(known).sort(order);
        if (!down) sorted.reverse();
        body.append(...sorted, ...rows.filter((row) => !known(row)));  // what is not known is last
      };
      head.addEventListener("click", sort);
      head.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(); });
    });
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
