// The worker: decodes the file, runs the networks for the camera, sorts. wasm does the work.
"use strict";

const SLICE = 2048; // anchors per turn: between turns, messages are taken and the order renewed
const STILL = 1e-6; // a camera that moved less, in scene units, stands still

let code, memory; // what page.c exports, and its memory
let camera = null; // the newest: {centre, row: depth's coefficients, number}
let seen = null; // the centre that the last set, or the one that is being made, is for
let stale = false; // whether more was decoded since that set began
let making = false;
let sorted = -1; // number of the camera of the last order
let awake = false;

const turns = new MessageChannel(); // a turn that comes after messages that wait
turns.port1.onmessage = () => { awake = false; turn(); };

function wake() {
  if (!awake && code) {
    awake = true;
    turns.port2.postMessage(0);
  }
}

function copy(Type, at, length) {
  return new Type(memory.buffer, at, length).slice();
}

function text(at) {
  const bytes = new Uint8Array(memory.buffer, at);
  return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
}

function fail(reason) {
  code = null;
  postMessage({kind: "failed", reason});
}

// A hash as `clgs info` shows it: that of splats as a number, that of a scene as bytes.
function hex(at, splats) {
  const bytes = [...new Uint8Array(memory.buffer, at, 8)];
  return (splats ? bytes.reverse() : bytes).map((byte) => byte.toString(16).padStart(2, "0"))
    .join("");
}

// `first`: with the positions, to choose a view by.
function facts(first) {
  const [items, near, alphaCut, alphaMax, blur, ...rest] =
    copy(Float64Array, code.page_numbers(), 20);
  const hashes = code.page_hashes();
  return {
    items, near, alphaCut, alphaMax, blur, background: rest.slice(0, 3), splats: rest[3],
    learned: rest[4], origin: [...rest.slice(5, 8)], photos: [...rest.slice(8)],
    hash: hex(hashes, rest[3]), expectedHash: hex(hashes + 8, rest[3]),
    positions: first ? copy(Float32Array, code.page_positions(), 3 * items) : null,
    layers: code.page_layers(0), ready: code.page_layers(1),
  };
}

async function start(wasm) {
  code = null;
  camera = seen = null;
  making = false;
  sorted = -1;
  const {instance} = await WebAssembly.instantiate(wasm);
  memory = instance.exports.memory;
  return instance.exports;
}

// Room for a file of this size, with its first bytes.
function place(exports, size, first) {
  const room = exports.page_room(size);
  if (!room) throw new Error(text(exports.page_problem()));
  new Uint8Array(memory.buffer, room, first.length).set(first);
  return room;
}

// What a function of page.c gives, unless it has failed.
function checked(exports, result) {
  if (result < 0) throw new Error(text(exports.page_problem()));
  return result;
}

// Take `steps` steps; in a scene that is shown already, pictures go on in between.
async function decode(exports, steps) {
  for (let left = steps; left > 0;) {
    left = checked(exports, exports.page_step());
    if (!code) postMessage({kind: "progress", share: 1 - left / steps});
    else await new Promise((done) => setTimeout(done));
  }
}

// Say what there is, and draw it; `whole`: no more bytes will come.
function show(exports, whole) {
  const first = !code;
  code = exports;
  const scene = facts(first);
  if (whole && scene.ready < 1) throw new Error("the file is cut before its first layer ends");
  stale = true;
  postMessage({kind: "scene", ...scene, whole}, first ? [scene.positions.buffer] : []);
  wake();
}

async function load(wasm, file) {
  const exports = await start(wasm);
  place(exports, file.length, file);
  await decode(exports, checked(exports, exports.page_open()));
  show(exports, true);
}

function moved() {
  return !seen || camera.centre.some((x, i) => Math.abs(x - seen[i]) > STILL);
}

// Post the order for the newest camera, and a set of Gaussians that it is for, if it is a new one.
function sendOrder(records) {
  const {row, number} = camera;
  const count = code.page_sort(row[0], row[1], row[2], row[3]);
  const order = copy(Uint32Array, code.page_order(), count);
  sorted = number;
  const message = {kind: "order", order, number, settled: !making && !stale && !moved()};
  const owned = [order.buffer];
  if (records) {
    message.records = records;
    owned.push(records.buffer);
  }
  postMessage(message, owned);
}

function turn() {
  if (!code || !camera) return;
  if (sorted !== camera.number && sorted >= 0) sendOrder(null);
  if (!making && (stale || moved())) {
    seen = camera.centre;
    stale = false;
    code.page_begin(seen[0], seen[1], seen[2]);
    making = true;
  }
  if (making && code.page_add(SLICE) === 0) {
    making = false;
    sendOrder(copy(Uint32Array, code.page_records(), 12 * code.page_count()));
  }
  if (making || stale || moved()) wake();
}

onmessage = ({data}) => {
  if (data.kind === "load") {
    const loading = data.address ? stream(data.wasm, data.address) : load(data.wasm, data.file);
    loading.catch((error) => fail(String(error.message || error)));
  } else {
    camera = data.camera;
    wake();
  }
};
