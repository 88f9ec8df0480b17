// Mouse, touch and keyboard input, mapped to viewer methods: orbit, look, shift, approach, step.

const TURN = 2.6; // radians for a drag over the whole height
const KEYS = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, -1, 0], q: [0, 1, 0] };

function followPointers(canvas, viewer) {
  const fingers = new Map();
  const middle = () => {
    const all = [...fingers.values()];
    const x = all.reduce((sum, one) => sum + one.x, 0) / all.length;
    const y = all.reduce((sum, one) => sum + one.y, 0) / all.length;
    const apart = all.length > 1 ? Math.hypot(all[0].x - all[1].x, all[0].y - all[1].y) : 0;
    return { x, y, apart };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    const shifts = event.button !== 0 || event.shiftKey;
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY, shifts });
  });
  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const before = middle();
    [finger.x, finger.y] = [event.clientX, event.clientY];
    const after = middle();
    const [dx, dy] = [after.x - before.x, after.y - before.y].map((way) => way / canvas.clientHeight);
    if (fingers.size > 1 || finger.shifts) viewer.shift(dx, dy);
    else viewer.drag(dx * TURN, dy * TURN);
    if (before.apart && after.apart) viewer.approach(before.apart / after.apart);
  });
  for (const name of ["pointerup", "pointercancel"])
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", (event) => {
    const box = canvas.getBoundingClientRect();
    viewer.focusOn((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  });
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      viewer.approach(Math.exp(Math.min(Math.max(event.deltaY * lines, -300), 300) * 0.0015));
    },
    { passive: false },
  );
}

function followKeys(viewer) {
  const held = new Set();
  const press = {
    arrowleft: () => viewer.step(-1),
    arrowright: () => viewer.step(1),
    p: () => viewer.togglePhoto(),
    f: () => viewer.toggleFly(),
    h: () => viewer.home(),
    "?": () => viewer.toggleHelp(),
    escape: () => viewer.toggleHelp(false),
  };
  let last = 0;
  const walk = (now) => {
    if (!held.size) return;
    const seconds = Math.min((now - last) / 1000, 0.1);
    last = now;
    const pace = seconds * (held.has("shift") ? 4 : 1);
    const way = [...held].map((key) => KEYS[key] || [0, 0, 0]).reduce((sum, key) => plus(sum, key));
    viewer.walk(scaled(way, pace));
    requestAnimationFrame(walk);
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const key = event.key.toLowerCase();
    if (key in KEYS || key === "shift") {
      const began = !held.size;
      held.add(key);
      if (began) requestAnimationFrame((now) => walk((last = now)));
    } else if (key in press) press[key]();
    else return;
    if (key !== "shift") event.preventDefault();
  });
  document.addEventListener("keyup", (event) => held.delete(event.key.toLowerCase()));
  window.addEventListener("blur", () => held.clear());
}
