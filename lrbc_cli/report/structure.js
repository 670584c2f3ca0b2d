"use strict";
(() => {
  // Turns the picture of the structure: the same lines, dots and symbols as in the still one, which stays where scripts do not run.
  const make = (name, attributes, parent, text) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    if (parent) parent.append(element);
    return element;
  };
  const RULER = 28, FONT = 12, LEAST = 8.2;

  const start = (holder, order) => {
    const scene = JSON.parse(holder.querySelector("script").textContent);
    const stage = holder.querySelector(".stage"), bars = [...holder.querySelectorAll(".controls")], told = holder.querySelector(".told");
    const control = (name) => holder.querySelector(`.controls [name=${name}]`);
    const svg = make("svg", { "aria-hidden": "true" });
    let [azimuth, elevation] = scene.camera, zoom = 1, names = true, waiting = false, placed = "", picked = null;

    const airBox = control("air");
    let air = !airBox || airBox.checked;

    const place = (k) => scene.nodes.slice(3 * k, 3 * k + 3);
    const mesh = scene.ends.length ? [["mesh", scene.ends.flatMap(place)]] : [];
    const paths = [...scene.dots.map((d) => [...d, true]), ...mesh, ...scene.lines].map(([role, xyz, dots]) => {
      const attributes = { class: `l r-${role}${dots ? " dots" : ""}`, "stroke-width": dots ? (role === "term-dot" ? 5 : 2.2) : role === "mesh" ? 0.7 : role === "term" ? 3.5 : 1.4 };
      return { role, xyz, dots, path: make("path", attributes, svg) };
    });
    const frame = make("path", { class: "l r-box" }, svg);
    const rulers = scene.rulers.map(([ends, label, ticks]) => ({
      ends, words: [...ticks, [null, label]].map(([at, text]) => ({ at, text, element: make("text", { class: "t r-text", "text-anchor": "middle" }, svg, text) })),
    }));
    const marks = scene.marks.map(([name, at, glyph, title, still]) => {
      const group = make("g", {}, svg);
      return { name, xyz: at, still, group, title: make("title", {}, group, title), glyph: make("g", {}, group), own: glyph, label: null, first: false };
    });
    const leaders = make("path", { class: "l r-box", "stroke-width": 1 });
    if (marks.length) marks[0].group.before(leaders);
    const sensed = ["measured-way", "measured-point dots", "modelled-point"].map((role) => make("path", { class: `l r-${role}`, "stroke-width": role.endsWith("dots") ? 6 : 1.3, fill: "none" }, svg));
    for (const mark of marks) mark.label = make("text", { class: "t r-strong label", "font-size": FONT }, svg, mark.name);

    // A deflection shape moves every point as its nearest node; microphones stay.
    const nearest = (xyz, i) => {
      let best = -1, least = Infinity;
      for (let k = 0; k < scene.nodes.length; k += 3) {
        const d = (scene.nodes[k] - xyz[i]) ** 2 + (scene.nodes[k + 1] - xyz[i + 1]) ** 2 + (scene.nodes[k + 2] - xyz[i + 2]) ** 2;
        if (d < least) [best, least] = [k, d];
      }
      return best;
    };
    const follow = (item) => (item.near ||= Array.from({ length: item.xyz.length / 3 }, (_, i) => nearest(item.xyz, 3 * i)));
    const bytes = (text) => new Int8Array([...atob(text)].map((c) => c.charCodeAt(0)));
    let shape = null, phase = 0, size = 1, moving = 0, wanted = false, seen = true, last = 0;
    const bent = (item, still) => {
      if (!shape || still) return item.xyz;
      const near = follow(item), c = (size * scene.deflection * Math.cos(phase)) / 127, s = (size * scene.deflection * Math.sin(phase)) / 127;
      return item.xyz.map((value, i) => value + c * shape.real[near[(i / 3) | 0] + (i % 3)] - s * shape.imag[near[(i / 3) | 0] + (i % 3)]);
    };
    // Two seconds a period, as long as the picture is in sight.
    const step = (now) => {
      phase = (phase + (Math.max(0, now - last) / 2000) * 2 * Math.PI) % (2 * Math.PI);
      last = now;
      draw();
      moving = requestAnimationFrame(step);
    };
    const go = () => {
      cancelAnimationFrame(moving);
      last = performance.now();
      moving = wanted && seen ? requestAnimationFrame(step) : 0;
    };
    const player = holder.querySelector("[data-do=play]");
    const calm = matchMedia("(prefers-reduced-motion: reduce)");
    const play = (on) => {
      if (!player) return;
      wanted = on;
      player.textContent = calm.matches ? "Step" : "Animate";
      if (calm.matches) player.removeAttribute("aria-pressed");
      else player.setAttribute("aria-pressed", String(on));
      go();
    };
    const deform = (own) => {
      play(false);
      [shape, phase] = [own ? { real: bytes(own[1]), imag: bytes(own[2]), points: own[3] } : null, 0];
      for (const part of holder.querySelectorAll(".moves")) part.hidden = !own;
      // What is drawn in its plane deflects towards the viewer.
      if (own && azimuth === scene.camera[0] && elevation === scene.camera[1] && [0, 90].includes(elevation)) [azimuth, elevation] = [-60, 25];
    };

    // Symbols of bolts are those of the chosen job; bolts stand last.
    const choose = (index) => {
      const job = scene.jobs[index], offset = marks.length - scene.bolts;
      marks.forEach((mark, i) => {
        const [glyph, title] = job && i >= offset ? job.bolts[i - offset] : [mark.own, mark.title.textContent];
        mark.glyph.innerHTML = scene.glyphs[glyph];
        mark.title.textContent = title;
        mark.letters = [...mark.glyph.querySelectorAll("text")].map((text) => [text, ...["font-size", "y"].map((key) => Number(text.getAttribute(key)))]);
        mark.grown = 0;
        mark.first = scene.glyphs[glyph].includes("loose-on");
      });
      if (job && told) told.textContent = job.text;
      const chooser = control("shape");
      if (!chooser) return;
      chooser.replaceChildren(chooser.options[0], ...job.shapes.map(([label], i) => new Option(label, i)));
      chooser.value = "";
      chooser.disabled = !job.shapes.length;
      deform(null);
    };

    const draw = () => {
      waiting = false;
      const width = Math.max(stage.clientWidth, 200);
      const [ca, sa, ce, se] = [azimuth, elevation].flatMap((angle) => [Math.cos, Math.sin].map((f) => f((angle * Math.PI) / 180)));
      const right = [-sa, ca, 0], up = [-se * ca, -se * sa, ce];
      const dot = (v, xyz, i) => v[0] * xyz[i] + v[1] * xyz[i + 1] + v[2] * xyz[i + 2];
      const bounds = [1e9, -1e9, 1e9, -1e9];
      const grow = (xyz, i) => {
        const x = dot(right, xyz, i), y = dot(up, xyz, i);
        bounds[0] = Math.min(bounds[0], x); bounds[1] = Math.max(bounds[1], x);
        bounds[2] = Math.min(bounds[2], y); bounds[3] = Math.max(bounds[3], y);
      };
      for (let k = 0; k < 8; k++) grow([0, 1, 2].map((i) => (k & (1 << i) ? scene.high : scene.low)[i]), 0);
      const wide = Math.max(bounds[1] - bounds[0], 1), high = Math.max(bounds[3] - bounds[2], 1);
      const space = width - 2 * RULER - 30;
      // The height is that of the first view: what stands below the picture must not move while it turns.
      if (!draw.height) draw.height = Math.round(Math.min(Math.max((space * high) / wide + 2 * RULER + 20, 190), Math.max(0.72 * width, 300), 520));
      const height = draw.height, scale = zoom * Math.min(space / wide, (height - 2 * RULER - 20) / high);
      // Nearer, the structure is in the middle, however far microphones stand from it.
      const near = Math.min(1, Math.max(0, zoom - 1));
      const [cx, cy] = [[right, 0], [up, 2]].map(([axis, k]) => ((1 - near) * (bounds[k] + bounds[k + 1])) / 2 + near * dot(axis, scene.middle, 0));
      const px = (xyz, i) => width / 2 + (dot(right, xyz, i) - cx) * scale, py = (xyz, i) => height / 2 - (dot(up, xyz, i) - cy) * scale;
      svg.setAttribute("viewBox", `0 0 ${width} ${height}`);

      for (const item of paths) {
        const { role, dots, path } = item, parts = [], xyz = bent(item, role === "air");
        for (let i = 0; i < (role === "air" && !air ? 0 : xyz.length); i += dots ? 3 : 6) {
          parts.push("M", px(xyz, i).toFixed(1), " ", py(xyz, i).toFixed(1));
          if (dots) parts.push("h0");
          else parts.push("L", px(xyz, i + 3).toFixed(1), " ", py(xyz, i + 3).toFixed(1));
        }
        path.setAttribute("d", parts.join(""));
        if (role.startsWith("mesh")) path.classList.toggle(role.replace("mesh", "r-shape"), Boolean(shape));
      }

      const drawn = ["", "", ""];
      for (const [x, y, z, u, v, w, ...values] of shape ? shape.points : []) {
        const [measured, model] = [0, 2].map((i) => {
          const far = size * scene.deflection * (values[i] * Math.cos(phase) - values[i + 1] * Math.sin(phase));
          const tip = [x + far * u, y + far * v, z + far * w];
          return [px(tip, 0).toFixed(1), py(tip, 0).toFixed(1)];
        });
        drawn[0] += `M${px([x, y, z], 0).toFixed(1)} ${py([x, y, z], 0).toFixed(1)}L${measured.join(" ")}`;
        drawn[1] += `M${measured.join(" ")}h0`;
        drawn[2] += `M${model.join(" ")}m-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0`;
      }
      sensed.forEach((path, i) => path.setAttribute("d", drawn[i]));

      const strokes = [], words = [], edges = [];
      for (const { ends, words: own } of rulers) {
        const a = [px(ends, 0), py(ends, 0)], b = [px(ends, 3), py(ends, 3)];
        const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
        strokes.push(`M${a}L${b}`);
        for (let t = 0; t < 1; t += 6 / Math.max(length, 6)) edges.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
        let out = length > 1 ? [(b[1] - a[1]) / length, (a[0] - b[0]) / length] : [0, 1];
        const middle = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
        if (out[0] * (middle[0] - width / 2) + out[1] * (middle[1] - height / 2) < 0) out = out.map((v) => -v);
        for (const { at, text, element } of own) {
          // The label of a ruler that stands upright stands above it, where the page is narrow too.
          const upright = !at && Math.abs(out[0]) > 0.7;
          const [x, y] = at ? [px(at, 0), py(at, 0)] : upright ? [b[0] + (14 * (b[0] - a[0])) / length, b[1] + (14 * (b[1] - a[1])) / length] : middle;
          const far = upright ? 8 : (at ? 12 : RULER) + (0.28 * FONT * text.length - 2) * Math.abs(out[0]);
          if (at) strokes.push(`M${x} ${y}l${out[0] * 4} ${out[1] * 4}`);
          const [left, base] = [x + out[0] * far, y + out[1] * far + 4], broad = 0.28 * FONT * text.length;
          element.setAttribute("x", left);
          element.setAttribute("y", base);
          element.setAttribute("font-size", FONT - 1);
          element.style.display = "none";
          // Labels before ticks.
          if (length >= 40) words[at ? "push" : "unshift"]({ element, box: [left - broad, left + broad, base - 9, base + 1] });
        }
      }
      frame.setAttribute("d", strokes.join(""));

      // Names where there is room: first those of loose bolts.
      const at = marks.map((mark) => {
        const xyz = bent(mark, mark.still);
        return (mark.seen = [px(xyz, 0), py(xyz, 0)]);
      });
      const bolts = at.slice(marks.length - scene.bolts);
      const apart = bolts.slice(1).map(([x, y], i) => Math.hypot(x - bolts[i][0], y - bolts[i][1])).filter((d) => d > 1);
      // Symbols shrink where bolts stand close to one another.
      const grown = Math.min(1, Math.max(0.6, Math.min(...apart, 24) / 19)), half = 8 * grown;
      // While it moves, names keep their places.
      const view = [azimuth, elevation, zoom, width, names, marks.indexOf(picked)].join(), steady = moving && view === placed;
      placed = view;
      const taken = steady ? [] : [...at.map(([x, y]) => [x - half, x + half, y - half, y + half]), ...edges.map(([x, y]) => [x - 1, x + 1, y - 1, y + 1])];
      const named = [], hit = (box, by) => by.some((t) => box[0] < t[1] && t[0] < box[1] && box[2] < t[3] && t[2] < box[3]);
      for (const { xyz } of shape || steady ? [] : paths.filter(({ role }) => role === "term")) {
        for (let i = 0; i < xyz.length; i += 6) {
          const [x, y, dx, dy] = [px(xyz, i), py(xyz, i), px(xyz, i + 3) - px(xyz, i), py(xyz, i + 3) - py(xyz, i)];
          for (let k = 0; k < 8; k++) taken.push([x + (k * dx) / 8 - 2, x + (k * dx) / 8 + 2, y + (k * dy) / 8 - 2, y + (k * dy) / 8 + 2]);
        }
      }
      const lines = [], important = (mark) => mark.first || mark === picked;
      const name = (mark) => {
        const [x, y] = mark.seen, long = (mark.long ||= mark.label.getComputedTextLength()) || 0.6 * FONT * mark.name.length;
        mark.group.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)}) scale(${(0.125 * grown).toFixed(4)})`);
        // Symbols shrink, but letters on them stay legible.
        for (const [text, high, base] of mark.grown === grown ? [] : mark.letters) {
          const by = Math.max(1, LEAST / (0.125 * grown * high));
          text.setAttribute("font-size", high * by);
          text.setAttribute("y", base * by);
        }
        mark.grown = grown;
        const close = [[15 * grown, 4, "start"], [-15 * grown, 4, "end"], [0, 20, "middle"], [0, -12, "middle"]];
        // Those of loose bolts may stand farther away, at the end of a line.
        const far = mark.first ? [-1, 1, -1.6, 1.6, -2.2, 2.2].flatMap((v) => [-1, 1].map((h) => [34 * h, 26 * v + 4, h < 0 ? "end" : "start"])) : [];
        const among = (by) => [...close, ...far].find(([dx, dy, anchor]) => {
          const left = x + dx - { start: 0, middle: 0.5, end: 1 }[anchor] * long, box = [left, left + long, y + dy - 10, y + dy + 2];
          if (box[0] < 0 || box[1] > width || box[2] < 0 || box[3] > height || hit(box, by)) return false;
          taken.push(box);
          named.push(box);
          return true;
        });
        // Those of loose bolts, and the one that is asked for, rather stand on symbols than nowhere.
        const found = steady ? mark.place : (names || mark === picked) && (among(taken) || (important(mark) && among(named)));
        mark.place = found;
        mark.label.style.display = found ? "" : "none";
        if (!found) return;
        if (Math.abs(found[0]) > 20) lines.push(`M${x} ${y}L${x + 0.94 * found[0]} ${y + found[1] - 4}`);
        for (const [key, value] of Object.entries({ x: x + found[0], y: y + found[1], "text-anchor": found[2] })) mark.label.setAttribute(key, value);
      };
      if (picked) name(picked);
      for (const mark of marks) if (mark.first && mark !== picked) name(mark);
      for (const word of words) {
        const free = steady ? word.element.free : !hit(word.box, taken);
        word.element.free = free;
        if (free) taken.push(word.box), named.push(word.box);
        word.element.style.display = free ? "" : "none";
      }
      for (const mark of marks) if (!important(mark)) name(mark);
      leaders.setAttribute("d", lines.join(""));
    };
    const later = () => {
      if (!waiting) requestAnimationFrame(draw);
      waiting = true;
    };
    const act = {
      ArrowLeft: () => (azimuth += 5), ArrowRight: () => (azimuth -= 5),
      ArrowUp: () => (elevation = Math.min(90, elevation + 5)), ArrowDown: () => (elevation = Math.max(-90, elevation - 5)),
      "+": () => (zoom = Math.min(8, zoom * 1.25)), "-": () => (zoom = Math.max(0.5, zoom / 1.25)),
      n: () => (picked = marks[(marks.indexOf(picked) + 1) % marks.length]),
      0: () => ([azimuth, elevation, zoom] = [...scene.camera, 1]),
    };
    stage.addEventListener("keydown", (event) => {
      if (!act[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act[event.key]();
      later();
    });
    // The name of the symbol that is tapped or pointed at.
    const ask = (event) => {
      const box = svg.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
      const far = (mark) => Math.hypot(mark.seen[0] - x, mark.seen[1] - y);
      const [first] = [...marks].sort((a, b) => far(a) - far(b));
      const now = first && far(first) < 16 ? first : null;
      if (now !== picked) (picked = now), later();
    };
    let held = null, down = null;
    stage.addEventListener("pointerdown", (event) => {
      held = down = [event.clientX, event.clientY];
      stage.setPointerCapture(event.pointerId);
    });
    stage.addEventListener("pointermove", (event) => {
      if (!held) return ask(event);
      azimuth -= 0.5 * (event.clientX - held[0]);
      elevation = Math.max(-90, Math.min(90, elevation + 0.5 * (event.clientY - held[1])));
      held = [event.clientX, event.clientY];
      later();
    });
    for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, () => (held = null));
    stage.addEventListener("pointerup", (event) => down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 4 && ask(event));
    act.play = () => {
      // Where motion is not wanted, step by step.
      if (calm.matches) phase += Math.PI / 4;
      else play(!wanted);
    };
    holder.addEventListener("click", (event) => {
      const does = event.target.dataset && act[event.target.dataset.do];
      if (does) does(), later();
    });
    holder.addEventListener("input", (event) => {
      if (event.target.name === "size") (size = Number(event.target.value)), later();
    });
    holder.addEventListener("change", (event) => {
      if (event.target.name === "shape") deform(shapeOf(event.target.value));
      if (event.target.name === "shown") choose(Number(event.target.value));
      if (event.target.name === "names") names = event.target.checked;
      if (event.target.name === "air") air = event.target.checked;
      later();
    });
    const select = control("shown"), chooser = control("shape");
    const shapeOf = (value) => value && scene.jobs[select ? Number(select.value) : scene.first].shapes[value];
    choose(select ? Number(select.value) : scene.first);

    // A page that loads itself anew stays as its reader left it; storage may be switched off.
    const kept = `structure ${order} ${location.pathname}`, label = (list) => (list && list.selectedOptions.length ? list.selectedOptions[0].text : "");
    let touched = false;
    const recalled = () => {
      try {
        return JSON.parse(sessionStorage.getItem(kept));
      } catch {
        return null;
      }
    };
    const pick = (list, text) => {
      const found = list && [...list.options].find((option) => option.text === text);
      if (found) list.value = found.value;
      return found;
    };
    const before = recalled();
    if (before) {
      touched = true;
      if (pick(select, before.job)) choose(Number(select.value));
      if (before.shape && pick(chooser, before.shape)) deform(shapeOf(chooser.value)), play(before.playing);
      ({ view: [azimuth, elevation, zoom], phase, size, names, air } = before);
      for (const [name, value] of Object.entries({ names, air })) if (control(name)) control(name).checked = value;
      if (control("size")) control("size").value = size;
    }
    for (const event of ["pointerdown", "keydown", "change"]) holder.addEventListener(event, () => (touched = true));
    addEventListener("pagehide", () => {
      const now = { job: label(select), shape: chooser && chooser.value ? label(chooser) : "", playing: wanted, view: [azimuth, elevation, zoom], phase, size, names, air };
      try {
        if (touched) sessionStorage.setItem(kept, JSON.stringify(now));
      } catch {
        // The next page begins as the first did.
      }
    });

    for (const bar of bars) bar.hidden = false;
    stage.querySelector(".still").replaceWith(svg);
    holder.classList.add("turns");
    const resized = () => {
      draw.height = 0;
      const before = [azimuth, elevation, zoom];
      act[0]();
      draw();
      [azimuth, elevation, zoom] = before;
      later();
    };
    // In a frame of its own: drawing sets the height that is observed.
    new IntersectionObserver((entries) => ((seen = entries.at(-1).isIntersecting), go())).observe(stage);
    new ResizeObserver(() => requestAnimationFrame(resized)).observe(stage);
  };
  document.querySelectorAll(".turnable").forEach(start);
})();
