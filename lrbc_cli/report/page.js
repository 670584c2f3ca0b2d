"use strict";
(() => {
  const jobs = document.getElementById("jobs");

  // Which FRFs are shown; without scripts all of them are.
  const filter = document.querySelector(".filter");
  if (filter) {
    const apply = () => {
      const want = filter.querySelector("select").value;
      for (const f of jobs.querySelectorAll("figure[data-response]")) f.hidden = want !== "" && f.dataset.response !== want;
      jobs.classList.toggle("no-initial", !filter.querySelector("input").checked);
    };
    filter.hidden = false;
    filter.addEventListener("change", apply);
    apply();
  }

  // Folded parts are printed too, but for long documents.
  const opened = [];
  addEventListener("beforeprint", () => {
    for (const d of document.querySelectorAll("details:not([open]):not(.document)")) { d.open = true; opened.push(d); }
  });
  addEventListener("afterprint", () => { while (opened.length) opened.pop().open = false; });

  for (const button of document.querySelectorAll(".copied button")) {
    button.hidden = false;
    button.addEventListener("click", () => {
      getSelection().selectAllChildren(button.previousElementSibling);
      button.textContent = document.execCommand("copy") ? "Copied" : "Selected: copy it with the keyboard";
    });
  }

  // Values of curves, read back from what is drawn: under the pointer, at a tap, and by arrow keys.
  const box = document.createElement("div");
  box.id = "readout";
  box.setAttribute("role", "status");
  box.hidden = true;
  document.body.append(box);
  const parsed = new WeakMap();
  const points = (path) => {
    if (!parsed.has(path)) {
      const all = [];
      for (const piece of path.getAttribute("d").split("M").slice(1)) {
        const n = (piece.match(/-?\d+/g) || []).map(Number);
        let [x, y] = n;
        all.push([x, y]);
        for (let i = 2; i + 1 < n.length; i += 2) all.push([(x += n[i]), (y += n[i + 1])]);
      }
      parsed.set(path, all);
    }
    return parsed.get(path);
  };
  const range = (panel, key) => panel.dataset[key].split(" ").map(Number);
  // A point of a curve, which is drawn to tenths of points, is that of the nearest line.
  const lineOf = (panel, value) => {
    if (!panel.dataset.steps) return show(value);
    const [first, step] = range(panel, "steps");
    return show(first + step * Math.round((value - first) / step), 7);
  };
  const show = (value, digits = 4) => Number(value.toPrecision(digits)).toString().replace("-", "\u2212");
  const curves = (panel) => [...panel.querySelectorAll("path[data-name]")].filter((p) => getComputedStyle(p).display !== "none");
  let cursor = null;
  const clear = () => {
    box.hidden = true;
    if (cursor) cursor.remove();
    cursor = null;
  };
  // Shows what the curves of a panel are at x; returns where the cursor stands, or null.
  const read = (panel, at) => {
    clear();
    const frame = panel.querySelector(".hit");
    const [left, top, width, height] = ["x", "y", "width", "height"].map((k) => Number(frame.getAttribute(k)));
    const [x0, x1] = range(panel, "x"), [y0, y1] = range(panel, "y");
    const power = panel.dataset.scale === "log";
    const value = (y) => { const v = y0 + ((top + height - y) / height) * (y1 - y0); return power ? (10 ** v).toExponential(2) : show(v, 3); };
    const lines = [];
    let snap = at;
    for (const path of curves(panel)) {
      let best = null;
      for (const p of points(path)) if (!best || Math.abs(p[0] - at) < Math.abs(best[0] - at)) best = p;
      if (best && Math.abs(best[0] - at) < 120) {
        if (!lines.length) snap = best[0];
        if (lines.length < 10) lines.push(`${path.dataset.name}: ${value(best[1])}`);
      }
    }
    if (!lines.length) return null;
    cursor = document.createElementNS("http://www.w3.org/2000/svg", "line");
    for (const [k, v] of Object.entries({ class: "cursor", x1: snap, x2: snap, y1: top, y2: top + height })) cursor.setAttribute(k, v);
    panel.append(cursor);
    box.textContent = `${panel.dataset.xl}: ${lineOf(panel, x0 + ((snap - left) / width) * (x1 - x0))}\n${panel.dataset.yl}\n${lines.join("\n")}`;
    box.hidden = false;
    return snap;
  };
  const place = (x, y) => {
    const over = box.getBoundingClientRect();
    box.style.left = `${Math.max(4, Math.min(x + 16, innerWidth - over.width - 8))}px`;
    box.style.top = `${Math.max(4, y + 16 + over.height > innerHeight ? y - over.height - 16 : y + 16)}px`;
  };
  const pointed = (event) => {
    const panel = event.target.closest ? event.target.closest("g.panel") : null;
    if (!panel) return clear();
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(panel.ownerSVGElement.getScreenCTM().inverse());
    // Cells and bars have no curves: their own words.
    const title = event.target.querySelector ? event.target.querySelector(":scope > title") : null;
    if (read(panel, at.x) === null && title && event.type === "pointerdown") {
      box.textContent = title.textContent;
      box.hidden = false;
    }
    if (!box.hidden) place(event.clientX, event.clientY);
  };
  document.addEventListener("pointermove", (event) => { if (event.pointerType === "mouse") pointed(event); });
  document.addEventListener("pointerdown", pointed);
  document.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse") clear(); });

  const steps = new WeakMap();
  document.addEventListener("keydown", (event) => {
    const plot = event.target.closest ? event.target.closest(".plot") : null;
    if (event.key === "Escape") return clear();
    const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -20, PageDown: 20, Home: -Infinity, End: Infinity }[event.key];
    const turn = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!plot || (step === undefined && turn === undefined) || event.ctrlKey || event.altKey || event.metaKey) return;
    const panels = [...plot.querySelectorAll("g.panel")].filter((p) => curves(p).length);
    if (!panels.length || (turn && panels.length < 2)) return;
    event.preventDefault();
    const state = steps.get(plot) || { panel: 0, index: -1 };
    state.panel = (state.panel + (turn || 0) + panels.length) % panels.length;
    const panel = panels[state.panel], path = points(curves(panel).reduce((a, b) => (points(b).length > points(a).length ? b : a)));
    state.index = Math.max(0, Math.min(path.length - 1, state.index + (step || 0)));
    steps.set(plot, state);
    const snap = read(panel, path[state.index][0]);
    if (snap === null) return;
    const matrix = panel.ownerSVGElement.getScreenCTM(), edges = plot.getBoundingClientRect();
    const x = new DOMPoint(snap, 0).matrixTransform(matrix).x;
    if (x < edges.left + 20 || x > edges.right - 20) plot.scrollLeft += x - (edges.left + edges.right) / 2;
    place(Math.max(edges.left, Math.min(x, edges.right)), Math.max(edges.top, 60));
  });
  // A tap moves the focus as well.
  document.addEventListener("focusout", (event) => { if (!event.relatedTarget || !event.relatedTarget.closest(".plot")) clear(); });
})();
