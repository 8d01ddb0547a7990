// A camera that turns around a target, with damping; OpenCV's axes: x right, y down, z forward.

const SETTLING = 9; // a motion falls to 1/e in 1/9 second
const STEEPEST = 1.553; // radians above or below the horizon: 89 degrees

const add = (a, b, times = 1) => a.map((x, i) => x + times * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0]];
const scaled = (a, times) => a.map((x) => x * times);
const unit = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));

class Camera {
  // start: {eye, target, up, fov}: scene units; fov of the longer side, radians.
  constructor(start) {
    this.start = start;
    this.reset();
  }

  reset() {
    const {eye, target, up, fov} = this.start;
    this.fov = fov;
    this.target = [...target];
    this.stand(up, eye);
  }

  // Take `up` as upright and look from `eye`.
  stand(up, eye) {
    this.up = unit(up);
    const across = Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    this.east = unit(cross(across, this.up));
    this.north = cross(this.up, this.east);
    const away = add(eye, this.target, -1);
    this.distance = Math.hypot(...away) || 1;
    const height = dot(away, this.up) / this.distance;
    this.pitch = Math.asin(Math.max(-1, Math.min(1, height)));
    this.yaw = Math.atan2(dot(away, this.north), dot(away, this.east));
    this.speed = {yaw: 0, pitch: 0, zoom: 0, move: [0, 0, 0]};
  }

  // Unit vector from the target to the camera.
  away() {
    const flat = Math.cos(this.pitch);
    return [0, 1, 2].map((i) => flat * (Math.cos(this.yaw) * this.east[i]
      + Math.sin(this.yaw) * this.north[i]) + Math.sin(this.pitch) * this.up[i]);
  }

  // Rows of the rotation: right, down, forward.
  axes() {
    const forward = scaled(this.away(), -1);
    const right = unit(cross(forward, this.up));
    return [right, cross(forward, right), forward];
  }

  // Impulses of the hand: radians; zoom as a logarithm; move in units of the distance.
  turn(yaw, pitch) {
    this.speed.yaw += yaw * SETTLING;
    this.speed.pitch += pitch * SETTLING;
  }

  zoom(log) {
    this.speed.zoom += log * SETTLING;
  }

  move(right, down, forward) {
    const by = [right, down, forward], axes = this.axes();
    axes.forEach((axis, i) => {
      this.speed.move = add(this.speed.move, axis, by[i] * this.distance * SETTLING);
    });
  }

  // Move on by some seconds; whether anything moves.
  step(seconds) {
    const speed = this.speed, time = Math.min(seconds, 0.1);
    const passed = (1 - Math.exp(-SETTLING * time)) / SETTLING, kept = Math.exp(-SETTLING * time);
    const still = Math.hypot(speed.yaw, speed.pitch, speed.zoom,
      Math.hypot(...speed.move) / this.distance) < 1e-4;
    if (still) return false;
    this.yaw += speed.yaw * passed;
    this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch + speed.pitch * passed));
    this.distance *= Math.exp(speed.zoom * passed);
    this.target = add(this.target, speed.move, passed);
    speed.yaw *= kept;
    speed.pitch *= kept;
    speed.zoom *= kept;
    speed.move = scaled(speed.move, kept);
    return true;
  }

  // A pinhole camera of this size: x_camera = rotation x + translation; pixel centres at +0.5.
  pinhole(width, height) {
    const rows = this.axes(), eye = add(this.target, this.away(), this.distance);
    const focal = 0.5 * Math.max(width, height) / Math.tan(0.5 * this.fov);
    return {
      rotation: rows.flat(), translation: rows.map((row) => -dot(row, eye)),
      fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height,
    };
  }
}

// Where a pinhole camera stands.
function centreOf({rotation, translation}) {
  return [0, 1, 2].map((i) => -(rotation[i] * translation[0] + rotation[3 + i] * translation[1]
    + rotation[6 + i] * translation[2]));
}

// The same camera among positions that are relative to `origin`.
function movedBy(view, origin) {
  const {rotation, translation} = view;
  return {...view, translation: [0, 1, 2].map((row) => translation[row]
    + dot(rotation.slice(3 * row, 3 * row + 3), origin))};
}

// A first view of a scene whose cameras are not known: of the middle of its anchors. In scenes made
// of photos the origin is the middle of the cameras, at most 4 units away: if the anchors lie around
// it, the cameras went around an object, otherwise they looked away from it.
function guessStart(positions) {
  const columns = [0, 1, 2].map((axis) => positions.filter((_, i) => i % 3 === axis).sort());
  const quantile = (share) => columns.map((c) => c[Math.floor(share * (c.length - 1))] ?? 0);
  const target = quantile(0.5), size = Math.hypot(...add(quantile(0.9), quantile(0.1), -1)) || 1;
  const far = Math.hypot(...target), up = [0, 0, 1];
  if (far > 0.6 * size) return {eye: [0, 0, 0], target, up: [0, -1, 0], fov: 1};
  return {eye: add(target, unit([1, -1, 0.6]), 2 * size), target, up, fov: 0.8};
}
