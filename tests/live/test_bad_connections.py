"""Real clients and a real server, with a proxy between them that stalls and breaks connections."""

from __future__ import annotations

import asyncio

from support.bad_proxy import bad_proxy
from support.serving import run, serving

from synchronizar.live import messages as m
from synchronizar.live.client import Client

WORDS = 30


async def numbers(client: Client, last: int) -> list[int]:
    """What is said until `last` has come."""
    heard: list[int] = []
    async for word in client.messages():
        if isinstance(word, m.Said):
            heard.append(word.data)
            if heard[-1] == last:
                break
    return heard


def test_what_is_said_comes_once_and_in_order_and_a_client_comes_back_as_who_it_was() -> None:
    async def test() -> None:
        async with serving() as (server, address), bad_proxy(server.port, seed=1) as (proxy, port):
            far = address.replace(f":{server.port}/", f":{port}/")
            async with await Client.join(far, ["alice"]) as alice:
                bob = await Client.join(far, ["bob"])
                heard = asyncio.create_task(numbers(alice, WORDS))
                other = asyncio.create_task(numbers(bob, WORDS))
                for n in range(1, WORDS + 1):
                    await alice.say_message(m.Say("count", n))
                    await bob.say_message(m.Say("count", n))
                    await bob.send_pose("bob", float(n), [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
                assert await heard == await other == list(range(1, WORDS + 1))
                assert proxy.stalls > 0
                proxy.break_all()
                # Before the server has noticed, from another address.
                async with await Client.join(address, ["bob"], resume=bob.resume) as again:
                    assert again.welcome.you == ["bob"]
                    assert [member.name for member in again.welcome.members] == ["alice", "bob"]
                    room = server.hosts[0].room
                    while len(room.clients) > 1:
                        await asyncio.sleep(0.01)
                    assert room.devices["bob"].client is not None
                    assert room.devices["alice"].client is None
                await bob.close()

    run(test)
