import { expect, test } from "vitest";
import { Signal } from "./signal";

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
