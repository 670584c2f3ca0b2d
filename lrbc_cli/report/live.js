(() => {
  // While `lrbc watch` runs: a picture beside the page tells by its width which page is the newest, by its height that somebody watches.
  const note = document.getElementById("live"), old = document.getElementById("old");
  const own = 2 * Number(note.dataset.stamp) + (old && !old.hidden ? 1 : 0);
  const EVERY = 3000, QUIET = 3000, GONE = 20000;
  let beat = 0, heard = 0, silent = 0, lost = 0, since = "", hand = 0;

  // Never under the hand of a reader.
  for (const event of ["pointermove", "pointerdown", "keydown", "wheel", "touchmove", "change"]) addEventListener(event, () => (hand = Date.now()), { passive: true });
  const again = () => {
    if (Date.now() - hand >= QUIET) location.reload();
  };
  const alone = () => {
    note.textContent = `Not updated since ${since || note.dataset.written}: lrbc watch does not run any more.`;
    note.hidden = false;
  };
  const look = () => {
    const sign = new Image();
    sign.onload = () => {
      lost = 0;
      if (sign.naturalHeight !== beat) {
        // A first sign may be an old one.
        if (beat) since = new Date().toLocaleString("en-GB", { dateStyle: "long", timeStyle: "short" }), (note.hidden = true);
        [beat, heard, silent] = [sign.naturalHeight, Date.now(), 0];
      } else if (++silent >= 3 && Date.now() - heard >= GONE) alone();
      if (sign.naturalWidth > 1 && sign.naturalWidth !== own) again();
    };
    sign.onerror = () => {
      // The watcher takes the sign away when it ends, after the last page.
      if (++lost < 3) return;
      if (since) again();
      else alone();
    };
    sign.src = `.watch.svg?${Date.now()}`;
  };
  setInterval(look, EVERY);
  look();

  // What is folded out stays so, and what is chosen.
  const kept = `open ${location.pathname}`, all = [...document.querySelectorAll("details")], chosen = [...document.querySelectorAll(".filter :is(select, input)")];
  const place = (one) => {
    const part = one.closest("[id]");
    return part ? `${part.id} ${[...part.querySelectorAll("details")].indexOf(one)}` : "";
  };
  const key = (one) => (one.type === "checkbox" ? "checked" : "value");
  try {
    const { open, values } = JSON.parse(sessionStorage.getItem(kept)) || { open: [], values: {} };
    for (const one of all) if (open.includes(place(one))) one.open = true;
    for (const one of chosen) {
      const value = values[one.name];
      if (value === undefined || (one.options && ![...one.options].some((option) => option.value === value))) continue;
      one[key(one)] = value;
      one.dispatchEvent(new Event("change", { bubbles: true }));
    }
    hand = 0;
    addEventListener("pagehide", () => {
      const now = { open: all.filter((one) => one.open).map(place), values: Object.fromEntries(chosen.map((one) => [one.name, one[key(one)]])) };
      sessionStorage.setItem(kept, JSON.stringify(now));
    });
  } catch {
    // Storage may be switched off.
  }
})();
