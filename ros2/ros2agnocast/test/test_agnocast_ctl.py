# SPDX-License-Identifier: Apache-2.0
#
# Goal: the process becomes agnocast-ctl, with each word as it was typed and with the signals that a
# shell gives its children. Method: an agnocast-ctl in a temporary folder prints what it gets; a
# parser with a subcommand stands for that of ros2.
import argparse
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import unittest

PACKAGE = str(pathlib.Path(__file__).resolve().parents[1])
sys.path.insert(0, PACKAGE)
from ros2agnocast import agnocast_ctl

COMMAND_LINE = """
import argparse, sys
sys.path.insert(0, sys.argv.pop(1))
from ros2agnocast import agnocast_ctl
parser = argparse.ArgumentParser(prog="ros2")
parser.add_argument("--use-python-default-buffering", action="store_true")
agnocast_ctl.add_words(parser.add_subparsers().add_parser("agnocast"))
print("before")
agnocast_ctl.become(parser.parse_args().words)
"""
# Prints the words between brackets, then the set of signals that it ignores.
PROGRAM = """#!/bin/sh
[ "$1" != --complete ] || { shift; printf '%s+\\n' "$@"; exit 0; }
printf '[%s]' "$@"
sed -n 's/^SigIgn:./ /p' /proc/$$/status
exit 37
"""


class AgnocastCtlTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.program = os.path.join(folder.name, "agnocast-ctl")
        pathlib.Path(self.program).write_text(PROGRAM, encoding="utf-8")
        os.chmod(self.program, 0o755)
        before = os.environ["PATH"]
        self.addCleanup(os.environ.__setitem__, "PATH", before)
        os.environ["PATH"] = f"{folder.name}:/usr/bin:/bin"

    def run_(self, *words):
        return subprocess.run([sys.executable, "-c", COMMAND_LINE, PACKAGE, *words],
                              capture_output=True, text=True)

    def test_every_word_and_the_status_are_passed_on(self):
        for words in (["topic", "list"], ["-j", "topic", "list"], ["--help"], ["-h"],
                      ["topic", "-h"], ["topic", "pub", "/x", "T", "--", "-5"], ["--", "--"],
                      ["explain", ""], ["access", "/x", "--user", "alice"], ["--use", "x"],
                      ["two words", "a\nb"]):
            done = self.run_("agnocast", *words)
            self.assertEqual(done.returncode, 37, done.stderr)
            self.assertTrue(done.stdout.startswith(
                "before\n" + "".join(f"[{word}]" for word in words) + " "), done.stdout)

    def test_without_words_it_prints_the_help(self):
        self.assertTrue(self.run_("agnocast").stdout.startswith("before\n[--help] "))

    def test_it_does_not_ignore_the_signals_that_python_ignores(self):
        ignored = int(self.run_("agnocast", "status").stdout.split()[-1], 16)
        for number in (signal.SIGPIPE, signal.SIGXFSZ):
            self.assertEqual(ignored >> (number - 1) & 1, 0, number)

    def test_the_words_at_the_cursor_are_those_of_agnocast_ctl(self):
        typed = argparse.Namespace(words=["topic", "info"])
        self.assertEqual(agnocast_ctl.completions("/po", typed, action=None),
                         ["topic+", "info+", "/po+"])
        self.assertEqual(agnocast_ctl.completions("", argparse.Namespace(words=None)), ["+"])

    def test_a_missing_agnocast_ctl_has_a_remedy_and_no_completions(self):
        os.remove(self.program)
        with self.assertRaises(agnocast_ctl.AgnocastCtlNotFound) as raised:
            agnocast_ctl.become(["status"])
        self.assertRegex(str(raised.exception),
                         r"^ros2 agnocast: there is no agnocast-ctl in PATH\nhint: source ")
        self.assertEqual(agnocast_ctl.completions("", argparse.Namespace(words=[])), [])


if __name__ == "__main__":
    unittest.main()
