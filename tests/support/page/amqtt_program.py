"""``amqtt_program.py PORT FILE USER PASSWORD``: a broker on loopback that lets one user in; FILE gets the hash."""

import asyncio
import sys
from pathlib import Path

from amqtt.broker import Broker
from pwdlib.hashers.argon2 import Argon2Hasher


async def serve(port: str, users: str, user: str, password: str) -> None:
    hasher = Argon2Hasher(time_cost=1, memory_cost=8, parallelism=1)
    Path(users).write_text(f"{user}:{hasher.hash(password)}\n")
    config = {
        "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}},
        "plugins": {"amqtt.plugins.authentication.FileAuthPlugin": {"password_file": users}},
    }
    broker = Broker(config)
    await broker.start()
    print("listening", flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(serve(*sys.argv[1:]))
