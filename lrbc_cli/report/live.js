(() => {
  // While `lrbc watch` runs: look for a newer page every few seconds, but never under the hand of a reader.
  let timer = 0;
  const again = () => {
    clearTimeout(timer);
    timer = setTimeout(() => location.reload(), 3000);
  };
  for (const event of ["pointermove", "pointerdown", "keydown", "wheel", "touchmove"]) addEventListener(event, again, { passive: true });
  again();
})();
