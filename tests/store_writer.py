"""A process that has children write samples as the service does, and kills each at a random moment.

It is forked, since a new interpreter for each of a hundred lives would take minutes. Called with a database, the number
of lives and a seed, it prints `life writer number` for each sample that a child was told to be durable.
"""

import asyncio
import os
import random
import select
import signal
import sys
import time

import alembic.command  # noqa: F401 (for the first migration: children inherit what is imported)
import psycopg  # noqa: F401

from service.store.journal import Insert
from service.store.store import Store, open_store
from service.store.tables import telemetry

WRITERS = 4
LONGEST_S = 0.1


async def write(store: Store, life: int, writer: int, pipe: int) -> None:
    """Write one sample after another, and tell each that is durable."""
    number = 0
    while True:
        row = {"machine": f"{life}-{writer}", "time_s": float(number), "received_s": 0.0, "sample": "{}" * 50}
        store.journal.write(Insert(telemetry, [row]))
        await store.journal.durable(30.0)
        os.write(pipe, f"{life} {writer} {number}\n".encode())
        number += 1


async def live(url: str, life: int, pipe: int) -> None:
    store = open_store(url)
    await asyncio.gather(*(write(store, life, writer, pipe) for writer in range(WRITERS)))


def main(url: str, lives: int, seed: int) -> None:
    rng = random.Random(seed)  # noqa: S311 (moments, not secrets)
    for life in range(lives):
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            os.close(reading)
            asyncio.run(live(url, life, writing))
        os.close(writing)
        if life % 4:  # the others may end before they write, or while they make their tables
            select.select([reading], [], [], 30.0)
        time.sleep(rng.uniform(0.0, LONGEST_S))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        with os.fdopen(reading, "rb") as pipe:
            sys.stdout.write("".join(line for line in pipe.read().decode().splitlines(True) if line.endswith("\n")))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
