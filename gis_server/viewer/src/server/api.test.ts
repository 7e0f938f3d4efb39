import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { ApiError, api, UnreachableError, urls } from "./api";

beforeEach(() => vi.stubGlobal("sessionStorage", { getItem: () => null }));
afterEach(() => vi.unstubAllGlobals());

const answer = (status: number, body: unknown) =>
  vi.stubGlobal("fetch", async () => new Response(JSON.stringify(body), { status }));

test("names of missions are escaped in addresses", () => {
  expect(urls.layers("a b/c")).toBe("api/missions/a%20b%2Fc/layers");
});

test("a place is requested to a tenth of a millimetre", () => {
  expect(urls.identify("MER2", [12.345678, -0.00004])).toBe(
    "api/missions/MER2/identify?east=12.3457&north=-0.0000",
  );
});

test("images are filtered by what is known only", () => {
  expect(urls.images("MER2")).toBe("api/missions/MER2/images");
  expect(urls.images("MER2", { sol: 0, stop: null })).toBe("api/missions/MER2/images?sol=0");
  expect(urls.images("MER2", { sol: 156, stop: "mer2-site0010" })).toBe(
    "api/missions/MER2/images?sol=156&stop=mer2-site0010",
  );
});

test("a server that does not answer is distinguished from one that refuses", async () => {
  vi.stubGlobal("fetch", async () => {
    throw new TypeError("Failed to fetch");
  });
  await expect(api.layers("MER2")).rejects.toThrow(UnreachableError);
  answer(404, { detail: "no mission MERX" });
  await expect(api.layers("MERX")).rejects.toThrow(/^no mission MERX$/);
  await expect(api.layers("MERX")).rejects.toThrow(ApiError);
});

test("an error without a problem document is reported with its URL", async () => {
  answer(500, { detail: { what: "the server failed; its log has the cause" } });
  await expect(api.layers("MER2")).rejects.toThrow(
    /layers was answered with 500.*its log has the cause/,
  );
  answer(422, { detail: [{ loc: ["query", "east"], msg: "a number is expected" }] });
  await expect(api.layers("MER2")).rejects.toThrow(/layers was answered with 422.*a number/);
});

test("something else than a list is an error that shows it", async () => {
  answer(200, { detail: "hello" });
  await expect(api.layers("MER2")).rejects.toThrow(/expected a list of layers.*hello/);
});

test("a list is read from its first page to its last", async () => {
  const requested: string[] = [];
  vi.stubGlobal("fetch", async (url: string) => {
    requested.push(url);
    const link = '<?limit=2&offset=0>; rel="prev", <?limit=2&offset=2>; rel="next"';
    return new Response(JSON.stringify([requested.length]), {
      headers: requested.length === 1 ? { Link: link } : {},
    });
  });
  expect(await api.layers("MER2")).toEqual([1, 2]);
  expect(requested).toEqual([
    "api/missions/MER2/layers",
    "api/missions/MER2/layers?limit=2&offset=2",
  ]);
});

test("the layers that the start has no room for are read after it", async () => {
  const requested: string[] = [];
  vi.stubGlobal("fetch", async (url: string) => {
    requested.push(url);
    if (url !== "api/start") return new Response('["second"]');
    return new Response(JSON.stringify({ missions: [], mission: "MER2", layers: ["first"] }), {
      headers: {
        Link: '<missions/MER2/layers?limit=1&offset=1>; rel="next"',
        "Last-Event-ID": "7",
      },
    });
  });
  expect(await api.start()).toMatchObject({ layers: ["first", "second"], lastEvent: "7" });
  expect(requested[1]).toBe("api/missions/MER2/layers?limit=1&offset=1");
});
