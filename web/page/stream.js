// A file behind an address: it is decoded and shown as its bytes come, layer by layer, or, from a
// server that gives parts of files, first where the camera looks.

const ATTEMPTS = 5;
const REQUEST = 1 << 16; // bytes of neighbouring chunks that are asked for together, at most
const AT_ONCE = 4; // requests
const NUMBERS = 9; // of a chunk, see page_chunks
const ASIDE = 1000; // added to the number of a chunk that the camera does not see
const WIDE = 0.5; // cosine of the angle from which on it does not

async function ask(address, options) {
  const answer = await fetch(address, options).catch(() => {
    throw new Error(`${address}: nothing answers, or it gives nothing to pages of other sites`);
  });
  if (!answer.ok) throw new Error(`${address}: the server says ${answer.status}`);
  return answer;
}

// The bytes of an answer, in pieces, as an asynchronous generator; `ranges`: whether the server
// gives parts of files, too. A connection that breaks before the first piece is read is tried
// again: browsers throw away what came just before it broke.
async function* pieces(address) {
  for (let attempt = 1, come = false; ; attempt++) {
    const answer = await ask(address);
    const ranges = answer.headers.get("Accept-Ranges") === "bytes";
    const reader = answer.body.getReader();
    try {
      for (let next; !(next = await reader.read()).done; come = true)
        yield {piece: next.value, ranges};
      return;
    } catch (error) {
      if (come || attempt === ATTEMPTS) throw error;
    } finally {
      reader.cancel().catch(() => {});
    }
  }
}

// The bytes of a part of the file. Browsers let one request at a time look into their store.
async function part(address, begin, end) {
  for (let attempt = 1; ; attempt++) {
    try {
      const headers = {Range: `bytes=${begin}-${end - 1}`};
      const answer = await ask(address, {headers, cache: "no-store"});
      const bytes = answer.status === 206 ? new Uint8Array(await answer.arrayBuffer()) : [];
      if (bytes.length === end - begin) return bytes;
      throw new Error(`${address}: the server gives other bytes than it was asked for`);
    } catch (error) {
      if (attempt === ATTEMPTS) throw error;
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

// The chunks of the file: where their bytes are, their layers, and spheres around them.
function chunksOf(exports) {
  const count = exports.page_chunk_count();
  const numbers = new Float64Array(memory.buffer, exports.page_chunks(), NUMBERS * count).slice();
  return Array.from({length: count}, (_, index) => {
    const [begin, end, layer, ...bounds] = numbers.subarray(NUMBERS * index, NUMBERS * (index + 1));
    const middle = [0, 1, 2].map((axis) => (bounds[axis] + bounds[axis + 3]) / 2);
    const radius = Math.hypot(...middle.map((x, axis) => x - bounds[axis]));
    return {index, begin, end, layer, middle, radius, asked: false};
  });
}

// Chunks of lower numbers come first: of what the camera sees, the coarse layers, then the near
// chunks.
function rank(chunk) {
  if (!camera) return chunk.index;
  const {centre, row} = camera;
  const away = chunk.middle.map((x, i) => x - centre[i]);
  const distance = Math.hypot(...away);
  const depth = row[3] + chunk.middle.reduce((sum, x, i) => sum + row[i] * x, 0);
  const seen = depth + chunk.radius >= WIDE * (distance - chunk.radius);
  return (seen ? 0 : ASIDE) + chunk.layer + distance / (distance + chunk.radius + 1);
}

// The first chunk that was not asked for, by rank, with neighbours that belong to its request.
function choose(chunks) {
  let best = null, least = Infinity;
  for (const chunk of chunks) {
    const number = chunk.asked ? Infinity : rank(chunk);
    if (number < least) [best, least] = [chunk, number];
  }
  if (!best) return [];
  const near = (chunk) => chunk && !chunk.asked && chunk.layer === best.layer
    && (rank(chunk) < ASIDE) === (least < ASIDE);
  let first = best.index, last = best.index;
  const size = (from, to) => chunks[to].end - chunks[from].begin;
  while (near(chunks[last + 1]) && size(first, last + 1) <= REQUEST) last++;
  while (near(chunks[first - 1]) && size(first - 1, last) <= REQUEST) first--;
  const chosen = chunks.slice(first, last + 1);
  for (const chunk of chosen) chunk.asked = true;
  return chosen;
}

// Once the first layers are shown, fetch all other chunks, and at last the details. `room`: of the
// file's bytes, of which `arrived` have come.
async function look(exports, address, room, arrived, size) {
  const chunks = chunksOf(exports);
  let come = arrived;
  const fill = async (begin, end) => {
    const bytes = await part(address, begin, end);
    new Uint8Array(memory.buffer, room + begin, bytes.length).set(bytes);
    come += bytes.length;
  };
  const take = async (chosen) => {
    for (const {index} of chosen) {
      checked(exports, exports.page_take(index));
      await new Promise((done) => setTimeout(done));
    }
    postMessage({kind: "progress", share: come / size});
    if (chosen.length) show(exports, false);
  };
  const ready = exports.page_layers(1);
  for (const chunk of chunks) chunk.asked = chunk.layer < ready || chunk.end <= arrived;
  await take(chunks.filter(({layer, end}) => layer >= ready && end <= arrived));
  const fetchAll = async () => {
    for (let chosen; (chosen = choose(chunks)).length > 0;) {
      await fill(chosen[0].begin, chosen.at(-1).end);
      await take(chosen);
    }
  };
  const loops = await Promise.allSettled(Array.from({length: AT_ONCE}, fetchAll));
  for (const {reason} of loops) if (reason) throw reason;
  for (let {end} = chunks.at(-1); end < size; end += REQUEST)
    await fill(end, Math.min(end + REQUEST, size));
  await decode(exports, exports.page_arrived(size));
}

async function stream(wasm, address) {
  const exports = await start(wasm);
  let front = new Uint8Array(0), room = 0, arrived = 0, size = 0, needed = 0, open = false;
  let byPlace = false;
  try {
    for await (const {piece, ranges} of pieces(address)) {
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
      byPlace = ranges && code && exports.page_chunk_count() > 0 && size - arrived > REQUEST;
      if (byPlace) break;
    }
    if (byPlace) await look(exports, address, room, arrived, size);
  } catch (error) { // what has come is a scene, unless its first layer is cut
    if (!code || exports.page_problem()) throw error;
  }
  if (!open) throw new Error(`${address}: is cut; load it again`);
  if (byPlace) show(exports, true);
  else await advance(exports, arrived, true);
}
