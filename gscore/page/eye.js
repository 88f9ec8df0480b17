// Camera of the viewer: OpenCV axes (x right, y down, z forward), as rows of a rotation.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, times = 1) => a.map((value, i) => value + times * b[i]);
const scaled = (a, by) => a.map((value) => value * by);
const unit = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

// Rodrigues' formula.
function turnedAbout(axis, angle, v) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return plus(plus(scaled(v, c), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
}

const STEEPEST = 0.998; // |forward . up|: closer to the pole, left and right would swap

class Eye {
  constructor(up) {
    this.up = unit(up);
    this.position = [0, 0, 0];
    this.rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    this.focus = [0, 0, 1];
  }

  // `camera` has a position and a world-to-camera rotation; the focus becomes the point of the
  // optical axis nearest to `around`.
  take(camera, around) {
    this.position = [...camera.position];
    this.rotation = camera.rotation.map((row) => [...row]);
    const ahead = dot(plus(around, this.position, -1), this.forward);
    const far = Math.hypot(...plus(around, this.position, -1));
    this.focus = plus(this.position, this.forward, ahead > 0.1 * far ? ahead : far || 1);
  }

  get forward() {
    return this.rotation[2];
  }

  get distance() {
    return Math.hypot(...plus(this.focus, this.position, -1));
  }

  turn(yaw, pitch) {
    const tilted = turnedAbout(this.rotation[0], pitch, this.forward);
    const steep = Math.abs(dot(tilted, this.up));
    if (steep > STEEPEST && steep > Math.abs(dot(this.forward, this.up))) pitch = 0;
    const right = this.rotation[0];
    this.rotation = this.rotation.map((row) => turnedAbout(this.up, yaw, turnedAbout(right, pitch, row)));
    this.straighten();
  }

  // Orthonormalise, so that rounding errors do not accumulate.
  straighten() {
    const forward = unit(this.forward);
    const right = unit(cross(this.rotation[1], forward));
    this.rotation = [right, cross(forward, right), forward];
  }

  orbit(yaw, pitch) {
    const away = plus(this.position, this.focus, -1);
    const inside = this.rotation.map((row) => dot(row, away));
    this.turn(yaw, pitch);
    this.position = inside.reduce((sum, value, k) => plus(sum, this.rotation[k], value), this.focus);
  }

  look(yaw, pitch) {
    const { distance } = this;
    this.turn(yaw, pitch);
    this.focus = plus(this.position, this.forward, distance);
  }

  // Move along the camera axes, together with the focus.
  move(right, down, forward) {
    [right, down, forward].forEach((way, k) => {
      this.position = plus(this.position, this.rotation[k], way);
      this.focus = plus(this.focus, this.rotation[k], way);
    });
  }

  approach(factor) {
    const away = plus(this.position, this.focus, -1);
    this.position = plus(this.focus, away, Math.max(factor, 1e-3));
  }
}

// Intrinsics of `camera` scaled to fit the middle of a canvas.
function fitted(camera, canvas) {
  const scale = Math.min(canvas.width / camera.width, canvas.height / camera.height);
  return {
    fx: camera.fx * scale,
    fy: camera.fy * scale,
    cx: camera.cx * scale + (canvas.width - camera.width * scale) / 2,
    cy: camera.cy * scale + (canvas.height - camera.height * scale) / 2,
  };
}
