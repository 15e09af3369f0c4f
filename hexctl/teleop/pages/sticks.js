// Sticks under fingers: `changed` is called when one is taken or let go, `moved` while one moves.
function sticksOf(walk, turn, changed, moved = () => {}) {
  const sticks = [walk, turn].map(el => ({ el, id: null, x: 0, y: 0 }));
  const draw = s => { s.el.lastElementChild.style.transform = `translate(${s.x * s.el.clientWidth / 3}px, ${s.y * s.el.clientHeight / 3}px)`; };
  const free = s => { s.id = null; s.x = s.y = 0; draw(s); };
  for (const s of sticks) {
    const move = e => {
      if (e.pointerId !== s.id) return;
      const box = s.el.getBoundingClientRect();
      let x = 2 * (e.clientX - box.left) / box.width - 1, y = s.el === turn ? 0 : 2 * (e.clientY - box.top) / box.height - 1;
      const far = Math.hypot(x, y);
      if (far > 1) { x /= far; y /= far; }
      if (far < 0.08) x = y = 0;
      s.x = x; s.y = y; draw(s); moved();
    };
    s.el.addEventListener("pointerdown", e => {
      if (s.id !== null) return;
      e.preventDefault(); s.id = e.pointerId; s.el.setPointerCapture(e.pointerId); move(e); changed();
    });
    s.el.addEventListener("pointermove", move);
    const up = e => { if (e.pointerId === s.id) { free(s); changed(); } };
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) s.el.addEventListener(kind, up);
  }
  return {
    down: () => sticks.some(s => s.id !== null),
    shares: () => [-sticks[0].y, -sticks[0].x, -sticks[1].x],  // ahead, left, turn
    letGo: () => sticks.forEach(free),
  };
}
