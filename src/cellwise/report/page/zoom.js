// Pictures that zoom: lines, bands and marks of the axes are moved to the part that is looked at.
// A view is the part of an axes' box that is shown, in shares of it: x from the left, y from above.
"use strict";
(() => {
  const NAMES = "http://www.w3.org/2000/svg", LEAST = 1e-4, WHOLE = [0, 1], CLICK = 5, BESIDE = 46, NARROWEST = 250;
  const SECONDS = { s: 1, min: 60, h: 3600 };
  const PAIR = /(-?\d+(?:\.\d+)?(?:e-?\d+)?)[ ,](-?\d+(?:\.\d+)?(?:e-?\d+)?)/g;

  const made = (name, into, settings = {}) => {
    const element = document.createElementNS(NAMES, name);
    for (const [key, value] of Object.entries(settings)) element.setAttribute(key, value);
    into.append(element);
    return element;
  };

  // What moves: each gets functions that take an old place to the new one.
  function pathMover(path, down = 0) {
    const drawn = path.getAttribute("d");
    return (x, y) => path.setAttribute("d", drawn.replace(
      PAIR, (_, a, b) => `${x(+a).toFixed(2)} ${y(+b + down).toFixed(2)}`));
  }

  function useMover(use, svg) {
    const a = +use.getAttribute("x"), b = +use.getAttribute("y");
    if (a !== 0) return (x, y) => {  // a mark keeps its size
      use.setAttribute("x", x(a).toFixed(2));
      use.setAttribute("y", y(b).toFixed(2));
    };
    // A band: a shape of its own, drawn once from below.
    const shape = svg.querySelector(use.getAttribute("xlink:href") || use.getAttribute("href"));
    const path = shape.cloneNode();
    path.removeAttribute("id");
    path.setAttribute("style", [shape, use].map((e) => e.getAttribute("style") || "").join(";"));
    use.replaceWith(path);
    return pathMover(path, b);
  }

  function imageMover(image) {
    const drawn = image.getAttribute("transform") || "";
    return (x, y) => {
      const sx = x(1) - x(0), sy = y(1) - y(0);
      image.setAttribute("transform", `matrix(${sx} 0 0 ${sy} ${x(0)} ${y(0)}) ${drawn}`);
    };
  }

  function textMover(group, [a, b, ofX, ofY], still, inside, right) {
    // In a narrow window it is as large as the rest, and ends where the window does.
    const sizes = [...group.querySelectorAll("text")].map((t) => parseFloat(t.style.fontSize) || 8);
    const larger = right ? Math.max(11.1 / Math.min(...sizes), 1) : 1;
    return (x, y) => {
      const left = (ofX ? x : still.x)(a), top = (ofY ? y : still.y)(b);
      group.setAttribute("transform",
        `translate(${left} ${top}) scale(${larger}) translate(${-a} ${-b})`);
      group.style.display = inside(left, top) ? "" : "none";
      if (!right || group.style.display) return;
      const box = group.getBBox(), ends = left + larger * (box.x + box.width - a);
      const over = Math.max(ends - right, 0) || Math.min(left + larger * (box.x - a), 0);
      if (over) group.setAttribute("transform", group.getAttribute("transform").replace(
        /[^(]+/, "translate").replace(/\((\S+)/, `(${left - over}`));
    };
  }

  function movers(group, axes, svg) {
    const [left, top, wide, tall] = axes.at || axes.box, found = [];
    const right = axes.at ? axes.end || svg.viewBox.baseVal.width : 0, [left0, top0, wide0, tall0] = axes.box;
    const still = { x: (old) => left + (wide * (old - left0)) / wide0,
      y: (old) => top + (tall * (old - top0)) / tall0 };
    const inside = (x, y) =>
      x >= left - 1 && x <= left + wide + 1 && y >= top - 1 && y <= top + tall + 1;
    for (const clipped of group.querySelectorAll("[clip-path]")) {
      if (clipped.closest("[data-tick]")) continue;
      const parts = clipped.tagName === "g" ? [...clipped.children] : [clipped];
      for (const part of parts) {
        if (part.tagName === "path") found.push(pathMover(part));
        else if (part.tagName === "use") found.push(useMover(part, svg));
        else if (part.tagName === "image") found.push(imageMover(part));
      }
    }
    axes.texts.forEach((place, k) => {
      const text = group.querySelector(`[data-text="${k}"]`);
      if (text) found.push(textMover(text, place, still, inside, right));
    });
    return found;
  }

  // Round numbers of an axis within its limits.
  function round(low, high, about) {
    const raw = (high - low) / about, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw) || raw;
    const digits = Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 9), found = [];
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + step * 1e-9; v += step)
      found.push([v, (Math.abs(v) < step * 1e-9 ? 0 : v).toFixed(digits)]);
    return found;
  }

  function decades(low, high) {
    const found = [], every = high / low < 300 ? [1, 2, 5] : [1];
    for (let k = Math.floor(Math.log10(low)); k <= Math.ceil(Math.log10(high)); k++)
      for (const m of every)
        if (m * 10 ** k >= low && m * 10 ** k <= high)
          found.push([m * 10 ** k, String(+(m * 10 ** k).toPrecision(3))]);
    return found.length > 2 ? found : round(low, high, 4);
  }

  const value = (axis, share) => {
    const [a, b] = axis.log ? axis.limits.map(Math.log10) : axis.limits;
    return axis.log ? 10 ** (a + share * (b - a)) : a + share * (b - a);
  };
  const shareOf = (axis, v) => {
    const [a, b] = axis.log ? axis.limits.map(Math.log10) : axis.limits;
    return ((axis.log ? Math.log10(v) : v) - a) / (b - a);
  };

  function plotOf(svg, axes, number) {
    const group = svg.querySelector(`[data-plot="${number}"]`);
    const [left0, top0, wide0, tall0] = axes.box;  // in which it was drawn
    const [left, top, wide, tall] = axes.at || axes.box;
    const plot = { axes, view: { x: WHOLE, y: WHOLE }, moving: movers(group, axes, svg) };
    const own = { x: made("g", group), y: made("g", group) };
    group.prepend(own.x, own.y);  // below the data
    const ticks = {};
    for (const side of ["x", "y"])
      ticks[side] = [...group.querySelectorAll(`[data-axis="${side}"] > [data-tick]`)];
    const place = {
      x: (old) => left + (wide * ((old - left0) / wide0 - plot.view.x[0])) / span(plot.view.x),
      y: (old) => top + (tall * ((old - top0) / tall0 - plot.view.y[0])) / span(plot.view.y),
    };

    function axis(side) {
      const axis = axes[side], view = plot.view[side];
      const whole = view[0] === 0 && view[1] === 1 && !axes.at;
      let free = -Infinity;  // where in a narrow window the next word has room
      own[side].replaceChildren();
      for (const tick of ticks[side]) {
        const use = tick.querySelector("use"), text = tick.querySelector("text");
        tick.removeAttribute("transform");
        tick.style.display = whole || axis.words ? "" : "none";
        if (whole || !axis.words || !(use || text)) continue;
        // Without a mark where the middle of the word is.
        const old = use ? +use.getAttribute(side) : +text.getAttribute(side) - (side === "y" ? 3 : 0);
        const now = place[side](old);
        const low = side === "x" ? left : top, size = side === "x" ? wide : tall;
        if (now < low - 1 || now > low + size + 1) tick.style.display = "none";
        const moved = side === "x" ? `${now - old} ${top + tall - top0 - tall0}`
          : `${left - left0} ${now - old}`;
        tick.setAttribute("transform", `translate(${moved})`);
        if (!axes.at || side === "y" || !text || tick.style.display) continue;
        text.removeAttribute("transform");
        for (const [key, v] of [["x", old], ["y", top0 + tall0 + 14]]) text.setAttribute(key, v);
        text.style.textAnchor = axis.turned ? "end" : "middle";
        if (axis.turned) text.setAttribute("transform", `rotate(-40 ${old} ${top0 + tall0 + 14})`);
        if (axis.turned) continue;
        const half = text.getComputedTextLength() / 2;
        if (now - half < free) text.style.display = "none";
        else free = now + half + 4;
      }
      if (whole || axis.words) return;
      const shares = side === "x" ? view : [1 - view[1], 1 - view[0]];
      const [low, high] = shares.map((share) => value(axis, share)).sort((a, b) => a - b);
      const about = side === "x" ? Math.max(wide / 70, 2) : Math.max(tall / 30, axes.at ? 3 : 2);
      const found = axis.log ? decades(low, high) : round(low, high, about);
      for (const [v, text] of found) drawTick(side, axis, shareOf(axis, v), text);
    }

    function drawTick(side, axis, share, text) {
      const at = side === "x" ? place.x(left0 + share * wide0) : place.y(top0 + (1 - share) * tall0);
      const ends = side === "x" ? { x1: at, x2: at, y1: top, y2: top + tall }
        : { x1: left, x2: left + wide, y1: at, y2: at };
      if (axis.grid) made("line", own[side], { ...ends, class: "grid" });
      if (!axis.shown) return;
      const spot = side === "x" ? { x: at, y: top + tall + 12, "text-anchor": "middle" }
        : { x: left - 6, y: at + 3, "text-anchor": "end" };
      made("text", own[side], { ...spot, class: "tick" }).textContent = text;
    }

    plot.draw = () => {
      for (const move of plot.moving) move(place.x, place.y);
      axis("x");
      axis("y");
      plot.drawMarked();
    };
    plot.holds = ({ x, y }) => x >= left && x <= left + wide && y >= top && y <= top + tall;
    plot.shares = ({ x, y }) => ({
      x: plot.view.x[0] + span(plot.view.x) * Math.min(Math.max((x - left) / wide, 0), 1),
      y: plot.view.y[0] + span(plot.view.y) * Math.min(Math.max((y - top) / tall, 0), 1),
    });
    // One time in all plots: a line, and what an alert is about, shaded.
    const cursor = made("line", svg, { class: "cursor", y1: top, y2: top + tall });
    const alarm = made("rect", svg, { class: "alarm", y: top, height: tall });
    plot.point = (share) => {
      const x = share === null ? -1 : (share - plot.view.x[0]) / span(plot.view.x);
      cursor.style.display = x >= 0 && x <= 1 ? "" : "none";
      for (const end of ["x1", "x2"]) cursor.setAttribute(end, left + x * wide);
    };
    plot.point(null);
    plot.marked = null;
    plot.drawMarked = () => {
      const [a, b] = (plot.marked || [-9, -9]).map((share) =>
        Math.min(Math.max((share - plot.view.x[0]) / span(plot.view.x), -0.1), 1.1));
      const [from, to] = [a, b].map((share) => Math.min(Math.max(share, 0), 1));
      alarm.style.display = b < 0 || a > 1 ? "none" : "";
      alarm.setAttribute("x", left + from * wide - 1);
      alarm.setAttribute("width", (to - from) * wide + 2);
    };
    plot.drawMarked();
    plot.reading = (at) => {
      const shares = plot.shares(at);
      const sides = [["x", shares.x], ["y", 1 - shares.y]].filter(([side]) => !axes[side].words);
      return sides.map(([side, share]) => {
        const axis = axes[side], shown = axis.label.replace(/\s*\[.*\]/, "");
        const unit = (axis.label.match(/\[(.*)\]/) || ["", ""])[1];
        return `${shown} ${+value(axis, share).toPrecision(5)} ${unit}`.trim();
      }).join(", ");
    };
    return plot;
  }

  const span = (view) => view[1] - view[0];

  function start(figure) {
    const svg = figure.querySelector("svg");
    const all = JSON.parse(figure.dataset.axes);
    for (const axes of all)  // of panels over one another only the lowest names x
      axes.x.label ||= (all.find((t) => t.share === axes.share && t.x.label) || axes).x.label;
    const plots = all.map((axes, k) => plotOf(svg, axes, k));
    const readout = figure.querySelector(".readout");
    let grip = null, looked = plots[0], waiting = new Set();

    function show(plot, side, view) {
      let [a, b] = view;
      if (b - a < LEAST) b = a + LEAST;
      const kept = [Math.max(a, 0), Math.min(b, 1)];
      const shown = span(kept) > 0 ? kept : WHOLE;
      for (const one of plots)
        if (one === plot || (side === "x" && one.axes.share === plot.axes.share)) {
          one.view[side] = shown;
          waiting.add(one);
        }
      requestAnimationFrame(draw);
    }
    if (all[0].at) for (const plot of plots) plot.draw();
    // Plots over the time of one log: seconds from its first row, in shares of the axis and back.
    const clock = figure.dataset.clock, x0 = plots[0].axes.x;
    const unit = clock && SECONDS[(x0.label.match(/\btime \[(\w+)\]/) || [])[1]];
    const timed = unit ? plots.filter((plot) => plot.axes.share === plots[0].axes.share) : [];
    function point(plot, share) {
      for (const one of plots) one.point(plot && one.axes.share === plot.axes.share ? share : null);
      const at = timed.includes(plot) ? unit * value(x0, share) : null;
      if (unit) tell("cellwise-point", { clock, at, from: figure });
    }
    if (unit) {
      document.addEventListener("cellwise-point", ({ detail }) => {
        if (detail.clock !== clock || detail.from === figure) return;
        for (const one of timed) one.point(detail.at === null ? null : shareOf(x0, detail.at / unit));
      });
      document.addEventListener("cellwise-look", ({ detail }) => {
        if (detail.clock !== clock) return;
        const [from, to] = [detail.from, detail.to].map((at) => shareOf(x0, at / unit));
        for (const one of timed) one.marked = [from, to];
        const room = Math.max(2 * (to - from), 0.01);
        show(plots[0], "x", [from - room, to + room]);
      });
    }
    function draw() {
      waiting.forEach((plot) => plot.draw());
      waiting = new Set();
      figure.dataset.views = JSON.stringify(plots.map((plot) => plot.view));
    }
    const about = (view, factor, middle) =>
      [middle - (middle - view[0]) * factor, middle + (view[1] - middle) * factor];
    const whole = (plot) => ["x", "y"].forEach((side) => show(plot, side, WHOLE));
    const pan = (plot, by) => {
      const [a, b] = plot.view.x, from = Math.min(Math.max(a + by * (b - a), 0), 1 - (b - a));
      show(plot, "x", [from, from + (b - a)]);
    };
    const where = (event) =>
      new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const under = (at) => plots.find((plot) => plot.holds(at));

    svg.addEventListener("wheel", (event) => {
      const at = where(event), plot = under(at);
      if (!plot || !(event.ctrlKey || document.activeElement === svg)) return;
      event.preventDefault();
      const side = event.shiftKey ? "y" : "x", turned = event.deltaY || event.deltaX;
      show(plot, side, about(plot.view[side], turned > 0 ? 1.25 : 0.8, plot.shares(at)[side]));
    }, { passive: false });
    svg.addEventListener("pointerdown", (event) => {
      const at = where(event), plot = under(at);
      if (!plot || event.button) return;
      looked = plot;
      grip = { plot, at, box: made("rect", svg, { class: "grip" }) };
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      const at = where(event), plot = grip ? grip.plot : under(at);
      readout.textContent = plot ? plot.reading(at) : "";
      point(plot, plot ? plot.shares(at).x : null);
      if (!grip) return;
      const [x, y, wide, tall] = drawnBox(grip, at);
      for (const [key, v] of Object.entries({ x, y, width: wide, height: tall }))
        grip.box.setAttribute(key, v);
    });
    svg.addEventListener("pointerup", (event) => {
      if (!grip) return;
      const { plot, at, box } = grip, end = where(event), [from, to] = [at, end].map(plot.shares);
      const size = { x: Math.abs(at.x - end.x), y: Math.abs(at.y - end.y) };
      box.remove();
      grip = null;
      for (const side of ["x", "y"])
        if (size[side] > CLICK) show(plot, side, [from[side], to[side]].sort((a, b) => a - b));
    });
    svg.addEventListener("pointercancel", () => { if (grip) grip.box.remove(); grip = null; });
    svg.addEventListener("pointerleave", () => { readout.textContent = ""; point(undefined, null); });
    svg.addEventListener("dblclick", (event) => { const p = under(where(event)); if (p) whole(p); });
    svg.addEventListener("keydown", (event) => {
      const zoom = (factor) =>
        show(looked, "x", about(looked.view.x, factor, (looked.view.x[0] + looked.view.x[1]) / 2));
      const does = { "+": () => zoom(0.5), "-": () => zoom(2), ArrowLeft: () => pan(looked, -0.25),
        ArrowRight: () => pan(looked, 0.25), Escape: () => plots.forEach(whole) }[event.key];
      if (does) { event.preventDefault(); does(); }
    });
  }

  const tell = (name, detail) => document.dispatchEvent(new CustomEvent(name, { detail }));

  // A link of an alert: every plot of its log shows the time it names, marked.
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a.jump");
    if (!link) return;
    const { clock, from, to } = link.dataset;
    const shown = [...document.querySelectorAll("[data-clock]")].find(
      (element) => element !== link && !element.matches("a") && element.dataset.clock === clock);
    if (!shown) return;  // as a plain link
    event.preventDefault();
    tell("cellwise-look", { clock, from: +from, to: +to });
    shown.scrollIntoView({ block: "start" });
  });

  // A drag that is nearly level is of x alone, one nearly upright of y alone.
  function drawnBox({ plot, at }, end) {
    const [left, top, wide, tall] = plot.axes.box;
    const level = Math.abs(at.y - end.y) <= CLICK, upright = Math.abs(at.x - end.x) <= CLICK;
    return [upright ? left : Math.min(at.x, end.x), level ? top : Math.min(at.y, end.y),
      upright ? wide : Math.abs(at.x - end.x), level ? tall : Math.abs(at.y - end.y)];
  }

  // A narrow window has the same picture, laid out for it.
  const narrow = matchMedia("(max-width: 700px)");
  for (const figure of document.querySelectorAll("figure[data-axes]")) {
    const wide = figure.querySelector("svg"), axes = figure.dataset.axes, fresh = wide.cloneNode(true);
    let begun = false;
    const begin = () => { if (!begun) { begun = true; start(figure); } };
    const dress = (svg) => {
      svg.setAttribute("tabindex", "0");
      for (const kind of ["pointerenter", "focus"]) svg.addEventListener(kind, begin);
      begun = false;
    };
    const fit = () => {
      figure.classList.toggle("fit", narrow.matches);
      const room = Math.max(document.documentElement.clientWidth - BESIDE, NARROWEST);
      const [svg, told] = narrow.matches ? narrowed(fresh, JSON.parse(axes), room)
        : [fresh.cloneNode(true), JSON.parse(axes)];
      figure.querySelector("svg").replaceWith(svg);
      figure.dataset.axes = JSON.stringify(told);
      dress(svg);
      if (narrow.matches) begin();
    };
    narrow.addEventListener("change", fit);
    if (narrow.matches) fit();
    else dress(wide);
    // The first event of another plot of the same log begins this one, which then hears it, too.
    if (figure.dataset.clock)
      for (const kind of ["cellwise-point", "cellwise-look"])
        document.addEventListener(kind, ({ detail }) => {
          if (begun || detail.clock !== figure.dataset.clock) return;
          begin();
          tell(kind, detail);
        });
  }
  document.documentElement.dataset.pictures = "ready";
})();
