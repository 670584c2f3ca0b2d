(() => {
  // While `lrbc watch` runs: look for a newer page every few seconds, but never under the hand of a reader.
  let timer = 0;
  const again = () => {
    clearTimeout(timer);
    timer = setTimeout(() => location.reload(), 3000);
  };
  for (const event of ["pointermove", "pointerdown", "keydown", "wheel", "touchmove"]) addEventListener(event, again, { passive: true });
  again();

  // What is folded out stays so.
  const kept = `open ${location.pathname}`, all = [...document.querySelectorAll("details")];
  const place = (one) => {
    const part = one.closest("[id]");
    return part ? `${part.id} ${[...part.querySelectorAll("details")].indexOf(one)}` : "";
  };
  try {
    const open = JSON.parse(sessionStorage.getItem(kept)) || [];
    for (const one of all) if (open.includes(place(one))) one.open = true;
    addEventListener("pagehide", () => sessionStorage.setItem(kept, JSON.stringify(all.filter((one) => one.open).map(place))));
  } catch {
    // Storage may be switched off.
  }
})();
