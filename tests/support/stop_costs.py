"""Processing time of each stop by the records of its products: does a late one cost more?

`python -m tests.support.stop_costs STORE docs/figures/growth_images.png` prints a line a sol and
draws them. Sols come one after the other, so what was made between the networks of two is a stop's.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from solmap.products.model import ProductKind, ScopeLevel
from solmap.products.store.product_store import ProductStore

LEVELS = {ScopeLevel.PAIR, ScopeLevel.STOP, ScopeLevel.SOL}
"""What products of a sol are about; those of the whole mission come once a downlink."""


@dataclass(frozen=True, slots=True)
class StopCost:
    """What was spent between two networks."""

    sol: str
    products: int
    cpu_s: float
    peak_mb: float
    """Of the process, up to then."""
    network_kb: float


def stop_costs(store: ProductStore) -> Iterator[StopCost]:
    """The stops of a store in the order in which they were made."""
    notes = [(ref, store.provenance(ref)) for ref in store.refs() if ref.scope.level in LEVELS]
    notes.sort(key=lambda one: (one[1]["made_at"], one[0].kind is ProductKind.NETWORK))
    since: list[dict[str, float]] = []
    for ref, note in notes:
        since.append(note)
        if ref.kind is ProductKind.NETWORK:
            yield StopCost(
                ref.scope.name,
                len(since),
                round(sum(one["cpu_s"] for one in since), 2),
                max(one["peak_rss_mb"] for one in since),
                round(note["bytes"] / 1024, 1),
            )
            since = []


def image(costs: list[StopCost]) -> Figure:
    """Processor and memory by stop; the first has no maps of a stop before it."""
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    seconds, memory = figure.subplots(2, 1, sharex=True)
    number = range(1, len(costs) + 1)
    seconds.bar(list(number), [one.cpu_s for one in costs])
    seconds.set(ylabel="processor of products, s")
    memory.plot(list(number), [one.peak_mb for one in costs], ".-")
    memory.set(ylabel="peak of the process, MB", ylim=(0, None), xlabel="stop")
    for axes in (seconds, memory):
        axes.grid(alpha=0.3)
    return figure


def main() -> None:
    """Print the stops of a store, and draw them."""
    costs = list(stop_costs(ProductStore.open(Path(sys.argv[1]))))
    for one in costs:
        sys.stdout.write(f"{one}\n")
    figure = image(costs)
    FigureCanvasAgg(figure)
    figure.savefig(sys.argv[2], dpi=110)


if __name__ == "__main__":
    main()
