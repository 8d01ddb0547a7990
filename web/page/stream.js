// A file behind an address: layers are decoded and shown as their bytes come.

const ATTEMPTS = 5;

// The bytes of an answer, in pieces, as an asynchronous generator. A connection that breaks before
// the first piece is read is tried again: browsers throw away what came just before it broke.
async function* pieces(address) {
  for (let attempt = 1, come = false; ; attempt++) {
    const answer = await fetch(address).catch(() => {
      throw new Error(`${address}: nothing answers, or it gives nothing to pages of other sites`);
    });
    if (!answer.ok) throw new Error(`${address}: the server says ${answer.status}`);
    const reader = answer.body.getReader();
    try {
      for (let next; !(next = await reader.read()).done; come = true) yield next.value;
      return;
    } catch (error) {
      if (come || attempt === ATTEMPTS) throw error;
    }
  }
}

function joined(first, second) {
  const both = new Uint8Array(first.length + second.length);
  both.set(first);
  both.set(second, first.length);
  return both;
}

// Decode and show the layers that are complete with this many bytes.
async function advance(exports, arrived, whole) {
  const steps = exports.page_arrived(arrived);
  if (steps === 0 && !whole) return;
  await decode(exports, steps);
  if (exports.page_layers(1) > 0 || whole) show(exports, whole);
}

async function stream(wasm, address) {
  const exports = await start(wasm);
  let front = new Uint8Array(0), room = 0, arrived = 0, size = 0, needed = 0, open = false;
  try {
    for await (const piece of pieces(address)) {
      arrived += piece.length;
      if (room) {
        if (arrived > size) throw new Error(`${address}: is longer than it says; load it again`);
        new Uint8Array(memory.buffer, room + arrived - piece.length, piece.length).set(piece);
      } else {
        front = joined(front, piece);
        place(exports, front.length, front);
        size = checked(exports, exports.page_size(0));
        needed = exports.page_size(1);
        if (size === 0) continue;
        room = place(exports, Math.max(size, front.length), front);
      }
      if (!open && arrived >= needed) {
        exports.page_arrived(arrived);
        checked(exports, exports.page_open());
        open = true;
      }
      if (open && arrived < size) await advance(exports, arrived, false);
      if (!code) postMessage({kind: "progress", share: arrived / size});
    }
  } catch (error) { // what has come is a scene, unless its first layer is cut
    if (!code) throw error;
  }
  if (!open) throw new Error(`${address}: is cut; load it again`);
  await advance(exports, arrived, true);
}
