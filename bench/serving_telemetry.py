"""Gateways: telemetry of many machines, one sample a request, each machine on a connection of its own.

A process of its own, since its work would hold up whoever measures. The next sample of a machine is sent when it is due
and the one before has been acknowledged; it writes how many were after each second.
"""

import asyncio
import json
import sys
import time
from typing import Any

from serving_servers import HOST


async def main() -> None:
    """Read what to do from standard input; run until it is ended."""
    orders = json.loads(sys.stdin.readline())
    sent = [0]
    period_s, names = 1.0 / orders["hz"], orders["machines"]
    gateways = [
        asyncio.create_task(_gateway(orders, name, period_s, period_s * number / len(names), sent))
        for number, name in enumerate(names)
    ]
    while not any(gateway.done() for gateway in gateways):
        await asyncio.sleep(1.0)
        print(sent[0], flush=True)
    await asyncio.gather(*gateways)


async def _gateway(orders: dict[str, Any], name: str, period_s: float, first_s: float, sent: list[int]) -> None:
    reader, writer = await asyncio.open_connection(HOST, orders["port"])
    head = "".join(f"{key}: {value}\r\n" for key, value in orders["headers"].items())
    due_s = time.perf_counter() + first_s
    while True:
        await asyncio.sleep(max(0.0, due_s - time.perf_counter()))
        due_s = max(due_s + period_s, time.perf_counter() - period_s)
        sample = {"time": time.time(), "temperatures": orders["temperatures"]}
        content = json.dumps({"samples": [sample]})
        writer.write(
            f"POST /v1/machines/{name}/telemetry HTTP/1.1\r\nHost: bench\r\nContent-Type: application/json\r\n"
            f"Content-Length: {len(content)}\r\n{head}\r\n{content}".encode()
        )
        answer = (await reader.readuntil(b"\r\n\r\n")).lower()
        await reader.readexactly(int(answer.split(b"content-length:")[1].split(b"\r\n")[0]))
        sent[0] += b" 200 " in answer.split(b"\r\n")[0]


if __name__ == "__main__":
    asyncio.run(main())
