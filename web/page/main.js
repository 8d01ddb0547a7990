// The page: reads its own file, one that is dropped, or one behind an address, and draws whenever
// something has changed.

const element = (id) => document.getElementById(id);
const settings = JSON.parse(element("settings").textContent);
const canvas = element("view");

const viewer = {
  renderer: null, worker: null, camera: null, hands: null, scene: null,
  fixed: null, // a camera that a program has set; the hands then have no part
  number: 0, // of the newest camera
  pending: null, // what must be drawn next: the newest order, records that came with or before it
  shown: -1, // the camera that the drawn order is for
  settled: false, // whether the newest order is for the newest camera, and so are its Gaussians
  updates: 0, // sets of Gaussians
  sharpness: 1, // of the pixels' number along a side, while the camera moves
  awake: false, last: 0,
};

const SLOW = 40, FAST = 18; // milliseconds of a picture: fewer pixels above, more again below
const LEAST_SHARPNESS = 0.35;

function bytesOf(id) {
  const text = atob(element(id).textContent.trim());
  return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
}

function note(text, share) {
  element("note").textContent = text;
  element("bar").firstChild.style.width = `${100 * share}%`;
}

function fail(reason) {
  viewer.failed = reason;
  note(reason, 0);
  element("loading").className = "failed";
  if (!settings.title) element("drop").hidden = false;
}

function wake() {
  if (!viewer.awake && viewer.scene) {
    viewer.awake = true;
    requestAnimationFrame(draw);
  }
}

function present(moves) {
  if (viewer.fixed) return movedBy(viewer.fixed, viewer.scene.origin);
  const ratio = Math.min(window.devicePixelRatio || 1, 2) * (moves ? viewer.sharpness : 1);
  return viewer.camera.pinhole(Math.max(1, Math.round(canvas.clientWidth * ratio)),
    Math.max(1, Math.round(canvas.clientHeight * ratio)));
}

// Tell the worker of a camera that differs from the last.
function tell(view) {
  const {rotation, translation} = view;
  const key = [...rotation, ...translation].join();
  if (key === viewer.key) return;
  viewer.key = key;
  viewer.settled = false;
  viewer.worker.postMessage({kind: "camera", camera: {
    centre: centreOf(view), row: [...rotation.slice(6), translation[2]], number: ++viewer.number,
  }});
}

// Pictures of a moving camera keep up with it, at the price of sharpness on slow devices.
function adapt() {
  const {milliseconds} = viewer.renderer;
  if (milliseconds > SLOW) viewer.sharpness = Math.max(LEAST_SHARPNESS, 0.85 * viewer.sharpness);
  if (milliseconds < FAST) viewer.sharpness = Math.min(1, 1.05 * viewer.sharpness);
}

// The camera goes on, and the worker follows it, also while the device still draws.
function draw(now) {
  const {renderer, scene, hands, camera, fixed} = viewer;
  viewer.awake = false;
  if (!scene) return;
  const seconds = (now - viewer.last) / 1000;
  const moves = !fixed && [hands.step(seconds), camera.step(seconds)].some(Boolean);
  viewer.last = now;
  const busy = renderer.busy();
  if (moves && !busy) adapt();
  const view = present(moves);
  tell(view);
  if (!busy) show(view);
  if (moves || busy) wake();
}

function show(view) {
  const {renderer, pending} = viewer;
  if (pending) {
    renderer.set(pending.records, pending.order);
    viewer.shown = pending.number;
    viewer.pending = null;
  }
  renderer.draw(view, viewer.scene);
  viewer.drawn = viewer.shown;
}

const handlers = {
  progress: ({share}) => note("Decoding", share),
  failed: ({reason}) => fail(reason),
  // Of a file in layers it comes once for each layer; the camera stays where it is then.
  scene(message) {
    const first = !viewer.scene;
    const scene = viewer.scene = {...message, margin: settings.margin};
    if (first) {
      const start = settings.start && viewer.own ? {...settings.start} : guessStart(scene.positions);
      if (settings.start && viewer.own) {
        start.eye = add(start.eye, scene.origin, -1);
        start.target = add(start.target, scene.origin, -1);
      }
      viewer.camera = viewer.hands.camera = new Camera(start);
      note("Drawing", 1);
    }
    delete scene.positions;
    viewer.settled = false;
    element("status").textContent = `${settings.title || viewer.name} \u00b7 ${contents(scene)}`;
    wake();
  },
  order({order, records, number, settled}) {
    if (records) viewer.updates++;
    viewer.pending = {records: records || viewer.pending?.records, order, number};
    viewer.settled = settled && number === viewer.number;
    canvas.classList.add("shown");
    element("loading").className = "done";
    wake();
  },
};

function contents(scene) {
  const count = `${scene.items.toLocaleString("en")} ${scene.splats ? "splats" : "anchors"}`;
  if (scene.ready < scene.layers) {
    const rest = scene.whole ? "the rest is lost" : "more comes";
    return `${count} \u00b7 ${scene.ready} of ${scene.layers} layers, ${rest}`;
  }
  return `${count} \u00b7 file ${scene.hash === scene.expectedHash ? "intact" : "damaged"}`;
}

// `file`: its bytes, or the address that the worker reads them from.
function load(file, name) {
  viewer.worker?.terminate();
  const source = new Blob([element("worker").textContent], {type: "text/javascript"});
  const address = URL.createObjectURL(source);
  const worker = viewer.worker = new Worker(address);
  Object.assign(viewer, {scene: null, pending: null, name, key: "", failed: null, settled: false,
    shown: -1});
  worker.onmessage = ({data}) => {
    try {
      handlers[data.kind](data);
    } catch (error) {
      fail(String(error.message || error));
    }
  };
  worker.onerror = (event) => fail(event.message || "the browser refuses workers");
  element("drop").hidden = true;
  element("loading").className = "";
  canvas.classList.remove("shown");
  note("Decoding", 0);
  const what = file instanceof Uint8Array ? {file} : {address: file};
  worker.postMessage({kind: "load", wasm: bytesOf("wasm"), ...what}, file.buffer ? [file.buffer] : []);
}

async function take(file) {
  if (!file) return;
  viewer.own = false;
  settings.title = "";
  document.title = file.name;
  load(new Uint8Array(await file.arrayBuffer()), file.name);
}

const commands = {
  KeyR: () => viewer.camera?.reset(),
  KeyH: () => document.body.classList.toggle("quiet"),
  KeyF: () => document.fullscreenElement ? document.exitFullscreen()
    : document.documentElement.requestFullscreen?.(),
  // The next of the six directions becomes upright: files do not say which one is.
  KeyU() {
    const all = [[0, 0, 1], [0, -1, 0], [0, 1, 0], [0, 0, -1], [1, 0, 0], [-1, 0, 0]];
    viewer.upright = ((viewer.upright ?? -1) + 1) % all.length;
    const {camera} = viewer;
    camera?.stand(all[viewer.upright], add(camera.target, camera.away(), camera.distance));
  },
};

function listen() {
  viewer.hands = new Hands(canvas, null, wake, commands);
  window.addEventListener("resize", wake);
  const drop = element("drop");
  for (const name of ["dragover", "dragleave", "drop"]) {
    window.addEventListener(name, (event) => {
      event.preventDefault();
      drop.classList.toggle("over", name === "dragover");
      if (name === "drop") take(event.dataTransfer.files[0]);
    });
  }
  drop.querySelector("input").addEventListener("change", (event) => take(event.target.files[0]));
  setTimeout(() => document.body.classList.add("quiet"), 12000);
}

// For programs: clgs.setCamera({rotation (9), translation (3), fx, fy, cx, cy, width, height}) shows
// the picture of a camera, in scene units, at its size and without help; clgs.state() tells of it.
window.clgs = {
  setCamera(view) {
    viewer.fixed = view;
    viewer.settled = false;
    viewer.key = "";
    document.body.classList.add("bare");
    canvas.style.width = `${view.width / (window.devicePixelRatio || 1)}px`;
    canvas.style.height = `${view.height / (window.devicePixelRatio || 1)}px`;
    wake();
  },
  load: (bytes, name) => load(bytes, name),
  state: () => ({
    ready: viewer.settled && viewer.drawn === viewer.number && !viewer.renderer.busy(),
    failed: viewer.failed || null,
    hash: viewer.scene?.hash, expectedHash: viewer.scene?.expectedHash,
    layers: viewer.scene?.layers, layersReady: viewer.scene?.ready, whole: viewer.scene?.whole,
    frames: viewer.renderer?.frames, updates: viewer.updates, gaussians: viewer.renderer?.count,
    width: canvas.width, height: canvas.height,
    yaw: viewer.camera?.yaw, pitch: viewer.camera?.pitch, distance: viewer.camera?.distance,
    target: viewer.camera?.target,
  }),
};

try {
  viewer.renderer = new Renderer(canvas);
  listen();
  const named = new URLSearchParams(location.search).get("scene") || settings.address;
  if (element("scene").textContent.trim()) {
    viewer.own = true;
    load(bytesOf("scene"), settings.title);
  } else if (named) {
    viewer.own = named === settings.address;
    load(new URL(named, location.href).href, named.split("/").pop());
  } else {
    element("loading").className = "done";
    element("drop").hidden = false;
  }
} catch (error) {
  fail(String(error.message || error));
}
