# SPDX-License-Identifier: Apache-2.0
#
# Goal: unchanged nodes in C++ and Python, and the `ros2` command, work over rmw_agnocast_cpp, and a
# node that dies is gone. Method: ROS 2's demo nodes and tools as they are, beside a real daemon.
import os
import pathlib
import re
import subprocess
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test"))
import processes

processes.require(modules=["rclpy", "ros2cli", "ros2node", "ros2topic", "ros2service", "ros2param"],
                  programs=["ros2", "agnocastd"])
daemon = None


def run(*words):
    return subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                          timeout=processes.PATIENCE_S)


def node(package, program, *arguments):
    """Starts a demo node itself: `ros2 run` would not pass a signal on."""
    found = run("ros2", "pkg", "prefix", package)
    if found.returncode != 0:
        raise unittest.SkipTest(f"package {package} is not found")
    return processes.Program(f"{found.stdout.strip()}/lib/{package}/{program}", *arguments)


def setUpModule():
    global daemon
    os.environ["RMW_IMPLEMENTATION"] = "rmw_agnocast_cpp"
    found = run(sys.executable, "-c",
                "import rclpy.utilities as u; print(u.get_rmw_implementation_identifier())")
    if "Expected RMW implementation identifier" in found.stderr:
        raise unittest.SkipTest("rmw_implementation was built with one rmw")
    assert found.stdout.strip() == "rmw_agnocast_cpp", found.stdout + found.stderr
    daemon = processes.Daemon()


def tearDownModule():
    daemon.stop()
    del os.environ["RMW_IMPLEMENTATION"]


class DemosTest(unittest.TestCase):
    def answer(self, *words):
        """Returns what a command of ros2 prints, without its daemon."""
        done = run("ros2", *words)
        self.assertEqual(done.returncode, 0, f"{words}: {done.stdout}{done.stderr}")
        return done.stdout

    def test_talkers_and_listeners_in_both_languages_hear_each_other(self):
        for packages in (("demo_nodes_cpp", "demo_nodes_cpp"), ("demo_nodes_cpp", "demo_nodes_py"),
                         ("demo_nodes_py", "demo_nodes_cpp"), ("demo_nodes_py", "demo_nodes_py")):
            with self.subTest(packages=packages), node(packages[0], "talker"), \
                    node(packages[1], "listener") as listener:
                first = int(listener.wait_for(r"I heard: \[Hello World: (\d+)\]").group(1))
                listener.wait_for(rf"Hello World: {first + 3}\b")
                heard = [int(n) for n in re.findall(r"Hello World: (\d+)", listener.output())]
                self.assertEqual(heard, list(range(heard[0], heard[0] + len(heard))))

    def test_a_service_answers(self):
        for packages in (("demo_nodes_cpp", "demo_nodes_py"), ("demo_nodes_py", "demo_nodes_cpp")):
            with self.subTest(packages=packages), node(packages[0], "add_two_ints_server"), \
                    node(packages[1], "add_two_ints_client") as client:
                client.wait_for(r"[Rr]esult of add_two_ints: (for 2 \+ 3 = )?5")
        with node("demo_nodes_cpp", "add_two_ints_server"):
            self.assertIn("sum=42", self.answer("service", "call", "/add_two_ints",
                                                "example_interfaces/srv/AddTwoInts",
                                                "{a: 40, b: 2}"))

    def test_the_commands_of_ros2_see_the_nodes(self):
        with node("demo_nodes_cpp", "talker") as talker, node("demo_nodes_py", "listener") as other:
            other.wait_for("I heard")
            nodes = self.answer("node", "list", "--no-daemon").split()
            self.assertLessEqual({"/talker", "/listener"}, set(nodes))
            self.assertEqual(len(nodes), len(set(nodes)))
            info = self.answer("node", "info", "/talker", "--no-daemon")
            for words in ("/chatter: std_msgs/msg/String", "/talker/get_parameters", "/rosout"):
                self.assertIn(words, info)
            topic = self.answer("topic", "info", "-v", "/chatter", "--no-daemon")
            self.assertIn("Publisher count: 1", topic)
            self.assertIn("Subscription count: 1", topic)
            self.assertIn("/chatter [std_msgs/msg/String]",
                          self.answer("topic", "list", "-t", "--no-daemon"))
            self.assertIn("Hello World", self.answer("topic", "echo", "--once", "/chatter",
                                                     "std_msgs/msg/String"))
            self.assertIn("Boolean value is: False",
                          self.answer("param", "get", "/talker", "use_sim_time"))
            talker.__exit__()
            self.assertNotIn("/talker\n", self.answer("node", "list", "--no-daemon"))
            self.assertIn("Publisher count: 0",
                          self.answer("topic", "info", "/chatter", "--no-daemon"))


if __name__ == "__main__":
    unittest.main()
