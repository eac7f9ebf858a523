#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""CDR (XCDR1) of the values in golden samples, from their own schemas: independent of bridge/, to
test it.

  encode.py --check FILE…        checks that each file's bytes encode its value
  encode.py --big-endian FILE…   prints a line for each: its name, its value as big-endian bytes
  encode.py --fill FILE…         writes length and cdr_hex into files that have schema and value

A folder stands for each *.json in it that has a schema. Format: docs/bridge.md.
"""
import json
import pathlib
import re
import struct
import sys

FORMATS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float32": "f",
    "float64": "d",
}


class Encoder:
    def __init__(self, schema, is_big_endian):
        self.schema = schema
        self.order = ">" if is_big_endian else "<"
        self.bytes = bytearray()

    def number(self, code, value):
        raw = struct.pack(self.order + code, value)
        self.bytes += bytes(-len(self.bytes) % len(raw)) + raw

    def one(self, kind, value):
        kind = kind.split("<=")[0]
        if kind == "string":
            raw = value.encode() + b"\0"
            self.number("I", len(raw))
            self.bytes += raw
        elif kind == "wstring":
            units = value.encode("utf-16-le")
            self.number("I", len(units) // 2)
            for unit in struct.unpack("<%dH" % (len(units) // 2), units):
                self.number("I", unit)
        elif kind in FORMATS:
            self.number(FORMATS[kind], float(value) if kind.startswith("float") else value)
        else:
            for name, field in self.schema[kind]:
                self.field(field, value[name])

    def field(self, kind, value):
        array = re.fullmatch(r"(.*)\[(.*)\]", kind)
        if not array:
            return self.one(kind, value)
        if array[2].isdigit():
            assert len(value) == int(array[2]), "%s has %d elements" % (kind, len(value))
        else:
            self.number("I", len(value))
        for element in value:
            self.one(array[1], element)


def encode(sample, is_big_endian=False):
    encoder = Encoder(sample["schema"], is_big_endian)
    encoder.one(sample["ros_type"], sample["value"])
    return bytes([0, 0 if is_big_endian else 1, 0, 0]) + bytes(encoder.bytes)


def as_text(sample):
    """Returns a line for each key, and for each type of the schema."""
    lines = []
    for key, value in sample.items():
        if key == "schema":
            types = ",\n".join(
                "    %s: %s" % (json.dumps(name), json.dumps(fields))
                for name, fields in value.items()
            )
            lines.append('  "schema": {\n%s\n  }' % types)
        else:
            lines.append("  %s: %s" % (json.dumps(key), json.dumps(value)))
    return "{\n" + ",\n".join(lines) + "\n}\n"


def main():
    if len(sys.argv) < 3 or sys.argv[1] not in ("--check", "--big-endian", "--fill"):
        sys.exit(__doc__)
    mode = sys.argv[1]
    paths = [
        path
        for name in map(pathlib.Path, sys.argv[2:])
        for path in (sorted(name.glob("*.json")) if name.is_dir() else [name])
    ]
    count = wrong = 0
    for path in paths:
        sample = json.loads(path.read_text())
        if "schema" not in sample:
            continue
        count += 1
        if mode == "--big-endian":
            print(sample["name"], encode(sample, True).hex())
            continue
        raw = encode(sample)
        if mode == "--fill":
            sample["length"], sample["cdr_hex"] = len(raw), raw.hex()
            path.write_text(as_text(sample))
        elif raw.hex() != sample["cdr_hex"] or len(raw) != sample["length"]:
            wrong += 1
            print(
                "%s: %s is written, the value makes %s" % (path.name, sample["cdr_hex"], raw.hex())
            )
    if mode == "--check":
        print("%d of %d samples are what their values make" % (count - wrong, count))
    sys.exit(1 if wrong or not count else 0)


main()
