"use strict";
// Mouse, fingers and keys on the map: they pan and zoom the view, and set, drag and clear the ends of the path.

function listen(pane) {
  const down = new Map();
  let moved = 0, dragged = null, spread = 0;
  const { lines } = pane;
  const positionOf = (event) => {
    const box = lines.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const near = (u, v, reach) => {
    const shown = pane.shownEnds();
    return ["goal", "start"].find((role) => {
      if (!shown[role]) return false;
      const [x, y] = pane.toPixels(...shown[role]);
      return Math.hypot(x - u, y - v) < reach;
    });
  };
  lines.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    lines.setPointerCapture(event.pointerId);
    const [u, v] = positionOf(event);
    down.set(event.pointerId, [u, v]);
    moved = down.size > 1 ? Infinity : 0;
    dragged = down.size === 1 ? near(u, v, event.pointerType === "touch" ? 26 : 14) : null;
    spread = 0;
  });
  lines.addEventListener("pointermove", (event) => {
    const [u, v] = positionOf(event), before = down.get(event.pointerId);
    pointer = { pane, at: [u, v] };
    if (!before) {
      lines.style.cursor = near(u, v, 14) ? "grab" : "crosshair";
      return invalidate();
    }
    down.set(event.pointerId, [u, v]);
    moved += Math.hypot(u - before[0], v - before[1]);
    if (dragged && moved > 3) place(pane.toMetres(u, v), dragged);
    else if (down.size === 1 && moved > 4) pan(u - before[0], v - before[1]);
    else if (down.size === 2) {
      const [[a, b], [c, d]] = [...down.values()], wide = Math.hypot(a - c, b - d);
      pan((u - before[0]) / 2, (v - before[1]) / 2);
      if (spread) zoom(wide / spread, pane, (a + c) / 2, (b + d) / 2);
      spread = wide;
    }
  });
  const up = (event) => {
    const [u, v] = positionOf(event);
    if (down.delete(event.pointerId) && event.type === "pointerup" && moved <= 4 && !dragged) {
      place(pane.toMetres(u, v), event.shiftKey ? "start" : undefined);
    }
    if (down.size === 0) dragged = null;
    spread = 0;
  };
  lines.addEventListener("pointerup", up);
  lines.addEventListener("pointercancel", up);
  lines.addEventListener("pointerleave", () => {
    pointer = null;
    invalidate();
  });
  lines.addEventListener("wheel", (event) => {
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode]; // pixels, lines or pages
    zoom(Math.exp(-0.0016 * pixels), pane, ...positionOf(event));
  }, { passive: false });
  lines.addEventListener("keydown", (event) => onKey(event, pane));
  lines.addEventListener("focus", invalidate);
  lines.addEventListener("blur", invalidate);
}

function onKey(event, pane) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const step = event.shiftKey ? 8 : 60, keys = {
    ArrowLeft: () => pan(step, 0), ArrowRight: () => pan(-step, 0),
    ArrowUp: () => pan(0, step), ArrowDown: () => pan(0, -step),
    "+": () => zoom(1.4, pane), "=": () => zoom(1.4, pane), "-": () => zoom(1 / 1.4, pane), 0: fit,
    PageUp: () => cut(Math.min(Number($("height").value) + 1, header.heights.length - 1)),
    PageDown: () => cut(Math.max(Number($("height").value) - 1, 0)),
    a: () => place([view.x, view.y], "start"), b: () => place([view.x, view.y], "goal"), Escape: clearPath,
  };
  const action = keys[event.key] ?? keys[event.key.toLowerCase()];
  if (!action) return;
  event.preventDefault();
  pointer = null;
  action();
}
