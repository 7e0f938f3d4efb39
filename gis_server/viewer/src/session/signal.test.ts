import { expect, test } from "vitest";
import { HeldSignal, Signal } from "./signal";

test("listeners hear what comes after them until they stop", () => {
  const signal = new Signal<number>();
  const heard: number[] = [];
  signal.emit(1);
  const stop = signal.on((value) => heard.push(value));
  signal.emit(2);
  stop();
  signal.emit(3);
  expect(heard).toEqual([2]);
});

test("a listener that stops another while both are called breaks nothing", () => {
  const signal = new Signal<string>();
  const heard: string[] = [];
  const stopSecond: (() => void)[] = [];
  signal.on(() => stopSecond[0]?.());
  stopSecond.push(signal.on((value) => heard.push(value)));
  signal.emit("a");
  signal.emit("b");
  expect(heard).toEqual(["a"]);
});

test("of calls before all listeners exist, only the last reaches them, once", () => {
  const signal = new HeldSignal<string>();
  const heard: string[] = [];
  signal.on((value) => heard.push(`one ${value}`));
  signal.emit("a");
  signal.emit("b");
  signal.on((value) => heard.push(`two ${value}`));
  expect(heard).toEqual([]);
  signal.release();
  expect(heard).toEqual(["one b", "two b"]);
  signal.emit("c");
  signal.release();
  expect(heard).toEqual(["one b", "two b", "one c", "two c"]);
});
