"use strict";
(() => {
  // Filter of the FRF figures; without scripts all of them are shown.
  const filter = document.querySelector(".filter");
  if (filter) {
    const figures = [...document.querySelectorAll(".frfs figure")];
    const apply = () => {
      const want = Object.fromEntries([...filter.querySelectorAll("select")].map((s) => [s.name, s.value]));
      for (const f of figures) {
        f.hidden = (want.response !== "" && f.dataset.response !== want.response) || (want.job !== "" && f.dataset.job !== want.job);
      }
    };
    filter.hidden = false;
    filter.addEventListener("change", apply);
    apply();
  }

  // Values under the pointer, read back from the drawn curves.
  const box = document.createElement("div");
  box.id = "readout";
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
  const show = (value, digits = 4) => Number(value.toPrecision(digits)).toString().replace("-", "\u2212");
  let cursor = null;
  const clear = () => {
    box.hidden = true;
    if (cursor) cursor.remove();
    cursor = null;
  };
  document.addEventListener("pointermove", (event) => {
    const panel = event.target.closest ? event.target.closest("g.panel") : null;
    clear();
    if (!panel) return;
    const frame = panel.querySelector(".hit"), svg = panel.ownerSVGElement;
    const [left, top, width, height] = ["x", "y", "width", "height"].map((k) => Number(frame.getAttribute(k)));
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const [x0, x1] = range(panel, "x"), [y0, y1] = range(panel, "y");
    const power = panel.dataset.scale === "log";
    const value = (y) => { const v = y0 + ((top + height - y) / height) * (y1 - y0); return power ? (10 ** v).toExponential(2) : show(v, 3); };
    const lines = [];
    let snap = at.x;
    for (const path of panel.querySelectorAll("path[data-name]")) {
      let best = null;
      for (const p of points(path)) if (!best || Math.abs(p[0] - at.x) < Math.abs(best[0] - at.x)) best = p;
      if (best && Math.abs(best[0] - at.x) < 120) {
        if (!lines.length) snap = best[0];
        if (lines.length < 10) lines.push(`${path.dataset.name}: ${value(best[1])}`);
      }
    }
    if (!lines.length) return;
    cursor = document.createElementNS("http://www.w3.org/2000/svg", "line");
    for (const [k, v] of Object.entries({ class: "cursor", x1: snap, x2: snap, y1: top, y2: top + height })) cursor.setAttribute(k, v);
    panel.append(cursor);
    box.textContent = `${panel.dataset.xl}: ${show(x0 + ((snap - left) / width) * (x1 - x0))}\n${panel.dataset.yl}\n${lines.join("\n")}`;
    box.hidden = false;
    const over = box.getBoundingClientRect();
    box.style.left = `${Math.max(4, Math.min(event.clientX + 16, innerWidth - over.width - 8))}px`;
    box.style.top = `${Math.max(4, Math.min(event.clientY + 16, innerHeight - over.height - 8))}px`;
  });
  document.addEventListener("pointerleave", clear);
})();
