// A picture for a narrow window: its axes one below the other, as wide as the window, with text of a size that
// can be read there. Titles, names of axes and keys are set anew; the data move as they do when one zooms.
"use strict";
const narrowed = (() => {
  const NAMES = "http://www.w3.org/2000/svg";
  // Sizes of text, height of its lines, room at the sides, for marks of a key, for colours [px]; heights of axes.
  const TEXT = 11, TITLE = 12.5, LINE = 16, SIDE = 8, MARK = 21, BAR = 56, NOTE = 46;
  const LEAST = 90, MOST = 260, SHARE = 0.85, MANY = 16, SINE = 0.643;  // of 40 degrees
  const FONT = '"DejaVu Sans", Verdana, sans-serif';
  const ruler = document.createElement("canvas").getContext("2d");
  const widthOf = (text, size = TEXT, weight = 400) => {
    ruler.font = `${weight} ${size}px ${FONT}`;
    return ruler.measureText(text).width;
  };

  function made(name, into, settings) {
    const element = document.createElementNS(NAMES, name);
    for (const [key, value] of Object.entries(settings)) element.setAttribute(key, value);
    into.append(element);
    return element;
  }

  // Where a text stands in the wide picture.
  function spot(text) {
    const moved = /translate\(([-\d.]+)[ ,]+([-\d.]+)\)/.exec(text.getAttribute("transform") || "");
    return moved ? [+moved[1], +moved[2]] : [+text.getAttribute("x"), +text.getAttribute("y")];
  }

  function wrapped(text, room, size, weight) {
    const lines = [""];
    for (const word of text.split(/\s+/)) {
      const longer = `${lines.at(-1)} ${word}`.trim();
      if (lines.at(-1) && widthOf(longer, size, weight) > room) lines.push(word);
      else lines[lines.length - 1] = longer;
    }
    return lines.filter((line) => line);
  }

  // What a key names: its marks and their text, in the order in which they are drawn.
  function named(legend) {
    const found = [];
    let marks = [];
    for (const part of [...legend.children].slice(1)) {
      const text = part.querySelector("text");
      if (!text) { marks.push(part); continue; }
      found.push({ marks, text });
      marks = [];
    }
    return found;
  }

  function page(svg, width) {
    const into = made("g", svg, { class: "set" });
    let top = 2;
    return {
      into,
      get top() { return top; },
      skip: (height) => { top += height; },
      title(text, size = TITLE) {
        for (const line of wrapped(text, width - 4, size, 700)) {
          top += LINE;
          made("text", into, { x: 0, y: top - 3, class: "title", "font-size": size }).textContent = line;
        }
      },
      // The name of the y axis and the keys, as many in a line as there is room for.
      key(label, legends) {
        const items = legends.flatMap(named);
        if (!label && !items.length) return;
        let x = 0, started = false;
        top += LINE;
        const next = (needs) => {
          if (started && x + needs > width) { top += LINE; x = 0; }
          started = true;
        };
        if (label) {
          next(widthOf(label));
          made("text", into, { x, y: top - 4, class: "name" }).textContent = label;
          x += widthOf(label) + 12;
        }
        for (const { marks, text } of items) {
          const [left, base] = spot(text), needs = MARK + widthOf(text.textContent) + 10;
          next(needs);
          const group = made("g", into, { transform: `translate(${x + MARK - 3 - left} ${top - 4 - base})` });
          group.append(...marks);
          made("text", into, { x: x + MARK, y: top - 4, class: "key" }).textContent = text.textContent;
          x += needs;
        }
      },
      below(text) {
        top += LINE;
        made("text", into, { x: width / 2, y: top - 4, class: "name", "text-anchor": "middle" }).textContent = text;
      },
    };
  }

  // Room for the numbers or words at the left of an axes.
  function leftOf(group) {
    const words = [...group.querySelectorAll('[data-axis="y"] [data-tick] text')];
    return SIDE + Math.max(24, ...words.map((text) => widthOf(text.textContent)));
  }

  function place(svg, group, axes, at) {
    axes.at = at;
    const [left, top, wide, tall] = at, x = [left, left + wide], y = [top, top + tall];
    const ids = [...group.querySelectorAll("[clip-path]")].map((e) => e.getAttribute("clip-path"));
    for (const id of new Set(ids)) {
      const rect = svg.querySelector(`${id.slice(4, -1)} rect`);
      if (rect) ["x", "y", "width", "height"].forEach((key, k) => rect.setAttribute(key, at[k]));
    }
    const line = (x1, y1, x2, y2) => made("line", group, { x1, y1, x2, y2, class: "frame" });
    line(x[0], y[0], x[0], y[1]);
    line(x[0], y[1], x[1], y[1]);
  }

  // The picture of a wide one, and what the program must know of its axes.
  return (wide, told, width) => {
    const svg = wide.cloneNode(true), all = structuredClone(told);
    const part = (of, name) => [...of.querySelectorAll(`[data-part="${name}"]`)];
    const groups = all.map((_, k) => svg.querySelector(`[data-plot="${k}"]`));
    const set = page(svg, width);
    for (const heading of part(svg, "heading"))
      set.title([...heading.querySelectorAll("text")].map((t) => t.textContent).join(" "), TITLE + 1);
    const whole = part(svg, "legend").filter((legend) => !legend.closest("[data-plot]"));
    all.forEach((axes, k) => {
      const group = groups[k], next = all[k + 1], tall = axes.box[3];
      if (axes.colours) {  // of the axes before it: beside them, as they are
        const [x, y] = /M ([\d.]+) ([\d.]+)/.exec(part(group, "frame")[0].innerHTML).slice(1);
        const [, top, , height] = all[k - 1].at;
        group.setAttribute("transform", `translate(${width - BAR + 10 - x} ${top + height - y})`);
        group.setAttribute("class", "colours");
        set.below(`colours: ${axes.y.label}`);
        return;
      }
      const bar = next && next.colours ? BAR : 0, beside = axes.texts.some(([, , ofX]) => !ofX);
      const besides = bar ? bar + (beside ? NOTE : 0) : SIDE;
      if (k) set.skip(8);
      if (axes.title) set.title(axes.title);
      set.key(axes.y.label, part(group, "legend"));
      set.skip(4);
      const left = Math.min(leftOf(group), 0.5 * width);
      const height = Math.min(Math.max(SHARE * tall, LEAST), MOST);
      place(svg, group, axes, [left, set.top, width - left - besides, height]);
      if (bar) axes.end = width - bar;
      set.skip(height);
      // Axes above others of the same x leave its numbers to the lowest.
      const last = !next || next.share !== axes.share;
      axes.x.shown = last;
      if (!last) return;
      // Words that have no room side by side are turned.
      const words = axes.x.words ? [...group.querySelectorAll('[data-axis="x"] [data-tick] text')] : [];
      const long = words.map((text) => widthOf(text.textContent) + 4);
      axes.x.turned = words.length < MANY && words.length * Math.max(0, ...long) > axes.at[2];
      set.skip(axes.x.turned ? SINE * Math.max(...long) + LINE : LINE);
      const named = axes.x.label || (all.find((t) => t.share === axes.share && t.x.label) || axes).x.label;
      if (named) set.below(named);
    });
    if (whole.length) { set.skip(4); set.key("", whole); }
    // What was set anew, and what lay behind it.
    const old = ["title", "heading", "label", "frame", "legend", "arrow"];
    for (const gone of svg.querySelectorAll(old.map((name) => `[data-part="${name}"]`).join()))
      if (!gone.closest(".colours") || gone.dataset.part === "label") gone.remove();
    for (const path of svg.querySelectorAll("path"))
      if (!path.closest("[data-plot], .set, defs")) path.remove();
    svg.setAttribute("viewBox", `0 0 ${width} ${Math.ceil(set.top + 4)}`);
    return [svg, all];
  };
})();
