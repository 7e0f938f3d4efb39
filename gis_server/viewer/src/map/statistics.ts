/** Mean and spread of a sample. */

export interface Statistics {
  readonly count: number;
  readonly mean: number;
  readonly sigma: number;
  /** 98th percentile of the absolute values. */
  readonly most: number;
}

const SHARE = 0.98;

/** Statistics of the known values; null if there are none. */
export function statistics(values: readonly number[]): Statistics | null {
  const known = values.filter(Number.isFinite);
  const count = known.length;
  if (count === 0) return null;
  const mean = known.reduce((sum, value) => sum + value, 0) / count;
  const square = known.reduce((sum, value) => sum + (value - mean) ** 2, 0) / count;
  const sizes = known.map(Math.abs).sort((a, b) => a - b);
  const most = sizes[Math.ceil(SHARE * (count - 1))] ?? 0;
  return { count, mean, sigma: Math.sqrt(square), most };
}
