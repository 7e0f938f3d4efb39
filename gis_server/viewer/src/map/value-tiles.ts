/**
 * Tiles of values as the server sends them (`docs/reference/http-api.md`): 258 x 258 values, the outermost of which
 * belong to the neighbours, so that computations with the eight cells around have no seam.
 */

/** Cells of a tile along a side, and with the cells around. */
export const SIDE = 256;
export const STRIDE = 258;
const HEAD_BYTES = 24;
/** A tile with its gradients is 0.8 MB. */
const MOST_KEPT = 220;

/** Rise to the east and to the north on every cell; NaN where one of the nine cells is unknown. */
export interface Gradients {
  readonly east: Float32Array;
  readonly north: Float32Array;
}

export class ValueTile {
  private slopes: Gradients | null = null;

  /** `values` has 258 x 258 of them from the north-west, NaN where not measured; cells are `cell_m` wide. */
  constructor(
    readonly values: Float32Array,
    readonly cell_m: number,
  ) {}

  /** Value of a cell, both counted from the north-west. */
  at(row: number, column: number): number {
    return this.values[(row + 1) * STRIDE + column + 1] ?? Number.NaN;
  }

  /** The 256 values of a row, from the west. */
  row(row: number): Float32Array {
    const from = (row + 1) * STRIDE + 1;
    return this.values.subarray(from, from + SIDE);
  }

  get gradients(): Gradients {
    this.slopes ??= gradientsOf(this.values, this.cell_m);
    return this.slopes;
  }
}

export class TileFormatError extends Error {
  override readonly name = "TileFormatError";
}

/** Values of a tile's body. */
export function decode(body: ArrayBuffer): Float32Array {
  const head = new DataView(body);
  const magic = body.byteLength >= HEAD_BYTES ? head.getUint32(0, false) : 0;
  if (magic !== 0x534d5631)
    throw new TileFormatError(`a tile of values begins with SMV1, not 0x${magic.toString(16)}`);
  const [columns, rows] = [head.getUint16(4, true), head.getUint16(6, true)];
  const [offset, step] = [head.getFloat64(8, true), head.getFloat64(16, true)];
  const count = rows * columns;
  const low = new Uint8Array(body, HEAD_BYTES, count);
  const high = new Uint8Array(body, HEAD_BYTES + count, count);
  const values = new Float32Array(count);
  for (let row = 0, at = 0; row < rows; row += 1)
    for (let column = 0, k = 0; column < columns; column += 1, at += 1) {
      k = (k + (low[at] ?? 0) + ((high[at] ?? 0) << 8)) & 0xffff;
      values[at] = k ? offset + step * k : Number.NaN;
    }
  return values;
}

/** Gradient of the plane through the nine cells around each: `docs/reference/http-api.md`. */
export function gradientsOf(values: Float32Array, cell_m: number): Gradients {
  const east = new Float32Array(SIDE * SIDE);
  const north = new Float32Array(SIDE * SIDE);
  const scale = 1 / (6 * cell_m);
  const v = (at: number) => values[at] as number;
  for (let row = 0, to = 0; row < SIDE; row += 1)
    for (let column = 0; column < SIDE; column += 1, to += 1) {
      const here = (row + 1) * STRIDE + column + 1;
      const [up, down] = [here - STRIDE, here + STRIDE];
      const [nw, ne, sw, se] = [v(up - 1), v(up + 1), v(down - 1), v(down + 1)];
      const known = v(here) * 0; // NaN where the cell itself was not measured
      east[to] = (ne + v(here + 1) + se - (nw + v(here - 1) + sw)) * scale + known;
      north[to] = (nw + v(up) + ne - (sw + v(down) + se)) * scale + known;
    }
  return { east, north };
}

/** Cache of the most recently used tiles; each is requested once. */
export class ValueTiles {
  private readonly kept = new Map<string, Promise<ValueTile | null>>();
  /** Arrived tiles, readable at once; null where nothing was measured. */
  private readonly here = new Map<string, ValueTile | null>();

  constructor(private readonly most = MOST_KEPT) {}

  /** The tile at an address; null where nothing was measured. */
  get(url: string, cell_m: number): Promise<ValueTile | null> {
    const known = this.kept.get(url);
    if (known) {
      this.kept.delete(url);
      this.kept.set(url, known);
      return known;
    }
    const loading = fetchTile(url, cell_m);
    this.kept.set(url, loading);
    loading.then(
      (tile) => this.here.set(url, tile),
      () => this.forget(url),
    );
    for (const old of this.kept.keys()) {
      if (this.kept.size <= this.most) break;
      this.forget(old);
    }
    return loading;
  }

  /** A tile that has arrived; undefined if not. */
  peek(url: string): ValueTile | null | undefined {
    return this.here.get(url);
  }

  private forget(url: string): void {
    this.kept.delete(url);
    this.here.delete(url);
  }
}

/** URLs contain digests, so tiles stay valid as long as the page is open. */
export const valueTiles = new ValueTiles();

async function fetchTile(url: string, cell_m: number): Promise<ValueTile | null> {
  const answer = await fetch(url);
  if (answer.status === 204) return null;
  if (!answer.ok) throw new TileFormatError(`${url} was answered with ${answer.status}`);
  return new ValueTile(decode(await answer.arrayBuffer()), cell_m);
}

export const tileUrl = (template: string, z: number, x: number, y: number) =>
  template.replace("{z}", String(z)).replace("{x}", String(x)).replace("{y}", String(y));
