/** The text beside the pointer about the feature under it. */

import { measured, scopeTitle, sigmaText } from "../../page/format";

export interface Tip {
  readonly title: string;
  readonly facts: readonly string[];
  /** A warning. */
  readonly caution?: string;
}

type Properties = Readonly<Record<string, unknown>>;
const number = (value: unknown): number | null => (typeof value === "number" ? value : null);

/** A tie point: its kind, residual, standard deviation, and the pairs it joins by their left images. */
export function tieTip({ kind, residual_px, sigma_m, pairs }: Properties): Tip {
  const [residual, sigma] = [number(residual_px), number(sigma_m)];
  const images = Array.isArray(pairs) ? pairs.map(String) : [];
  return {
    title: `tie point${kind ? ` · ${String(kind)}` : ""}`,
    facts: [
      residual === null
        ? "residual not known"
        : `residual ${measured(residual, "px", null, 0.01)} (rms)`,
      ...(sigma === null ? [] : [`σ of its place ${sigmaText(sigma)}`]),
      ...images,
    ],
  };
}

export function imageTip(properties: Properties): Tip {
  const { image, sol, instrument, eye, unpaired_because: reason, unpaired } = properties;
  const facts = [`sol ${sol ?? "?"} · ${instrument ?? ""} ${eye ?? ""}`];
  const title = String(image);
  if (!reason && unpaired !== true) return { title, facts };
  return { title, facts, caution: `without partner: ${reason ?? "no reason recorded"}` };
}

/** Text for any feature of a layer. */
export function tipOf(
  layer: { readonly kind: string; readonly title: string },
  of: Properties,
): Tip {
  if (layer.kind === "tie-points") return tieTip(of);
  if (typeof of.image === "string") return imageTip(of);
  return {
    title: scopeTitle(String(of.stop ?? layer.title)),
    facts: [String(of.solution ?? "")],
  };
}
