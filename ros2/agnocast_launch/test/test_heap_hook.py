# SPDX-License-Identifier: Apache-2.0
#
# Goal: a command starts with agnocast-run of its own PATH, in front of everything, once, and not at
# all where agnocast is switched off. Method: values; an agnocast-run in a temporary folder.
import os
import pathlib
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
from agnocast_launch.heap_hook import AgnocastRunNotFound, words_in_front


class HeapHookTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name
        self.run = os.path.join(self.folder, "agnocast-run")
        pathlib.Path(self.run).write_text("#!/bin/sh\n", encoding="utf-8")
        os.chmod(self.run, 0o755)
        self.environment = {"PATH": f"/nonexistent:{self.folder}"}

    def test_the_agnocast_run_of_the_path_is_put_in_front(self):
        self.assertEqual(words_in_front("lidar-1", [], self.environment), [self.run])

    def test_a_prefix_stays_behind_it(self):
        for prefix in (["gdb", "--args"], ["taskset", "-c", "1"], ["not-agnocast-run"]):
            self.assertEqual(words_in_front("lidar-1", prefix, self.environment), [self.run])

    def test_a_prefix_that_contains_it_is_left_alone(self):
        for prefix in (["agnocast-run"],
                       ["sudo", "-E", "/opt/bin/agnocast-run", "--scope", "all"]):
            self.assertEqual(words_in_front("lidar-1", prefix, self.environment), [])
            self.assertEqual(words_in_front("lidar-1", prefix, {"PATH": "/nonexistent"}), [])

    def test_switched_off_it_is_neither_added_nor_needed(self):
        for path in (self.folder, "/nonexistent"):
            environment = {"AGNOCAST": "off", "PATH": path}
            self.assertEqual(words_in_front("lidar-1", [], environment), [])

    def test_only_off_switches_off(self):
        for value in ("", "on", "OFF", "0"):
            environment = {**self.environment, "AGNOCAST": value}
            self.assertEqual(words_in_front("lidar-1", [], environment), [self.run])

    def test_the_error_says_which_process_where_and_what_to_do(self):
        with self.assertRaises(AgnocastRunNotFound) as raised:
            words_in_front("lidar-1", [], {"PATH": "/nonexistent"})
        text = str(raised.exception)
        self.assertRegex(text, r"^lidar-1: there is no agnocast-run in its PATH \(/nonexistent\)\n")
        self.assertRegex(text, r"\nhint: source the setup.bash .*; AGNOCAST=off starts the process")

    def test_a_file_that_cannot_be_executed_is_not_taken(self):
        os.chmod(self.run, 0o644)
        with self.assertRaises(AgnocastRunNotFound):
            words_in_front("lidar-1", [], self.environment)

    def test_without_a_path_that_of_the_launch_process_counts(self):
        before = os.environ["PATH"]
        self.addCleanup(os.environ.__setitem__, "PATH", before)
        os.environ["PATH"] = self.folder
        self.assertEqual(words_in_front("lidar-1", [], {}), [self.run])


if __name__ == "__main__":
    unittest.main()
