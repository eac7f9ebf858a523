#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The definitions of interfaces/ are those of the sourced ROS 2: the same fields, types, defaults
and constants in the same order. Run by scripts/test-ros2; exit status 77 without a ROS 2."""

import os
import pathlib
import re
import sys

INTERFACES = pathlib.Path(__file__).resolve().parents[3] / "interfaces"
OURS = {"agnocast_test_msgs"}  # ROS 2 does not have it


def meaning_of(path):
    """The lines of a definition without comments and spacing."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        # A # in quotes is part of a default.
        line = re.match(r"""(?:[^#"']|"[^"]*"|'[^']*')*""", line).group()
        line = re.sub(r"\s*=\s*", "=", " ".join(line.split()))
        if line:
            lines.append(line)
    return lines


def installed(package, relative):
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":"):
        path = pathlib.Path(prefix) / "share" / package / relative
        if prefix and path.exists():
            return path
    return None


def main():
    if "ROS_DISTRO" not in os.environ:
        print("SKIPPED: no ROS 2 is sourced")
        return 77
    compared, wrong, missing = 0, 0, {}
    for package in sorted(path for path in INTERFACES.iterdir() if path.is_dir()):
        if package.name in OURS:
            continue
        for kind in ("msg", "srv", "action"):
            for ours in sorted(package.glob(f"{kind}/*.{kind}")):
                theirs = installed(package.name, ours.relative_to(package))
                if theirs is None:
                    missing[package.name] = missing.get(package.name, 0) + 1
                    continue
                compared += 1
                if meaning_of(ours) != meaning_of(theirs):
                    wrong += 1
                    print(f"{ours.relative_to(INTERFACES)} differs from {theirs}")
    for package, count in missing.items():
        print(f"not compared: {package}, {count} definitions: this ROS 2 does not have them")
    print(f"{compared} definitions compared, {wrong} differ")
    return 1 if wrong or not compared else 0


if __name__ == "__main__":
    sys.exit(main())
