import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { gathered, publishedText } from "./gather";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

test("what comes in a burst is worked on once, when it has ended", () => {
  const worked: (readonly number[])[] = [];
  const calls = gathered<number>(300, (all) => worked.push(all));
  for (const [k, wait] of [100, 200, 299].entries()) {
    calls.add(k);
    vi.advanceTimersByTime(wait);
  }
  expect(worked).toEqual([]);
  vi.advanceTimersByTime(300);
  expect(worked).toEqual([[0, 1, 2]]);
  calls.add(3);
  vi.advanceTimersByTime(300);
  expect(worked).toEqual([[0, 1, 2], [3]]);
});

test("what is to be tried again waits longer, or for the next burst", () => {
  const worked: (readonly number[])[] = [];
  const calls = gathered<number>(300, (all) => worked.push(all));
  calls.add(0, 2000);
  vi.advanceTimersByTime(1999);
  expect(worked).toEqual([]);
  vi.advanceTimersByTime(1);
  expect(worked).toEqual([[0]]);
  calls.add(1, 2000);
  calls.add(2);
  vi.advanceTimersByTime(300);
  expect(worked).toEqual([[0], [1, 2]]);
});

test("a cancelled burst is forgotten", () => {
  const worked: unknown[] = [];
  const calls = gathered<number>(300, (all) => worked.push(all));
  calls.add(1);
  calls.cancel();
  vi.advanceTimersByTime(1000);
  expect(worked).toEqual([]);
});

test("publishing is reported by number and place", () => {
  const stop = "mer2-site0010-drive0064";
  expect(publishedText([`${stop}/dtm`])).toBe(`1 layer of ${stop} published`);
  expect(publishedText([`${stop}/dtm`, `${stop}/dtm`, `${stop}/slope`])).toBe(
    `2 layers of ${stop} published`,
  );
  expect(publishedText([`${stop}/dtm`, "mer2/stops"])).toBe("2 layers of 2 places published");
});
