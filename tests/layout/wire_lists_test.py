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


def head(path):
    """Returns the comment at the beginning."""
    return text(path).split("#pragma once")[0]


class WireLists(unittest.TestCase):
    def setUp(self):
        enumeration = re.search(r"enum class Opcode[^{]*\{(.*?)\};", text(f"{ABI}/wire.hpp"), re.S).group(1)
        numbers = {name: int(number) for name, number in re.findall(r"(\w+) = (\d+)", enumeration)}
        self.opcodes = set(numbers)
        self.requests = {name for name, number in numbers.items() if number < 100}
        self.assertGreater(len(self.requests), 20)
        self.assertGreater(len(self.opcodes), 2 * len(self.requests) - 1)

    def test_the_fingerprint_has_every_opcode_and_packet(self):
        fingerprint = text(f"{ABI}/fingerprint.hpp")
        self.assertEqual({name for name in self.opcodes if f"Opcode::{name}" not in fingerprint}, set())
        packets = {name for header in ("wire", "observe")
                   for name in re.findall(r"^struct (\w+) \{", text(f"{ABI}/{header}.hpp"), re.M)}
        packets.remove("Name")  # name_bytes
        self.assertGreater(len(packets), 40)
        self.assertEqual({name for name in packets if f"sizeof(wire::{name})" not in fingerprint}, set())

    def test_the_tables_have_every_opcode(self):
        tables = set(re.findall(r"\w+", head(f"{ABI}/wire.hpp") + head(f"{ABI}/observe.hpp")))
        self.assertEqual(self.opcodes - tables, set())

    def test_the_decoder_and_the_fuzz_target_have_every_request(self):
        for path in ("daemon/transport/request_reading.cpp", "tests/fuzz/protocol/scenario.cpp"):
            named = set(re.findall(r"Opcode::(\w+)", text(path)))
            self.assertEqual(self.requests - named, set(), path)


if __name__ == "__main__":
    unittest.main()
