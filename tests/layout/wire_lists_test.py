#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
#
# Goal: the lists of the wire that are kept by hand lack nothing. Method: compares the names of the
# opcodes and packets in wire.hpp and observe.hpp with the fingerprint (which changes with no value
# that it does not list), the requests with the table in the head of wire.hpp or observe.hpp, the
# decoder and the fuzz target's list.
import os
import re
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
ABI = "include/agnocast/abi"


def text(path):
    with open(os.path.join(ROOT, path), encoding="utf-8") as source:
        return source.read()


def column(header, number):
    """Returns the words of a column of the tables in the comment at the beginning; of the answers,
    also of further lines."""
    found = set()
    for line in text(f"{ABI}/{header}.hpp").split("#pragma once")[0].splitlines():
        if row := re.match(r"//   (\S.*)", line):
            line = (re.split(r"\s{2,}", row.group(1)) + 3 * [""])[number]
        elif number == 0 or not line.startswith("//    "):
            continue
        found |= set(re.findall(r"[a-z_]+", line))
    return found


class WireLists(unittest.TestCase):
    def setUp(self):
        enumeration = re.search(
            r"enum class Opcode[^{]*\{(.*?)\};", text(f"{ABI}/wire.hpp"), re.S
        ).group(1)
        self.numbers = {
            name: int(number) for name, number in re.findall(r"(\w+) = (\d+)", enumeration)
        }
        self.opcodes = set(self.numbers)
        self.requests = {name for name, number in self.numbers.items() if number < 100}
        self.assertGreater(len(self.requests), 20)
        self.assertGreater(len(self.opcodes), 2 * len(self.requests) - 1)

    def test_the_fingerprint_has_every_opcode_and_packet(self):
        fingerprint = text(f"{ABI}/fingerprint.hpp")
        self.assertEqual(self.opcodes - set(re.findall(r"\bOpcode::(\w+)", fingerprint)), set())
        packets = {
            name
            for header in ("wire", "observe")
            for name in re.findall(r"^struct (\w+) \{", text(f"{ABI}/{header}.hpp"), re.M)
        }
        packets.remove("Name")  # name_bytes
        self.assertGreater(len(packets), 40)
        self.assertEqual(packets - set(re.findall(r"sizeof\(wire::(\w+)\)", fingerprint)), set())

    def test_the_tables_have_every_opcode(self):
        named = column("wire", 0) | column("observe", 0)
        answers = {name for name in self.opcodes if 100 <= self.numbers[name] < 200}
        self.assertEqual(self.opcodes - answers - named, set())
        self.assertEqual(answers - column("wire", 2) - column("observe", 2), set())

    def test_the_decoder_and_the_fuzz_target_have_every_request(self):
        rows = set(
            re.findall(
                r"\{(?:wire::)?Opcode::(\w+), *sizeof", text("daemon/transport/request_reading.cpp")
            )
        )
        self.assertEqual(self.requests - rows, set())
        rows = set(re.findall(r"\{Opcode::(\w+), sizeof", text("tests/fuzz/protocol/scenario.cpp")))
        # Without its descriptor it would only be refused.
        self.assertEqual(self.requests - rows, {"bring_window"})


if __name__ == "__main__":
    unittest.main()
