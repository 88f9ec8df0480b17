// The viewer: state of the view, scheduling of sorting and drawing, and buttons.

const MOST_PIXELS = 4e6;
const SLOW = 34; // ms per frame: below 30 fps the resolution in motion decreases
const FAST = 18;
const COARSEST = 0.35;
const REST = 150; // ms without motion before the picture is drawn at full resolution
const PACE = 0.6; // share of the distance to the focus that keys move per second

const SENTENCES = {
  webgl2:
    "This browser does not support WebGL 2, which the page needs. Turn on hardware acceleration in its settings, or open the page in a newer Firefox, Chrome, Edge or Safari.",
  inflate:
    "This browser cannot unpack the splats. Open the page in Firefox 113, Chrome 80, Safari 16.4 or newer.",
  lost: "The connection to the graphics card was lost. It usually recovers; if not, reload the page.",
};

const $ = (id) => document.getElementById(id);

class Viewer {
  constructor(scene, canvas, splats) {
    this.scene = scene;
    this.canvas = canvas;
    this.splats = splats;
    this.renderer = new Renderer(canvas, scene, splats);
    this.eye = new Eye(scene.up);
    this.first = scene.cameras[scene.first.number] || scene.first;
    this.camera = this.first;
    this.at = -1; // index of the selected camera
    this.flies = false;
    this.scale = 1; // resolution in motion
    this.moved = -Infinity;
    this.version = 0; // of the view
    this.sorted = -1; // version of the current order
    this.waiting = []; // callbacks for a sorted picture
    this.startSorter();
    new ResizeObserver(() => this.wake()).observe(canvas);
    this.home();
  }

  startSorter() {
    const url = URL.createObjectURL(new Blob([$("sorter").textContent], { type: "text/javascript" }));
    this.sorter = new Worker(url);
    URL.revokeObjectURL(url);
    this.sorter.postMessage({ means: this.splats.means });
    this.sorting = false;
    this.sorter.onmessage = ({ data }) => {
      this.sorting = false;
      this.sortMs = data.ms;
      this.renderer.setOrder(data.order);
      this.sorted = data.number;
      this.wake();
    };
  }

  // The view has changed.
  change() {
    this.version++;
    this.moved = performance.now();
    this.wake();
  }

  wake() {
    if (this.awake) return;
    this.awake = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.awake = false;
    if (!this.sorting && this.sorted !== this.version) {
      this.sorting = true;
      const { position, forward } = this.eye;
      this.sorter.postMessage({ position, forward, near: this.scene.near, number: this.version });
    }
    const moves = now - this.moved < REST;
    this.pace(now, moves);
    this.resize(moves ? this.scale : 1);
    if (this.sorted >= 0) this.renderer.draw(this.eye, fitted(this.camera, this.canvas));
    if (moves) this.wake();
    else if (this.sorted === this.version) this.waiting.splice(0).forEach((done) => done());
  }

  // Lower the resolution in motion if frames are slow, raise it if they are fast.
  pace(now, moves) {
    const took = now - (this.last ?? now);
    this.last = moves ? now : null;
    if (took > SLOW && took < 1000) this.scale = Math.max(COARSEST, this.scale * 0.93);
    else if (took && took < FAST) this.scale = Math.min(1, this.scale * 1.02);
  }

  resize(scale) {
    const { clientWidth, clientHeight } = this.canvas;
    const pixels = clientWidth * clientHeight || 1;
    const dense = Math.min(window.devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / pixels)) * scale;
    const size = [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(side * dense)));
    if (this.canvas.width !== size[0]) this.canvas.width = size[0];
    if (this.canvas.height !== size[1]) this.canvas.height = size[1];
  }

  // Resolves when the picture at rest is drawn in sorted order.
  settled() {
    this.wake();
    return new Promise((done) => this.waiting.push(done));
  }

  drag(yaw, pitch) {
    if (this.flies) this.eye.look(yaw, pitch);
    else this.eye.orbit(-yaw, -pitch);
    this.change();
  }

  shift(dx, dy) {
    const wide = (this.eye.distance * this.camera.height) / this.camera.fy;
    this.eye.move(-dx * wide, -dy * wide, 0);
    this.change();
  }

  approach(factor) {
    if (this.flies) this.eye.move(0, 0, (1 - factor) * this.eye.distance);
    else this.eye.approach(factor);
    this.change();
  }

  walk(way) {
    if (!way.some(Boolean)) return;
    this.eye.move(...scaled(way, PACE * this.eye.distance));
    this.change();
  }

  // Set the centre of rotation to the nearest opaque splat near a position of the canvas, 0 to 1.
  focusOn(x, y) {
    const { means, opacity, count } = this.splats;
    const lens = fitted(this.camera, this.canvas);
    const [right, down, forward] = this.eye.rotation;
    const [px, py] = [x * this.canvas.width, y * this.canvas.height];
    const close = 0.012 * this.canvas.height;
    let nearest = Infinity;
    for (let i = 0; i < count; i++) {
      if (opacity[i] < 100) continue;
      const away = plus([means[3 * i], means[3 * i + 1], means[3 * i + 2]], this.eye.position, -1);
      const z = dot(away, forward);
      if (z <= this.scene.near || z >= nearest) continue;
      const u = (lens.fx * dot(away, right)) / z + lens.cx - px;
      const v = (lens.fy * dot(away, down)) / z + lens.cy - py;
      if (Math.hypot(u, v) < close) nearest = z;
    }
    if (nearest === Infinity) return;
    const ray = [(px - lens.cx) / lens.fx, (py - lens.cy) / lens.fy, 1];
    this.eye.focus = ray.reduce((sum, part, k) => plus(sum, this.eye.rotation[k], part * nearest), this.eye.position);
  }

  // Show a camera of the capture by number, or else the first view.
  show(number) {
    const { cameras } = this.scene;
    this.at = cameras[number] ? number : -1;
    this.camera = cameras[number] || this.first;
    this.eye.take(this.camera, this.scene.focus);
    $("cameras").value = String(this.at);
    this.showPhoto();
    this.change();
  }

  step(by) {
    const { length } = this.scene.cameras;
    if (length) this.show(this.at < 0 ? (by > 0 ? 0 : length - 1) : (this.at + by + length) % length);
  }

  home() {
    this.show(this.scene.first.number ?? -1);
  }

  get photos() {
    return $("photo").getAttribute("aria-pressed") === "true";
  }

  togglePhoto() {
    if (!this.scene.cameras.some((camera) => camera.photo)) return;
    $("photo").setAttribute("aria-pressed", String(!this.photos));
    this.showPhoto();
  }

  showPhoto() {
    const figure = document.querySelector("figure");
    const { photo, name } = this.camera;
    figure.hidden = !this.photos;
    figure.classList.toggle("none", !photo);
    if (photo) Object.assign(figure.firstElementChild, { src: photo, alt: `Photo ${name}` });
    this.wake();
  }

  toggleFly() {
    this.flies = !this.flies;
    $("fly").setAttribute("aria-pressed", String(this.flies));
  }

  toggleHelp(open = $("words").hidden) {
    $("words").hidden = !open;
    $("help").setAttribute("aria-pressed", String(open));
  }
}

function say(sentence) {
  $("message").textContent = sentence;
}

function fillCameras(scene, viewer) {
  const { cameras } = scene;
  $("steps").hidden = !cameras.length;
  $("photo").hidden = !cameras.some((camera) => camera.photo);
  if (!scene.cameras[scene.first.number]) $("cameras").append(new Option("first view", "-1"));
  cameras.forEach((camera, i) => $("cameras").append(new Option(camera.label, String(i))));
  $("cameras").value = String(viewer.at);
  $("cameras").addEventListener("change", (event) => {
    viewer.show(Number(event.target.value));
    viewer.canvas.focus();
  });
}

function connect(viewer, scene) {
  const { canvas } = viewer;
  fillCameras(scene, viewer);
  const clicks = {
    before: () => viewer.step(-1),
    after: () => viewer.step(1),
    photo: () => viewer.togglePhoto(),
    fly: () => viewer.toggleFly(),
    home: () => viewer.home(),
    help: () => viewer.toggleHelp(),
  };
  for (const [id, act] of Object.entries(clicks)) $(id).addEventListener("click", act);
  $("facts").textContent = scene.facts;
  followPointers(canvas, viewer);
  followKeys(viewer);
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    say(SENTENCES.lost);
  });
  canvas.addEventListener("webglcontextrestored", () => {
    viewer.renderer.setUp();
    viewer.version++;
    viewer.wake();
    say("");
  });
}

async function begin() {
  const canvas = document.querySelector("canvas");
  const scene = JSON.parse($("scene").textContent);
  if (!document.createElement("canvas").getContext("webgl2")) return say(SENTENCES.webgl2);
  if (!window.DecompressionStream) return say(SENTENCES.inflate);
  try {
    const splats = await unpack(scene.splats, $("splats").textContent);
    $("splats").remove();
    const viewer = new Viewer(scene, canvas, splats);
    connect(viewer, scene);
    await viewer.settled();
    say("");
    window.viewer = viewer; // for consoles and tests
  } catch (error) {
    say(`The splats cannot be shown: ${error.message}. Reload the page, or open it in another browser.`);
    throw error;
  }
}

begin();
