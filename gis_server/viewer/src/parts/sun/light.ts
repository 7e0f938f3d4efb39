/** The time of day in words. */

/** `14.5` as `14:30`. */
export function clock(hours: number): string {
  const minutes = Math.round(hours * 60) % 1440;
  const two = (value: number) => String(value).padStart(2, "0");
  return `${two(Math.floor(minutes / 60))}:${two(minutes % 60)}`;
}
