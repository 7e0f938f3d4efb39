"""What flows need to run: the engine, task runners, failures, progress, records and run pages.

It uses tasks and products but none of the flows: `flows`, `flows.service` and `flows.cli` import
it. `engine` and `children` must be importable before Prefect is, because they set what Prefect
reads at import.
"""
