# SPDX-License-Identifier: Apache-2.0
#
# Goal: what launch files of each format start has the heap hook, keeps its own prefix, works, and
# ends with Ctrl-C. Method: `ros2 launch` on the files in launch/, demo nodes and the talker of
# agnocast beside a real daemon; the hook is looked for in /proc.
import os
import pathlib
import re
import signal
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test"))
import processes
from processes import eventually

processes.require(modules=["agnocast_launch", "launch_ros", "launch_xml", "launch_yaml"],
                  programs=["ros2", "agnocastd", "agnocast-run", "talker", "taskset"])
FILES = pathlib.Path(__file__).resolve().parent / "launch"
daemon = None


def setUpModule():
    global daemon
    daemon = processes.Daemon()


def tearDownModule():
    daemon.stop()


# A shell has its background processes ignore SIGINT, and these hand that on to what they launch,
# which then cannot be ended so.
signal.signal(signal.SIGINT, signal.default_int_handler)


class LaunchTest(unittest.TestCase):
    def launch(self, *words, environment=None):
        """Starts `ros2 launch`; its processes end with the test, and have time to shut down."""
        timeouts = [f"{name}_timeout:={processes.PATIENCE_S}" for name in ("sigterm", "sigkill")]
        launched = processes.Program("ros2", "launch", *map(str, words), *timeouts,
                                     environment=environment)
        self.addCleanup(launched.__exit__)
        return launched

    def pid_of(self, launched, name, program):
        """Returns the process of this name in the log of launch once it runs the program."""
        found = launched.wait_for(rf"\[{name}-\d+\]: process started with pid \[(\d+)\]")
        pid = int(found.group(1))
        processes.wait_for_program(pid, program)
        return pid

    def expect_hook(self, pid):
        eventually(lambda: processes.has_hook(pid), f"process {pid} has the heap hook")
        preloaded = processes.environment_of(pid)["LD_PRELOAD"].split(":")
        hooks = [path for path in preloaded if os.path.basename(path) == processes.HOOK]
        self.assertEqual(len(hooks), 1, preloaded)

    def expect_no_hook(self, launched, pid, name):
        launched.wait_for(rf"^\[{name}-\d+\] .*Hello World: 1")
        self.assertFalse(processes.has_hook(pid))
        self.assertNotIn("LD_PRELOAD", processes.environment_of(pid))

    def end(self, launched, pids, nodes):
        """Ends the launch as Ctrl-C does: the processes are gone, the nodes have shut down."""
        self.assertEqual(launched.interrupt(), 0, launched.output())
        for pid in pids:
            self.assertFalse(os.path.exists(f"/proc/{pid}"), launched.output())
        for pid in nodes:
            self.assertRegex(launched.output(), rf"process has finished cleanly \[pid {pid}\]")

    def test_each_action_of_a_python_file(self):
        launched = self.launch(FILES / "nodes.launch.py")
        nodes = [self.pid_of(launched, name, name)
                 for name in ("listener", "lifecycle_talker", "component_container")]
        talker = self.pid_of(launched, "talker", "talker")
        for pid in (*nodes, talker):
            self.expect_hook(pid)
        launched.wait_for(r"Loaded node '/mouth' in container '/container'")
        launched.wait_for(r"^\[listener-1\] .*\[ear\]: I heard: \[Hello World")
        launched.wait_for(r"^\[listener-4\] I heard: 'Hello World")
        self.end(launched, [*nodes, talker], nodes)

    def frontend(self, file):
        launched = self.launch(FILES / file)
        ear = self.pid_of(launched, "agnocast-run", "listener")
        container = self.pid_of(launched, "env", "component_container")
        talker = int(re.findall(r"\[agnocast-run-\d+\]: process started with pid \[(\d+)\]",
                                launched.wait_for(r"(?s).*\[agnocast-run-4\]: .*").group(0))[-1])
        processes.wait_for_program(talker, "talker")
        for pid in (ear, container, talker):
            self.expect_hook(pid)
        self.assertEqual(processes.environment_of(container)["KEPT"], "1")
        launched.wait_for(r"Loaded node '/mouth' in container '/container'")
        launched.wait_for(r"\[ear\]: I heard: \[Hello World")
        launched.wait_for(r"^\[listener-3\] I heard: 'Hello World")
        self.end(launched, [ear, container, talker], [ear, container])

    def test_the_prefix_of_an_xml_file(self):
        self.frontend("nodes.launch.xml")

    def test_the_prefix_of_a_yaml_file(self):
        self.frontend("nodes.launch.yaml")

    def test_prefixes_of_a_file_are_kept(self):
        launched = self.launch(FILES / "prefixes.launch.py")
        names = ("pinned", "inside", "argument", "preloads")
        pids = {name: self.pid_of(launched, name, "talker") for name in names}
        for pid in pids.values():
            self.expect_hook(pid)
        self.assertRegex(launched.output(), r"cmd='\S*/agnocast-run taskset -c \d+ \S*/talker ")
        self.assertEqual(os.sched_getaffinity(pids["pinned"]), {min(os.sched_getaffinity(0))})
        self.assertEqual(processes.environment_of(pids["inside"])["INSIDE"], "1")
        self.assertRegex(processes.environment_of(pids["preloads"])["LD_PRELOAD"], r":libm\.so\.6$")
        for name in names:
            launched.wait_for(rf"^\[{name}-\d+\] .*Hello World: 1")
        self.end(launched, pids.values(), pids.values())

    def test_prefix_and_filter_of_the_command_line_are_kept(self):
        launched = self.launch("--launch-prefix", "env KEPT=1", "--launch-prefix-filter",
                               "lifecycle_.*", FILES / "nodes.launch.py")
        with_prefix = self.pid_of(launched, "env", "lifecycle_talker")
        without = self.pid_of(launched, "listener", "listener")
        for pid in (with_prefix, without):
            self.expect_hook(pid)
        self.assertEqual(processes.environment_of(with_prefix)["KEPT"], "1")
        self.assertNotIn("KEPT", processes.environment_of(without))

    def test_the_prefix_of_the_command_line_serves_any_launch_file(self):
        launched = self.launch("--launch-prefix", "agnocast-run", "demo_nodes_cpp",
                               "talker_listener.launch.py")
        launched.wait_for(r"\[listener\]: I heard: \[Hello World")
        pids = [int(pid) for pid in re.findall(r"process started with pid \[(\d+)\]",
                                               launched.output())]
        self.assertEqual(len(pids), 2)
        for pid in pids:
            self.expect_hook(pid)
        self.end(launched, pids, pids)

    def test_switched_off_for_one_node_or_by_an_action(self):
        launched = self.launch(FILES / "off.launch.py")
        pids = {name: self.pid_of(launched, name, "talker") for name in ("one", "other", "later")}
        self.expect_hook(pids["other"])
        self.expect_no_hook(launched, pids["one"], "one")
        self.expect_no_hook(launched, pids["later"], "later")

    def test_switched_off_agnocast_run_is_not_needed(self):
        launched = self.launch(FILES / "off.launch.py", environment={
            **os.environ, "AGNOCAST": "off", "PATH": processes.path_without("agnocast-run")})
        pids = {name: self.pid_of(launched, name, "talker") for name in ("one", "other", "later")}
        for name, pid in pids.items():
            self.expect_no_hook(launched, pid, name)
        self.end(launched, pids.values(), pids.values())

    def test_a_missing_agnocast_run_ends_the_launch_with_a_remedy(self):
        launched = self.launch(FILES / "prefixes.launch.py", environment={
            **os.environ, "PATH": processes.path_without("agnocast-run")})
        self.assertEqual(launched.status(), 1, launched.output())
        self.assertRegex(launched.output(),
                         r"pinned-1: there is no agnocast-run in its PATH \(.+\)\nhint: source")
        self.assertNotIn("process started", launched.output())


if __name__ == "__main__":
    unittest.main()
