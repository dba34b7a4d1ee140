"""A room and a program that joins it for two phones: poses and ranges go there, frames come back.

`python examples/room_client.py` opens a room of its own, `python examples/room_client.py ADDRESS` joins that of a
`synchronizar serve` in which nobody walks. The walk is made up and goes by its own time, faster than anybody walks; who
walks now leaves `time` out, stamps by a clock, and says no `Clock` and no `Finish`.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from synchronizar.live import BlockingClient
from synchronizar.live import messages as m

POSES_HZ, RANGES_HZ, SECONDS = 30, 10, 20
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def main() -> None:
    """Walk, and print what the room says."""
    if sys.argv[1:]:
        walk(sys.argv[1])
        return
    with opened_room() as address:
        walk(address)


def walk(address: str) -> None:
    """Two phones in a room; print where Alice has to draw Bob."""
    noise = np.random.default_rng(3)
    with BlockingClient.join(address, ["alice", "bob"], up="y", time="recorded") as client:
        for n in range(SECONDS * POSES_HZ):
            t = n / POSES_HZ
            client.send_poses([("alice", t, alice(t), UPRIGHT), ("bob", t, bob_in_his_own_frame(t), UPRIGHT)])
            if n % (POSES_HZ // RANGES_HZ) == 0:
                distance = np.linalg.norm(alice(t) - bob(t)) + noise.normal(0.0, 0.1)
                client.send_range(t, "alice", "bob", float(distance))
                client.say_message(m.Clock(t))
        client.say_message(m.Finish(t))
        client.until(lambda said: isinstance(said, m.Answer))
        for message in client.messages(timeout=0.0):
            if isinstance(message, m.Events):
                print(f"{message.t:5.1f} s  {'; '.join(message.events)}")

        users = client.frames.users
        bob_in_common = np.array(users["bob"].matrix) @ [*bob_in_his_own_frame(t), 1.0]
        found = (np.linalg.inv(users["alice"].matrix) @ bob_in_common)[:3]
        print(f"bob: {users['bob'].state}: {users['bob'].reason}")
        print(f"Alice draws Bob at {np.round(found, 2)} of her own axes; he is at {np.round(bob(t), 2)}")
        print(f"error: {np.linalg.norm(found - bob(t)):.3f} m")


@contextmanager
def opened_room() -> Iterator[str]:
    """A server on this machine alone, and the address of its room."""
    serve = [sys.executable, "-m", "synchronizar", "serve", "--json", "--no-tls", "--host", "127.0.0.1"]
    with subprocess.Popen([*serve, "--port", "0", "--udp-port", "0"], stdout=subprocess.PIPE) as server:
        assert server.stdout is not None
        yield json.loads(server.stdout.readline())["join"]
        server.terminate()


def alice(t: float) -> np.ndarray:
    """(3,) m: where Alice is, in her own axes, y up."""
    return np.array([2.0 * np.sin(0.5 * t), 0.05 * np.sin(9.0 * t), -2.0 * np.sin(0.8 * t)])


def bob(t: float) -> np.ndarray:
    """(3,) m: where Bob is, in Alice's axes."""
    return np.array([3.0 * np.cos(0.4 * t), 0.05 * np.cos(8.0 * t), -2.0 * np.sin(0.6 * t)])


def bob_in_his_own_frame(t: float) -> np.ndarray:
    """(3,) m: the same in Bob's axes; his SLAM began 3 m away, turned by 90 degrees."""
    x, y, z = bob(t) - [3.0, 0.0, 0.0]
    return np.array([-z, y, x])


if __name__ == "__main__":
    main()
