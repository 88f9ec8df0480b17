// Worker: indices of the splats in front of a camera, farthest first.
// Bits of positive floats have the same order as their values: two passes of a counting sort, 16
// bits each, sort depths exactly, and equal ones by index.
"use strict";
let means, keys, indices, spare, spareKeys;
const counts = [new Uint32Array(65536), new Uint32Array(65536)];

function depths(position, forward, near) {
  const values = new Float32Array(keys.buffer);
  const [px, py, pz] = position;
  const [fx, fy, fz] = forward;
  let found = 0;
  for (let i = 0, at = 0; i < means.length / 3; i++, at += 3) {
    const z = (means[at] - px) * fx + (means[at + 1] - py) * fy + (means[at + 2] - pz) * fz;
    if (z > near) {
      values[found] = z;
      indices[found++] = i;
    }
  }
  return found;
}

function pass(found, shift, count, [fromKeys, from], [toKeys, to]) {
  // Larger keys come first.
  for (let value = 65535, sum = 0; value >= 0; value--) {
    const here = count[value];
    count[value] = sum;
    sum += here;
  }
  for (let i = 0; i < found; i++) {
    const place = count[(fromKeys[i] >>> shift) & 65535]++;
    toKeys[place] = fromKeys[i];
    to[place] = from[i];
  }
}

function sorted({ position, forward, near }) {
  const found = depths(position, forward, near);
  counts.forEach((count) => count.fill(0));
  for (let i = 0; i < found; i++) {
    counts[0][keys[i] & 65535]++;
    counts[1][keys[i] >>> 16]++;
  }
  pass(found, 0, counts[0], [keys, indices], [spareKeys, spare]);
  pass(found, 16, counts[1], [spareKeys, spare], [keys, indices]);
  return indices.slice(0, found);
}

onmessage = ({ data }) => {
  if (data.means) {
    means = data.means;
    [keys, indices, spare, spareKeys] = [0, 0, 0, 0].map(() => new Uint32Array(means.length / 3));
    return;
  }
  const began = performance.now();
  const order = sorted(data);
  postMessage({ order, number: data.number, ms: performance.now() - began }, [order.buffer]);
};
