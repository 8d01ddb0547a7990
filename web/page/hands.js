// Mouse, touch and keys move the camera.

const WALK = 0.5; // of the distance, per second
const KEYS = {
  KeyW: [0, 0, 1], ArrowUp: [0, 0, 1], KeyS: [0, 0, -1], ArrowDown: [0, 0, -1],
  KeyA: [-1, 0, 0], ArrowLeft: [-1, 0, 0], KeyD: [1, 0, 0], ArrowRight: [1, 0, 0],
  KeyQ: [0, 1, 0], KeyE: [0, -1, 0],
};

class Hands {
  // wake: called when the picture will change; commands: functions by the code of a key.
  constructor(canvas, camera, wake, commands) {
    Object.assign(this, {canvas, camera, wake, commands, pressed: new Set(), fingers: new Map()});
    const listen = (target, names, handler) => names.forEach((name) =>
      target.addEventListener(name, handler, {passive: false}));
    listen(canvas, ["pointerdown"], (event) => this.down(event));
    listen(canvas, ["pointermove"], (event) => this.drag(event));
    listen(canvas, ["pointerup", "pointercancel"], (event) => this.up(event));
    listen(canvas, ["wheel"], (event) => this.wheel(event));
    listen(canvas, ["contextmenu"], (event) => event.preventDefault());
    listen(window, ["keydown"], (event) => this.key(event));
    listen(window, ["keyup"], (event) => this.pressed.delete(event.code));
    listen(window, ["blur"], () => this.pressed.clear());
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.focus();
    this.canvas.classList.add("held");
    this.fingers.set(event.pointerId, event);
  }

  up(event) {
    this.fingers.delete(event.pointerId);
    this.canvas.classList.toggle("held", this.fingers.size > 0);
  }

  // One finger or the left button turns; two fingers move and pinch; other buttons move.
  drag(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const size = Math.min(this.canvas.clientWidth, this.canvas.clientHeight) || 1;
    const x = (event.clientX - before.clientX) / size, y = (event.clientY - before.clientY) / size;
    const others = [...this.fingers.values()].filter((one) => one.pointerId !== event.pointerId);
    this.fingers.set(event.pointerId, event);
    if (others.length > 0) {
      const span = (one) => Math.hypot(one.clientX - others[0].clientX,
        one.clientY - others[0].clientY) || 1;
      this.camera.zoom(Math.log(span(before) / span(event)));
      this.camera.move(-x / 2, -y / 2, 0); // each finger moves half
    } else if (event.buttons & 1 && !event.shiftKey) {
      this.camera.turn(-3 * x, 3 * y);
    } else {
      this.camera.move(-x, -y, 0);
    }
    this.wake();
  }

  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    this.camera.zoom(Math.max(-0.5, Math.min(0.5, event.deltaY * lines * 0.0012)));
    this.wake();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (KEYS[event.code]) {
      this.pressed.add(event.code);
    } else if (this.commands[event.code]) {
      this.commands[event.code]();
    } else {
      return;
    }
    event.preventDefault();
    this.wake();
  }

  // Walk as long as keys are pressed; whether any is.
  step(seconds) {
    const time = Math.min(seconds, 0.1) * WALK;
    for (const code of this.pressed) this.camera.move(...KEYS[code].map((x) => x * time));
    return this.pressed.size > 0;
  }
}
