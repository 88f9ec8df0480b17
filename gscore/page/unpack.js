// Decodes the text in the page for the graphics card, the inverse of pack.py.

const ALPHABET = Array.from({ length: 94 }, (_, i) => String.fromCharCode(33 + i))
  .filter((letter) => !"\"&'<>\\`".includes(letter))
  .slice(0, 85);

// Five characters are a big-endian number in base 85: four bytes.
function decode85(text, length) {
  const digit = new Uint8Array(128);
  ALPHABET.forEach((letter, value) => (digit[letter.charCodeAt(0)] = value));
  const groups = text.length / 5;
  const bytes = new DataView(new ArrayBuffer(groups * 4));
  for (let i = 0, at = 0; i < groups; i++) {
    let value = 0;
    for (let k = 0; k < 5; k++) value = value * 85 + digit[text.charCodeAt(at++)];
    bytes.setUint32(i * 4, value);
  }
  return new Uint8Array(bytes.buffer, 0, length);
}

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Columns of numbers in sequence.
class Reader {
  constructor(bytes, count) {
    this.bytes = bytes;
    this.count = count;
    this.at = 0;
  }

  take(count) {
    this.at += count;
    return this.bytes.subarray(this.at - count, this.at);
  }

  floats(count) {
    const found = new Float32Array(this.bytes.slice(this.at, this.at + 4 * count).buffer);
    this.at += 4 * count;
    return found;
  }

  narrow(columns) {
    return Array.from({ length: columns }, () => this.take(this.count));
  }

  wide(columns, { signed = false } = {}) {
    const low = this.narrow(columns);
    const high = this.narrow(columns);
    return low.map((column, c) => {
      const found = new (signed ? Int16Array : Uint16Array)(this.count);
      for (let i = 0; i < found.length; i++) found[i] = column[i] | (high[c][i] << 8);
      return found;
    });
  }
}

// Half-precision floats, in pairs of 16 bits, as unpackHalf2x16 of the shader reads them.
const HALF = (() => {
  const number = new Float32Array(1);
  const bits = new Uint32Array(number.buffer);
  return (value) => {
    number[0] = Math.min(Math.max(value, -65504), 65504);
    const sign = (bits[0] >>> 16) & 0x8000;
    const magnitude = bits[0] & 0x7fffffff;
    if (magnitude < 0x33000001) return sign; // below half of the smallest subnormal
    if (magnitude < 0x38800000) return sign | Math.round(Math.abs(number[0]) * 16777216);
    return sign | ((magnitude - 0x38000000 + 0x0fff + ((magnitude >> 13) & 1)) >> 13);
  };
})();

// A texel has four 32-bit words. Those of a splat: 0: position (three floats), rotation (largest
// component and the three others in a byte each); 1: sizes, colour and opacity as halves; then the
// higher SH coefficients, four per word.
function texelsOf(degree) {
  return 2 + Math.ceil((3 * ((degree + 1) ** 2 - 1)) / 16);
}

async function unpack(head, text) {
  const { count, blocks } = head;
  const from = new Reader(await inflate(decode85(text, head.bytes)), count);
  const lengths = from.take(blocks);
  const boxes = from.floats(blocks * 6);
  const places = from.wide(3);
  const largest = from.narrow(1)[0];
  const turns = from.narrow(3);
  const sizes = from.wide(3);
  const opacity = from.narrow(1)[0];
  const color = from.wide(3, { signed: true });
  const rest = from.narrow(3 * ((head.degree + 1) ** 2 - 1));
  const means = new Float32Array(count * 3);
  const texels = texelsOf(head.degree);
  const words = new Uint32Array(count * texels * 4);
  const floats = new Float32Array(words.buffer);
  const bytes = new Uint8Array(words.buffer);
  const log = (axis, i) => sizes[axis][i] * head.size_step + head.size_low;
  const shade = (channel, i) =>
    head.color_step * head.color_axes.reduce((sum, axis, k) => sum + axis[channel] * color[k][i], 0);
  for (let i = 0, block = 0, end = lengths[0] + 1; i < count; i++) {
    if (i === end) end += lengths[++block] + 1;
    const at = i * texels * 4;
    const box = block * 6;
    for (let axis = 0; axis < 3; axis++) {
      const low = boxes[box + axis];
      const side = boxes[box + 3 + axis] - low;
      means[3 * i + axis] = low + (places[axis][i] / (head.places - 1)) * side;
      floats[at + axis] = means[3 * i + axis];
    }
    words[at + 3] = largest[i] | (turns[0][i] << 8) | (turns[1][i] << 16) | (turns[2][i] << 24);
    words[at + 4] = HALF(log(0, i)) | (HALF(log(1, i)) << 16);
    words[at + 5] = HALF(log(2, i)) | (HALF(opacity[i] / 255) << 16);
    words[at + 6] = HALF(shade(0, i)) | (HALF(shade(1, i)) << 16);
    words[at + 7] = HALF(shade(2, i));
    for (let k = 0; k < rest.length; k++) bytes[(at + 8) * 4 + k] = rest[k][i];
  }
  return { count, texels, words, means, opacity };
}
