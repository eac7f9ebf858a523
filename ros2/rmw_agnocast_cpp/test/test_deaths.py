# SPDX-License-Identifier: Apache-2.0
#
# Goal: nodes that are killed at any moment leave nothing behind: the others go on, the graph has
# nobody who is dead, and the daemon's tables are sound. Method: ROS 2's demo nodes in C++ and
# Python, as they are, beside a real daemon; SIGKILL at times between the start of a process and its
# work, from a seed that is printed.
import json
import os
import pathlib
import random
import re
import subprocess
import sys
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test"))
import processes
from test_demos import node, setUpModule, tearDownModule  # noqa: F401 (unittest looks for them)

KILLS = 40
# They start, connect, create and begin to work within this time.
LIFE_MAX_S = 1.5


def nodes():
    """Returns the processes of the nodes that the daemon has, as (name, pid)."""
    done = subprocess.run(["agnocast-ctl", "node", "list", "-j"], capture_output=True, text=True,
                          check=True)
    return {(one["name"], one["pid"]) for one in json.loads(done.stdout)["nodes"]}


class DeathsTest(unittest.TestCase):
    def expect_soundness(self):
        done = subprocess.run(["agnocast-ctl", "verify"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def test_the_others_go_on(self):
        seed = int(os.environ.get("AGNOCAST_SEED", time.time_ns() % 1_000_000))
        print(f"AGNOCAST_SEED={seed}", flush=True)
        chance = random.Random(seed)
        mortal = [("demo_nodes_cpp", "talker"), ("demo_nodes_py", "talker"),
                  ("demo_nodes_cpp", "listener"), ("demo_nodes_py", "listener"),
                  ("demo_nodes_cpp", "add_two_ints_server"),
                  ("demo_nodes_py", "add_two_ints_client"),
                  ("demo_nodes_cpp", "parameter_events_async"),
                  ("action_tutorials_cpp", "fibonacci_action_server"),
                  ("action_tutorials_py", "fibonacci_action_client")]
        with node("demo_nodes_cpp", "talker", "--ros-args", "-r", "__node:=stays") as talker, \
                node("demo_nodes_py", "listener", "--ros-args", "-r",
                     "__node:=hears") as listener, \
                node("demo_nodes_cpp", "add_two_ints_server", "--ros-args", "-r",
                     "__node:=serves") as server:
            listener.wait_for("I heard")
            for _ in range(KILLS // 4):
                several = [node(*chance.choice(mortal)) for _ in range(4)]
                try:
                    time.sleep(chance.random() * LIFE_MAX_S)
                finally:
                    for one in several:
                        one.__exit__()
                dead = {one.process.pid for one in several}
                processes.eventually(lambda: not dead & {pid for _, pid in nodes()},
                                     "the dead are out of the graph")
                self.expect_soundness()
            # The nodes that stayed work on, with each other and with new ones.
            last = int(re.findall(r"Hello World: (\d+)", talker.output())[-1])
            listener.wait_for(rf"I heard: \[Hello World: {last + 3}\]")
            with node("demo_nodes_py", "add_two_ints_client") as client:
                client.wait_for(r"[Rr]esult of add_two_ints: (for 2 \+ 3 = )?5")
            self.assertIsNone(server.process.poll())
            processes.eventually(lambda: len(nodes()) == 3, "only those that stayed are there")
            self.expect_soundness()


if __name__ == "__main__":
    unittest.main()
