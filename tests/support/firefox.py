"""Firefox for Playwright, which starts this in its place: `python firefox.py FIREFOX ARGUMENT...`.

Playwright drives a Firefox that it did not build over WebDriver BiDi, and begins every page with a
command that Firefox ESR 153 does not have (`emulation.setMediaFeaturesOverride`) and that tests in
Firefox do not need. It is answered here; all else is forwarded between the two.
"""

from __future__ import annotations

import asyncio
import json
import re
import signal
import sys
from functools import partial

from websockets.asyncio.client import connect
from websockets.asyncio.server import serve

UNKNOWN = "emulation.setMediaFeaturesOverride"
LISTENS = re.compile(r"WebDriver BiDi listening on (ws://\S+)")
NO_LIMIT = None


async def pass_on(client, browser: str) -> None:
    """Forward messages between one client and the browser, until either disconnects."""
    async with connect(browser + client.request.path, max_size=NO_LIMIT, proxy=None) as server:

        async def request() -> None:
            async for message in client:
                requested = json.loads(message)
                if requested["method"] == UNKNOWN:
                    answer = {"type": "success", "id": requested["id"], "result": {}}
                    await client.send(json.dumps(answer))
                else:
                    await server.send(message)

        async def answer() -> None:
            async for message in server:
                await client.send(message)

        both = [asyncio.ensure_future(each()) for each in (request, answer)]
        await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)


async def run(command: list[str]) -> int:
    """Start Firefox, and have the reader of its log connect to this process instead of it."""
    firefox = await asyncio.create_subprocess_exec(*command, stderr=asyncio.subprocess.PIPE)
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, firefox.terminate)
    async for line in firefox.stderr:
        message_ = line.decode()
        if found := LISTENS.search(message_):
            talk = partial(pass_on, browser=found[1])
            proxy = await serve(talk, "127.0.0.1", 0, max_size=NO_LIMIT)
            message_ = (
                f"WebDriver BiDi listening on ws://127.0.0.1:{proxy.sockets[0].getsockname()[1]}\n"
            )
        sys.stderr.write(message_)
        sys.stderr.flush()
    return await firefox.wait()


if __name__ == "__main__":
    sys.exit(asyncio.run(run(sys.argv[1:])))
