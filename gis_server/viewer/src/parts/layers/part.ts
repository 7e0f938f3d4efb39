/** Which layers the map shows, and the list in which they are chosen. */

import { h } from "../../page/dom";
import { api } from "../../server/api";
import type { Layer } from "../../server/records";
import type { Context } from "../../session/context";
import { type LayerPanel, layerPanel } from "./panel";

export function layersPart(context: Context): void {
  const { layers, view, page, drawing, waiting } = context;
  let panel: LayerPanel | null = null;

  const put = (layer: Layer) => {
    const shown = view.shown.get(layer.id);
    const state = layers.state(layer);
    shown?.map.setVisible(state.visible);
    shown?.map.setOpacity(state.opacity);
    if (state.visible && shown) waiting.run(async () => void (await shown.load()));
  };
  const draw = () => {
    panel = layerPanel(layers.all, (layer) => layers.state(layer), {
      setVisible: (layer, visible) => layers.change(layer, { visible }),
      setOpacity: (layer, opacity) => layers.change(layer, { opacity }),
      zoomTo: (layer) => view.fit(layer.bounds),
      showProvenance: (layer) => waiting.run(() => showProvenance(context, layer)),
      setEllipseFactor: (factor) => {
        drawing.ellipseFactor = factor;
        view.redraw();
      },
    });
    panel.setEllipseFactor(drawing.ellipseFactor);
    page.layers.replaceChildren(panel.element);
    for (const layer of layers.all) put(layer);
  };

  layers.changed.on((layer) => {
    panel?.set(layer.id, layers.state(layer));
    put(layer);
  });
  layers.replaced.on(draw);
  context.signals.ellipses.on((factor) => panel?.setEllipseFactor(factor));
  draw();
}

async function showProvenance({ page }: Context, layer: Layer): Promise<void> {
  const document = await api.provenance(layer);
  const text = h("pre", { class: "json" }, JSON.stringify(document, null, 2));
  page.dialog(`${layer.title}: how it was made`, text);
}
