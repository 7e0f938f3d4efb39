"""The flows: which tasks run in which order, for a downlink, a sol, a mission or a store.

What enters are folders, files and the settings; what leaves are published layers and reports of
what could not be made. `cli` holds the commands, `service` what `solmap up` keeps running,
`runtime` what flows need to run: engine, workers, failures, progress and records of runs. Imports
point from `cli` to `service` to the flows to `runtime`; science is called in `tasks`, never here,
and nothing is imported from `gis_server`.
"""

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    # `python -m solmap.flows.cli`: what is imported from here on is not looked for in the folder
    # that the user is in; with `-P` nothing is.
    del sys.path[0]

from solmap.products.store.garbage import collect_garbage_rarely

collect_garbage_rarely()  # else a tenth of the time of a command's imports
