// A zip archive of stored files (PKWARE's APPNOTE, method 0): images are compressed already. The page makes it, because the
// server sends frames one by one or as a multipart stream, which no desktop opens.

// Limits on the archive's bytes and number of files without the 64-bit extension.
export const MOST_BYTES = 0xffffffff, MOST_FILES = 0xffff;
const UTF8 = 0x0800, VERSION = 20;

const CRC = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let bit = 0; bit < 8; bit++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

function crc32(bytes) {
  let crc = ~0;
  for (const byte of bytes) crc = CRC[(crc ^ byte) & 0xff] ^ (crc >>> 8);
  return ~crc >>> 0;
}

export class Zip {
  constructor(date = new Date()) {
    this.time = date.getHours() << 11 | date.getMinutes() << 5 | date.getSeconds() >> 1;
    this.day = date.getFullYear() - 1980 << 9 | date.getMonth() + 1 << 5 | date.getDate();
    this.parts = [];
    this.entries = [];
    this.at = 0;
  }

  async add(name, blob) {
    const crc = crc32(new Uint8Array(await blob.arrayBuffer())), text = new TextEncoder().encode(name);
    const facts = [[VERSION, 2], [UTF8, 2], [0, 2], [this.time, 2], [this.day, 2], [crc, 4], [blob.size, 4], [blob.size, 4], [text.length, 2], [0, 2]];
    const head = fields([[0x04034b50, 4], ...facts]);
    // The directory repeats these fields, with no comment, disk or attributes, and with the position of the entry.
    this.entries.push(fields([[0x02014b50, 4], [VERSION, 2], ...facts, [0, 2], [0, 2], [0, 2], [0, 4], [this.at, 4]]), text);
    this.parts.push(head, text, blob);
    this.at += head.length + text.length + blob.size;
  }

  finish() {
    const count = this.entries.length / 2, size = this.entries.reduce((sum, part) => sum + part.length, 0);
    const end = fields([[0x06054b50, 4], [0, 2], [0, 2], [count, 2], [count, 2], [size, 4], [this.at, 4], [0, 2]]);
    return new Blob([...this.parts, ...this.entries, end], { type: 'application/zip' });
  }
}

// Little-endian numbers of these sizes in bytes.
function fields(list) {
  const bytes = new Uint8Array(list.reduce((sum, [, size]) => sum + size, 0)), view = new DataView(bytes.buffer);
  let at = 0;
  for (const [value, size] of list) {
    if (size === 2) view.setUint16(at, value, true); else view.setUint32(at, value, true);
    at += size;
  }
  return bytes;
}
