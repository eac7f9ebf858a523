# SPDX-License-Identifier: Apache-2.0
#
# Goal: `ros2 agnocast` and agnocast-ctl are one program: output, errors, status, terminal, signals
# and completion. Method: both with the same words, beside a real daemon and a talker.
import importlib.util
import os
import pathlib
import pty
import subprocess
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test"))
import processes

processes.require(modules=["ros2agnocast", "ros2cli"],
                  programs=["ros2", "agnocastd", "agnocast-ctl", "agnocast-run", "talker"])
daemon = talker = None


def setUpModule():
    global daemon, talker
    daemon = processes.Daemon()
    talker = processes.Program("agnocast-run", "talker", "--verbose")
    talker.wait_for("Hello World: 1")


def tearDownModule():
    talker.__exit__()
    daemon.stop()


def run(*words, **arguments):
    return subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                          timeout=processes.PATIENCE_S, **arguments)


def run_in_terminal(*words):
    """Returns what the program prints in a terminal."""
    ours, its = pty.openpty()
    process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=its, stderr=its)
    os.close(its)
    printed = b""
    try:
        while True:
            printed += os.read(ours, 65536)
    except OSError:  # the program has closed the terminal
        pass
    os.close(ours)
    process.wait(processes.PATIENCE_S)
    return printed


class Ros2AgnocastTest(unittest.TestCase):
    def expect_same(self, *words):
        ros2, ctl = run("ros2", "agnocast", *words), run("agnocast-ctl", *words)
        self.assertEqual((ros2.returncode, ros2.stdout, ros2.stderr),
                         (ctl.returncode, ctl.stdout, ctl.stderr))
        return ros2

    def test_answers_are_those_of_agnocast_ctl(self):
        self.assertIn("/chatter", self.expect_same("topic", "list").stdout)
        self.assertIn("std_msgs/msg/String", self.expect_same("topic", "list", "-t").stdout)
        self.assertIn('"agnocast.topic-list/1"', self.expect_same("-j", "topic", "list").stdout)
        self.assertIn("/talker", self.expect_same("nodes").stdout)
        self.assertIn("Publishers", self.expect_same("node", "info", "/talker").stdout)
        self.assertIn("remedy", self.expect_same("explain", "hook_missing").stdout.lower())

    def test_errors_and_their_status_are_those_of_agnocast_ctl(self):
        self.assertEqual(self.expect_same("topic", "type", "/nothing").returncode, 4)
        self.assertEqual(self.expect_same("topic", "list", "--nothing").returncode, 2)
        self.assertEqual(self.expect_same("nothing").returncode, 2)
        self.assertEqual(self.expect_same("explain", "").returncode, 2)
        self.assertEqual(self.expect_same("status", "--socket", "/nonexistent").returncode, 3)

    def test_help_is_that_of_agnocast_ctl(self):
        ctl = run("agnocast-ctl", "--help").stdout
        self.assertIn("topic hz NAME", ctl)
        for words in ([], ["-h"], ["--help"]):
            ros2 = run("ros2", "agnocast", *words)
            self.assertEqual((ros2.returncode, ros2.stdout), (0, ctl))
        self.assertIn("--verbose", self.expect_same("topic", "info", "--help").stdout)
        self.assertRegex(run("ros2", "--help").stdout, r"\n +agnocast +Inspect agnocast")

    def test_it_writes_to_the_terminal_as_agnocast_ctl_does(self):
        ctl = run_in_terminal("agnocast-ctl", "topic", "list", "-v")
        self.assertIn(b"\x1b[", ctl)  # headings are bold
        self.assertEqual(run_in_terminal("ros2", "agnocast", "topic", "list", "-v"), ctl)

    def test_the_process_becomes_agnocast_ctl_and_ends_with_ctrl_c(self):
        with processes.Program("ros2", "agnocast", "topic", "hz", "/chatter") as ros2, \
                processes.Program("agnocast-ctl", "topic", "hz", "/chatter") as ctl:
            processes.wait_for_program(ros2.process.pid, "agnocast-ctl")
            for program in (ros2, ctl):
                program.wait_for("average rate")
            self.assertEqual(ros2.interrupt(), ctl.interrupt())

    def test_a_missing_agnocast_ctl_has_a_remedy(self):
        done = run("ros2", "agnocast", "topic", "list", env={
            **os.environ, "PATH": processes.path_without("agnocast-ctl")})
        self.assertEqual((done.returncode, done.stdout), (1, ""))
        self.assertRegex(done.stderr, r"^ros2 agnocast: there is no agnocast-ctl in PATH\nhint: ")

    @unittest.skipUnless(importlib.util.find_spec("argcomplete"), "there is no argcomplete")
    def test_the_tab_key_offers_the_words_of_agnocast_ctl(self):
        def offered(line):
            # The variables are those of argcomplete's shell function; it reads descriptor 8.
            done = run("bash", "-c", "exec ros2 8>&1 9>/dev/null >/dev/null 2>&1", env={
                **os.environ, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_TYPE": "9",
                "COMP_LINE": line, "COMP_POINT": str(len(line))})
            return {word.strip() for word in done.stdout.split("\n")} - {""}
        self.assertIn("agnocast", offered("ros2 agn"))
        for typed in ([""], ["topic", ""], ["topic", "li"], ["topic", "info", "/ch"],
                      ["topic", "list", "--co"], ["-j", "topic", ""]):
            expected = set(run("agnocast-ctl", "--complete", *typed).stdout.split())
            self.assertTrue(expected, typed)
            self.assertEqual(offered("ros2 agnocast " + " ".join(typed)), expected)


if __name__ == "__main__":
    unittest.main()
